"""The clock of a path, and the reasons why an arm cannot follow it."""

from __future__ import annotations

from cardan.gateway.servo.choice import AnyServo

SETTLE_S = 1.0
"""Longest time for the last fraction of a millimetre of a path."""

AT_REST_RAD_S = 2e-4
"""All joints slower than this can stop within one period."""

TOLERANCE_M = 1e-3
TOLERANCE_RAD = 5e-3
"""Largest distance of a joint from its goal, rad or m, at the end of a path that succeeded."""

STUCK_SHARE = 0.01
"""Share of the wanted speed below which an arm counts as stuck."""

STUCK_S = 0.5
"""How long an arm must be that slow to count as stuck."""


class PathClock:
    """The time of a path, s, which runs at 0 to 1 times real time."""

    def __init__(self, duration_s: float) -> None:
        self.duration_s = duration_s
        self.time_s = 0.0
        self._rate, self._decay_1_s = 1.0, 0.0
        self._stuck_s = 0.0

    @property
    def braking(self) -> bool:
        """True once it was told to stop."""
        return self._decay_1_s > 0.0

    @property
    def over(self) -> bool:
        """True at the end of the path, or where it was stopped."""
        return self.time_s >= self.duration_s or self._rate <= 0.0

    @property
    def stuck(self) -> bool:
        """True when the path has not progressed for `STUCK_S` although it should."""
        return self._stuck_s >= STUCK_S

    def brake(self, time_s: float) -> None:
        """Stop within `time_s`."""
        if not self.braking:
            self._decay_1_s = self._rate / max(time_s, 1e-6)

    def next_step(self, dt_s: float) -> float:
        """How much of the path's time the next period should take."""
        self._rate = max(0.0, self._rate - self._decay_1_s * dt_s)
        return min(self._rate * dt_s, self.duration_s - self.time_s)

    def advance(self, step_s: float, share: float, dt_s: float) -> None:
        """The period went by, and `share` of the step could be done."""
        self.time_s += share * step_s
        if self.duration_s - self.time_s < 1e-9:
            self.time_s = self.duration_s
        slow = step_s > 0.0 and share < STUCK_SHARE
        self._stuck_s = self._stuck_s + dt_s if slow else 0.0


def stuck_in_words(servo: AnyServo, share: float) -> str:
    status = servo.status()
    why = f"stuck after {share:.0%} of the time"
    if status.limiting_joints:
        why += f"; at a limit: {', '.join(status.limiting_joints)}"
    if status.active_pairs:
        why += f"; {' and '.join(status.nearest_pair)} are {status.distance_m * 1e3:.1f} mm apart"
    return why
