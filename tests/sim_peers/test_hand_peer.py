"""The loop that serves a device which a hand moves in real time."""

from __future__ import annotations

import math
import selectors
import socket

import pytest

from cardan.sim_peers import hand_peer
from cardan.sim_peers.hand_peer import HandPeer


class Clock:
    """A monotonic clock that only waiting moves."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


class Waiting(selectors.SelectSelector):
    """Waits on the clock; what is readable then is seen."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def select(self, timeout=None):
        ready = super().select(0)
        if not ready:
            self._clock.now_s += timeout
        return ready


class Peer(HandPeer):
    """A device that does something every 0.4 s, on a carrier with one thing to do at 101 s."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.done: list[tuple[str, float]] = []
        self._clock = clock
        self._carrier_s = 101.0

    @property
    def endpoint(self) -> str:
        return "nowhere"

    def open(self) -> None:
        self._selector = Waiting(self._clock)

    def close(self) -> None:
        self._selector.close()

    @property
    def _hand_due_s(self) -> float:
        return self._played_s + 0.4

    def _play(self, now_s: float) -> None:
        if self._start_s is not None:
            self._played_s = now_s - self._start_s
            self.done.append(("play", round(now_s, 9)))

    def _carrier_due_s(self) -> float:
        return self._carrier_s

    def _attend(self, now_s: float) -> None:
        if now_s >= self._carrier_s:
            self._carrier_s = math.inf
            self.done.append(("attend", now_s))


@pytest.fixture
def peer(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(hand_peer, "time", clock)
    peer = Peer(clock)
    peer.open()
    yield peer
    peer.close()


def test_nothing_is_played_before_the_script_starts(peer):
    peer.step(100.9)
    assert peer.done == []
    assert peer._device_s() == 0.0


def test_each_is_served_when_it_is_due(peer):
    peer._begin()
    peer.step(101.1)
    peer._begin()
    assert peer.done == [
        ("play", 100.0),
        ("play", 100.4),
        ("play", 100.8),
        ("attend", 101.0),
        ("play", 101.0),
        ("play", 101.1),
    ]
    assert peer._device_s() == pytest.approx(1.1)
    assert peer._device_s(100.5) == 0.5


def test_what_arrives_is_handled_before_the_next_turn(peer):
    one, other = socket.socketpair()
    with one, other:
        peer._selector.register(one, selectors.EVENT_READ, lambda: (one.recv(1), peer._begin()))
        other.send(b"x")
        peer.step(100.5)
    assert peer.done[0] == ("play", 100.0)
