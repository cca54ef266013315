"""Heartbeat of the process that supervises a session."""

from __future__ import annotations

BEAT_PERIOD_S = 0.1
"""Period of a supervisor's beats: it may miss four before the session's arm is stopped."""

BEAT = b"beat"


class SupervisorHeartbeat:
    """Checks the time of the supervisor's last beat. Local monotonic time, s."""

    def __init__(self, silence_s: float, now_s: float) -> None:
        """`silence_s` is the longest time without a beat."""
        self._silence_s = silence_s
        self._heard_s = now_s

    def heard(self, now_s: float) -> None:
        """Record a beat."""
        self._heard_s = now_s

    def fault(self, now_s: float) -> str:
        """Return why the arm must not be moved; empty while the supervisor sends beats."""
        age_s = now_s - self._heard_s
        if age_s <= self._silence_s:
            return ""
        return (
            f"the process that supervises this session was silent for {age_s:.1f} s: it is "
            "stopped, or its output is not read"
        )
