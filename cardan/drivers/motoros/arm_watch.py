"""Where the arm really is, compared with where its velocities should have brought it.

A controller in velocity mode says nothing of the position that it has commanded, and the arm is
late by design. So what is measured is compared with all that was commanded within the lag: an arm
in good order is somewhere on that way. What it is away from it, is what velocities were lost by: a
speed limit, a late command, a person in the way.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

_ROWS = 16
"""Of the way that is kept; between them it is taken for straight."""


class ArmWatch:
    """The commanded way of the last `lag_s`."""

    def __init__(self, lag_s: float, positions: Sequence[float], now_s: float) -> None:
        self._lag_s = lag_s
        self._spacing_s = lag_s / _ROWS
        self._way: deque[tuple[float, list[float]]] = deque()
        self.begin(positions, now_s)

    def begin(self, positions: Sequence[float], now_s: float) -> None:
        """The arm stands at `positions`, rad, and has for long."""
        self._way.clear()
        self._way.append((now_s - self._lag_s, list(positions)))

    def note(self, positions: Sequence[float], now_s: float) -> None:
        """Where the arm is commanded to be at `now_s`."""
        way = self._way
        if now_s - way[-1][0] >= self._spacing_s:
            way.append((now_s, list(positions)))
            while len(way) > 1 and way[1][0] <= now_s - self._lag_s:
                way.popleft()

    def away(self, measured: Sequence[float], commanded: Sequence[float]) -> list[float]:
        """From the nearest place of the way, which ends at `commanded`, to `measured`; rad."""
        best: list[float] | None = None
        nearest = 0.0
        start = self._way[0][1]
        for _, end in (*self._way, (0.0, list(commanded))):
            along = square = 0.0
            for a, b, m in zip(start, end, measured, strict=True):
                along += (m - a) * (b - a)
                square += (b - a) * (b - a)
            share = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
            found = [m - a - share * (b - a) for a, b, m in zip(start, end, measured, strict=True)]
            size = sum(each * each for each in found)
            if best is None or size < nearest:
                best, nearest = found, size
            start = end
        assert best is not None
        return best

    def shift(self, by: Sequence[float]) -> None:
        """The whole way was somewhere else than thought, `by` so much."""
        for _, positions in self._way:
            for i, each in enumerate(by):
                positions[i] += each
