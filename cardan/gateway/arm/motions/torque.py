"""gcmp, forc and streamed wrenches: torques at the joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.common.arm_libraries import np, pin
from cardan.common.options import Options
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.joint_space_arm import JointSpaceArm
from cardan.gateway.arm.motions.base import ARRIVED, GOING, CommandedMotion, Progress
from cardan.gateway.arm.vocab import State
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import FloatArray
from cardan.robots import ArmModel
from cardan.robots.counterbalance import Counterbalance
from cardan.spatial import add, is_finite, limit_norm, norm, subtract
from cardan.types import ZERO3, Frame, RobotState, TorqueCommand, Vector3, Wrench

_SLEW = "the largest force within 10 ms; a faster rise is a step"
FORCE_SLEW_N_S = bounds.Range(0.0, 1e6, "N/s", _SLEW, above=True)
TORQUE_SLEW_NM_S = bounds.Range(0.0, 1e6, "N·m/s", _SLEW, above=True)


@dataclass(frozen=True, kw_only=True)
class TorqueLimits(Options):
    """Limits of torque motions. Raises OptionError."""

    force_n: Annotated[float, bounds.ROBOT_FORCE_N] = 100.0
    """Largest force of a wrench, N."""
    torque_nm: Annotated[float, bounds.ROBOT_TORQUE_NM] = 20.0
    force_slew_n_s: Annotated[float, FORCE_SLEW_N_S] = 500.0
    torque_slew_nm_s: Annotated[float, TORQUE_SLEW_NM_S] = 100.0
    speed_share: Annotated[float, bounds.SHARE] = 0.5
    """Share of each joint's speed limit above which a torque motion is stopped as a runaway."""


