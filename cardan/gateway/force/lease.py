"""Lease of the force: the node that may command it, and its valid forces. No I/O; time is an
argument."""

from __future__ import annotations

from cardan.gateway.force.link import ForceMessage
from cardan.types import NEVER_S

LEASE_S = 1.0
"""Silence after which another node may replace a node."""

FUTURE_S = 0.1
"""A stamp farther in the future is from another clock; such a force is dropped."""


class Lease:
    """Lease of the force: a single owner at a time, by number, and its newest force."""

    def __init__(self, max_age_s: float) -> None:
        self._max_age_s = max_age_s
        self.owner: int | None = None
        self.newest: ForceMessage | None = None
        self.dropped = 0
        """Count of forces that were stale, out of order, or from the future."""
        self.refused = 0
        """Count of nodes that were refused while another was connected."""
        self._heard_s = NEVER_S
        self._stamp_s = NEVER_S

    def ask(self, number: int, now_s: float) -> str:
        """Let `number` own the force. Return why not; empty when it owns it now."""
        if self.owner is not None and now_s - self._heard_s < LEASE_S:
            self.refused += 1
            return "another force node is connected: end it first; only one commands the force"
        self.owner, self._heard_s = number, now_s
        self.newest = None
        return ""

    def leave(self, number: int) -> None:
        """Drop the force of `number`, which has disconnected."""
        if number == self.owner:
            self.owner = self.newest = None

    def take(self, number: int, message: ForceMessage, now_s: float) -> bool:
        """Take a force; return False if it is dropped."""
        if number != self.owner:
            self.dropped += 1
            return False
        self._heard_s = now_s
        before = self.newest
        if (
            (before is not None and message.sequence <= before.sequence)
            or message.stamp_s < self._stamp_s
            or not -FUTURE_S <= now_s - message.stamp_s <= self._max_age_s
        ):
            self.dropped += 1
            return False
        self.newest, self._stamp_s = message, message.stamp_s
        return True
