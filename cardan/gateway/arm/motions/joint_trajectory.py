"""A joint trajectory planned by another program, with its tolerances."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from cardan.common.arm_libraries import np
from cardan.gateway.arm.arrival import Arrival
from cardan.gateway.arm.motions.base import Deceleration, Progress
from cardan.gateway.arm.motions.joints import FollowJoints
from cardan.gateway.kinematics.base import FloatArray
from cardan.gateway.motion.joint_trajectory import (
    GOAL_TOLERANCE,
    PATH_TOLERANCE,
    JointTrajectory,
)
from cardan.gateway.motion.trajectories import SplineTrajectory
from cardan.gateway.servo.choice import AnyServo
from cardan.types import RobotState


class FollowJointTrajectory(FollowJoints):
    """The joints follow a trajectory as it was planned, as far as the arm's limits allow it.

    An arm that lags behind by more than the path tolerance is braked along the trajectory.
    """

    def __init__(
        self,
        servo: AnyServo,
        path: SplineTrajectory,
        deceleration: Deceleration,
        wanted: JointTrajectory,
        arrival: Arrival,
    ) -> None:
        super().__init__(servo, path, deceleration, arrival)
        self._way = path
        self._path_tolerance = None
        if wanted.path_tolerance is not None:
            self._path_tolerance = _free_where_0(wanted.path_tolerance)
        if wanted.goal_tolerance is not None:
            self._near = _free_where_0(
                [
                    arrival.options.arrival_joint if each is None else each
                    for each in wanted.goal_tolerance
                ]
            )
        self._timeout_s = wanted.goal_time_s or self._timeout_s
        self._elapsed_s = 0.0
        self._times_s = wanted.times_s

    @property
    def elapsed_s(self) -> float:
        """Time since the start."""
        return self._elapsed_s

    def desired(self) -> tuple[FloatArray, FloatArray]:
        """Present joint positions and velocities of the trajectory."""
        return self._way.at(self._elapsed_s)

    @property
    def point(self) -> int:
        """Index of the trajectory's present or last passed point."""
        return max(0, bisect_right(self._times_s, self._elapsed_s) - 1)

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        progress = super().tick(robot, dt_s)
        self._elapsed_s += dt_s
        if progress.over or self._resting or self._clock.braking or self._path_tolerance is None:
            return progress
        worst, away = self._beyond(robot, self.desired()[0], self._path_tolerance)
        if worst is not None:
            self._reason = f"{PATH_TOLERANCE}: {self._in_words(worst, away)}"
            self.brake()
        return progress

    def _not_arrived(self, left: str) -> str:
        return f"{GOAL_TOLERANCE}: {left or super()._not_arrived(left)}"

    def _in_words(self, joint: int, away: float) -> str:
        name = self._servo.kinematics.names[joint]
        return f"{name} is {away:.4f} off its trajectory after {self._elapsed_s:.2f} s"


def _free_where_0(tolerance: Sequence[float]) -> FloatArray:
    """Return the joints' tolerances, with 0 replaced by infinity: the joint may be anywhere."""
    given = np.array(tolerance)
    return np.where(given > 0.0, given, np.inf)
