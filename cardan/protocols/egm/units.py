"""The units of EGM's wire (mm, degrees) against SI."""

from __future__ import annotations

import math
from collections.abc import Iterable

MM_PER_M = 1000.0
RAD_PER_DEG = math.pi / 180.0

SNAP = 1.5 * 2.0**11
"""Adding and then subtracting this rounds a number below 1024 to a multiple of 2^-41 (4.5e-13).

Below 1 rad the radian's last bit is coarser than that of the same angle in degrees, so that no
radian at all converts to exactly 30°. Rounding to what a radian can tell apart gives 30° back.
"""


def radians(degrees: Iterable[float]) -> tuple[float, ...]:
    """Degrees as rad (or deg/s as rad/s)."""
    return tuple([value * RAD_PER_DEG for value in degrees])


def degrees(radians: Iterable[float]) -> list[float]:
    """Rad as degrees (or rad/s as deg/s), to within 2.3e-13 degrees."""
    return [value / RAD_PER_DEG + SNAP - SNAP for value in radians]
