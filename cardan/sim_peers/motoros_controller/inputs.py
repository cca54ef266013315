"""MotoROS's view of its controller: status inputs, and the condition for motion.

Source: MotoROS 1.9.12, Controller.c; the order of the reasons is that of its not-ready subcodes.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

from cardan.protocols.simple_message.codes import NotReadySubcode

POLL_S = 0.010
"""Poll period of the inputs."""


@dataclass(kw_only=True, slots=True)
class Inputs:
    """The status inputs at one moment."""

    servo: bool
    play: bool
    """False: teach."""
    remote: bool
    alarm: int = 0
    """Number of the active alarm."""
    error: int = 0
    """Number of the active error, which is less than an alarm."""
    estop: bool = False
    hold: bool = False
    operating: bool = False
    """A job runs."""
    waiting: bool = False
    """INIT_ROS is on its WAIT line (output 889 is on)."""
    energy_saving: bool = False
    collaborative_stop: bool = False

    def copy(self) -> Inputs:
        """Return a copy of the present inputs."""
        return copy.copy(self)

    @property
    def drives_powered(self) -> bool:
        """True with the servos on and without energy saving."""
        return self.servo and not self.energy_saving

    @property
    def moves(self) -> bool:
        """True if the controller executes increments at all."""
        return (
            self.operating
            and self.waiting
            and self.servo
            and self.play
            and self.remote
            and not (
                self.alarm
                or self.estop
                or self.hold
                or self.energy_saving
                or self.collaborative_stop
            )
        )


def not_ready_reason(
    inputs: Inputs, job_ready: bool, collaborative_stop: bool, increment_error: bool
) -> NotReadySubcode:
    """Return the first reason in MotoROS's order why motion is not possible."""
    reasons = (
        (inputs.alarm, NotReadySubcode.ALARM),
        (inputs.error, NotReadySubcode.ERROR),
        (inputs.estop, NotReadySubcode.ESTOP),
        (not inputs.play, NotReadySubcode.NOT_PLAY),
        (not inputs.remote, NotReadySubcode.NOT_REMOTE),
        (not inputs.drives_powered, NotReadySubcode.SERVO_OFF),
        (inputs.hold, NotReadySubcode.HOLD),
        (collaborative_stop, NotReadySubcode.PFL_ACTIVE),
        (increment_error, NotReadySubcode.INC_MOVE_ERROR),
        (not inputs.operating, NotReadySubcode.NOT_STARTED),
        (not job_ready, NotReadySubcode.WAITING_ROS),
    )
    for applies, reason in reasons:
        if applies:
            return reason
    # MotoROS gives this subcode in all other cases, although its name is SKILLSEND.
    return NotReadySubcode.SKILLSEND
