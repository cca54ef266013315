"""Joins a session's reference to the servo: the arm's share of a control tick."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from cardan.gateway.kinematics.base import FloatArray, to_pose, to_se3
from cardan.gateway.motion.reference import Reference
from cardan.gateway.servo.lag import ResponseLag
from cardan.gateway.servo.servo import Servo, ServoStatus, servo_steps
from cardan.spatial import is_finite, norm, subtract
from cardan.types import (
    CommandKind,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    RobotCommand,
    RobotState,
    Twist,
    Vector3,
)

PREFERRED = (CommandKind.JOINT, CommandKind.JOINT_VELOCITY, CommandKind.POSE)
"""What a robot is sent, best first: joint positions leave nothing to anybody else's kinematics."""

GLIDE_SHARE = 0.1
"""Of the joints' speeds, at most, while commanded joints are brought back to measured ones: nobody
steers that motion."""

CORRECTION_SHARE = 0.2
"""Of the joints' speeds that a robot of velocities may be corrected with: an arm that was pushed
away comes back, it does not spring."""

VELOCITY_GAIN_1_S = 10.0
"""Of the position error of a robot that only takes velocities. It is what keeps such an arm from
sinking under its own weight; higher gains ring with the delay of real velocity loops."""

SAME_TCP_M = 0.002
"""A controller whose TCP is farther from the model's than this has another tool or base."""


