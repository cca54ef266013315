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
    """Why it did not arrive; empty when it did, or goes on."""


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
    """Why it must not go on; empty while it may."""
    heard_s = math.inf
    """Time of the newest command of the source, s; infinite where a source need not renew it."""
    silence_s = math.inf
    """Longest silence of the source after which the motion may go on."""
    recovers = False
    """Whether it brings the command back to its robot."""
    follows_operator = False
    """Whether it follows the operator device."""
    in_one_step = False
    """Whether a long period must not be divided for it."""
    outlives_silence = False
    """Whether silence of the source only brakes it, and does not end it."""

    @property
    def yields(self) -> bool:
        """True while something else than a command may move the arm."""
        return False

    @property
    def driven(self) -> bool:
        """Whether the arm would continue to move if its source fell silent now."""
        return False

    @property
    def idle(self) -> bool:
        """True while nothing moves and nothing is asked for."""
        return False

    @abstractmethod
    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""

    @abstractmethod
    def brake(self) -> None:
        """Come to rest from now on; `tick` says when that is done."""

    def release(self) -> None:  # noqa: B027 - only one of them outlives silence
        """Drive nothing from the next tick on, where it outlives silence."""
