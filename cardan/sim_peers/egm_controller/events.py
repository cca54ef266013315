"""The controller's event log, with the numbers of events that users published."""

from __future__ import annotations

from typing import NamedTuple

MOTORS_OFF = 10010
MOTORS_ON = 10011
EMERGENCY_STOP = 10013
PROGRAM_STOPPED = 10125
PROGRAM_STARTED = 10151
NO_DATA = 41822
MODE_MISMATCH = 41826
MOTION_SUPERVISION = 50204
MOVE_NOT_ALLOWED = 50453


class Event(NamedTuple):
    """A line of the controller's event log."""

    time_s: float
    """Since the start of the controller."""
    code: int
    """0 where the number is not published."""
    text: str
