"""Motions along a path: their clock, their end, and reasons why an arm cannot follow one."""

from __future__ import annotations

from abc import abstractmethod

from cardan.gateway.arm.arrival import Arrival
from cardan.gateway.arm.motions.base import ARRIVED, GOING, CommandedMotion, Progress
from cardan.gateway.kinematics.singularity import UNBENT
from cardan.gateway.servo.choice import AnyServo
from cardan.types import RobotState

SETTLE_S = 1.0
"""Longest time for the last fraction of a millimeter of a path."""

AT_REST_RAD_S = 2e-4
"""Joint speed below which all joints can stop within one period, rad/s or m/s."""

TOLERANCE_M = 1e-3
TOLERANCE_RAD = 5e-3
"""Largest distance of a joint from its goal, rad or m, at the end of a path that succeeded."""

STUCK_SHARE = 0.01
"""Share of the wanted speed below which an arm counts as stuck."""

STUCK_S = 0.5
"""Time at such a speed after which an arm counts as stuck."""


class TrajectoryClock:
    """Time of a path, s, at 0 to 1 times real time."""

    def __init__(self, duration_s: float) -> None:
        self.duration_s = duration_s
        self.time_s = 0.0
        self._rate, self._decay_1_s = 1.0, 0.0
        self._stuck_s = 0.0

    @property
    def braking(self) -> bool:
        """True once it was asked to stop."""
        return self._decay_1_s > 0.0

    @property
    def over(self) -> bool:
        """True at the end of the path, or at its stop."""
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
        """Return the share of the path's time for the next period, s."""
        self._rate = max(0.0, self._rate - self._decay_1_s * dt_s)
        return min(self._rate * dt_s, self.duration_s - self.time_s)

    def advance(self, step_s: float, share: float, dt_s: float) -> None:
        """Advance by a period in which `share` of the step was possible."""
        self.time_s += share * step_s
        if self.duration_s - self.time_s < 1e-9:
            self.time_s = self.duration_s
        slow = step_s > 0.0 and share < STUCK_SHARE
        self._stuck_s = self._stuck_s + dt_s if slow else 0.0


class TrajectoryMotion(CommandedMotion):
    """Motion along a path. It has arrived once its command, and the measured arm too, is at rest at
    the end of the path."""

    def __init__(self, servo: AnyServo, duration_s: float, arrival: Arrival) -> None:
        self._servo = servo
        self._clock = TrajectoryClock(duration_s)
        self._arrival = arrival
        self._timeout_s = arrival.lag_s + arrival.options.arrival_timeout_s
        self._resting = False
        self._over_s = self._waited_s = 0.0
        self._reason = ""

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        servo, clock = self._servo, self._clock
        self._arrival.observe(robot)
        if self._resting:
            servo.brake(dt_s)
            if servo.moving:
                return GOING
            if clock.braking or self._reason:
                return Progress(True, self._reason)
            return self._wait(robot, dt_s)
        step_s = clock.next_step(dt_s)
        clock.advance(step_s, self._follow(step_s, dt_s), dt_s)
        if clock.over:
            self._over_s += dt_s
            if self._over_s > SETTLE_S or self._commanded_there():
                self._resting = True
                if not clock.braking:
                    self._reason = self._missed()
        elif clock.stuck and not clock.braking:
            self._reason = stuck_in_words(servo, clock.time_s / clock.duration_s)
            self._resting = True
        return GOING

    def _wait(self, robot: RobotState, dt_s: float) -> Progress:
        """Wait for the arm to reach its command."""
        # A robot that lags may not have begun to move: then the tolerance is small.
        early = self._waited_s < min(self._arrival.lag_s, self._timeout_s)
        left = self._left(robot, early)
        if self._arrival.arrived(robot, not left):
            return ARRIVED
        self._waited_s += dt_s
        if self._waited_s <= self._timeout_s:
            return GOING
        return Progress(True, self._not_arrived(left))

    def _not_arrived(self, left: str) -> str:
        """Return why the arm, which is still `left` from its goal, did not arrive in time."""
        why = left or "it still moves"
        return f"the arm has not arrived {self._timeout_s:g} s after its command: {why}"

    @abstractmethod
    def _follow(self, step_s: float, dt_s: float) -> float:
        """Follow the path for `step_s` of its time; return the share that was possible."""

    @abstractmethod
    def _commanded_there(self) -> bool:
        """Return whether the command is at the end of the path."""

    @abstractmethod
    def _missed(self) -> str:
        """Return why the command has not reached the end of the path; empty if it has."""

    @abstractmethod
    def _left(self, robot: RobotState, early: bool) -> str:
        """Return the distance of the measured arm from the end of the path, as text; empty if it is
        near enough. The tolerance is smaller while it is `early`."""


def stuck_in_words(servo: AnyServo, share: float) -> str:
    status = servo.status()
    why = f"stuck after {share:.0%} of the time"
    if status.limiting_joints:
        why += f"; at a limit: {', '.join(status.limiting_joints)}"
    if status.singular:
        why += f"; {UNBENT.format(status.smallest_singular_value)}"
    if status.active_pairs:
        why += f"; {status.nearest_in_words}"
    return why
