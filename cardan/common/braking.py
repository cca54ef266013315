"""Bounds from which a motion can still stop where it must, in discrete time."""

from __future__ import annotations

import math


def stopping_speed(distance: float, acceleration: float, dt_s: float) -> float:
    """The highest speed that, held for one period, leaves enough distance to stop.

    That is the v with v·dt + v²/(2a) = distance, in units of `distance` per s; zero at or beyond
    the end. A point that always moves at most at this speed slows by at most `acceleration` and
    never passes the end, also when the periods that follow are shorter or longer, as they are
    when datagrams get lost. (sqrt(2·a·d) and the bound for a fixed period overshoot then.)
    """
    if distance <= 0.0:
        return 0.0
    gain = acceleration * dt_s
    return math.sqrt(gain * gain + 2.0 * acceleration * distance) - gain
