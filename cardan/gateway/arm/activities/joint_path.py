"""movj and relj: all joints along one path variable."""

from __future__ import annotations

from typing import Protocol

from cardan.arm_libraries import np
from cardan.gateway.arm.activities.base import GOING, Activity, Deceleration, Progress
from cardan.gateway.arm.activities.path import SETTLE_S, TOLERANCE_RAD, PathClock, stuck_in_words
from cardan.gateway.arm.codes import State
from cardan.gateway.kinematics.base import FloatArray
from cardan.gateway.servo.choice import AnyServo
from cardan.types import RobotState

ARRIVED_RAD = 1e-5
"""Largest distance of a joint from its goal, rad or m, at which the motion has arrived."""


class JointMotionPath(Protocol):
    """What a joint motion follows."""

    @property
    def duration_s(self) -> float:
        """Time until rest, s."""

    def at(self, t_s: float, /) -> tuple[FloatArray, FloatArray]:
        """Joint positions and velocities at `t_s` since the start; the next call may reuse them."""


class FollowJoints(Activity):
    """movj and relj: all joints along one path variable."""

    state = State.MOVJ

    def __init__(self, servo: AnyServo, path: JointMotionPath, deceleration: Deceleration) -> None:
        self._servo, self._path = servo, path
        self._clock = PathClock(path.duration_s)
        self._slowing = deceleration.joint_share * servo.kinematics.acceleration
        self._resting = False
        self._over_s = 0.0
        self._reason = ""

    def brake(self) -> None:
        """Stop along the path."""
        velocity = np.abs(self._path.at(self._clock.time_s)[1])
        self._clock.brake(float((velocity / self._slowing).max()))

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        servo, clock = self._servo, self._clock
        if self._resting:
            servo.brake(dt_s)
            return GOING if servo.moving else Progress(True, self._reason)
        step_s = clock.next_step(dt_s)
        goal = self._path.at(clock.time_s)[0].copy()
        rate = (self._path.at(clock.time_s + step_s)[0] - goal) / dt_s
        share = servo.tick_joints(goal, rate, dt_s)
        clock.advance(step_s, share, dt_s)
        if clock.over:
            self._over_s += dt_s
            off = float(np.abs(self._path.at(clock.time_s)[0] - servo.q).max())
            if off < ARRIVED_RAD or self._over_s > SETTLE_S:
                self._resting = True
                if off > TOLERANCE_RAD and not clock.braking:
                    self._reason = f"a joint came to rest {off:.4f} rad away from its goal"
        elif clock.stuck and not clock.braking:
            self._reason = stuck_in_words(servo, clock.time_s / clock.duration_s)
            self._resting = True
        return GOING
