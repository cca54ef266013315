"""The controller's event log, with the numbers of events that users published."""

from __future__ import annotations

from typing import NamedTuple

UNNUMBERED = 0
"""For events whose number is not published."""

MOTORS_OFF = 10010
MOTORS_ON = 10011
EMERGENCY_STOP = 10013
PROGRAM_STOPPED = 10125
PROGRAM_STARTED = 10151
NO_DATA = 41822
MODE_MISMATCH = 41826
NEAR_SINGULARITY = 50026
JOINT_OUT_OF_RANGE = 50027
MOTION_SUPERVISION = 50204
MOVE_NOT_ALLOWED = 50453


class EventMessage(NamedTuple):
    """A line of the controller's event log."""

    time_s: float
    """Since the start of the controller."""
    code: int
    """0 where the number is not published."""
    text: str


class ControllerEventLog:
    """The event log of one controller, and the time that its next events get."""

    def __init__(self) -> None:
        self.now_s = 0.0
        """Since the start of the controller."""
        self.events: list[EventMessage] = []
        """Oldest first."""

    def add(self, code: int, text: str) -> None:
        """Add an event."""
        self.events.append(EventMessage(self.now_s, code, text))
