"""Streamed joint speeds: joint jogging."""

from __future__ import annotations

from cardan.common.arm_libraries import np
from cardan.gateway.arm.joint_space_arm import JointSpaceArm
from cardan.gateway.arm.motions.base import ARRIVED, GOING, CommandedMotion, Progress
from cardan.gateway.kinematics.base import FloatArray
from cardan.types import RobotState


class FollowJointStream(CommandedMotion):
    """Every joint moves at the speed that was streamed last."""

    def __init__(
        self, commanded: JointSpaceArm, speed_share: float, acceleration_share: float
    ) -> None:
        """Shares of the arm's joint speeds and accelerations that may be used."""
        self._commanded, servo = commanded, commanded.servo
        self._fastest = speed_share * servo.kinematics.velocity
        self._acceleration = acceleration_share * servo.kinematics.acceleration
        self._target: FloatArray = np.zeros(servo.joints)
        self._rate: FloatArray = np.zeros(servo.joints)
        self._braking = False

    def aim(self, rates: FloatArray) -> bool:
        """Set the joint speeds from now on to `rates` (rad/s, m/s); return whether these were too
        fast and are slowed, all joints alike."""
        over = float((np.abs(rates) / self._fastest).max())
        self._target = rates / max(1.0, over)
        return over > 1.0

    @property
    def driven(self) -> bool:
        return bool(self._target.any()) and not self._braking

    @property
    def idle(self) -> bool:
        return not self._target.any() and not self._commanded.moving

    def brake(self) -> None:
        """Ramp to zero speed."""
        self._braking = True
        self._target = np.zeros_like(self._target)

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move on by one period."""
        servo = self._commanded.servo
        most = self._acceleration * dt_s
        change = self._target - self._rate
        # The same share for all joints, so that they keep their proportion while they speed up.
        share = min(1.0, 1.0 / max(float((np.abs(change) / most).max()), 1e-9))
        self._rate = self._rate + share * change
        if self._rate.any():
            servo.tick_joints(servo.q.copy(), self._rate, dt_s)
        elif servo.moving:
            servo.brake(dt_s)
        elif self._braking:
            return ARRIVED
        return GOING
