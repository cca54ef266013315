"""Limiters that keep the reference within its limits, whatever is commanded.

Each limiter owns a `reference` and its `velocity` and moves it by one control period at
a time: towards a moving target (`track`), at a velocity (`drive`), or to a stop (`brake`). Limits
are bounds on the next velocity, chosen so that the bound after it can be met as well; nothing is
ever refused or frozen, and no period contains a step.

The bound on the way to a border or a target is the speed v with v²/(2a) + v·dt = d: after one
period at v exactly the braking distance is left. Unlike the bound for a fixed period it also
holds when the following periods are shorter or longer, as they are when datagrams get lost.

Plain floats on purpose: numpy is slower for six numbers.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from cardan.common.braking import (
    clipped,
    stopping_speed,
    stopping_speeds,
    within_walls,
)
from cardan.spatial import limit_norm, towards
from cardan.types import IDENTITY, ZERO3, Quaternion, Vector3

_sqrt = math.sqrt
_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor, for objects made in every cycle."""
_SQRT_3 = _sqrt(3.0)
_TINY = 1e-12
"""Distances and speeds below this (m, rad, per s) are rounding."""


class JointLimiter:
    """A limiter for axes that are independent of each other: joints, external axes.

    Positions stay in `lower`..`upper`, velocities within ±`speed`, and velocities change by at
    most `acceleration` times the period. An axis found outside its range may only move inwards.
    """

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        speed: Sequence[float],
        acceleration: Sequence[float],
        longest_period_s: float,
    ) -> None:
        """Limits per axis in rad or m; no period given later is above `longest_period_s`."""
        self._axes = range(len(speed))
        self._rest = (0.0,) * len(speed)
        self._lower = tuple(lower)
        self._upper = tuple(upper)
        self._speed = tuple(speed)
        self._acceleration = tuple(acceleration)
        # Between the inner bounds even the full speed can be stopped in time.
        braking = [
            v * v / (2.0 * a) + v * longest_period_s
            for v, a in zip(speed, acceleration, strict=True)
        ]
        self._inner_lower = tuple(b + d for b, d in zip(lower, braking, strict=True))
        self._inner_upper = tuple(b - d for b, d in zip(upper, braking, strict=True))
        self._target: Sequence[float] | None = None
        self.reference: list[float] = [0.0] * len(speed)
        """Commanded positions, always the same list object."""
        self.velocity: list[float] = [0.0] * len(speed)
        """Commanded velocities, always the same list object."""

    @property
    def limits(self) -> tuple[tuple[float, ...], ...]:
        """Lower and upper ends, the inner bounds within which full speed can be stopped, speeds and
        accelerations, by axis."""
        return (
            self._lower,
            self._upper,
            self._inner_lower,
            self._inner_upper,
            self._speed,
            self._acceleration,
        )

    @property
    def moving(self) -> bool:
        """True while the reference has a speed."""
        return any(self.velocity)

    def reset(self, positions: Sequence[float], velocities: Sequence[float] | None = None) -> None:
        """Start from `positions` at rest, or at `velocities` as far as they can be stopped."""
        self.reference[:] = positions
        self._target = None
        if velocities is None:
            self.velocity[:] = self._rest
            return
        ends = stopping_speeds(positions, self._lower, self._upper, self._acceleration, 0.0)
        velocities = clipped(velocities, [-v for v in self._speed], self._speed)
        self.velocity[:] = clipped(velocities, *ends)

    def coast(self, gap_s: float) -> None:
        """Advance by `gap_s` at the present speeds, stopping at the ends of the range."""
        self.reset(
            [
                min(max(q + v * gap_s, min(low, q)), max(high, q))
                for q, v, low, high in zip(
                    self.reference, self.velocity, self._lower, self._upper, strict=True
                )
            ],
            tuple(self.velocity),
        )

    def relocate(self, positions: Sequence[float]) -> None:
        """Set the reference to the measured positions, keeping the velocities (speed control)."""
        self.reference[:] = positions

    def track(
        self, target: Sequence[float], velocities: Sequence[float] | None, dt_s: float
    ) -> None:
        """Advance one period towards `target`, which moves at its observed speed.

        `velocities` stand in for that speed on the first call after a reset or a brake.
        """
        previous, self._target = self._target, target
        if previous is not None:
            velocities = [(q - before) / dt_s for q, before in zip(target, previous, strict=False)]
        elif velocities is None:
            velocities = self._rest
        self._advance(velocities, target, dt_s)

    def drive(self, velocities: Sequence[float], dt_s: float) -> None:
        """Advance one period at `velocities`."""
        self._target = None
        self._advance(velocities, None, dt_s)

    def brake(self, dt_s: float) -> None:
        """Slow down, or stand still, for one period."""
        self._target = None
        if any(self.velocity):
            self._advance(self._rest, None, dt_s)

    def _advance(
        self, desired: Sequence[float], target: Sequence[float] | None, dt_s: float
    ) -> None:
        """Advance one period at the velocities `desired`, and towards a `target` that moves at
        them."""
        positions, velocities = self.reference, self.velocity
        inner_lower, inner_upper = self._inner_lower, self._inner_upper
        for i, speed, a, position, before, velocity in zip(
            self._axes,
            self._speed,
            self._acceleration,
            positions,
            velocities,
            desired,
            strict=False,
        ):
            gain = a * dt_s
            if target is not None:
                if velocity > speed:
                    velocity = speed
                elif velocity < -speed:
                    velocity = -speed
                behind = target[i] - position - velocity * dt_s
                if behind > _TINY:
                    velocity += stopping_speed(behind, a, dt_s)
                elif behind < -_TINY:
                    velocity -= stopping_speed(-behind, a, dt_s)
            highest = before + gain
            if highest > speed:
                highest = speed
            lowest = before - gain
            if lowest < -speed:
                lowest = -speed
            if position > inner_upper[i]:
                highest = min(highest, stopping_speed(self._upper[i] - position, a, dt_s))
            if position < inner_lower[i]:
                lowest = max(lowest, -stopping_speed(position - self._lower[i], a, dt_s))
            if velocity < lowest:
                velocity = lowest
            if velocity > highest:
                velocity = highest
            velocities[i] = velocity
            positions[i] = position + velocity * dt_s


