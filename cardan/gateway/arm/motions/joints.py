"""movj and relj: all joints along one path variable."""

from __future__ import annotations

from cardan.common.arm_libraries import np
from cardan.gateway.arm.arrival import Arrival
from cardan.gateway.arm.motions.base import Deceleration
from cardan.gateway.arm.motions.trajectory_motion import TOLERANCE_RAD, TrajectoryMotion
from cardan.gateway.arm.vocab import State
from cardan.gateway.kinematics.base import FloatArray, short_way
from cardan.gateway.motion.trajectories import (
    HoldTrajectory,
    PointToPointTrajectory,
    SplineTrajectory,
)
from cardan.gateway.servo.choice import AnyServo
from cardan.types import RobotState

ARRIVED_RAD = 1e-5
"""Largest distance of a commanded joint from its goal, rad or m, at which the command has arrived.
"""


class FollowJoints(TrajectoryMotion):
    """movj and relj: all joints along one path variable."""

    state = State.MOVJ

    def __init__(
        self,
        servo: AnyServo,
        path: PointToPointTrajectory | HoldTrajectory | SplineTrajectory,
        deceleration: Deceleration,
        arrival: Arrival,
    ) -> None:
        super().__init__(servo, path.duration_s, arrival)
        self._path = path
        self._slowing = deceleration.joint_share * servo.kinematics.acceleration
        self._near = np.full(servo.joints, arrival.options.arrival_joint)
        """Largest distance of each measured joint from its goal."""

    def brake(self) -> None:
        """Stop along the path."""
        velocity = np.abs(self._path.at(self._clock.time_s)[1])
        self._clock.brake(float((velocity / self._slowing).max()))

    def _follow(self, step_s: float, dt_s: float) -> float:
        now_s = self._clock.time_s
        goal = self._path.at(now_s)[0].copy()
        rate = (self._path.at(now_s + step_s)[0] - goal) / dt_s
        return self._servo.tick_joints(goal, rate, dt_s)

    @property
    def _commanded_off(self) -> float:
        return float(np.abs(self._path.at(self._clock.time_s)[0] - self._servo.q).max())

    def _commanded_there(self) -> bool:
        return self._commanded_off < ARRIVED_RAD

    def _missed(self) -> str:
        off = self._commanded_off
        return (
            f"a joint came to rest {off:.4f} rad away from its goal" if off > TOLERANCE_RAD else ""
        )

    def _left(self, robot: RobotState, early: bool) -> str:
        goal = self._path.at(self._clock.duration_s)[0]
        near = np.minimum(self._near, TOLERANCE_RAD) if early else self._near
        worst, away = self._beyond(robot, goal, near)
        return "" if worst is None else self._in_words(worst, away)

    def _in_words(self, joint: int, away: float) -> str:
        return (
            f"{self._servo.kinematics.names[joint]} is {away:.4f} from its goal; allowed: "
            f"{self._near[joint]:g} (arrival_joint)"
        )

    def _beyond(
        self, robot: RobotState, desired: FloatArray, tolerance: FloatArray
    ) -> tuple[int | None, float]:
        """Return the measured joint that is farthest beyond its tolerance, and its distance from
        the goal; None if none is."""
        away = np.abs(
            short_way(np.array(robot.joints) - desired, self._servo.kinematics.continuous)
        )
        worst = int((away - tolerance).argmax())
        return (worst if away[worst] > tolerance[worst] else None), float(away[worst])
