"""Follows the operator device in rate, position or absolute mode, as its newest request asks."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.types import ZERO_TWIST, Twist


class FollowHand(ReferenceMotion):
    """The TCP goes as the newest request of an operator device asks."""

    follows_hand = True

    def aim(self, twist: Twist, rates: Mapping[str, float], driving: bool) -> None:
        """Set the requested motion. Jerk is limited only while the operator is `driving`: releasing
        the dead-man brakes at once."""
        self.wanted, self.smooth = twist, driving
        self.rates = rates if rates and any(rates.values()) else None

    @property
    def driven(self) -> bool:
        return self.wanted != ZERO_TWIST or self.rates is not None
