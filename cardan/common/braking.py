"""Bounds from which a motion can still stop in time, in discrete time."""

from __future__ import annotations

import math
from collections.abc import Sequence


def stopping_speed(distance: float, acceleration: float, dt_s: float) -> float:
    """Return the highest speed that, held for one period, leaves enough distance to stop: the v
    with v·dt + v²/(2a) = distance, in units of `distance` per s; zero at or beyond the end, and if
    `distance` is NaN. A point that always moves at most at this speed slows by at most
    `acceleration` and never passes the end, also when the periods that follow are shorter or
    longer, as they are when datagrams get lost. (sqrt(2·a·d) and the bound for a fixed period
    overshoot then.)
    """
    if not distance > 0.0:
        return 0.0
    gain = acceleration * dt_s
    return math.sqrt(gain * gain + 2.0 * acceleration * distance) - gain


def stopping_speeds(
    positions: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
    acceleration: Sequence[float],
    dt_s: float,
) -> tuple[list[float], list[float]]:
    """Return the lowest and the highest velocity along each axis from which it can stop at its
    ends. An end may be infinite. An axis beyond one of its ends may only move inwards."""
    axes = list(zip(positions, lower, upper, acceleration, strict=True))
    return (
        [-stopping_speed(q - low, a, dt_s) for q, low, _, a in axes],
        [stopping_speed(high - q, a, dt_s) for q, _, high, a in axes],
    )


def clipped(
    values: Sequence[float], lowest: Sequence[float], highest: Sequence[float]
) -> tuple[float, ...]:
    """Return `values`, each within its bounds."""
    bounds = zip(values, lowest, highest, strict=True)
    return tuple([min(max(v, low), high) for v, low, high in bounds])


def within_walls(
    now: Sequence[float],
    wanted: Sequence[float],
    lowest: Sequence[float],
    highest: Sequence[float],
    most: float,
    braking: float = math.inf,
) -> tuple[float, float, float]:
    """Return the next velocity of a point that must stop at walls: `wanted`, or as much of it as
    possible.

    `lowest` and `highest` bound it along each axis (see :func:`stopping_speed`), `most` is the
    longest change from `now`. The change that the walls need has priority, along each axis no more
    than `braking`; the rest follows within `most`. All in the same unit, m/s.
    """
    fitting = clipped(wanted, lowest, highest)
    due = clipped(
        clipped(now, lowest, highest), [v - braking for v in now], [v + braking for v in now]
    )
    mx, my, mz = due[0] - now[0], due[1] - now[1], due[2] - now[2]
    fx, fy, fz = fitting[0] - due[0], fitting[1] - due[1], fitting[2] - due[2]
    a = fx * fx + fy * fy + fz * fz
    b = mx * fx + my * fy + mz * fz
    c = mx * mx + my * my + mz * mz - most * most
    if a + 2.0 * b + c <= 0.0:
        return fitting[0], fitting[1], fitting[2]
    share = (math.sqrt(b * b - a * c) - b) / a if c < 0.0 < a else 0.0
    return due[0] + fx * share, due[1] + fy * share, due[2] + fz * share
