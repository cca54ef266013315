"""The TCP connections of a controller, as far as they can be known without sockets."""

from __future__ import annotations

from typing import Literal

from cardan.types import NEVER_S

Channel = Literal["motion", "state"]
CHANNELS: tuple[Channel, ...] = ("state", "motion")
"""The state port comes first: what it says tells the byte order of the other."""

SHORTEST_BACKOFF_S, LONGEST_BACKOFF_S = 0.25, 2.0
STEADY_S = 5.0
"""Duration after which a lost connection is tried again soon: two programs that take the motion
port's only connection from each other would otherwise do so for ever."""


class Connection:
    """Whether one connection is up, since when, and when to try again."""

    def __init__(self) -> None:
        self.up = False
        self.reason = ""
        """Why it is down; empty before the first attempt and while it is up."""
        self.retry_s = NEVER_S
        self.since_s = NEVER_S
        self.count = 0
        """How often it has been up."""
        self._backoff_s = SHORTEST_BACKOFF_S

    def opened(self, now_s: float) -> None:
        """It is up."""
        self.up, self.reason, self.since_s = True, "", now_s
        self.count += 1

    def lost(self, reason: str, now_s: float) -> None:
        """It broke, or could not be made."""
        if self.up and now_s - self.since_s >= STEADY_S:
            self._backoff_s = SHORTEST_BACKOFF_S
        self.up, self.reason = False, reason
        self.retry_s = now_s + self._backoff_s
        self._backoff_s = min(2.0 * self._backoff_s, LONGEST_BACKOFF_S)
