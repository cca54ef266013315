"""A latency histogram that a control loop can feed in every cycle."""

from __future__ import annotations

import math
from collections.abc import Sequence

_LOWEST_S = 1e-7
_HIGHEST_S = 1e3
_BUCKETS_PER_OCTAVE = 16
"""Neighboring bucket borders differ by 4.4 %, so a percentile is off by 2.2 % at most."""
_SCALE = _BUCKETS_PER_OCTAVE / math.log(2.0)
_OFFSET = -math.log(_LOWEST_S) * _SCALE
_LAST = int(math.log(_HIGHEST_S) * _SCALE + _OFFSET) + 1


class LatencyHistogram:
    """Counts durations in log-spaced buckets from 0.1 µs to 1000 s; the memory never grows.

    Durations beyond either end count in the outermost bucket; `max` and `mean` stay exact.
    """

    __slots__ = ("_buckets", "_count", "_max", "_min", "_sum")

    def __init__(self) -> None:
        self._buckets = [0] * (_LAST + 1)
        self._count = 0
        self._sum = 0.0
        self._min = math.inf
        self._max = 0.0

    def add(self, seconds: float) -> None:
        """Count one duration, s. Negative ones (a clock that was set back) count as zero."""
        if seconds >= _HIGHEST_S:
            index = _LAST
        elif seconds > _LOWEST_S:
            index = int(math.log(seconds) * _SCALE + _OFFSET)
        else:
            index = 0
            if not seconds > 0.0:
                seconds = 0.0
        self._buckets[index] += 1
        self._count += 1
        self._sum += seconds
        if seconds > self._max:
            self._max = seconds
        if seconds < self._min:
            self._min = seconds

    def within(self, bounds_s: Sequence[float]) -> list[int]:
        """Return the number of durations no longer than each of `bounds_s`, which ascend, s. A
        duration in the bucket of a bound counts as shorter: off by 4.4 % of it at most."""
        found, below, index = [], 0, 0
        for bound_s in bounds_s:
            last = min(max(int(math.log(bound_s) * _SCALE + _OFFSET), 0), _LAST)
            below += sum(self._buckets[index : last + 1])
            index = max(index, last + 1)
            found.append(below)
        return found

    @property
    def sum(self) -> float:
        """Sum of the durations, s."""
        return self._sum

    @property
    def count(self) -> int:
        """Number of durations."""
        return self._count

    @property
    def max(self) -> float:
        """Longest duration, s; 0 when empty."""
        return self._max

    @property
    def mean(self) -> float:
        """Arithmetic mean, s; 0 when empty."""
        return self._sum / self._count if self._count else 0.0

    def percentile(self, p: float) -> float:
        """Return the duration that `p` percent (0..100) of the added ones do not exceed, s; 0 if
        empty.

        The middle of its bucket, never outside the shortest and longest added. Raises ValueError
        for a `p` outside 0..100.
        """
        if not 0.0 <= p <= 100.0:
            raise ValueError(f"percentile {p} is not allowed; it must be 0 to 100")
        if not self._count:
            return 0.0
        below = max(1, math.ceil(self._count * p / 100.0))
        index = -1
        while below > 0:
            index += 1
            below -= self._buckets[index]
        middle = math.exp((index + 0.5 - _OFFSET) / _SCALE)
        return min(max(middle, self._min), self._max)
