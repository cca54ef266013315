"""Status of a controller: for views, recorders, and the Cartesian interface."""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, NamedTuple

from cardan.gateway.arm.authority import AuthorityState
from cardan.types import Pose, Twist

if TYPE_CHECKING:  # Imports Pinocchio, which sessions without an arm's model do without.
    from cardan.gateway.servo.servo import ServoStatus


class Phase(enum.Enum):
    """What an arm is doing."""

    NO_ROBOT = "no robot"
    """The robot is silent or would not act on commands."""
    DISARMED = "disarmed"
    """Holding; going on takes the deliberate act, or a verb."""
    HOLDING = "holding"
    """At rest; a source has the authority and may move at once."""
    MOVING = "moving"
    BRAKING = "braking"
    """Ramping down, by the operator's will or because something is wrong."""
    RECOVERING = "recovering"
    """The command is brought back to a robot that is not where it was commanded to be: slowly, a
    leash's length at most. Any button ends it."""


class ArmStatus(NamedTuple):
    """What the last tick decided."""

    phase: Phase
    message: str
    """Why nothing moves and what to do about it; empty when all is well."""
    target: Twist
    """What the operator asks for, along `target.frame`, after the filters."""
    twist: Twist
    """What is commanded, base axes."""
    pose: Pose | None
    """Where the TCP is commanded to be."""
    leash_used: float
    at_workspace_limit: bool
    gripper_closed: bool
    trips: int
    """How often a watchdog or fault disengaged the source that moved the arm."""
    authority: AuthorityState
    filters: tuple[str, ...] = ()
    """What the filters do to the operator's motion; those that do nothing are silent."""
    arm: ServoStatus | None = None
    """What the servo met, where there is an arm's model."""
