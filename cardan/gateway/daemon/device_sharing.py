"""Sharing policy for one device used by several sessions (no I/O).

The device passes through rest: the session that has it closes it, its arm brakes, and only when
that rests does the next session open it.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from typing import NamedTuple

AT_REST = frozenset({"disarmed", "no robot"})
"""Phases of an arm whose operator device may go to another arm."""


class Order(enum.Enum):
    """Order from the daemon to a session."""

    TAKE = "take"
    GIVE = "give"


class SessionState(NamedTuple):
    """Known state of a session."""

    wanted: bool
    """True if it runs, or is to be restarted."""
    running: bool
    held: bool
    """True if it has the device open."""
    phase: str
    passes: int
    """Count of its operator's requests to pass the device on, since its begin."""


class SharedDevice:
    """A device that several sessions share: its holder, and the next one."""

    def __init__(self, name: str, sessions: Sequence[str]) -> None:
        """`sessions` in the order of passing the device; the first has it at the beginning."""
        self.name = name
        self.sessions = tuple(sessions)
        self.holder = self.sessions[0]
        """Session that has it, or is getting it."""
        self._next = ""
        """Session that gets it once the holder's arm is at rest."""
        self._passes: dict[str, int] = {}

    @property
    def next(self) -> str:
        """Session that waits for it; empty: none."""
        return self._next

    def serve(self, sessions: Sequence[str]) -> None:
        """Set the sessions that share it from now on; its holder keeps it."""
        self.sessions = tuple(sessions)
        if self.holder not in sessions:
            self.holder, self._next = self.sessions[0], ""
        if self._next not in sessions:
            self._next = ""

    def pass_to(self, session: str) -> None:
        """Give the device to `session`, one of those that share it."""
        self._next = "" if session == self.holder else session

    def after(self, session: str, may: Callable[[str], bool]) -> str:
        """Return the next session after this one for which `may` is true; empty: none."""
        start = self.sessions.index(session)
        round_ = (*self.sessions[start + 1 :], *self.sessions[:start])
        return next((each for each in round_ if may(each)), "")

    def poll(self, seen: Callable[[str], SessionState]) -> list[tuple[str, Order]]:
        """Return the orders to sessions; call this several times a second."""
        found: list[tuple[str, Order]] = []
        now = {session: seen(session) for session in self.sessions}
        holder = now[self.holder]
        if holder.passes > self._passes.get(self.holder, 0) and not self._next:
            self._next = self.after(self.holder, lambda each: now[each].wanted)
        for session, each in now.items():
            self._passes[session] = each.passes
        if not holder.wanted and not self._next:
            self._next = self.after(self.holder, lambda each: now[each].wanted)
        if self._next:
            if holder.held and holder.running:
                found.append((self.holder, Order.GIVE))
            elif not holder.running or holder.phase in AT_REST:
                self.holder, self._next = self._next, ""
        if not self._next:
            for session, each in now.items():
                if each.running and each.held is not (session == self.holder):
                    order = Order.TAKE if session == self.holder else Order.GIVE
                    others = any(o.held and o.running for s, o in now.items() if s != session)
                    if order is Order.GIVE or not others:
                        found.append((session, order))
        return found
