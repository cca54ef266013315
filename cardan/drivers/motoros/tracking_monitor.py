"""Comparison of the arm's measured position with the integral of its commanded velocities.

A controller in velocity mode does not report its commanded position, and the arm lags by design.
The measured position is therefore compared with the path commanded within the lag: an arm that
follows is on that path, or beside it if the controller's filter cuts a curve. An arm that has not
even reached the path's beginning has lost motion: to a speed limit, a late command, or a person in
the way. At rest the path is one point, and every distance counts.
"""

from __future__ import annotations

import operator
from collections import deque
from collections.abc import Sequence

_ROWS = 16
"""Points of the commanded path that are kept; it is interpolated linearly."""


class TrackingMonitor:
    """Commanded path of the last `lag_s`."""

    def __init__(self, lag_s: float, positions: Sequence[float], now_s: float) -> None:
        self._lag_s = lag_s
        self._spacing_s = lag_s / _ROWS
        self._path: deque[tuple[float, list[float]]] = deque()
        self.begin(positions, now_s)

    def begin(self, positions: Sequence[float], now_s: float) -> None:
        """Begin with an arm at rest at `positions`, rad."""
        self._path.clear()
        self._path.append((now_s - self._lag_s, list(positions)))

    def record(self, positions: Sequence[float], now_s: float) -> None:
        """Record the commanded positions at `now_s`, rad."""
        path = self._path
        if now_s - path[-1][0] >= self._spacing_s:
            path.append((now_s, list(positions)))
            while len(path) > 1 and path[1][0] <= now_s - self._lag_s:
                path.popleft()

    def away(self, measured: Sequence[float], commanded: Sequence[float]) -> list[float] | None:
        """Distance of `measured` from the nearer end of the path, which ends at `commanded`, rad;
        None if a point between the ends is nearest."""
        best: list[float] | None = None
        nearest = 0.0
        outside = False
        start = self._path[0][1]
        places = (*self._path, (0.0, list(commanded)))
        for number, (_, end) in enumerate(places):
            along = square = 0.0
            for a, b, m in zip(start, end, measured, strict=True):
                along += (m - a) * (b - a)
                square += (b - a) * (b - a)
            share = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
            found = [m - a - share * (b - a) for a, b, m in zip(start, end, measured, strict=True)]
            size = sum(each * each for each in found)
            if best is None or size < nearest:
                best, nearest = found, size
                before = not any(map(operator.ne, start, places[0][1])) and share == 0.0
                outside = before or (number == len(places) - 1 and share == 1.0)
            start = end
        return best if outside else None

    def shift(self, by: Sequence[float]) -> None:
        """Move the whole path by `by`, rad, because its positions were off by that."""
        for _, positions in self._path:
            for i, each in enumerate(by):
                positions[i] += each
