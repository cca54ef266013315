"""When a process of the daemon runs, without I/O: started, watched, started again, given up.

Local monotonic time, s, comes in with every call.
"""

from __future__ import annotations

import enum
from typing import Final

from cardan.types import NEVER_S

FIRST_PAUSE_S: Final = 1.0
"""Pause before the first new start of a process that has ended by itself."""

LONGEST_PAUSE_S: Final = 30.0
"""The pauses double up to this one."""

LASTED_S: Final = 60.0
"""A process that ran for longer has not failed to start: pauses begin at the first again."""


class UnitState(enum.Enum):
    """State of a unit."""

    STOPPED = "stopped"
    """It is not meant to run."""
    RUNNING = "running"
    ENDING = "ending"
    """It was asked to end."""
    WAITING = "waiting"
    """It has ended by itself, and is started again after a pause."""
    FAILED = "failed"
    """It is given up, until a request starts it."""


class Ended(enum.Enum):
    """How a process has ended."""

    AS_ASKED = "as asked"
    DIED = "died"
    """By itself, of a fault of its own."""
    UNABLE = "unable"
    """A resource is missing: a device, a port. It counts towards no limit."""
    MISCONFIGURED = "misconfigured"
    """Starting it again would change nothing."""


class Unit:
    """A process that is to run: when it is started, and how often again.

    The caller starts a process when `due`, tells of its beginning and its end, and asks it to end
    while `is_ending`.
    """

    def __init__(self, name: str, start_limit: int) -> None:
        """`start_limit`: starts in a row, none of which lasted, after which it is given up."""
        self.name = name
        self.start_limit = start_limit
        self.state = UnitState.STOPPED
        self.reason = ""
        """Why it is not running, in words."""
        self.restarts = 0
        """How often it was started again after an end of its own."""
        self.since_s = NEVER_S
        """Since when it is in its state."""
        self._due_s = NEVER_S
        self._pause_s = FIRST_PAUSE_S
        self._failures = 0
        self._then_start = False

    # -- requests --------------------------------------------------------------------------------

    def start(self, now_s: float) -> None:
        """It is to run from now on."""
        if self.state is UnitState.ENDING:
            self._then_start = True
        elif self.state is not UnitState.RUNNING:
            self._forgive()
            self._wait(now_s, now_s)

    def stop(self, now_s: float, reason: str = "stopped by hand") -> None:
        """It is not to run any more."""
        self._then_start = False
        if self.state is UnitState.RUNNING:
            self._enter(UnitState.ENDING, now_s, reason)
        elif self.state is not UnitState.ENDING:
            self._enter(UnitState.STOPPED, now_s, reason)

    def restart(self, now_s: float, reason: str = "restarted by hand") -> None:
        """It is to end, and to begin anew."""
        running = self.state in (UnitState.RUNNING, UnitState.ENDING)
        if running:
            self.stop(now_s, reason)
        self.start(now_s)

    # -- ends of its process ---------------------------------------------------------------------

    @property
    def due_s(self) -> float | None:
        """When a process is to be started; None: not by itself."""
        return self._due_s if self.state is UnitState.WAITING else None

    def due(self, now_s: float) -> bool:
        """Whether a process is to be started now."""
        return self.state is UnitState.WAITING and now_s >= self._due_s

    @property
    def wanted(self) -> bool:
        """Whether it runs, or is to run again by itself."""
        ending = self.state is UnitState.ENDING and self._then_start
        return ending or self.state in (UnitState.RUNNING, UnitState.WAITING)

    @property
    def is_ending(self) -> bool:
        """Whether its process is to end."""
        return self.state is UnitState.ENDING

    def begun(self, now_s: float) -> None:
        """Its process has been started."""
        self._enter(UnitState.RUNNING, now_s, "")

    def ended(self, how: Ended, reason: str, now_s: float) -> None:
        """Its process has ended; `reason` in words."""
        lasted = now_s - self.since_s > LASTED_S
        if self.state is UnitState.ENDING:
            words = self.reason
            self._enter(UnitState.STOPPED, now_s, words)
            if self._then_start:
                self._then_start = False
                self._forgive()
                self._wait(now_s, now_s, words)
            return
        if how is Ended.AS_ASKED:
            # Another program ended it, or its time was over.
            self._enter(UnitState.STOPPED, now_s, reason or "it has ended by itself")
            return
        if how is Ended.MISCONFIGURED:
            self._enter(UnitState.FAILED, now_s, reason)
            return
        if lasted:
            self._forgive()
        if how is Ended.DIED:
            self._failures += 1
        if self._failures >= self.start_limit:
            words = f"given up after {self._failures} starts in a row: {reason}"
            self._enter(UnitState.FAILED, now_s, words)
            return
        self.restarts += 1
        self._wait(now_s, now_s + self._pause_s, reason)
        self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)

    def _forgive(self) -> None:
        self._failures, self._pause_s = 0, FIRST_PAUSE_S

    def _wait(self, now_s: float, due_s: float, reason: str = "") -> None:
        self._due_s = due_s
        self._enter(UnitState.WAITING, now_s, reason)

    def _enter(self, state: UnitState, now_s: float, reason: str) -> None:
        self.state, self.since_s, self.reason = state, now_s, reason
