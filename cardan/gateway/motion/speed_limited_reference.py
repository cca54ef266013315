"""The virtual reference point: a pose that moves inside speed and acceleration limits.

The operator's twist is integrated on SE(3) into a reference pose, and the robot is commanded to be
there; the measured pose only supervises. Gravity sag and servo error therefore cannot creep into
the commanded pose (Łukawski, Victores and Balaguer 2023, section 4). Every limit is met by
construction: for any target, the next velocity is chosen inside bounds from which the reference can
still stop in time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

from cardan.common import bounds
from cardan.common.bounds import Bounds
from cardan.common.braking import (
    clipped,
    stopping_speed,
    stopping_speeds,
    within_walls,
)
from cardan.common.options import Options, require
from cardan.gateway.motion.shaping import JerkLimitedVector
from cardan.spatial import (
    limit_norm,
    moved,
    normalized,
    rotate,
    towards,
)
from cardan.types import ZERO3, Frame, Pose, Twist, Vector3

_new = tuple.__new__
"""Constructor of the named tuples of every cycle, in half the usual time."""

_BASE, _TOOL = Frame.BASE, Frame.TOOL
"""A look-up of an enum's member takes longer than what is done with it in a cycle."""


@dataclass(frozen=True, kw_only=True)
class ReferenceLimits(Options):
    """Limits of the reference; Euclidean norms, equal in all directions."""

    RENAMED: ClassVar = {"leash_m": "max_lead_m", "leash_rad": "max_lead_rad"}

    linear_speed_m_s: Annotated[float, bounds.LINEAR_SPEED_M_S] = 0.25
    """Default: the reduced speed of ISO 10218 beside a person."""
    linear_acceleration_m_s2: Annotated[float, bounds.LINEAR_ACCELERATION_M_S2] = 1.0
    angular_speed_rad_s: Annotated[float, bounds.ANGULAR_SPEED_RAD_S] = 1.0
    angular_acceleration_rad_s2: Annotated[float, bounds.ANGULAR_ACCELERATION_RAD_S2] = 4.0
    linear_jerk_m_s3: Annotated[float, bounds.LINEAR_JERK_M_S3] | None = None
    """Limit on the motion that the operator asks for; braking for a fault, a wall or the maximum
    lead is not limited by it. None: unbounded."""
    angular_jerk_rad_s3: Annotated[float, bounds.ANGULAR_JERK_RAD_S3] | None = None
    max_lead_m: Annotated[float, bounds.MAX_LEAD_M] = 0.05
    """Largest distance of the reference ahead of the measured position."""
    max_lead_rad: Annotated[float, bounds.MAX_LEAD_RAD] = 0.3
    """Largest angle of the reference ahead of the measured orientation."""
    workspace_x_m: Bounds | None = None
    """Range of the TCP along the base's x axis; None: unbounded."""
    workspace_y_m: Bounds | None = None
    workspace_z_m: Bounds | None = None

    @cached_property
    def workspace_m(self) -> tuple[Bounds | None, Bounds | None, Bounds | None]:
        """Range of the TCP along each base axis; None: unbounded."""
        return self.workspace_x_m, self.workspace_y_m, self.workspace_z_m

    def __post_init__(self) -> None:
        super().__post_init__()
        for axis, walls in zip("xyz", self.workspace_m, strict=True):
            good = walls is None or walls[0] < walls[1]
            require(good, f"workspace_{axis}_m", walls, "two ends, lower bound first")


