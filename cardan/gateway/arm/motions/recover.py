"""Recovery: brings a command back to a robot that did not follow it."""

from __future__ import annotations

from typing import NamedTuple

from cardan.gateway.arm.commanded_arm import (
    APPROACH_SPEED_M_S,
    APPROACH_SPEED_RAD_S,
    APPROACH_TIME_S,
    CommandedArm,
    FollowingError,
)
from cardan.gateway.arm.motions.base import GOING, CommandedMotion, Progress
from cardan.gateway.motion.speed_limited_reference import Reference
from cardan.spatial import norm, rotation_between, subtract
from cardan.types import RobotState

SETTLING_TIMES = 5.0
"""Longest duration of an approach in time constants, in addition to the time of the distance at
full speed."""

MARGIN_M, MARGIN_RAD = 0.01, 0.05
"""The command moves by the distance to its robot and at most this much more: beyond, it would chase
a robot that moves as well."""

MARGIN_SHARE = 1.5
"""Factor on that distance, for the same reason."""


class Way(NamedTuple):
    """Length of a motion of the TCP."""

    linear_m: float
    angular_rad: float


NO_WAY = Way(0.0, 0.0)


class Recover(CommandedMotion):
    """Moves the command slowly to the robot's measured position; the robot need not move. It ends
    near the robot, or after the maximum lead, or by `brake`: then `near` is False."""

    recovers = True

    def __init__(
        self,
        commanded: CommandedArm,
        reference: Reference,
        near: FollowingError,
        error: FollowingError,
        went: Way = NO_WAY,
    ) -> None:
        """Done when the following error, now `error`, is inside `near`. `went`: length of earlier
        recoveries since the last re-arming."""
        self._commanded = commanded
        self.reference: Reference = reference
        self._limit = near
        limits = reference.limits
        # Less the braking distance of its own speed.
        self._way_m = min(
            limits.max_lead_m - went.linear_m, MARGIN_SHARE * error.linear_m + MARGIN_M
        ) - (APPROACH_SPEED_M_S**2 / limits.linear_acceleration_m_s2)
        self._way_rad = min(
            limits.max_lead_rad - went.angular_rad, MARGIN_SHARE * error.angular_rad + MARGIN_RAD
        ) - (APPROACH_SPEED_RAD_S**2 / limits.angular_acceleration_rad_s2)
        self._left_s = SETTLING_TIMES * APPROACH_TIME_S + max(
            limits.max_lead_m / APPROACH_SPEED_M_S, limits.max_lead_rad / APPROACH_SPEED_RAD_S
        )
        self._braking = False
        self.near = False
        """True once the command is back at its robot."""
        self.went = went
        """Length of recoveries since the last re-arming, this one included."""

    def brake(self) -> None:
        """End it at its present position."""
        self._braking = True

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        commanded, reference = self._commanded, self.reference
        self._left_s -= dt_s
        if not self._braking:
            self.near = not commanded.following_error(robot, reference).exceeds(self._limit)
            spent = self._left_s <= 0.0 or self._way_m <= 0.0 or self._way_rad <= 0.0
            self._braking = self.near or spent
        before = commanded.pose
        if self._braking:
            commanded.brake(dt_s)
        else:
            commanded.approach(robot, dt_s)
        after = commanded.pose
        reference.pose = after
        step_m = norm(subtract(after.position, before.position))
        step_rad = norm(rotation_between(before.orientation, after.orientation))
        self._way_m -= step_m
        self._way_rad -= step_rad
        self.went = Way(self.went.linear_m + step_m, self.went.angular_rad + step_rad)
        return Progress(True) if self._braking and not commanded.moving else GOING