class ArmFollower:
    """Moves the commanded joints of one arm after a reference pose."""

    def __init__(self, servo: Servo, kinds: frozenset[CommandKind], lag_s: float = 0.0) -> None:
        """`kinds` are the commands that the robot takes; at least one of PREFERRED. `lag_s` is
        how far it may be behind them in good order."""
        self.servo = servo
        self._kind = next(kind for kind in PREFERRED if kind in kinds)
        self._twist = np.zeros((2, 3))
        self._highest = servo.kinematics.velocity
        self._sent: FloatArray | None = None
        self._still = np.zeros(servo.joints)
        self._relaxed = getattr(servo.kinematics, "relaxed", None)
        self._lag = ResponseLag(lag_s, servo.kinematics.continuous)

    def measured(self, state: RobotState) -> Pose:
        """The measured TCP, by the model, in its base frame.

        Of a robot that lags: where it will be when it has caught up.
        """
        return to_pose(self.servo.kinematics.forward(self._joints(state)))

    def reported(self, state: RobotState) -> Pose:
        """The TCP at the joints just as they are reported, by the model, in its base frame."""
        return to_pose(self.servo.kinematics.forward(np.array(state.joints)))

    def _joints(self, state: RobotState) -> FloatArray:
        return self._lag.expected(np.array(state.joints), self.servo.q)

    def obstacle(self, state: RobotState, new: bool = True) -> str:
        """Why the model does not fit what the robot reports, in words; empty when it does.

        The TCP is only compared when the robot is `new`: at rest, before it is commanded.
        """
        joints = self.servo.joints
        if len(state.joints) != joints:
            return f"the robot reports {len(state.joints)} joints, the arm's model has {joints}"
        if not is_finite(state.joints):
            return "the robot reports joints that are not numbers"
        if new and self._kind is CommandKind.POSE and state.pose is not None:
            apart_m = norm(subtract(state.pose.position, self.measured(state).position))
            if apart_m > SAME_TCP_M:
                return (
                    f"the controller's TCP is {apart_m * 1e3:.0f} mm away from the arm model's: "
                    "set [arm] tool to the controller's tool, and use its base frame"
                )
        return ""

    def place(self, state: RobotState) -> None:
        """Start from the measured joints, at rest."""
        self.servo.place(np.array(state.joints))
        self._lag.reset()
        self._sent = None

    def worst_joint(self, state: RobotState) -> tuple[str, float]:
        """The joint farthest from where it is commanded, and by how much, rad or m."""
        error = np.abs(self._error(state))
        worst = int(error.argmax())
        return self.servo.kinematics.names[worst], float(error[worst])

    def glide(self, state: RobotState, time_s: float, dt_s: float) -> Pose:
        """Bring the commanded joints back to the measured ones with a time constant of `time_s`;
        returns the commanded TCP."""
        servo = self.servo
        rate = self._error(state) / -time_s
        share = float((np.abs(rate) / self._highest).max()) / GLIDE_SHARE
        servo.tick_joints(servo.q.copy(), rate / max(1.0, share), dt_s)
        return to_pose(servo.placement)

    def halt(self, dt_s: float) -> Pose:
        """Brake all joints; returns the commanded TCP."""
        self.servo.brake(dt_s)
        return to_pose(self.servo.placement)

    def _error(self, state: RobotState) -> FloatArray:
        """Commanded less measured joints; whole turns of a continuous joint are no error."""
        error: FloatArray = self.servo.q - self._joints(state)
        turns = np.rint(error / (2.0 * math.pi))
        return np.where(self.servo.kinematics.continuous, error - 2.0 * math.pi * turns, error)

    @staticmethod
    def steps(dt_s: float) -> list[float]:
        """`dt_s` in steps that are short enough for `advance`."""
        return servo_steps(dt_s)

    def advance(
        self, reference: Reference, dt_s: float, joint_rates: Mapping[str, float] | None = None
    ) -> None:
        """Move joints and reference for `dt_s`; the reference's own twist is what is wanted.

        `joint_rates` by name, rad/s or m/s, are wanted beside it.
        """
        assert reference.pose is not None
        twist = self._twist
        twist[0], twist[1] = reference.linear, reference.angular
        servo = self.servo
        if self._relaxed is not None:
            servo.posture = self._relaxed(servo.q)
        rates = None
        if joint_rates:
            rates = np.array([joint_rates.get(name, 0.0) for name in servo.kinematics.names])
        servo.tick(to_se3(reference.pose), twist, dt_s, rates, slide=True)
        if servo.reachable is not None:
            reference.pose = to_pose(servo.reachable)
        linear, angular = servo.twist.tolist()
        reference.move(Vector3(*linear), Vector3(*angular), dt_s)

    def command(self, state: RobotState, meeting: bool = False) -> RobotCommand:
        """What the robot is sent.

        `meeting`: the commanded joints go to the robot, so it is not told to go along. One that is
        commanded by velocities would keep its distance for ever.
        """
        servo = self.servo
        self._lag.note(servo.q, state.stamp_s)
        v = self._still if meeting else servo.v
        if self._kind is CommandKind.JOINT:
            return JointCommand(tuple(servo.q.tolist()), tuple(v.tolist()))
        if self._kind is CommandKind.JOINT_VELOCITY:
            return JointVelocityCommand(tuple(self._velocities(state, v).tolist()))
        kinematics = servo.kinematics
        kinematics.update(servo.q)
        lines = kinematics.placement.rotation @ (kinematics.jacobian @ servo.v).reshape(2, 3).T
        linear, angular = lines.T.tolist()
        return PoseCommand(
            to_pose(kinematics.placement), Twist(Vector3(*linear), Vector3(*angular))
        )

    def _velocities(self, state: RobotState, wanted: FloatArray) -> FloatArray:
        """`wanted` and what brings the robot back to its positions, within limits."""
        servo, highest = self.servo, self._highest
        most = CORRECTION_SHARE * highest
        v = wanted + np.clip(VELOCITY_GAIN_1_S * self._error(state), -most, most)
        np.clip(v, -highest, highest, out=v)
        if self._sent is None:
            self._sent = np.zeros(servo.joints)
        step = servo.kinematics.acceleration * max(state.period_s, 0.0)
        self._sent = np.clip(v, self._sent - step, self._sent + step)
        return self._sent

    @property
    def moving(self) -> bool:
        """True until the commanded joints are at rest."""
        return self.servo.moving

    def status(self) -> ServoStatus:
        """What the last tick met."""
        return self.servo.status()
