"""The interface of a motion, and how one ends."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

from cardan.gateway.arm.vocab import State
from cardan.gateway.motion.speed_limited_reference import Reference
from cardan.types import RobotCommand, RobotState


class Deceleration(NamedTuple):
    """Deceleration of a braking ramp."""

    linear_m_s2: float
    angular_rad_s2: float
    joint_share: float
    """Share of each joint's acceleration."""


class Progress(NamedTuple):
    """State of a motion after a tick."""

    over: bool
    reason: str = ""
    """Why it did not arrive; empty while it goes on, or when it arrived."""


GOING = Progress(False)
ARRIVED = Progress(True)


class CommandedMotion(ABC):
    """Base of the motions that move the commanded arm. Each begins and ends at rest."""

    state = State.NOT_CONTROLLING
    """Its state in the Cartesian interface."""
    reference: Reference | None = None
    """The point that the TCP follows; None where joints follow a path."""
    command: RobotCommand | None = None
    """Sent to the robot in place of the commanded arm's command."""
    fault = ""
    """Reason why it must not continue; empty while it may."""
    heard_s = math.inf
    """Time of the newest command of the source, s; infinite where a source need not renew it."""
    silence_s = math.inf
    """Longest silence of the source after which the motion may go on."""
    recovers = False
    """True if it brings the command back to its robot."""
    follows_operator = False
    """True if it follows the operator device."""
    in_one_step = False
    """True if a long period must not be divided for it."""
    outlives_silence = False
    """True if silence of the source only brakes it, and does not end it."""

    @property
    def yields(self) -> bool:
        """True while the arm may be moved by something other than a command."""
        return False

    @property
    def driven(self) -> bool:
        """True if the arm would continue to move after its source fell silent now."""
        return False

    @property
    def idle(self) -> bool:
        """True while nothing moves and no motion is requested."""
        return False

    @abstractmethod
    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""

    @abstractmethod
    def brake(self) -> None:
        """Come to rest from now on; `tick` reports the end."""

    def release(self) -> None:  # noqa: B027 - only one of them outlives silence
        """Drive nothing from the next tick on, if it outlives silence."""
