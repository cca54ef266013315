"""Motion by the operator device in rate, position or absolute mode."""

from __future__ import annotations

from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.types import ZERO_TWIST


class FollowOperator(ReferenceMotion):
    """Moves the TCP by the newest request of an operator device."""

    follows_operator = True

    @property
    def driven(self) -> bool:
        return self.wanted != ZERO_TWIST or self.rates is not None
