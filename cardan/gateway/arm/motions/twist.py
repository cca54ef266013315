"""movv: a constant twist of the TCP, without end."""

from __future__ import annotations

from cardan.gateway.arm.commanded_arm import CommandedArm
from cardan.gateway.arm.motions.base import GOING, Deceleration, Progress
from cardan.gateway.arm.motions.reference_motion import ReferenceMotion
from cardan.gateway.arm.motions.trajectory_motion import STUCK_S, STUCK_SHARE
from cardan.gateway.arm.vocab import State
from cardan.gateway.motion.speed_limited_reference import Reference
from cardan.spatial import norm
from cardan.types import RobotState, Twist


class FollowTwist(ReferenceMotion):
    """movv: a constant twist, without end."""

    state = State.MOVV
    slides = False

    def __init__(
        self,
        commanded: CommandedArm,
        reference: Reference,
        deceleration: Deceleration,
        twist: Twist,
    ) -> None:
        """`twist` in base axes."""
        super().__init__(commanded, reference, deceleration)
        self.wanted = twist
        self._stuck_s = 0.0
        self._reason = ""

    @property
    def idle(self) -> bool:
        return False

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        if super().tick(robot, dt_s).over:
            return Progress(True, self._reason)
        reference = self.reference
        if not self.braking:
            walled = reference.at_workspace_limit and norm(reference.linear) < 1e-4
            slow = self.share < STUCK_SHARE or walled
            self._stuck_s = self._stuck_s + dt_s if slow else 0.0
            if self._stuck_s > STUCK_S:
                self._reason = (
                    "the TCP is at the limit of the workspace"
                    if walled
                    else self._commanded.held_by() or "the arm cannot go on in this direction"
                )
                self.brake()
        return GOING
