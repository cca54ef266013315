"""Restart policy of the daemon's processes, without I/O: start, watch, restart, give up. Local
monotonic time, s, is an argument of each call."""

from __future__ import annotations

import enum
from typing import Final

from cardan.types import NEVER_S

FIRST_PAUSE_S: Final = 1.0
"""Pause before the first restart of a process that has ended by itself."""

LONGEST_PAUSE_S: Final = 30.0
"""Longest pause; pauses double up to it."""

LASTED_S: Final = 60.0
"""Running time after which a start counts as successful: the pauses start again at the first."""


class UnitState(enum.Enum):
    """State of a unit."""

    STOPPED = "stopped"
    """The process is not meant to run."""
    RUNNING = "running"
    ENDING = "ending"
    """The process was requested to end."""
    WAITING = "waiting"
    """The process has ended by itself, and is restarted after a pause."""
    FAILED = "failed"
    """The process failed too often, and stays stopped until a request starts it."""


class Ended(enum.Enum):
    """Outcome of a process."""

    AS_ASKED = "as asked"
    DIED = "died"
    """The process ended by itself, with a fault of its own."""
    UNABLE = "unable"
    """A resource is missing: a device, a port. Does not count towards the limit."""
    MISCONFIGURED = "misconfigured"
    """The configuration is wrong: a restart would change nothing."""


class Unit:
    """Restart policy of one process. The caller starts the process when `due`, reports its begin
    and its end, and requests its end while `is_ending`."""

    def __init__(self, name: str, start_limit: int) -> None:
        """`start_limit`: short starts in a row after which it stays stopped."""
        self.name = name
        self.start_limit = start_limit
        self.state = UnitState.STOPPED
        self.reason = ""
        """Reason why it is not running."""
        self.restarts = 0
        """Count of restarts after an end of its own."""
        self.since_s = NEVER_S
        """Time since when it has its state."""
        self._due_s = NEVER_S
        self._pause_s = FIRST_PAUSE_S
        self._failures = 0
        self._then_start = False

    # -- requests --------------------------------------------------------------------------------

    def start(self, now_s: float) -> None:
        """Request that it run from now on."""
        if self.state is UnitState.ENDING:
            self._then_start = True
        elif self.state is not UnitState.RUNNING:
            self._forgive()
            self._wait(now_s, now_s)

    def stop(self, now_s: float, reason: str = "stopped by hand") -> None:
        """Request that it end and stay stopped."""
        self._then_start = False
        if self.state is UnitState.RUNNING:
            self._enter(UnitState.ENDING, now_s, reason)
        elif self.state is not UnitState.ENDING:
            self._enter(UnitState.STOPPED, now_s, reason)

    def restart(self, now_s: float, reason: str = "restarted by hand") -> None:
        """Request that it end and start again."""
        running = self.state in (UnitState.RUNNING, UnitState.ENDING)
        if running:
            self.stop(now_s, reason)
        self.start(now_s)

    # -- ends of its process ---------------------------------------------------------------------

    @property
    def due_s(self) -> float | None:
        """Time of the next start; None: only by request."""
        return self._due_s if self.state is UnitState.WAITING else None

    def due(self, now_s: float) -> bool:
        """Return whether the process is to be started now."""
        return self.state is UnitState.WAITING and now_s >= self._due_s

    @property
    def wanted(self) -> bool:
        """True if it runs, or is to be restarted."""
        ending = self.state is UnitState.ENDING and self._then_start
        return ending or self.state in (UnitState.RUNNING, UnitState.WAITING)

    @property
    def is_ending(self) -> bool:
        """True if its process is to end."""
        return self.state is UnitState.ENDING

    def begun(self, now_s: float) -> None:
        """Record that its process has been started."""
        self._enter(UnitState.RUNNING, now_s, "")

    def ended(self, how: Ended, reason: str, now_s: float) -> None:
        """Record that its process has ended, and why."""
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
