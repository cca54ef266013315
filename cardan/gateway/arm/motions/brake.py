"""Braking of a moving arm."""

from __future__ import annotations

from cardan.gateway.arm.commanded_arm import CommandedArm
from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.gateway.motion.speed_limited_reference import Reference


class Brake(ReferenceMotion):
    """Ramps the TCP from its present speed to rest within the reference's limits."""

    def __init__(self, commanded: CommandedArm, reference: Reference) -> None:
        super().__init__(commanded, reference)
        reference.place(commanded.pose)
        twist = commanded.twist
        reference.linear, reference.angular = twist.linear, twist.angular
        self.brake()

    @property
    def idle(self) -> bool:
        return False
