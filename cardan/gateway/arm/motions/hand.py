"""Follows the operator device in rate, position or absolute mode, as its newest request asks."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.gateway.arm.commanded_arm import CommandedArm
from cardan.gateway.arm.motions.base import ARRIVED, GOING, Progress
from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.gateway.motion.speed_limited_reference import Reference
from cardan.types import ZERO_TWIST, RobotState, Twist


class FollowHand(ReferenceMotion):
    """The TCP goes as the newest request of an operator device asks."""

    follows_hand = True

    def __init__(self, commanded: CommandedArm, reference: Reference) -> None:
        super().__init__(commanded, reference)
        self._twist = ZERO_TWIST
        self._rates: Mapping[str, float] | None = None
        self._driving = False

    def aim(self, twist: Twist, rates: Mapping[str, float], driving: bool) -> None:
        """Set the requested motion. Jerk is limited only while the operator is `driving`: releasing
        the dead-man brakes at once."""
        self._twist, self._driving = twist, driving
        self._rates = rates if rates and any(rates.values()) else None

    @property
    def driven(self) -> bool:
        return self._twist != ZERO_TWIST or self._rates is not None

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        over = self._advance(self._twist, dt_s, self._driving, self._rates)
        return ARRIVED if over else GOING
