"""Detection of motions that the daemon repeats by itself."""

from __future__ import annotations

from collections.abc import Sequence

from cardan.types import NEVER_S

FASTEST_PERIOD_S = 0.004
"""Period below which identical motions are the daemon's own: half the shortest period of a device,
8 ms. spacenavd uses its `repeat-interval` modulo 1000 as microseconds, so it repeats every 1.3 ms
or faster, or else every second or slower."""


class RepeatDetector:
    """Detector of repeated motions that come faster than any device sends them.

    Delayed motions come in a burst, so identical ones may be ahead of the fastest device's pace by
    up to `queued_s`.
    """

    __slots__ = ("_ahead_s", "_counts", "_queued_s", "_stamp_s", "in_pace_s", "repeating")

    def __init__(self, queued_s: float) -> None:
        self._queued_s = queued_s
        self._counts: Sequence[int] = ()
        self._stamp_s = NEVER_S
        self._ahead_s = 0.0
        self.in_pace_s = NEVER_S
        """Time of the last motion that was not ahead: the last that a device has certainly sent."""
        self.repeating = False
        """True if the last motion was the daemon's own, as are identical ones after it."""

    def take(self, counts: Sequence[int], now_s: float) -> bool:
        """Return True if the motion of `counts`, received at `now_s`, is the daemon's own."""
        before, self._counts = self._counts, counts
        elapsed_s = now_s - self._stamp_s
        self._stamp_s = now_s
        if counts != before:
            self.repeating = False
            self._ahead_s = FASTEST_PERIOD_S
            self.in_pace_s = now_s
        elif not self.repeating:
            self._ahead_s = max(0.0, self._ahead_s - elapsed_s)
            if self._ahead_s == 0.0:
                self.in_pace_s = now_s
            self._ahead_s += FASTEST_PERIOD_S
            self.repeating = self._ahead_s > self._queued_s
        return self.repeating
