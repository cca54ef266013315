"""The line between a simulated device and its host: carries reports, late where a fault says so."""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Mapping

from cardan.sim_peers.base import strikes


class DelayLine:
    """Carries reports in virtual time; subclasses lose and mangle them first.

    The fault ``burst`` holds reports back for its value, s, in every second such span, and then
    delivers all at once.
    """

    def __init__(self, faults: Mapping[str, float], seed: int) -> None:
        self._faults = faults
        self._random = random.Random(seed)
        self._burst_s = faults.get("burst", 0.0)
        self._carried = 0
        self._under_way: list[tuple[float, int, bytes]] = []

    @property
    def next_due_s(self) -> float:
        """When the next report arrives; inf when none is under way."""
        return self._under_way[0][0] if self._under_way else math.inf

    def carry(self, report: bytes, sent_s: float) -> None:
        """Take any report, sent at `sent_s`; of those sent at one time the order is kept."""
        arrival_s = sent_s
        if self._burst_s:
            window = math.floor(sent_s / self._burst_s)
            if window % 2:
                arrival_s = (window + 1) * self._burst_s
        self._carried += 1
        heapq.heappush(self._under_way, (arrival_s, self._carried, report))

    def arrived(self, now_s: float) -> list[bytes]:
        """The reports that have arrived by `now_s`, in order of arrival."""
        reports = []
        while self._under_way and self._under_way[0][0] <= now_s:
            reports.append(heapq.heappop(self._under_way)[2])
        return reports

    def cut(self) -> None:
        """Lose everything under way."""
        self._under_way.clear()

    def _strikes(self, fault: str, count: int) -> bool:
        """Whether a fault of every VALUE-th report acts on the `count`-th."""
        return strikes(self._faults, fault, count)
