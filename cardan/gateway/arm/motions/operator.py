"""Follows the operator device in rate, position or absolute mode, as its newest request asks."""

from __future__ import annotations

from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.types import ZERO_TWIST


class FollowOperator(ReferenceMotion):
    """The TCP goes as the newest request of an operator device asks."""

    follows_operator = True

    @property
    def driven(self) -> bool:
        return self.wanted != ZERO_TWIST or self.rates is not None
