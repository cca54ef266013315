"""Streamed twists of the TCP, and streamed speeds of single joints."""

from __future__ import annotations

from cardan.gateway.arm.commanded_arm import CommandedArm
from cardan.gateway.arm.motions.base import ARRIVED, GOING, Deceleration, Progress
from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.gateway.motion.speed_limited_reference import Reference
from cardan.types import ZERO_TWIST, RobotState


class FollowTwistStream(ReferenceMotion):
    """Streamed twists."""

    def __init__(
        self, commanded: CommandedArm, reference: Reference, deceleration: Deceleration
    ) -> None:
        super().__init__(commanded, reference, deceleration)
        self.target = ZERO_TWIST

    @property
    def driven(self) -> bool:
        return self.target != ZERO_TWIST and not self.braking

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        return ARRIVED if self._advance(self.target, dt_s) else GOING
