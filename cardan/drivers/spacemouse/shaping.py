"""From deflections to what the operator means: dead zone, response curve, locks, dominance."""

from __future__ import annotations

import math

from cardan.drivers.spacemouse.options import SpaceMouseOptions

Axes = tuple[float, float, float, float, float, float]
Triple = tuple[float, float, float]

NEUTRAL: Axes = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ZERO: Triple = (0.0, 0.0, 0.0)

DOMINANCE_MARGIN = 1.1
"""Another axis takes over when it is deflected so much more: no flutter between two."""


class Shaper:
    """Shapes six deflections in -1..1; the result is continuous and in -1..1, too."""

    def __init__(self, options: SpaceMouseOptions) -> None:
        self._dead = options.dead_zone
        self._reach = 1.0 - options.dead_zone
        self._linear = 1.0 - options.curve
        self._cubic = options.curve
        self._triple = self._per_axis if options.dead_zone_shape == "axis" else self._radial
        self._translation = options.translation
        self._rotation = options.rotation
        self._dominant = options.dominant_axis
        self._leader = 0

    def __call__(self, axes: Axes) -> Axes:
        """The shaped deflections."""
        x, y, z = self._triple(axes[:3]) if self._translation else _ZERO
        rx, ry, rz = self._triple(axes[3:]) if self._rotation else _ZERO
        shaped = (x, y, z, rx, ry, rz)
        return self._lead(shaped) if self._dominant else shaped

    def _per_axis(self, triple: Triple) -> Triple:
        a, b, c = triple
        return (self._axis(a), self._axis(b), self._axis(c))

    def _axis(self, u: float) -> float:
        size = abs(u) - self._dead
        if size <= 0.0:
            return 0.0
        size /= self._reach
        return math.copysign(size * (self._linear + self._cubic * size * size), u)

    def _radial(self, triple: Triple) -> Triple:
        a, b, c = triple
        length = math.sqrt(a * a + b * b + c * c)
        if length <= self._dead:
            return _ZERO
        size = (length - self._dead) / self._reach
        # In a corner the length passes 1, where the curve is flat and each axis is clamped.
        square = min(size * size, 1.0)
        gain = size / length * (self._linear + self._cubic * square)
        return (_clamp(a * gain), _clamp(b * gain), _clamp(c * gain))

    def _lead(self, axes: Axes) -> Axes:
        sizes = [abs(u) for u in axes]
        strongest = max(sizes)
        leading = sizes[self._leader]
        if leading == 0.0 or strongest > leading * DOMINANCE_MARGIN:
            self._leader = sizes.index(strongest)
        x, y, z, rx, ry, rz = (u if i == self._leader else 0.0 for i, u in enumerate(axes))
        return (x, y, z, rx, ry, rz)


def _clamp(value: float) -> float:
    return -1.0 if value < -1.0 else 1.0 if value > 1.0 else value
