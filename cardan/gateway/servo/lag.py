"""Expected position of a robot that lags behind its command in normal operation.

Industrial controllers filter their commands: a GP8 normally lags by 0.3 s. For supervision its
position must be compared with the commands within that time, not with the present one; else fast
motion looks like an arm that is blocked.
"""

from __future__ import annotations

from cardan.common.arm_libraries import np, npt
from cardan.gateway.kinematics.base import FloatArray, short_way

_ROWS = 17
"""Number of past commands that are kept. At 0.3 s they are 19 ms apart, 5 mm at 0.25 m/s."""


class ResponseLag:
    """Keeps the commanded joints of the last `lag_s`."""

    def __init__(self, lag_s: float, continuous: npt.NDArray[np.bool_]) -> None:
        """`continuous` marks joints whose whole turns make no difference."""
        self._spacing_s = lag_s / (_ROWS - 1)
        self._continuous = continuous
        self._rows: FloatArray | None = None
        self._next_s = 0.0
        self._at = 0

    @property
    def late(self) -> bool:
        """Whether the robot normally lags; False: joints are where they are commanded to be."""
        return self._spacing_s > 0.0

    def reset(self) -> None:
        """Forget the past: the joints were placed, not moved."""
        self._rows = None

    def note(self, commanded: FloatArray, stamp_s: float) -> None:
        """Where the joints are commanded to be at `stamp_s`."""
        if self._spacing_s == 0.0:
            return
        if self._rows is None:
            self._rows = np.tile(commanded, (_ROWS, 1))
            self._next_s = stamp_s + self._spacing_s
        elif stamp_s >= self._next_s:
            # After a gap the past is gone but for its newest row.
            missed = min(int((stamp_s - self._next_s) / self._spacing_s), _ROWS - 1)
            for _ in range(missed + 1):
                self._at = (self._at + 1) % _ROWS
                self._rows[self._at] = commanded
            self._next_s = stamp_s + self._spacing_s

    def expected(self, measured: FloatArray, commanded: FloatArray) -> FloatArray:
        """Where the joints will be once the robot has caught up with `commanded`.

        That is where they are measured, and the way from the nearest place of the past to
        `commanded`. A robot that is held stays behind: its past moves on without it.
        """
        rows = self._rows
        if rows is None:
            return measured
        away = self._away(rows - measured).max(axis=1)
        nearest = int(away.argmin())
        if self._away(commanded - measured).max() <= away[nearest]:
            return measured
        found: FloatArray = measured + (commanded - rows[nearest])
        return found

    def _away(self, difference: FloatArray) -> FloatArray:
        return np.abs(short_way(difference, self._continuous))
