"""Follows an operator's hand, by rate, position or absolute, as its newest request asks."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.gateway.arm.activities.base import ARRIVED, GOING, Progress
from cardan.gateway.arm.activities.reference_motion import ReferenceMotion
from cardan.gateway.arm.body import Body
from cardan.gateway.motion.reference import Reference
from cardan.types import ZERO_TWIST, RobotState, Twist


class FollowHand(ReferenceMotion):
    """The TCP goes as the newest request of an operator device asks."""

    def __init__(self, body: Body, reference: Reference) -> None:
        super().__init__(body, reference)
        self._twist = ZERO_TWIST
        self._rates: Mapping[str, float] = {}
        self._driving = False

    def aim(self, twist: Twist, rates: Mapping[str, float], driving: bool) -> None:
        """What is asked for from now on. Jerk is limited only while the operator is `driving`:
        letting go of the dead-man brakes at once."""
        self._twist, self._rates, self._driving = twist, rates, driving

    @property
    def driven(self) -> bool:
        return self._twist != ZERO_TWIST or any(self._rates.values())

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        rates = self._rates if any(self._rates.values()) else None
        return ARRIVED if self._advance(self._twist, dt_s, self._driving, rates) else GOING
