"""Shell that serves a device in real time."""

from __future__ import annotations

import math
import selectors
import socket

import pytest

from cardan.errors import AddressError
from cardan.sim_peers import device_peer
from cardan.sim_peers.backends.base import DeviceBackend
from cardan.sim_peers.device_peer import STALL_S, DevicePeer, DevicePeerOptions


class Clock:
    """Monotonic clock that only waiting advances."""

    def __init__(self) -> None:
        self.now_s = 64.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


class Waiting(selectors.SelectSelector):
    """Waits on the clock; data that is readable then is read."""

    clock: Clock

    def select(self, timeout=None):
        ready = super().select(0)
        if not ready:
            self.clock.now_s += timeout
        return ready


class Device:
    """Device that sends a report every 0.5 s, and follows its script."""

    def __init__(self, done) -> None:
        self.plugged = True
        self.next_due_s = 0.0
        self._done = done

    def reports(self, now_s):
        reports = []
        while self.next_due_s <= now_s:
            reports.append(round(self.next_due_s, 9))
            self.next_due_s += 0.5
        return reports

    def skip_to(self, now_s):
        while self.next_due_s < now_s - 1e-9:
            self.next_due_s += 0.5


class Motion:
    """Device motion that plugs and unplugs."""

    def __init__(self, *steps) -> None:
        self._steps = list(steps)

    @property
    def next_due_s(self):
        return self._steps[0][0] if self._steps else math.inf

    def advance(self, now_s, device):
        while self.next_due_s <= now_s:
            device.plugged = self._steps.pop(0)[1]


class Noting(DeviceBackend):
    """Backend that records its calls, and runs an action at 64.75 s."""

    endpoint = "nowhere"
    there = False

    def __init__(self, clock, done) -> None:
        self._clock = clock
        self._done = done
        self._own_s = 64.75

    def note(self, *what):
        self._done.append((*what, round(self._clock.now_s, 9)))

    def appear(self):
        self.there = True
        self.note("appear")

    def vanish(self):
        if self.there:
            self.there = False
            self.note("vanish")

    def send(self, messages):
        self.note(*messages)

    @property
    def due_s(self):
        return self._own_s

    def run_due(self, now_s):
        if now_s >= self._own_s:
            self._own_s = math.inf
            self.note("run_due")


@pytest.fixture
def make(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(device_peer, "time", clock)
    monkeypatch.setattr(selectors, "SelectSelector", Waiting)
    monkeypatch.setattr(Waiting, "clock", clock, raising=False)
    peers = []

    def making(*steps, **options):
        done = []
        backend = Noting(clock, done)
        peer = DevicePeer(Device(done), Motion(*steps), backend, DevicePeerOptions(**options))
        peer.done, peer.clock = done, clock
        peers.append(peer)
        return peer

    yield making
    for peer in peers:
        peer.close()


def opened(peer):
    peer.open()
    del peer.done[:]
    return peer


def test_nothing_is_played_before_the_script_starts(make):
    peer = make()
    peer.open()
    peer.step(64.5)
    assert peer.done == [("appear", 64.0)]
    assert peer.device_s() == 0.0


def test_each_is_served_when_it_is_due(make):
    peer = opened(make())
    peer.begin()
    peer.step(65.25)
    peer.begin()
    assert peer.done == [(0.0, 64.0), (0.5, 64.5), ("run_due", 64.75), (1.0, 65.0)]
    assert peer.device_s() == 1.25


def test_the_script_starts_at_once_where_that_is_wanted_or_nobody_connects(make):
    peer = opened(make(start_on_connect=False))
    peer.step(64.25)
    assert peer.done == [(0.0, 64.0)]
    peer = make()
    peer.backend.awaits_program = False
    opened(peer).step(64.5)
    assert peer.done == [(0.0, 64.25)]


def test_what_arrives_is_handled_before_the_next_turn(make):
    peer = opened(make())
    one, other = socket.socketpair()
    with one, other:
        peer.selector.register(one, selectors.EVENT_READ, lambda: (one.recv(1), peer.begin()))
        other.send(b"x")
        peer.step(64.25)
        peer.selector.unregister(one)
    assert peer.done[0] == (0.0, 64.0)


def test_the_device_is_unplugged_after_what_it_sent_and_plugged_before_what_it_sends(make):
    peer = opened(make((0.5, False), (1.0, True), start_on_connect=False))
    peer.step(65.25)
    assert peer.done == [
        (0.0, 64.0),
        (0.5, 64.5),
        ("vanish", 64.5),
        ("run_due", 64.75),
        ("appear", 65.0),
        (1.0, 65.0),
    ]


def test_a_late_peer_makes_no_burst(make):
    peer = opened(make(start_on_connect=False))
    peer.step(64.25)
    peer.clock.now_s = 66.0 + 0.5 * STALL_S
    peer.step(0.0)
    assert peer.done[1:] == [(2.0, 66.01), ("run_due", 66.01)]


def test_what_was_unplugged_and_plugged_in_while_the_peer_stood_still_was_gone(make):
    peer = opened(make((0.25, False), (0.5, True), start_on_connect=False))
    peer.step(64.125)
    peer.clock.now_s = 64.5
    peer.step(0.0)
    assert peer.done == [(0.0, 64.0), ("vanish", 64.5), ("appear", 64.5), (0.5, 64.5)]


@pytest.mark.parametrize("tells", [False, True])
def test_what_refuses_is_not_there_unless_its_backend_tells(make, tells):
    peer = make(faults={"refuse": 0.5})
    peer.backend.tells_refusal = tells
    peer.open()
    peer.step(64.25)
    assert peer.backend.there is tells
    peer.step(64.5)
    assert peer.done == [("appear", 64.0 if tells else 64.5)]


def test_to_catch_up_brings_the_device_to_the_present(make):
    peer = opened(make(start_on_connect=False))
    peer.step(64.25)
    peer.clock.now_s = 64.5
    peer.catch_up()
    assert peer.done == [(0.0, 64.0), (0.5, 64.5)]


def test_it_closes_what_it_could_not_open(make):
    peer = make()

    def fail():
        raise AddressError("taken")

    peer.backend.appear = fail
    for _ in range(2):
        with pytest.raises(AddressError, match="taken"):
            peer.open()
    del peer.backend.appear
    peer.open()
    peer.open()
    peer.close()
    peer.close()
    assert peer.done == [("appear", 64.0), ("vanish", 64.0)]
