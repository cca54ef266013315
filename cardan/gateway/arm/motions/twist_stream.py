"""Streamed twists of the TCP, and streamed speeds of single joints."""

from __future__ import annotations

from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.types import ZERO_TWIST


class FollowTwistStream(ReferenceMotion):
    """Streamed twists."""

    @property
    def driven(self) -> bool:
        return self.wanted != ZERO_TWIST and not self.braking
