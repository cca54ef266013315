"""State that an EGM session keeps between cycles."""

from __future__ import annotations

from typing import Final, Protocol

from cardan.drivers.missed_cycles import SLACK_S
from cardan.types import NEVER_S

UNKNOWN: Final = -1
"""Marks a clock that the controller does not send, or an invalid number."""

NO_STATES: Final = (-1, -1, -1)
"""States that no controller sends, so that the first received ones count as a change."""


class CycleState(Protocol):
    """Cycle state, in Python or in memory shared with the compiled part."""

    states: list[int]
    """The controller's states: motors, MCI, RAPID execution."""
    tm_ms: int
    """The controller's clock in the newest header; UNKNOWN if it sends none. The next likewise."""
    time_us: int
    last_step_s: float
    """Time between the two newest datagrams by both clocks."""
    since_reply_s: float
    """Time since the last answer by both clocks."""
    credit_s: float
    """Time credit; see missed_cycles.py."""
    replied_s: float
    """Local time at which the last answer was sent."""
    out_seqno: int
    """Sequence number of the next answer."""
    said_speed: bool
    """True if the last answer commanded motion."""
    known: bool
    """True if the compiled part has stored the newest state here."""
    steady: bool
    """True if the compiled part may make the next answer: nothing has to be made up for."""


class PlainCycleState:
    """A CycleState in Python."""

    __slots__ = (
        "credit_s",
        "known",
        "last_step_s",
        "out_seqno",
        "replied_s",
        "said_speed",
        "since_reply_s",
        "states",
        "steady",
        "time_us",
        "tm_ms",
    )

    def __init__(self) -> None:
        self.states = list(NO_STATES)
        self.tm_ms = self.time_us = UNKNOWN
        self.last_step_s = self.since_reply_s = 0.0
        self.credit_s = SLACK_S
        self.replied_s = NEVER_S
        self.out_seqno = 0
        self.known = self.said_speed = self.steady = False