class Reference:
    """A pose and its twist, both in the base frame, moved one control period at a time."""

    def __init__(self, limits: ReferenceLimits) -> None:
        self.limits = limits
        self.pose: Pose | None = None
        self.linear = ZERO3
        """m/s along base axes."""
        self.angular = ZERO3
        """rad/s along base axes."""
        self.ahead_m = 0.0
        """Distance from the position last observed to the reference."""
        self.ahead_rad = 0.0
        """Angle from the orientation last observed to the reference."""
        self.at_workspace_limit = False
        self._walls: tuple[tuple[float, ...], tuple[float, ...]] | None = None
        """Lower and upper corner of the workspace, infinite where unbounded."""
        if any(limits.workspace_m):
            ends = [walls or (-math.inf, math.inf) for walls in limits.workspace_m]
            self._walls = tuple(low for low, _ in ends), tuple(high for _, high in ends)
        self._smooth_linear: JerkLimitedVector | None = None
        self._smooth_angular: JerkLimitedVector | None = None
        if limits.linear_jerk_m_s3 is not None:
            self._smooth_linear = JerkLimitedVector(
                3,
                limits.linear_speed_m_s,
                limits.linear_acceleration_m_s2,
                limits.linear_jerk_m_s3,
            )
        if limits.angular_jerk_rad_s3 is not None:
            self._smooth_angular = JerkLimitedVector(
                3,
                limits.angular_speed_rad_s,
                limits.angular_acceleration_rad_s2,
                limits.angular_jerk_rad_s3,
            )

    @property
    def twist(self) -> Twist:
        """Present velocity, base axes."""
        return Twist(self.linear, self.angular, Frame.BASE)

    @property
    def moving(self) -> bool:
        """True until it has come to rest."""
        return self.linear != ZERO3 or self.angular != ZERO3

    def place(self, pose: Pose) -> None:
        """Put the reference at `pose`, at rest. Only while the robot is not under command."""
        self.pose = Pose(pose.position, normalized(pose.orientation), Frame.BASE)
        self.linear = self.angular = self._ahead = self._turned_ahead = ZERO3
        self.ahead_m = self.ahead_rad = 0.0
        self.at_workspace_limit = False
        for smooth in (self._smooth_linear, self._smooth_angular):
            if smooth is not None:
                smooth.reset()

    @property
    def lead_used(self) -> float:
        """Used share of the maximum lead, 0..1 and above; the worse of the two."""
        return max(self.ahead_m / self.limits.max_lead_m, self.ahead_rad / self.limits.max_lead_rad)

    def observe(self, measured: Pose) -> None:
        """Record the robot's pose: `ahead_m` and `ahead_rad` are measured from there."""
        pose = self.pose
        if pose is None:
            raise RuntimeError("the reference has not been placed")
        # In every control cycle: written out, a third of the time.
        (x, y, z), (w, i, j, k), _ = pose
        (u, v, s), (a, b, c, d), _ = measured
        x, y, z = x - u, y - v, z - s
        self._ahead = _new(Vector3, (x, y, z))
        self.ahead_m = math.sqrt(x * x + y * y + z * z)
        cosine = w * a + i * b + j * c + k * d
        x = i * a - w * b - j * d + k * c
        y = j * a - w * c - k * b + i * d
        z = k * a - w * d - i * c + j * b
        sine = math.sqrt(x * x + y * y + z * z)
        self.ahead_rad = angle = 2.0 * math.atan2(sine, abs(cosine))
        factor = math.copysign(angle / sine if sine > 1e-9 else 2.0, cosine)
        self._turned_ahead = _new(Vector3, (x * factor, y * factor, z * factor))

    def advance(self, target: Twist, dt_s: float, smooth: bool = True) -> None:
        """Move for `dt_s`, approaching `target` (base or tool axes) as fast as limits allow.
        Without `smooth` the jerk is not bounded: for immediate stops."""
        self.shape(target, dt_s, smooth)
        self.move(self.linear, self.angular, dt_s)

    def shape(self, target: Twist, dt_s: float, smooth: bool = True) -> None:
        """Bring the twist nearer to `target`, as `advance` does, without moving."""
        pose = self.pose
        if pose is None:
            raise RuntimeError("the reference has not been placed")
        limits = self.limits
        linear, angular = target.linear, target.angular
        if (frame := target.frame) is not _BASE:
            angular = rotate(pose.orientation, angular)
            if frame is _TOOL:
                linear = rotate(pose.orientation, linear)
        if math.hypot(*linear) > limits.linear_speed_m_s:
            linear = limit_norm(linear, limits.linear_speed_m_s)
        if math.hypot(*angular) > limits.angular_speed_rad_s:
            angular = limit_norm(angular, limits.angular_speed_rad_s)
        if smooth and self._smooth_linear is not None:
            linear = Vector3(*self._smooth_linear.advance(linear, dt_s))
        if smooth and self._smooth_angular is not None:
            angular = Vector3(*self._smooth_angular.advance(angular, dt_s))

        shaped: list[Vector3] = []
        for wanted, ahead, distance, max_lead, hardest in (
            (
                linear,
                self._ahead,
                self.ahead_m,
                limits.max_lead_m,
                limits.linear_acceleration_m_s2,
            ),
            (
                angular,
                self._turned_ahead,
                self.ahead_rad,
                limits.max_lead_rad,
                limits.angular_acceleration_rad_s2,
            ),
        ):
            if distance != 0.0:
                # Further ahead only as fast as it can stop; back or sideways is never held.
                (u, v, w), (a, b, c) = wanted, ahead
                outward = (u * a + v * b + w * c) / distance
                stops_after = outward * dt_s + outward * outward / (2.0 * hardest)
                if not (outward <= 0.0 or stops_after <= max_lead - distance):
                    excess = outward - stopping_speed(max_lead - distance, hardest, dt_s)
                    share = excess / distance
                    wanted = Vector3(u - a * share, v - b * share, w - c * share)
            shaped.append(wanted)
        linear, angular = shaped
        hardest = limits.linear_acceleration_m_s2
        if self._walls is not None:
            # A third of the squared budget for each axis, so that a corner is no worse.
            share = hardest / math.sqrt(3.0)
            bounds = stopping_speeds(pose.position, *self._walls, (share,) * 3, dt_s)
            self.at_workspace_limit = clipped(linear, *bounds) != linear
            confined = within_walls(self.linear, linear, *bounds, hardest * dt_s, share * dt_s)
            self.linear = Vector3(*confined)
        else:
            if linear != self.linear:
                linear = towards(self.linear, linear, hardest * dt_s)
            self.linear = linear
        if angular != self.angular:
            hardest = limits.angular_acceleration_rad_s2
            angular = towards(self.angular, angular, hardest * dt_s)
        self.angular = angular
        if not smooth:
            if self._smooth_linear is not None:
                self._smooth_linear.reset(self.linear)
            if self._smooth_angular is not None:
                self._smooth_angular.reset(self.angular)

    def move(self, linear: Vector3, angular: Vector3, dt_s: float) -> None:
        """Move for `dt_s` at a velocity in base axes, m/s and rad/s, ignoring its own twist."""
        pose = self.pose
        if pose is None:
            raise RuntimeError("the reference has not been placed")
        self.pose = moved(pose, linear, angular, dt_s)
