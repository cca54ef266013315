"""movl: the TCP along a line."""

from __future__ import annotations

from cardan.arm_libraries import np, npt, pin
from cardan.gateway.arm.activities.base import GOING, Activity, Deceleration, Progress
from cardan.gateway.arm.activities.path import (
    AT_REST_RAD_S,
    SETTLE_S,
    TOLERANCE_M,
    TOLERANCE_RAD,
    PathClock,
    stuck_in_words,
)
from cardan.gateway.arm.codes import State
from cardan.gateway.arm.planner import Line
from cardan.gateway.kinematics.base import to_se3
from cardan.gateway.servo.choice import AnyServo
from cardan.spatial import norm, rotation_between, scale, subtract
from cardan.types import RobotState


class FollowLine(Activity):
    """movl: the TCP along a line."""

    state = State.MOVL

    def __init__(
        self,
        servo: AnyServo,
        path: Line,
        followed: npt.NDArray[np.bool_],
        deceleration: Deceleration,
    ) -> None:
        """`followed` (6): directions that the arm follows, x y z rx ry rz along TCP axes."""
        self._servo, self._path = servo, path
        self._followed = followed
        self._deceleration = deceleration
        self._clock = PathClock(path.duration_s)
        self._resting = False
        self._over_s = 0.0
        self._reason = ""

    def brake(self) -> None:
        """Stop along the line."""
        twist = self._path.at(self._clock.time_s)[1]
        self._clock.brake(
            max(
                norm(twist.linear) / self._deceleration.linear_m_s2,
                norm(twist.angular) / self._deceleration.angular_rad_s2,
            )
        )

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        servo, clock = self._servo, self._clock
        if self._resting:
            servo.brake(dt_s)
            return GOING if servo.moving else Progress(True, self._reason)
        step_s = clock.next_step(dt_s)
        here = self._path.at(clock.time_s)[0]
        there = self._path.at(clock.time_s + step_s)[0]
        gain = 1.0 / dt_s
        twist = (
            scale(subtract(there.position, here.position), gain),
            scale(rotation_between(here.orientation, there.orientation), gain),
        )
        share = servo.tick(here, twist, dt_s)
        clock.advance(step_s, share, dt_s)
        if clock.over:
            self._over_s += dt_s
            if self._over_s > SETTLE_S or float(np.abs(servo.v).max()) < AT_REST_RAD_S:
                self._finish()
        elif clock.stuck and not clock.braking:
            self._reason = stuck_in_words(servo, clock.time_s / clock.duration_s)
            self._resting = True
        return GOING

    def _finish(self) -> None:
        self._resting = True
        difference = self._servo.placement.actInv(to_se3(self._path.at(self._clock.time_s)[0]))
        distance = np.linalg.norm(difference.translation[self._followed[:3]])
        angle = np.linalg.norm(pin.log3(difference.rotation)[self._followed[3:]])
        if (distance > TOLERANCE_M or angle > TOLERANCE_RAD) and not self._clock.braking:
            self._reason = (
                f"the TCP came to rest {distance * 1e3:.1f} mm and {angle:.3f} rad away from "
                "the goal"
            )
