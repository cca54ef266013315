"""Status of a controller: for views, recorders, and the Cartesian interface."""

from __future__ import annotations

import enum
from typing import Final, NamedTuple

from cardan.gateway.servo.status import ServoStatus
from cardan.types import Pose, Twist

OPERATOR = "device"
"""The operator device of the session: its name in files, in records and on the network."""

VERBS = "verbs"
"""The verbs and nameless streams of this process."""


class Phase(enum.Enum):
    """Phase of an arm, as displayed."""

    NO_ROBOT = "no robot"
    """The robot is silent or would not act on commands."""
    DISARMED = "disarmed"
    """Holding; to go on, re-arm or send a verb."""
    HOLDING = "holding"
    """At rest; a source has the authority and may move at once."""
    MOVING = "moving"
    BRAKING = "braking"
    """Ramping down, by the operator's will or because something is wrong."""
    RECOVERING = "recovering"
    """The command is brought back to a robot that is not where it was commanded to be: slowly, by
    the maximum lead at most. Any button ends it."""


LIMITS: Final = ("collision", "singularity", "joint", "unreachable", "workspace", "max_lead")
"""Limits of an arm's motion: a body nearby; a singularity; a joint's bound of speed, acceleration
or range; no joint for the commanded motion; the edge of the workspace; a robot that is as far
behind as it may be."""

TAUT_SHARE: Final = 0.9
"""Share of the maximum lead above which the robot counts as not following."""


class AuthorityState(NamedTuple):
    """The source that has the authority, the time since when, and the last refusal."""

    owner: str
    """Empty: no source."""
    since_s: float
    """Local monotonic time."""
    refused: str
    """The last refusal; empty before the first."""


class ArmStatus(NamedTuple):
    """Result of the last tick."""

    phase: Phase
    message: str
    """Reason why nothing moves, and what to do; empty when all is well."""
    target: Twist
    """Operator's request, along `target.frame`, after the filters."""
    twist: Twist
    """Commanded twist, base axes."""
    pose: Pose | None
    """Commanded TCP pose."""
    lead_used: float
    at_workspace_limit: bool
    gripper_closed: bool
    trips: int
    """Count of the trips: a watchdog or fault disengaged the source that moved the arm."""
    authority: AuthorityState
    filters: tuple[str, ...] = ()
    """Effects of the filters on the operator's motion; filters without effect are left out."""
    arm: ServoStatus | None = None
    """Status of the servo, if there is an arm's model."""

    def limits(self) -> list[str]:
        """Return those of LIMITS that act now."""
        found = [] if self.arm is None else self.arm.limits()
        if self.at_workspace_limit:
            found.append("workspace")
        if self.lead_used > TAUT_SHARE:
            found.append("max_lead")
        return found
