"""Conversion between units of EGM's wire (mm, degrees) and SI."""

from __future__ import annotations

import math
from collections.abc import Iterable

MM_PER_M = 1000.0
RAD_PER_DEG = math.pi / 180.0

SNAP = 1.5 * 2.0**11
"""Summand that rounds a number below 1024 to a multiple of 2^-41 (4.5e-13) when added and
subtracted.

Below 1 rad the radian's last bit is coarser than that of the same angle in degrees, so no radian
converts to exactly 30°. Rounding to the resolution of the radian restores 30°.
"""


def radians(degrees: Iterable[float]) -> tuple[float, ...]:
    """Convert degrees to rad (or deg/s to rad/s)."""
    return tuple([value * RAD_PER_DEG for value in degrees])


def degrees(radians: Iterable[float]) -> list[float]:
    """Convert rad to degrees (or rad/s to deg/s), to within 2.3e-13 degrees."""
    return [value / RAD_PER_DEG + SNAP - SNAP for value in radians]
