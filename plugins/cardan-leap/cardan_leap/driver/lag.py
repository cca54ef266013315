"""Latency of frames, by the service's own stamps, whose clock has an epoch of its own.

A network or a reader that cannot keep up delivers every frame, in order and evenly spaced, but
seconds late; only the stamps show that. The smallest difference so far between arrival and stamp is
the reference for no delay. It may rise only as slowly as clocks drift apart: a delay of 1 s would
have to last for a quarter of an hour to go undetected.
"""

from __future__ import annotations

import math

from cardan.types import NEVER_S

LARGEST_DRIFT = 1e-3
"""Rate at which our clock may gain on the service's: NTP alone slews a clock by 500 ppm."""

BACK_S = 0.1
"""Largest step back of stamps from the same clock: delays never reverse stamps."""


class Lag:
    """Delay of frames. Times are monotonic, s."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Restart with an unknown clock of the next frame."""
        self._least_s = math.inf
        """Difference between our clock and the stamp of a frame without delay."""
        self._stamp_s = -math.inf
        self._arrival_s = NEVER_S

    def is_another_clock(self, timestamp_us: int) -> bool:
        """True if a frame of this stamp, newer than the previous one, is of another clock."""
        return timestamp_us * 1e-6 < self._stamp_s - BACK_S

    def update(self, timestamp_us: int, now_s: float) -> float:
        """Return the latency of a frame of this stamp that was received at `now_s`, s."""
        stamp_s = timestamp_us * 1e-6
        passed_s = now_s - self._arrival_s
        if passed_s > 0.0:
            self._least_s += LARGEST_DRIFT * passed_s
            self._arrival_s = now_s
        self._stamp_s = stamp_s
        difference_s = now_s - stamp_s
        self._least_s = min(self._least_s, difference_s)
        return difference_s - self._least_s
