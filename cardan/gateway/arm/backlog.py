"""For how long what asks an arm to move may have waited on its way, whichever way it comes."""

from __future__ import annotations

from cardan.types import NEVER_S

STALE_S = 0.3
"""What may have waited for longer is not acted on: its sender may have stopped since."""

BACKLOGGED_S = 1.0
"""A client of which something waits for more than STALE_S, for this long, sends more than can be
handled: it is disconnected."""

BACKLOGGED = f"what you send has waited here for more than {STALE_S:g} s: send less often"
"""The reason that a client is told, of 123 bytes at most, as WebSocket has it."""


class Backlog:
    """Whether more waits of one client, and for longer, than is tolerated."""

    def __init__(self) -> None:
        self._since_s = NEVER_S

    def lasts(self, waited_s: float, now_s: float) -> bool:
        """Whether it has lasted for too long, as of `now_s` the newest that was read can have
        waited for `waited_s`."""
        if waited_s <= STALE_S:
            self._since_s = NEVER_S
            return False
        if self._since_s == NEVER_S:
            self._since_s = now_s
        return now_s - self._since_s > BACKLOGGED_S
