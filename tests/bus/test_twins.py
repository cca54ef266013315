"""Two nodes with one name: only one takes commands, whichever met the other first."""

from collections import deque

import pytest

from cardan.bus.options import BusOptions
from cardan.bus.twins import GONE_S, MEET_S, NameClaim, Twins
from cardan.errors import ConfigurationError
from cardan.protocols.ros2.zenoh import NODE, Entity

NAME = "/left/arm"


class Bus:
    """Liveliness tokens and their subscribers, matched by prefix alone like in Zenoh."""

    def __init__(self):
        self.tokens, self.watches = {}, []

    def declare(self, key):
        self.tokens[key] = True
        for watch in self.watches:
            watch.hear(key, True)

    def vanish(self, key):
        del self.tokens[key]
        for watch in self.watches:
            watch.hear(key, False)


class Watch:
    def __init__(self, bus, key):
        self.prefix, self.waiting = key.split("/")[0], deque()
        for each in bus.tokens:
            self.hear(each, True)
        bus.watches.append(self)

    def hear(self, key, there):
        if key.split("/")[0] == self.prefix:
            self.waiting.append((key, there))

    def poll(self):
        return self.waiting.popleft() if self.waiting else None


class Node:
    """A node that has joined; `appear` declares its token, and `leave` removes it."""

    namespace, name, full_name, options = "/left", "arm", NAME, BusOptions()

    def __init__(self, bus, zid):
        self.bus, self.zid, self.keys = bus, zid, []

    def watch_tokens(self, key):
        return Watch(self.bus, key)

    def declare_key_token(self, key):
        self.keys.append(key)
        self.bus.declare(key)

    def appear(self):
        self.declare_key_token(Entity(self.zid, "0", "0", NODE, "/left", "arm").token(0))

    def leave(self):
        while self.keys:
            self.bus.vanish(self.keys.pop())


class Clock:
    def __init__(self, *events):
        self.now_s, self.events = 0.0, dict(events)

    def __call__(self):
        return self.now_s

    def sleep(self, s):
        self.now_s += s
        for at_s in [each for each in self.events if each <= self.now_s]:
            self.events.pop(at_s)()


@pytest.fixture
def bus():
    return Bus()


def joined(bus, zid):
    node = Node(bus, zid)
    return node, Twins(node)


def begun(bus, zid, clock=None):
    node, twins = joined(bus, zid)
    clock = clock or Clock()
    twins.wait(clock, clock.sleep)
    twins.claim()
    node.appear()
    return node, twins


def test_a_name_that_is_free_is_taken_after_a_look(bus):
    clock = Clock()
    _, twins = begun(bus, "a1", clock)
    assert MEET_S <= clock.now_s < MEET_S + 0.1
    assert twins.state() == ("", True)


def test_who_comes_second_does_not_begin_and_says_who_has_the_name(bus):
    _, first = begun(bus, "b1")
    _, second = joined(bus, "a1")  # The id is smaller, but the first node keeps the name.
    clock = Clock()
    with pytest.raises(ConfigurationError, match=rf"another node on \S+ has the name {NAME}") as no:
        second.wait(clock, clock.sleep)
    assert no.value.key == "network.name"
    assert 'name = "left_arm"' in str(no.value)
    assert GONE_S <= clock.now_s < GONE_S + MEET_S
    assert first.state() == ("", True)


def test_a_haptic_devices_name_is_looked_at_as_well(bus):
    begun(bus, "b1")
    second = Twins(Node(bus, "a1"), "haptic")
    clock = Clock()
    with pytest.raises(ConfigurationError, match='haptic = "left_arm"') as no:
        second.wait(clock, clock.sleep)
    assert no.value.key == "network.haptic"


def test_one_that_is_met_late_in_the_look_is_found(bus):
    other, first = joined(bus, "b1")
    _, second = joined(bus, "a1")
    clock = Clock((MEET_S / 2, lambda: (first.claim(), other.appear())))
    with pytest.raises(ConfigurationError, match="has the name"):
        second.wait(clock, clock.sleep)


def test_a_node_of_another_program_has_the_name_as_well(bus):
    Node(bus, "b1").appear()
    with pytest.raises(ConfigurationError, match=f"another node has the name {NAME}"):
        begun(bus, "a1")


def test_what_a_crashed_one_has_left_is_waited_for_and_said(bus, caplog):
    gone, _ = begun(bus, "b1")
    clock = Clock((2.0, gone.leave))
    _, twins = begun(bus, "a1", clock)
    assert 2.0 <= clock.now_s < 2.1
    assert "waits up to 3 s for it to go" in caplog.text
    assert twins.state() == ("", True)


@pytest.mark.parametrize("zids", [("a1", "b1"), ("b1", "a1")])
def test_of_two_that_did_not_see_each_other_the_elder_takes_commands(bus, zids):
    elder, younger = (joined(bus, zid) for zid in zids)
    for node, twins in (younger, elder):
        twins.claim()
        node.appear()
    said, listens = elder[1].state()
    assert listens
    assert "started later and accepts no commands" in said
    said, listens = younger[1].state()
    assert not listens
    assert "this one accepts only stops from the network" in said
    elder[0].leave()
    assert younger[1].state() == ("", True)


def test_of_two_of_one_instant_exactly_one_takes_commands(bus, monkeypatch):
    monkeypatch.setattr("time.time_ns", lambda: 17)
    both = joined(bus, "a1"), joined(bus, "b1")
    for node, twins in both:
        twins.claim()
        node.appear()
    assert sorted(twins.state()[1] for _, twins in both) == [False, True]


def test_until_the_other_tells_since_when_no_command_is_taken(bus):
    _, twins = begun(bus, "a1")
    other, its = joined(bus, "b1")
    other.appear()
    assert not twins.state()[1]
    its.claim()
    assert twins.state()[1]


def test_a_claim_is_read_as_it_was_written_and_nothing_else_is():
    claim = NameClaim(5, "a1", "lab pc/1")
    assert NameClaim.parse(claim.key(3, NAME)) == NameClaim(5, "a1", "lab_pc_1")
    for each in ("", "@ros2_lv/0/a/0/0/NN", claim.key(3, NAME) + "/more", "@cardan_lv/0/n/a/-1/h"):
        assert NameClaim.parse(each) is None
