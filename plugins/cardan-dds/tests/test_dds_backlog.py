"""Messages that are delayed on their way from DDS are dropped; in virtual time, without DDS."""

from types import SimpleNamespace

import pytest

from cardan.gateway.arm.backlog import STALE_S
from cardan.gateway.servers.allow_list import Allowed
from cardan_dds import bridge as bridging
from cardan_dds.bridge import Bridge

TWIST = "geometry_msgs/msg/TwistStamped"
TOPIC = "/servo_node/delta_twist_cmds"
PERIOD_S, QUICKEST_S, AHEAD_S = 0.02, 0.004, 1e9
"""The clock of the nodes on DDS is ahead."""


class Bench:
    """A bridge with manually driven networks on both sides."""

    def __init__(self):
        self.now_s, self.passed, self.latched = 100.0, [], False
        self.sent_ns = 0
        dds = SimpleNamespace(
            watch_departures=lambda _: None,
            subscribe_from=lambda _topic, _type, heard, _history: heard,
            node_of=lambda writer: f"/{writer.guid.decode()}",
        )
        publisher = SimpleNamespace(publish=self.publish)
        client = SimpleNamespace(advertise=lambda *_: publisher)
        bus = SimpleNamespace(part=lambda *_: client, wants_history=lambda _: self.latched)
        self.bridge = Bridge(bus, dds, Allowed(("*",), (), ()))

    def publish(self, cdr, sent_ns):
        self.passed.append(cdr)
        self.sent_ns = sent_ns

    def monotonic(self):
        return self.now_s

    def subscribe(self, topic):
        return self.bridge._subscribe(topic, TWIST)

    def brings(self, heard, cdr, delay_s, writer="joystick", stamp_ns=None):
        """Deliver a message from DDS this long after its publication; return whether it was passed
        on."""
        self.now_s += PERIOD_S
        if stamp_ns is None:
            stamp_ns = round((self.now_s - delay_s + AHEAD_S) * 1e9)
        who = writer.encode()
        heard(cdr, stamp_ns, SimpleNamespace(guid=who, participant=who, transient_local=False))
        return self.passed[-1:] == [cdr]


@pytest.fixture
def bench(monkeypatch):
    bench = Bench()
    monkeypatch.setattr(bridging, "time", bench)
    return bench


def test_what_waited_for_too_long_is_dropped_and_counted_and_the_newest_counts(bench):
    heard = bench.subscribe(TOPIC)
    late_s = QUICKEST_S + STALE_S
    assert bench.brings(heard, b"1", QUICKEST_S)
    assert bench.brings(heard, b"2", late_s - 0.01)
    assert not bench.brings(heard, b"3", late_s + 0.01)
    assert not bench.brings(heard, b"4", late_s + 1.0)
    assert bench.brings(heard, b"5", QUICKEST_S)
    assert (bench.bridge.counts["stale"], bench.bridge.counts["in"]) == (2, 3)


def test_each_publisher_has_a_clock_of_its_own(bench):
    heard = bench.subscribe(TOPIC)
    assert bench.brings(heard, b"1", QUICKEST_S)
    assert bench.brings(heard, b"2", 10.0, "script")
    assert not bench.brings(heard, b"3", 10.0)
    assert bench.brings(heard, b"4", 10.0, "script")


@pytest.mark.parametrize("latched", [False, True])
def test_what_stops_and_what_is_kept_for_latecomers_is_never_too_late(bench, latched):
    bench.latched = latched
    heard = bench.subscribe(TOPIC if latched else "/arm/command/stop")
    assert bench.brings(heard, b"1", QUICKEST_S)
    assert bench.brings(heard, b"2", 10.0)
    assert bench.bridge.counts["stale"] == 0


def test_who_does_not_say_when_it_published_is_heard(bench):
    heard = bench.subscribe(TOPIC)
    for number in range(50):
        assert bench.brings(heard, bytes([number]), 0.0, stamp_ns=0)


def test_what_is_passed_on_says_when_its_writer_sent_it(bench):
    heard = bench.subscribe(TOPIC)
    assert bench.brings(heard, b"1", QUICKEST_S)
    assert bench.sent_ns == round((bench.now_s - QUICKEST_S + AHEAD_S) * 1e9)
    assert bench.brings(heard, b"2", QUICKEST_S, stamp_ns=-1)
    assert bench.sent_ns == 0
