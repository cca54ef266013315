"""Bounds from which a motion can still stop where it must, in discrete time."""

from __future__ import annotations

import math


def stopping_speed(distance: float, acceleration: float, dt_s: float) -> float:
    """The highest speed, held for one period, from which a point still stops within `distance`.

    Exact for steps of `dt_s`: a point that moves at this speed and then always at the newly
    computed one slows by at most `acceleration` and arrives at the end, never past it. (The
    continuous formula sqrt(2·a·d), and its usual discrete correction, overshoot in the last
    steps.) Units are those of `distance` per s; zero at or beyond the end.
    """
    if distance <= 0.0:
        return 0.0
    unit = acceleration * dt_s * dt_s
    # The number of periods the stop takes: the n-th triangular number holds the distance.
    periods = max(1.0, math.ceil(0.5 * (math.sqrt(1.0 + 8.0 * distance / unit) - 1.0)))
    return distance / (periods * dt_s) + 0.5 * acceleration * dt_s * (periods - 1.0)
