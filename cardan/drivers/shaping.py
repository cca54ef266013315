"""Shaping of deflections: dead zone, response curve, locks, dominant axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.options import Options
from cardan.types import NEUTRAL as NEUTRAL, Axes as Axes

Deflections = tuple[float, float, float, float, float, float]
"""Axes during the computation, as a plain tuple."""
Triple = tuple[float, float, float]

_ZERO: Triple = (0.0, 0.0, 0.0)

DOMINANCE_MARGIN = 1.1
"""Ratio of deflections at which the dominant axis changes: no flutter between two."""


@dataclass(frozen=True, kw_only=True)
class ShapingOptions(Options):
    """Options of every driver with deflections. Raises OptionError for invalid values."""

    dead_zone: Annotated[float, bounds.DEAD_ZONE] = 0.05
    """Share of the full scale that counts as rest, 0 to below 1; the rest is rescaled to 0..1."""
    dead_zone_shape: Literal["axis", "radial"] = "axis"
    """axis: dead zone per axis; radial: by the norms of translation and rotation."""
    curve: Annotated[float, bounds.SHARE_OR_NONE] = 0.0
    """Response curve: 0 linear to 1 cubic, which gives fine control near rest."""
    translation: bool = True
    """False: translation is locked at zero."""
    rotation: bool = True
    """False: rotation is locked at zero."""
    dominant_axis: bool = False
    """True: only the axis with the largest deflection acts."""


class Shaper:
    """Shaping of six deflections in -1..1; the result is continuous and in -1..1, too."""

    def __init__(self, options: ShapingOptions) -> None:
        self._dead = options.dead_zone
        self._reach = 1.0 - options.dead_zone
        self._linear = 1.0 - options.curve
        self._cubic = options.curve
        self._shape = self._per_axis if options.dead_zone_shape == "axis" else self._radial
        self._translation = options.translation
        self._rotation = options.rotation
        self._dominant = options.dominant_axis
        self._leader = 0

    def __call__(self, axes: Deflections) -> Axes:
        """Return the shaped deflections."""
        shaped = self._shape(axes)
        if not self._translation:
            shaped = (0.0, 0.0, 0.0, *shaped[3:])
        if not self._rotation:
            shaped = (*shaped[:3], 0.0, 0.0, 0.0)
        return Axes._make(self._lead(shaped) if self._dominant else shaped)

    def _per_axis(self, axes: Deflections) -> Deflections:
        dead, reach, linear, cubic = self._dead, self._reach, self._linear, self._cubic
        shaped = []
        for u in axes:
            if u > dead:
                size = (u - dead) / reach
            elif u < -dead:
                size = (u + dead) / reach
            else:
                shaped.append(0.0)
                continue
            shaped.append(size * (linear + cubic * size * size))
        return tuple(shaped)  # type: ignore[return-value]

    def _radial(self, axes: Deflections) -> Deflections:
        return (*self._scaled(*axes[:3]), *self._scaled(*axes[3:]))

    def _scaled(self, a: float, b: float, c: float) -> Triple:
        length = math.sqrt(a * a + b * b + c * c)
        if length <= self._dead:
            return _ZERO
        if length >= 1.0:  # full deflection, and the corners beyond it
            return (a, b, c)
        size = (length - self._dead) / self._reach
        gain = size / length * (self._linear + self._cubic * size * size)
        return (a * gain, b * gain, c * gain)

    def _lead(self, axes: Deflections) -> Deflections:
        sizes = [abs(u) for u in axes]
        strongest = max(sizes)
        leading = sizes[self._leader]
        if leading == 0.0 or strongest > leading * DOMINANCE_MARGIN:
            self._leader = sizes.index(strongest)
        x, y, z, rx, ry, rz = (u if i == self._leader else 0.0 for i, u in enumerate(axes))
        return (x, y, z, rx, ry, rz)