class TorqueMotion(CommandedMotion):
    """gcmp, forc and streamed wrenches: the arm's own weight, and a wrench on the world."""

    outlives_silence = True
    in_one_step = True

    def __init__(
        self,
        state: State,
        model: ArmModel,
        commanded: JointSpaceArm,
        kinematics: ArmKinematics,
        limits: TorqueLimits,
    ) -> None:
        """`kinematics` (with the tool) is used in `tick` only. Raises MotionRefusedError."""
        if not any(inertia.mass_kg > 0.0 for inertia in model.inertias):
            raise MotionRefusedError(
                f"the file of {model.name} gives no masses, so its weight is not known"
            )
        self.state = state
        self.limits = limits
        self._commanded = commanded
        self._seen: RobotState | None = None
        """The newest plausible state, with the speeds of its joints."""
        self._speeds: FloatArray = np.zeros(len(model.joints))
        self._braking = self._caught = False
        self._kinematics = kinematics
        self._weight = _Weight(model, kinematics)
        self._effort = np.array([joint.effort for joint in model.joints])
        self._fastest = limits.speed_share * kinematics.velocity
        self.target = Wrench(ZERO3, ZERO3)
        self._force, self._torque = ZERO3, ZERO3
        self._in_tcp_axes = np.zeros(6)
        self.share = 1.0
        """Share of the wrench that the joints' torques allowed in the last tick."""

    @property
    def yields(self) -> bool:
        return not self._caught

    @property
    def driven(self) -> bool:
        """True while it exerts a wrench, which must end when its source falls silent."""
        return self.target.force != ZERO3 or self.target.torque != ZERO3

    def brake(self) -> None:
        """Brake by position from the measured speed, so that the arm neither drops nor jerks."""
        self._braking = True
        self.command = None

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Return torques for the measured joints; while braking, a ramp of positions."""
        commanded = self._commanded
        if self._caught:
            commanded.brake(dt_s)
            return GOING if commanded.moving else ARRIVED
        q = self._look(robot)
        if not self._braking:
            self.fault = self.runaway(q, self._speeds)
            if self.fault:
                self.brake()
        if self._braking:
            commanded.catch(q, self._speeds)
            self._caught = True
            commanded.brake(dt_s)
            return GOING
        commanded.servo.place(q)
        self.command = self.torques(q, dt_s)
        return GOING

    def _look(self, robot: RobotState) -> FloatArray:
        """Take the joints of `robot`, or of the state before if these are impossible."""
        before = self._seen
        if before is not None:
            time_s = max(robot.stamp_s - before.stamp_s, robot.period_s, 0.0)
            if self._commanded.jump(before, robot, time_s):
                return np.array(before.joints)
        self._seen, q = robot, np.array(robot.joints)
        if len(robot.velocities) == len(q) and is_finite(robot.velocities):
            self._speeds = np.array(robot.velocities)
        elif before is not None and robot.period_s > 0.0:
            self._speeds = (q - np.array(before.joints)) / robot.period_s
        return q

    def check_weight(self, q: FloatArray) -> None:
        """Raise MotionRefusedError if a joint cannot hold the arm's weight at `q`."""
        gravity = _Weight(self._kinematics.arm, self._kinematics).torques(q)
        excess = np.abs(gravity) - self._effort
        worst = int(np.argmax(excess))
        if excess[worst] > 0.0:
            raise MotionRefusedError(
                f"{self._kinematics.names[worst]} would need {gravity[worst]:.1f} N·m to hold "
                f"the arm's weight; it has {self._effort[worst]:.1f} N·m"
            )

    def set_wrench(self, wrench: Wrench) -> None:
        """Exert `wrench` on the world; it is approached by the slew limits. Raises
        MotionRefusedError for a larger one than allowed."""
        force, torque = norm(wrench.force), norm(wrench.torque)
        if force > self.limits.force_n or torque > self.limits.torque_nm:
            raise MotionRefusedError(
                f"a wrench of {force:.1f} N and {torque:.1f} N·m is more than the "
                f"{self.limits.force_n:.1f} N and {self.limits.torque_nm:.1f} N·m allowed"
            )
        if wrench.frame is not self.target.frame:
            # Along other axes, so it starts from zero.
            self._force = self._torque = ZERO3
        self.target = wrench

    def release(self) -> None:
        """Exert no wrench from the next tick on."""
        self.target = Wrench(ZERO3, ZERO3, self.target.frame)
        self._force = self._torque = ZERO3

    def runaway(self, q: FloatArray, v: FloatArray) -> str:
        """Return why the arm has to be stopped; empty while it is slow and inside its limits."""
        kinematics = self._kinematics
        for index in np.flatnonzero(np.abs(v) > self._fastest):
            return (
                f"{kinematics.names[index]} ran away at {v[index]:.2f} rad/s; "
                f"allowed: {self._fastest[index]:.2f} rad/s"
            )
        leaving = ((q >= kinematics.upper) & (v > 0.0)) | ((q <= kinematics.lower) & (v < 0.0))
        for index in np.flatnonzero(leaving):
            return f"{kinematics.names[index]} came to its limit, {q[index]:.4f} rad"
        return ""

    def torques(self, q: FloatArray, dt_s: float) -> TorqueCommand:
        """Torques for the measured joint positions `q`."""
        kinematics, limits = self._kinematics, self.limits
        target = self.target
        self._force = _slewed(self._force, target.force, limits.force_slew_n_s * dt_s)
        self._torque = _slewed(self._torque, target.torque, limits.torque_slew_nm_s * dt_s)
        gravity = self._weight.torques(q)
        kinematics.update(q)
        wrench = self._in_tcp_axes
        wrench[:3], wrench[3:] = self._force, self._torque
        if target.frame is Frame.BASE:
            rotation = kinematics.placement.rotation
            wrench[:3] = wrench[:3].dot(rotation)
            wrench[3:] = wrench[3:].dot(rotation)
        added = kinematics.jacobian.T.dot(wrench)
        room = np.where(added >= 0.0, self._effort - gravity, self._effort + gravity)
        size = np.abs(added)
        self.share = 1.0
        tight = size > np.maximum(room, 0.0)
        if tight.any():
            self.share = float((np.maximum(room[tight], 0.0) / size[tight]).min())
        torques = np.clip(gravity + self.share * added, -self._effort, self._effort)
        return TorqueCommand(tuple(torques.tolist()))


class _Weight:
    """Joint torques that hold the arm: its weight, less the share of its springs."""

    def __init__(self, arm: ArmModel, kinematics: ArmKinematics) -> None:
        self._model = kinematics.model
        self._data = self._model.createData()
        joints = arm.counterbalanced_joints
        self._springs = Counterbalance(self._model, joints) if joints else None

    def torques(self, q: FloatArray) -> FloatArray:
        """Return the torques at the joint positions `q`, N·m or N."""
        weight: FloatArray = pin.computeGeneralizedGravity(self._model, self._data, q)
        return weight if self._springs is None else weight - self._springs.torques(q)


def _slewed(now: Vector3, target: Vector3, most: float) -> Vector3:
    return add(now, limit_norm(subtract(target, now), most))
