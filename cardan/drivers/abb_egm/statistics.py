"""State that an EGM session keeps between cycles."""

from __future__ import annotations

from typing import Final, Protocol

from cardan.drivers.missed_cycles import SLACK_S
from cardan.types import NEVER_S

UNKNOWN: Final = -1
"""A clock that the controller does not send, or no number of it."""

NO_STATES: Final = (-1, -1, -1)
"""No controller sends these, so the first states received count as a change."""


class CycleState(Protocol):
    """State in Python, or in memory shared with the compiled part."""

    states: list[int]
    """The controller's: motors, MCI, RAPID execution."""
    tm_ms: int
    """The controller's clock in the newest header; UNKNOWN: it sends none. Likewise:"""
    time_us: int
    last_step_s: float
    """Time between the two newest datagrams, as both clocks agree."""
    since_reply_s: float
    """Time since the last answer, likewise."""
    credit_s: float
    """Credit of time, as in missed_cycles.py."""
    replied_s: float
    """Local time at which the last answer was sent."""
    out_seqno: int
    """The next answer's sequence number."""
    said_speed: bool
    """Whether the last answer told the controller to move."""
    known: bool
    """Whether the compiled part has put the newest state here itself."""
    steady: bool
    """Whether the next answer may be made by the compiled part: nothing is to be made up for."""


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
