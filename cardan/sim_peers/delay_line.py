"""Line between a simulated device and its host, with delays by faults."""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Mapping

from cardan.sim_peers.base import strikes


class DelayLine:
    """Carries reports in virtual time; subclasses lose and mangle them first.

    The fault ``burst`` holds reports back for its value, s, in every second such interval, and then
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
        """Time of the next report's arrival; inf if none is under way."""
        return self._under_way[0][0] if self._under_way else math.inf

    def carry(self, report: bytes, sent_s: float) -> None:
        """Carry a report sent at `sent_s`; reports of one time keep their order."""
        arrival_s = sent_s
        if self._burst_s:
            window = math.floor(sent_s / self._burst_s)
            if window % 2:
                arrival_s = (window + 1) * self._burst_s
        self._carried += 1
        heapq.heappush(self._under_way, (arrival_s, self._carried, report))

    def arrived(self, now_s: float) -> list[bytes]:
        """Return the reports that have arrived by `now_s`, in order of arrival."""
        reports = []
        while self._under_way and self._under_way[0][0] <= now_s:
            reports.append(heapq.heappop(self._under_way)[2])
        return reports

    def cut(self) -> None:
        """Drop all reports under way."""
        self._under_way.clear()

    def _strikes(self, fault: str, count: int) -> bool:
        """Return True if a fault of every VALUE-th report acts on the `count`-th."""
        return strikes(self._faults, fault, count)