def _steer(
    velocity: Vector3,
    error: Sequence[float],
    forward: Sequence[float],
    speed: float,
    acceleration: float,
    dt_s: float,
) -> Vector3:
    """Return the next velocity of a point at distance `error` from a target moving at `forward`."""
    wx, wy, wz = forward
    fast = wx * wx + wy * wy + wz * wz
    if fast > speed * speed:
        shrink = speed / _sqrt(fast)
        wx *= shrink
        wy *= shrink
        wz *= shrink
    ex = error[0] - wx * dt_s
    ey = error[1] - wy * dt_s
    ez = error[2] - wz * dt_s
    behind = _sqrt(ex * ex + ey * ey + ez * ez)
    if behind > _TINY:
        closing = stopping_speed(behind, acceleration, dt_s) / behind
        wx += ex * closing
        wy += ey * closing
        wz += ez * closing
        squared = wx * wx + wy * wy + wz * wz
        if squared > speed * speed:
            shrink = speed / _sqrt(squared)
            wx *= shrink
            wy *= shrink
            wz *= shrink
    return towards(velocity, _new(Vector3, (wx, wy, wz)), acceleration * dt_s)


class _SpatialLimiter(ABC):
    """Limiter of three axes whose speed and acceleration are limited as vectors."""

    __slots__ = ("_acceleration", "_speed", "_target", "velocity")

    def __init__(self, speed: float, acceleration: float) -> None:
        self._speed = speed
        self._acceleration = acceleration
        self._target: Any = None
        self.velocity = ZERO3

    @property
    def moving(self) -> bool:
        """True while the reference has a speed."""
        return self.velocity != ZERO3

    def drive(self, velocity: Sequence[float], dt_s: float) -> None:
        """Advance one period at `velocity`."""
        self._target = None
        vx, vy, vz = limit_norm(Vector3(*velocity), self._speed)
        self._advance((vx * dt_s, vy * dt_s, vz * dt_s), (vx, vy, vz), dt_s)

    def brake(self, dt_s: float) -> None:
        """Slow down, or stand still, for one period."""
        self._target = None
        if self.velocity != ZERO3:
            self._advance(ZERO3, ZERO3, dt_s)

    @abstractmethod
    def _advance(self, error: Sequence[float], forward: Sequence[float], dt_s: float) -> None:
        """Advance one period towards a target at distance `error` that moves at `forward`."""


