"""movl: the TCP along a line."""

from __future__ import annotations

from cardan.common.arm_libraries import np, npt, pin
from cardan.gateway.arm.arrival import Arrival
from cardan.gateway.arm.motions.base import Deceleration
from cardan.gateway.arm.motions.trajectory_motion import (
    AT_REST_RAD_S,
    TOLERANCE_M,
    TOLERANCE_RAD,
    TrajectoryMotion,
)
from cardan.gateway.arm.vocab import State
from cardan.gateway.kinematics.base import SE3, to_se3
from cardan.gateway.motion.trajectories import LineTrajectory
from cardan.gateway.servo.choice import AnyServo
from cardan.spatial import norm, rotation_between, scale, subtract
from cardan.types import RobotState


class FollowLine(TrajectoryMotion):
    """movl: the TCP along a line."""

    state = State.MOVL

    def __init__(
        self,
        servo: AnyServo,
        path: LineTrajectory,
        retained: npt.NDArray[np.bool_],
        deceleration: Deceleration,
        arrival: Arrival,
    ) -> None:
        """`retained` (6): directions in which the TCP must end at its goal, x y z rx ry rz of its
        axes."""
        super().__init__(servo, path.duration_s, arrival)
        self._path = path
        self._retained = retained
        self._deceleration = deceleration

    def brake(self) -> None:
        """Stop along the line."""
        twist = self._path.at(self._clock.time_s)[1]
        self._clock.brake(
            max(
                norm(twist.linear) / self._deceleration.linear_m_s2,
                norm(twist.angular) / self._deceleration.angular_rad_s2,
            )
        )

    def _follow(self, step_s: float, dt_s: float) -> float:
        now_s = self._clock.time_s
        here = self._path.at(now_s)[0]
        there = self._path.at(now_s + step_s)[0]
        gain = 1.0 / dt_s
        twist = (
            scale(subtract(there.position, here.position), gain),
            scale(rotation_between(here.orientation, there.orientation), gain),
        )
        return self._servo.tick(here, twist, dt_s)

    def _commanded_there(self) -> bool:
        return float(np.abs(self._servo.v).max()) < AT_REST_RAD_S

    def _missed(self) -> str:
        distance_m, angle_rad = self._away(self._servo.placement)
        if distance_m <= TOLERANCE_M and angle_rad <= TOLERANCE_RAD:
            return ""
        return (
            f"the TCP came to rest {distance_m * 1e3:.1f} mm and {angle_rad:.3f} rad away from "
            "the goal"
        )

    def _left(self, robot: RobotState, early: bool) -> str:
        distance_m, angle_rad = self._away(self._servo.kinematics.forward(np.array(robot.joints)))
        allowed = self._arrival.options
        near_m, near_rad = allowed.arrival_m, allowed.arrival_rad
        if early:
            near_m, near_rad = min(near_m, TOLERANCE_M), min(near_rad, TOLERANCE_RAD)
        if distance_m <= near_m and angle_rad <= near_rad:
            return ""
        return (
            f"the TCP is {distance_m * 1e3:.1f} mm and {angle_rad:.3f} rad away from the goal; "
            f"allowed: {allowed.arrival_m * 1e3:g} mm (arrival_m) and {allowed.arrival_rad:g} rad "
            "(arrival_rad)"
        )

    def _away(self, placement: SE3) -> tuple[float, float]:
        """Distance and angle from a placement of the TCP to the end of the line."""
        difference = placement.actInv(to_se3(self._path.at(self._clock.time_s)[0]))
        return (
            float(np.linalg.norm(difference.translation[self._retained[:3]])),
            float(np.linalg.norm(pin.log3(difference.rotation)[self._retained[3:]])),
        )
