"""Detection of a controller that follows commands much too slowly."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.types import NEVER_S

_LOOK_EVERY = 25
"""Answers between two comparisons: 0.1 s at 250 Hz."""
_LOOKS_TO_REPORT = 5
"""Consecutive comparisons, 0.5 s: longer than the controller's ramp at the start."""
_NOTICEABLE = 0.003
"""Smallest commanded motion that is judged, rad or m per comparison."""
_ERROR_SHARE = 0.15
"""Share of a constant distance that a position gain of 1.5 1/s covers between comparisons."""
_CLEARLY_LESS = 0.5


class SpeedCapDetector:
    """Detector of a controller's own reference that stays far behind the commanded one.

    \\MaxSpeedDeviation does that: its default of 1 deg/s all but stops a robot.
    """

    __slots__ = ("_countdown", "_looks", "_made", "_s", "_sent", "commanded", "done")

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Restart, with a session or a state of the controller."""
        self._countdown = _LOOK_EVERY
        self._looks = 0
        self._sent: tuple[float, ...] | None = None
        self._made: tuple[float, ...] = ()
        self._s = NEVER_S
        self.commanded = 0.0
        """Commanded speed at the last comparison, rad/s or m/s."""
        self.done = 0.0
        """Speed of the controller's reference then, rad/s or m/s."""

    @property
    def capped(self) -> bool:
        """True when the motion has been far too slow for 0.5 s."""
        return self._looks >= _LOOKS_TO_REPORT

    def due(self) -> bool:
        """True if `look` is due; call it once per answer."""
        self._countdown -= 1
        return self._countdown <= 0

    def look(self, progress: tuple[Sequence[float], Sequence[float]] | None, now_s: float) -> None:
        """Compare the sent reference with the controller's own."""
        self._countdown = _LOOK_EVERY
        if progress is None:
            return
        sent, made = tuple(progress[0]), tuple(progress[1])
        if self._sent is not None and now_s > self._s:
            asked = max(math.dist(sent, self._sent), _ERROR_SHARE * math.dist(sent, made))
            went = math.dist(made, self._made)
            slow = asked > _NOTICEABLE and went < _CLEARLY_LESS * asked
            self._looks = self._looks + 1 if slow else 0
            self.commanded = asked / (now_s - self._s)
            self.done = went / (now_s - self._s)
        self._sent, self._made, self._s = sent, made, now_s