class PointLimiter(_SpatialLimiter):
    """Limiter of a point in space: speed, acceleration and, optionally, a bounding box.

    A point found outside the box may only move inwards.
    """

    __slots__ = ("_box", "reference")

    def __init__(
        self,
        speed: float,
        acceleration: float,
        box: tuple[Sequence[float], Sequence[float]] | None = None,
    ) -> None:
        """Set the limits in m/s and m/s²; `box` is its lower and its upper corner, m."""
        super().__init__(speed, acceleration)
        self._box = box
        self.reference = ZERO3

    def reset(self, position: Vector3, velocity: Sequence[float] = ZERO3) -> None:
        """Start from `position` at rest, or at `velocity` as far as it can be stopped."""
        self.reference = position
        self._target = None
        self.velocity = limit_norm(Vector3(*velocity), self._speed)
        if self._box is not None:
            self.velocity = Vector3(*clipped(self.velocity, *self._bounds(self._box, 0.0)))

    def coast(self, gap_s: float) -> None:
        """Advance by `gap_s` at the present velocity, stopping at the walls of the box."""
        x, y, z = self.reference
        vx, vy, vz = self.velocity
        place = Vector3(x + vx * gap_s, y + vy * gap_s, z + vz * gap_s)
        if self._box is not None and clipped(self.reference, *self._box) == self.reference:
            place = Vector3(*clipped(place, *self._box))
        self.reset(place, self.velocity)

    def relocate(self, position: Vector3) -> None:
        """Set the reference to the measured point, keeping the velocity (speed control)."""
        self.reference = position

    def track(self, target: Sequence[float], velocity: Sequence[float] | None, dt_s: float) -> None:
        """Advance one period towards `target`, which moves at its observed speed.

        `velocity` stands in for that speed on the first call after a reset or a brake. A target
        outside the box is replaced by the nearest point inside.
        """
        x, y, z = self.reference
        if self._box is not None:
            target = clipped(target, *self._box)  # the remaining component lies along the wall
        tx, ty, tz = target
        previous = self._target
        self._target = target
        forward: Sequence[float] = ZERO3
        if previous is not None:
            px, py, pz = previous
            forward = ((tx - px) / dt_s, (ty - py) / dt_s, (tz - pz) / dt_s)
        elif velocity is not None:
            forward = velocity
        self._advance((tx - x, ty - y, tz - z), forward, dt_s)

    def _advance(self, error: Sequence[float], forward: Sequence[float], dt_s: float) -> None:
        velocity = _steer(self.velocity, error, forward, self._speed, self._acceleration, dt_s)
        if self._box is not None:
            bounds = self._bounds(self._box, dt_s)
            if clipped(velocity, *bounds) != velocity:
                most = self._acceleration * dt_s
                confined = within_walls(self.velocity, velocity, *bounds, most)
                velocity = _new(Vector3, confined)
        self.velocity = velocity
        x, y, z = self.reference
        vx, vy, vz = velocity
        self.reference = _new(Vector3, (x + vx * dt_s, y + vy * dt_s, z + vz * dt_s))

    def _bounds(
        self, box: tuple[Sequence[float], Sequence[float]], dt_s: float
    ) -> tuple[list[float], list[float]]:
        # Three walls may have to be braked for at once: each gets its share of the acceleration.
        share = self._acceleration / _SQRT_3
        return stopping_speeds(self.reference, *box, (share,) * 3, dt_s)


