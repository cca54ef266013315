"""Faulty network between a simulated peer and the other side, in virtual time."""

from __future__ import annotations

import heapq
import random
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from cardan.sim_peers.base import FaultSwitch

LINK_FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch.share("drop", "share of datagrams lost, each way"),
    FaultSwitch.share("duplicate", "share of datagrams that arrive twice, each way"),
    FaultSwitch.share("reorder", "share of datagrams overtaken by the next, each way"),
    FaultSwitch("delay", "added to every datagram, each way, ms", 20.0),
    FaultSwitch("jitter", "at most this much added to a datagram, order kept, each way, ms", 8.0),
)
"""Switches of every peer on a network. The link also has "garbage", which means junk of a protocol:
each peer words its own."""

_NAMES = (*(switch.name for switch in LINK_FAULTS), "garbage")

_OVERTAKEN_AT_MOST_S = 0.05
"""Longest time that a datagram waits for one that overtakes it."""


SentT = TypeVar("SentT")


class FaultyLink(Generic[SentT]):
    """One direction of a faulty network, in virtual time: `push` sent items, `pop` arrived ones.

    With `garbage` the items are bytes.
    """

    def __init__(self, faults: Mapping[str, float], seed: int, garbage: bool = False) -> None:
        self._drop = faults.get("drop", 0.0)
        self._duplicate = faults.get("duplicate", 0.0)
        self._reorder = faults.get("reorder", 0.0)
        self._delay_s = faults.get("delay", 0.0) * 1e-3
        self._jitter_s = faults.get("jitter", 0.0) * 1e-3
        self._garbage = faults.get("garbage", 0.0) if garbage else 0.0
        self._random = random.Random(seed)
        self._waiting: list[tuple[float, int, SentT]] = []
        self._overtaken: tuple[float, SentT] | None = None
        self._latest_s = float("-inf")
        self._count = 0

    @staticmethod
    def wanted(faults: Mapping[str, float]) -> bool:
        """True when any of `faults` is one of the network's."""
        return any(faults.get(name, 0.0) > 0.0 for name in _NAMES)

    def push(self, now_s: float, data: SentT) -> None:
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

    def pop(self, now_s: float) -> list[SentT]:
        """Return the items that have arrived by `now_s`, in order of arrival."""
        self._release(now_s, force=False)
        arrived = []
        while self._waiting and self._waiting[0][0] <= now_s:
            arrived.append(heapq.heappop(self._waiting)[2])
        return arrived

    def next_s(self) -> float | None:
        """Return the time of the next arrival; None if nothing is under way."""
        times = [self._waiting[0][0]] if self._waiting else []
        if self._overtaken is not None:
            times.append(self._overtaken[0])
        return min(times) if times else None

    def _release(self, now_s: float, force: bool) -> None:
        if self._overtaken is not None and (force or now_s >= self._overtaken[0]):
            data = self._overtaken[1]
            self._overtaken = None
            self._enqueue(now_s, data)

    def _enqueue(self, now_s: float, data: SentT) -> None:
        due_s = now_s + self._delay_s + self._jitter_s * self._random.random()
        self._latest_s = due_s = max(due_s, self._latest_s)
        self._count += 1
        heapq.heappush(self._waiting, (due_s, self._count, data))

    def _junk(self, data: Any) -> Any:
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
