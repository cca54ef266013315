"""Streamed poses: the reference chases the newest one in bounded jerk, and can stop at it."""

from __future__ import annotations

import math

from cardan.gateway.arm.commanded_arm import CommandedArm
from cardan.gateway.arm.motions.base import GOING, Deceleration, Progress
from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.gateway.motion.shaping import PoseShaper
from cardan.gateway.motion.speed_limited_reference import Reference
from cardan.spatial import (
    add,
    dot,
    from_rotation_vector,
    multiply,
    norm,
    normalized,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import NEVER_S, ZERO3, Frame, Pose, RobotState

RESTING_M_S = 1e-6
"""Speed, m/s or rad/s, below which a reference is at rest: rounding."""

VELOCITY_TIME_S = 0.1
"""Time constant of the velocity that poses are extrapolated with: filters the noise of single
poses."""

LONGEST_BETWEEN_S = 0.3
"""Longest time between two poses from which a velocity is estimated."""

HELD_SHARE = 0.95
"""Share of the wanted speed below which the reference goes on from the speed that was reached."""


class FollowPoseStream(ReferenceMotion):
    """Streamed poses: the reference chases the newest in bounded jerk, and can stop at it."""

    def __init__(
        self,
        commanded: CommandedArm,
        reference: Reference,
        deceleration: Deceleration,
        shaper: PoseShaper,
        prediction_s: float = 0.0,
    ) -> None:
        """`prediction_s`: longest extrapolation of the target from the last poses, which removes
        the delay of a message; the TCP may overshoot a target that stops by as much."""
        super().__init__(commanded, reference, deceleration)
        self.target: Pose | None = None
        self._shaper = shaper
        self._prediction_s = prediction_s
        self._linear = self._angular = ZERO3
        self._aimed_s = NEVER_S
        self._since_s = 0.0
        assert self.reference.pose is not None
        shaper.place(self.reference.pose)

    @property
    def driven(self) -> bool:
        pose = self.reference.pose
        if self.target is None or self.braking or pose is None:
            return False
        reference = self.reference
        return (
            norm(reference.linear) > RESTING_M_S
            or norm(reference.angular) > RESTING_M_S
            or norm(subtract(self.target.position, pose.position)) > 1e-6
            or norm(rotation_between(pose.orientation, self.target.orientation)) > 1e-5
            or self._predicting
        )

    def aim(self, target: Pose, now_s: float) -> None:
        """Go to `target` from now on, or, with prediction, to the extrapolation of the last
        targets."""
        if self._prediction_s > 0.0 and self.target is not None:
            since_s = now_s - self._aimed_s
            if 0.0 < since_s < LONGEST_BETWEEN_S:
                share = (1.0 - math.exp(-since_s / VELOCITY_TIME_S)) / since_s
                keep = 1.0 - share * since_s
                way = subtract(target.position, self.target.position)
                turn = rotation_between(self.target.orientation, target.orientation)
                self._linear = add(scale(self._linear, keep), scale(way, share))
                self._angular = add(scale(self._angular, keep), scale(turn, share))
            elif since_s > 0.0:
                self._linear = self._angular = ZERO3
        self.target, self._aimed_s, self._since_s = target, now_s, 0.0

    @property
    def _predicting(self) -> bool:
        moving = norm(self._linear) > RESTING_M_S or norm(self._angular) > RESTING_M_S
        return moving and self._since_s < self._prediction_s

    def _predicted(self, target: Pose, dt_s: float) -> Pose:
        """The target, extrapolated by its velocity for `prediction_s` at most."""
        self._since_s += dt_s
        ahead_s = min(self._since_s, self._prediction_s)
        if ahead_s <= 0.0:
            return target
        turn = from_rotation_vector(scale(self._angular, ahead_s))
        return Pose(
            add(target.position, scale(self._linear, ahead_s)),
            normalized(multiply(turn, target.orientation)),
            Frame.BASE,
        )

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        reference, shaper = self.reference, self._shaper
        if self.braking or self.target is None or not self.driven:
            return super().tick(robot, dt_s)
        here = reference.pose
        assert here is not None
        target = self._predicted(self.target, dt_s)
        now = shaper.twist
        to_go = subtract(target.position, here.position)
        to_turn = rotation_between(here.orientation, target.orientation)
        back = dot(now.linear, to_go) < 0.0 or dot(now.angular, to_turn) < 0.0
        if back and self.share < HELD_SHARE:
            # A blocked arm did not gain the speed that the reference would have to brake from.
            shaper.adopt(here, self._commanded.twist)
        else:
            shaper.adopt(here)
        there = shaper.advance(target, dt_s)
        linear = scale(subtract(there.position, here.position), 1.0 / dt_s)
        angular = scale(rotation_between(here.orientation, there.orientation), 1.0 / dt_s)
        reference.linear, reference.angular = linear, angular
        self.share = self._commanded.follow(reference, dt_s, slide=self.slides)
        return GOING
