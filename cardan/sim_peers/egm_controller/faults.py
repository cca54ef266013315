"""Faults the simulated controller and the network around it can be told to have."""

from __future__ import annotations

import heapq
import random
from collections.abc import Mapping

from cardan.sim_peers.base import FaultSwitch

FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch("drop", "share of datagrams lost, each way (0..1)", 0.05, 0.0, 1.0),
    FaultSwitch(
        "duplicate", "share of datagrams that arrive twice, each way (0..1)", 0.05, 0.0, 1.0
    ),
    FaultSwitch(
        "reorder", "share of datagrams overtaken by the next, each way (0..1)", 0.05, 0.0, 1.0
    ),
    FaultSwitch("delay", "added to every datagram, each way, ms", 20.0),
    FaultSwitch("jitter", "at most this much added to a datagram, order kept, each way, ms", 8.0),
    FaultSwitch(
        "garbage", "share of cycles with a datagram that is not EGM before it (0..1)", 0.1, 0.0, 1.0
    ),
    FaultSwitch("pause", "silent for this long every 5 s, s", 0.3),
    FaultSwitch("restart", "the controller restarts at this time, once: seqno 0, new port, s", 5.0),
    FaultSwitch("port-change", "the local port changes every so many s", 3.0),
    FaultSwitch("estop", "emergency stop at this time, s", 5.0),
    FaultSwitch("motors-off", "motors go off at this time, s", 5.0),
    FaultSwitch(
        "clock-step",
        "the wall clock in the datagrams steps by this much after 2 s, s",
        3600.0,
        -1e9,
    ),
    FaultSwitch(
        "rapid-undefined", "RAPID's execution state is sent as UNDEFINED (1: yes)", 1.0, 0.0, 1.0
    ),
)

PAUSE_EVERY_S = 5.0
CLOCK_STEP_AT_S = 2.0
RESTART_SILENCE_S = 2.0
"""A real controller takes minutes; to a PC only the silence counts."""

_LINK_FAULTS = ("drop", "duplicate", "reorder", "delay", "jitter", "garbage")

_OVERTAKEN_AT_MOST_S = 0.05
"""A datagram waits this long at most for one that overtakes it."""


class FaultyLink:
    """One direction of a bad network, in virtual time: `push` what is sent, `pop` what arrives."""

    def __init__(self, faults: Mapping[str, float], seed: int, garbage: bool = False) -> None:
        self._drop = faults.get("drop", 0.0)
        self._duplicate = faults.get("duplicate", 0.0)
        self._reorder = faults.get("reorder", 0.0)
        self._delay_s = faults.get("delay", 0.0) * 1e-3
        self._jitter_s = faults.get("jitter", 0.0) * 1e-3
        self._garbage = faults.get("garbage", 0.0) if garbage else 0.0
        self._random = random.Random(seed)
        self._waiting: list[tuple[float, int, bytes]] = []
        self._overtaken: tuple[float, bytes] | None = None
        self._latest_s = float("-inf")
        self._count = 0

    @staticmethod
    def wanted(faults: Mapping[str, float]) -> bool:
        """True when any of `faults` is one of the network's."""
        return any(faults.get(name, 0.0) > 0.0 for name in _LINK_FAULTS)

    def push(self, now_s: float, data: bytes) -> None:
        """Send `data` at `now_s`."""
        chance = self._random.random
        if chance() < self._garbage:
            self._enqueue(now_s, self._junk(data))
        if chance() < self._drop:
            return
        if self._overtaken is None and chance() < self._reorder:
            self._overtaken = (now_s + _OVERTAKEN_AT_MOST_S, data)
            return
        self._enqueue(now_s, data)
        if chance() < self._duplicate:
            self._enqueue(now_s, data)
        self._release(now_s, force=True)

    def pop(self, now_s: float) -> list[bytes]:
        """What has arrived by `now_s`, in order of arrival."""
        self._release(now_s, force=False)
        arrived = []
        while self._waiting and self._waiting[0][0] <= now_s:
            arrived.append(heapq.heappop(self._waiting)[2])
        return arrived

    def next_s(self) -> float | None:
        """When the next datagram arrives, if one is under way."""
        times = [self._waiting[0][0]] if self._waiting else []
        if self._overtaken is not None:
            times.append(self._overtaken[0])
        return min(times) if times else None

    def _release(self, now_s: float, force: bool) -> None:
        if self._overtaken is not None and (force or now_s >= self._overtaken[0]):
            data = self._overtaken[1]
            self._overtaken = None
            self._enqueue(now_s, data)

    def _enqueue(self, now_s: float, data: bytes) -> None:
        due_s = now_s + self._delay_s + self._jitter_s * self._random.random()
        self._latest_s = due_s = max(due_s, self._latest_s)
        self._count += 1
        heapq.heappush(self._waiting, (due_s, self._count, data))

    def _junk(self, data: bytes) -> bytes:
        kind = self._random.randrange(5)
        if kind == 0:
            return b""
        if kind == 1:
            return data[: self._random.randrange(1, len(data))]
        if kind == 2:
            return data + self._random.randbytes(3000)
        if kind == 3:
            return b"GET / HTTP/1.1\r\n\r\n"
        return self._random.randbytes(self._random.randrange(1, 400))