class OrientationLimiter(_SpatialLimiter):
    """Limiter of an orientation: angular speed and acceleration; quaternions stay continuous.

    Rotations take the short way, whether a target is given as q or -q.
    """

    __slots__ = ("reference",)

    def __init__(self, speed: float, acceleration: float) -> None:
        """Set the limits in rad/s and rad/s²."""
        super().__init__(speed, acceleration)
        self.reference = IDENTITY

    def reset(self, orientation: Quaternion, velocity: Sequence[float] = ZERO3) -> None:
        """Start from `orientation` (a unit quaternion), turning at `velocity` within limits."""
        self.reference = orientation
        self._target = None
        self.velocity = limit_norm(Vector3(*velocity), self._speed)

    def coast(self, gap_s: float) -> None:
        """Advance by `gap_s` at the present angular velocity."""
        self._target = None
        self._turn(self.velocity, gap_s)

    def relocate(self, orientation: Quaternion) -> None:
        """Set the reference to the measured orientation, keeping the velocity (speed control)."""
        self.reference = orientation

    def track(self, target: Quaternion, velocity: Sequence[float] | None, dt_s: float) -> None:
        """Advance one period towards `target`, which turns at its observed rate.

        A target's length need not be exactly 1. `velocity` replaces the observed rate on the first
        call after a reset or a brake.
        """
        previous = self._target
        self._target = target
        w, x, y, z = target
        forward: Sequence[float] = ZERO3
        if previous is None:
            if velocity is not None:
                forward = velocity
        elif previous != target:
            # Within a period the sine of the half angle is the half angle.
            pw, px, py, pz = previous
            double = (2.0 if w * pw + x * px + y * py + z * pz >= 0.0 else -2.0) / dt_s
            forward = (
                double * (pw * x - px * w - y * pz + z * py),
                double * (pw * y - py * w - z * px + x * pz),
                double * (pw * z - pz * w - x * py + y * px),
            )
        qw, qx, qy, qz = self.reference
        dw = w * qw + x * qx + y * qy + z * qz
        dx = qw * x - qx * w - y * qz + z * qy
        dy = qw * y - qy * w - z * qx + x * qz
        dz = qw * z - qz * w - x * qy + y * qx
        sine = _sqrt(dx * dx + dy * dy + dz * dz)
        factor = 2.0
        if sine > _TINY:
            factor = 2.0 * math.atan2(sine, abs(dw)) / sine
        if dw < 0.0:
            factor = -factor
        self._advance((dx * factor, dy * factor, dz * factor), forward, dt_s)

    def _advance(self, error: Sequence[float], forward: Sequence[float], dt_s: float) -> None:
        velocity = _steer(self.velocity, error, forward, self._speed, self._acceleration, dt_s)
        self.velocity = velocity
        self._turn(velocity, dt_s)

    def _turn(self, velocity: Vector3, dt_s: float) -> None:
        wx, wy, wz = velocity
        rate = _sqrt(wx * wx + wy * wy + wz * wz)
        if rate < _TINY:
            return
        half = 0.5 * rate * dt_s
        factor = math.sin(half) / rate
        ax = wx * factor
        ay = wy * factor
        az = wz * factor
        aw = math.cos(half)
        w, x, y, z = self.reference
        nw = aw * w - ax * x - ay * y - az * z
        nx = aw * x + ax * w + ay * z - az * y
        ny = aw * y - ax * z + ay * w + az * x
        nz = aw * z + ax * y - ay * x + az * w
        # One Newton step keeps the length at 1 without a square root.
        unit = 1.5 - 0.5 * (nw * nw + nx * nx + ny * ny + nz * nz)
        self.reference = _new(Quaternion, (nw * unit, nx * unit, ny * unit, nz * unit))
