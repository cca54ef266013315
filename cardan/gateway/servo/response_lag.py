"""Expected position of a robot that lags behind its command in normal operation.

Industrial controllers filter their commands: a GP8 normally lags by 0.3 s. Supervision compares its
position with the commands within that time, not with the present one; else fast motion looks like a
blocked arm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import sub

from cardan.common.arm_libraries import np, npt
from cardan.gateway.kinematics.base import TURN, FloatArray

_ROWS = 17
"""Number of past commands that are kept. At 0.3 s they are 19 ms apart, 5 mm at 0.25 m/s."""


def farthest(
    place: Sequence[float], other: Sequence[float], continuous: Sequence[bool]
) -> tuple[float, int]:
    """Return the distance of the joint that is farthest away, rad or m, and its index. Whole turns
    of `continuous` joints are ignored."""
    ways = [*map(abs, map(sub, place, other))]
    most = max(ways)
    if most > math.pi:
        ways = [
            abs(math.remainder(way, TURN)) if turns else way
            for way, turns in zip(ways, continuous, strict=True)
        ]
        most = max(ways)
    return most, ways.index(most)


class ResponseLag:
    """Keeps the commanded joints of the last `lag_s`."""

    def __init__(self, lag_s: float, continuous: npt.NDArray[np.bool_]) -> None:
        """`continuous` marks joints whose whole turns are ignored."""
        self._spacing_s = lag_s / (_ROWS - 1)
        self._continuous: list[bool] = continuous.tolist()
        self._rows: list[list[float]] = []
        self._next_s = 0.0
        self._at = 0
        """Index of the newest row."""
        self._nearest = 0
        """Index of the last nearest row."""
        self._known: tuple[Sequence[float], Sequence[float], Sequence[float]] = (), (), ()
        """Last arguments of `expected`, and its result: each control cycle calls it twice."""

    def record_command(self, commanded: FloatArray, stamp_s: float) -> None:
        """Record the commanded joints of the time `stamp_s`."""
        if self._spacing_s == 0.0:
            return
        if not self._rows:
            self._rows = [commanded.tolist()] * _ROWS
            self._next_s = stamp_s + self._spacing_s
        elif stamp_s >= self._next_s:
            # After a gap only the newest row of the past is kept.
            missed = min(int((stamp_s - self._next_s) / self._spacing_s), _ROWS - 1)
            row = commanded.tolist()
            for _ in range(missed + 1):
                self._at = (self._at + 1) % _ROWS
                self._rows[self._at] = row
            self._next_s = stamp_s + self._spacing_s
        else:
            return
        self._known = (), (), ()

    def expected(self, measured: Sequence[float], commanded: Sequence[float]) -> Sequence[float]:
        """Return the joint positions once the robot has caught up with `commanded`: the measured
        ones, plus the distance from the nearest past command to `commanded`. A robot that is held
        stays behind: its past commands move on without it.
        """
        if not self._rows:
            return measured
        if measured is self._known[0] and commanded == self._known[1]:
            return self._known[2]
        rows, nearest = self._rows, commanded
        least, joint = farthest(commanded, measured, self._continuous)
        # The place that was nearest last rules most others out, by the joint that is farthest off.
        last, its = farthest(rows[self._nearest], measured, self._continuous)
        if last < least:
            nearest, least, joint = rows[self._nearest], last, its
        there, turns = measured[joint], self._continuous[joint]
        for index, row in enumerate(rows):
            way = row[joint] - there
            if abs(math.remainder(way, TURN) if turns else way) < least:
                away, _ = farthest(row, measured, self._continuous)
                if away < least:
                    nearest, least, self._nearest = row, away, index
        found = measured
        if nearest is not commanded:
            found = [
                there + (goal - past)
                for there, goal, past in zip(measured, commanded, nearest, strict=True)
            ]
        self._known = measured, commanded, found
        return found
