"""Rate limit of a client's actions: excess ones are refused."""

from __future__ import annotations

MAX_PUBLICATIONS_PER_S = 5000
"""Most publications of a client per second: enough for a page with 50 topics at 100 Hz."""


class RateLimit:
    """Rate limit, per second. Time is monotonic, in seconds."""

    def __init__(self, per_s: int) -> None:
        self._per_s = per_s
        self._second_s = float("-inf")
        self._count = 0

    def exceeded(self, now_s: float) -> bool:
        """Count one more action; return True if it exceeds the limit."""
        if now_s - self._second_s >= 1.0:
            self._second_s, self._count = now_s, 0
        self._count += 1
        return self._count > self._per_s
