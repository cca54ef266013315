"""A joint trajectory that somebody else planned, with the tolerances that go with it."""

from __future__ import annotations

from cardan.arm_libraries import np
from cardan.gateway.arm.activities.base import GOING, Deceleration, Progress
from cardan.gateway.arm.activities.joint_path import FollowJoints
from cardan.gateway.arm.activities.path import SETTLE_S
from cardan.gateway.kinematics.base import FloatArray
from cardan.gateway.motion.joint_trajectory import (
    GOAL_TOLERANCE,
    PATH_TOLERANCE,
    JointTrajectory,
)
from cardan.gateway.motion.trajectory import TrajectoryPath
from cardan.gateway.servo.choice import AnyServo
from cardan.types import RobotState


class FollowTrajectory(FollowJoints):
    """The joints follow a trajectory as it was planned, as far as the arm's limits allow it.

    An arm that lags behind by more than the path tolerance is braked along the trajectory.
    """

    def __init__(
        self,
        servo: AnyServo,
        path: TrajectoryPath,
        deceleration: Deceleration,
        wanted: JointTrajectory,
    ) -> None:
        super().__init__(servo, path, deceleration)
        self._way = path
        self._path_tolerance, self._goal_tolerance = (
            None if each is None else np.array(each)
            for each in (wanted.path_tolerance, wanted.goal_tolerance)
        )
        self._goal_time_s = wanted.goal_time_s or SETTLE_S
        self._elapsed_s = self._waited_s = 0.0

    @property
    def elapsed_s(self) -> float:
        """Since the start."""
        return self._elapsed_s

    def desired(self) -> tuple[FloatArray, FloatArray]:
        """Joint positions and velocities that the trajectory has now."""
        return self._way.at(self._elapsed_s)

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        progress = super().tick(robot, dt_s)
        self._elapsed_s += dt_s
        if self._clock.braking or self._reason:
            return progress
        if not progress.over:
            off = _worst(robot, self.desired()[0], self._path_tolerance)
            if off is not None and not self._resting:
                self._reason = f"{PATH_TOLERANCE}: {self._in_words(off, robot, self.desired()[0])}"
                self.brake()
            return progress
        goal = self._way.at(self._way.duration_s)[0]
        off = _worst(robot, goal, self._goal_tolerance)
        if off is None:
            return progress
        self._waited_s += dt_s
        if self._waited_s <= self._goal_time_s:
            return GOING
        return Progress(True, f"{GOAL_TOLERANCE}: {self._in_words(off, robot, goal)}")

    def _in_words(self, joint: int, robot: RobotState, desired: FloatArray) -> str:
        apart = abs(robot.joints[joint] - float(desired[joint]))
        name = self._servo.kinematics.names[joint]
        return f"{name} is {apart:.4f} from where it is to be after {self._elapsed_s:.2f} s"


def _worst(robot: RobotState, desired: FloatArray, tolerance: FloatArray | None) -> int | None:
    """The measured joint that is farthest beyond its tolerance; None where none is."""
    if tolerance is None or len(robot.joints) != len(desired):
        return None
    beyond = np.where(tolerance > 0.0, np.abs(np.array(robot.joints) - desired) - tolerance, -1.0)
    worst = int(beyond.argmax())
    return worst if beyond[worst] > 0.0 else None
