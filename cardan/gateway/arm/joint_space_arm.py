"""The commanded arm with a known model: every joint moves inside its own limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

from cardan.common.arm_libraries import np
from cardan.drivers.robot_core import jump
from cardan.gateway.arm.commanded_arm import (
    APPROACH_SPEED_M_S,
    APPROACH_SPEED_RAD_S,
    APPROACH_TIME_S,
    FASTEST_TCP_M_S,
    FASTEST_TCP_RAD_S,
    SHORTEST_S,
    CommandedArm,
    FollowingError,
)
from cardan.gateway.arm.neighbors import NeighborBodies
from cardan.gateway.arm.output_check import OutputLimits
from cardan.gateway.kinematics.base import SE3, FloatArray, Kinematics, short_way, to_pose
from cardan.gateway.kinematics.singularity import SINGULAR
from cardan.gateway.motion.speed_limited_reference import Reference
from cardan.gateway.servo.choice import AnyServo
from cardan.gateway.servo.servo import LONGEST_SERVO_STEP_S
from cardan.gateway.servo.status import ServoStatus
from cardan.spatial import is_finite, norm, rotation_between, subtract
from cardan.types import (
    IDENTITY_POSE,
    ZERO_TWIST,
    CommandKind,
    Frame,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    RobotCapabilities,
    RobotCommand,
    RobotState,
    Twist,
    Vector3,
)

PREFERRED = (CommandKind.JOINT, CommandKind.JOINT_VELOCITY, CommandKind.POSE)
"""Commands by preference: joint positions do not depend on the kinematics of other controllers."""

APPROACH_SHARE = 0.1
"""Largest share of the joints' speed limits with which commanded joints are brought back to
measured ones: no operator steers that motion."""

CORRECTION_SHARE = 0.2
"""Share of the joints' speed limits for corrections of a velocity-controlled robot's position: an
arm that was pushed away returns slowly."""

VELOCITY_GAIN_1_S = 10.0
"""Gain on the position error of a velocity-controlled robot. It keeps such an arm from sinking
under its own weight; higher gains oscillate with the delay of real velocity loops."""

POSE_TCP_TOLERANCE_M, JOINT_TCP_TOLERANCE_M = 0.002, 0.02
"""Largest difference between the robot's own TCP and the model's. Beyond it, commanded poses would
be wrong; with joint commands, workspace, obstacles and figures would be."""

TCP_TOLERANCE_RAD = 0.02

AT_LIMIT_RAD = 0.02
"""Distance to the end of a joint's range (rad, or m) within which the joint is reported to end a
motion."""

AT_REST_RAD_S = 2e-4
"""All joints slower than this can stop within one period."""

_new = tuple.__new__
"""Constructor of the named tuples of every cycle, in half the usual time."""

_JOINT = CommandKind.JOINT
"""A look-up of an enum's member takes longer than what is done with it in a cycle."""


class JointSpaceArm(CommandedArm):
    """The commanded joints of one arm."""

    longest_step_s = LONGEST_SERVO_STEP_S

    def __init__(
        self,
        servo: AnyServo,
        kinds: frozenset[CommandKind],
        lag_s: float = 0.0,
        *,
        sent_as: Kinematics | None = None,
        tcp_tolerance_m: float | None = None,
        neighbors: Sequence[NeighborBodies] = (),
    ) -> None:
        """`kinds` are the commands that the robot takes, at least one of PREFERRED; `lag_s` is its
        normal delay behind them. `sent_as`: the kinematics with the TCP of the robot's own
        controller, if that is not the servo's. `tcp_tolerance_m`: most that the robot's TCP may
        differ from the model's; None: by the kind of command. `neighbors`: other arms, whose bodies
        are the movers of the servo's collision model, in this order.
        """
        self.servo = servo
        self.kind = next((kind for kind in PREFERRED if kind in kinds), None)
        self.velocity_gain_1_s = VELOCITY_GAIN_1_S
        if tcp_tolerance_m is None:
            sends_poses = self.kind is CommandKind.POSE
            tcp_tolerance_m = POSE_TCP_TOLERANCE_M if sends_poses else JOINT_TCP_TOLERANCE_M
        self._tolerance_m = tcp_tolerance_m
        self._sent_as = sent_as or servo.kinematics
        self._highest = servo.kinematics.velocity
        self._fastest: list[float] = self._highest.tolist()
        self._continuous: list[bool] = servo.kinematics.continuous.tolist()
        self._still = np.zeros(servo.joints)
        self.neighbors = neighbors
        self._placed: list[Sequence[SE3]] = [()] * len(neighbors)
        self._sent: FloatArray | None = None
        self._relaxed = getattr(servo.kinematics, "relaxed", None)
        self._lag_s = lag_s
        servo.keep_past(lag_s)

    # -- commanded state -------------------------------------------------------------------------

    @property
    def pose(self) -> Pose:
        return self.servo.pose

    @property
    def tool(self) -> Pose:
        tool: Pose = getattr(self.servo.kinematics, "tool", IDENTITY_POSE)
        return tool

    @property
    def twist(self) -> Twist:
        # Not `servo.twist`, which is that of a reference: a motion of joints has none.
        servo = self.servo
        if not servo.moving:
            return ZERO_TWIST
        linear, angular = servo.motion.tolist()
        return Twist(Vector3(*linear), Vector3(*angular), Frame.BASE)

    @property
    def moving(self) -> bool:
        return self.servo.moving

    @property
    def settled(self) -> bool:
        fastest: float = max(map(abs, self.servo.v.tolist()))
        return fastest < AT_REST_RAD_S

    def status(self) -> ServoStatus:
        return self.servo.status()

    def keep_sent_as(self, kinematics: Kinematics) -> None:
        """Send poses by the tool of `kinematics`, which this owns from now on, whatever tool the
        servo gets: the robot's controller knows no other."""
        self._sent_as = kinematics

    def output_limits(self, capabilities: RobotCapabilities) -> OutputLimits:
        """Limits of these commands: those of its joints, and its robot's for the TCP."""
        bounds = self.servo.kinematics
        return OutputLimits(
            capabilities.linear_speed_m_s or FASTEST_TCP_M_S,
            math.inf,
            capabilities.angular_speed_rad_s or FASTEST_TCP_RAD_S,
            math.inf,
            tuple(bounds.lower.tolist()),
            tuple(bounds.upper.tolist()),
            tuple(bounds.velocity.tolist()),
            tuple(bounds.acceleration.tolist()),
        )

    def place_neighbor(self, index: int, joints: Sequence[float], ways_m: Sequence[float]) -> None:
        first = sum(len(each.shapes) for each in self.neighbors[:index])
        self._placed[index] = frames = self.neighbors[index].frames(joints)
        self.servo.move(first, frames, ways_m)

    def neighbor_frames(self) -> list[SE3]:
        """Frames of the neighbors' shapes in the base, as placed last, for any thread."""
        return list(itertools.chain.from_iterable(self._placed))

    # -- measured state --------------------------------------------------------------------------

    def obstacle(self, state: RobotState, new: bool) -> str:
        joints = self.servo.joints
        if len(state.joints) != joints:
            return f"the robot reports {len(state.joints)} joints, the arm's model has {joints}"
        if not (math.isfinite(sum(state.joints)) or is_finite(state.joints)):
            return "the robot reports joints that are not numbers"
        if new and state.pose is not None and self.kind is not None:
            return self._misfit(state, state.pose)
        return ""

    def _misfit(self, state: RobotState, reported: Pose) -> str:
        """Return how the robot's own TCP contradicts its joints by the model; else empty."""
        if self._sent_as is self.servo.kinematics:
            model = self.servo.pose_at(state.joints)
        else:
            model = to_pose(self._sent_as.forward(np.array(state.joints)))
        apart_m = norm(subtract(reported.position, model.position))
        apart_rad = 0.0
        if self.kind is CommandKind.POSE:
            apart_rad = norm(rotation_between(model.orientation, reported.orientation))
        if apart_m <= self._tolerance_m and apart_rad <= TCP_TOLERANCE_RAD:
            return ""
        turned = f" and {apart_rad:.3f} rad" if apart_rad > TCP_TOLERANCE_RAD else ""
        x, y, z = (1e3 * value for value in reported.position)
        u, v, w = (1e3 * value for value in model.position)
        return (
            f"the tool or the model does not fit: the controller's TCP is {apart_m * 1e3:.1f} mm"
            f"{turned} away from the arm model's ({x:.0f}, {y:.0f}, {z:.0f} against {u:.0f}, "
            f"{v:.0f}, {w:.0f} mm): set [arm] tool to the controller's tool, and use its base frame"
        )

    def measured(self, state: RobotState) -> Pose:
        return self.servo.measure(state.joints)[0]

    def reported(self, state: RobotState) -> Pose | None:
        if len(state.joints) != self.servo.joints or not is_finite(state.joints):
            return None
        return self.servo.pose_at(state.joints)

    def jump(self, before: RobotState, state: RobotState, time_s: float) -> str:
        found = jump(state.joints, before.joints, self._fastest, self._continuous, time_s)
        if found is None:
            return ""
        worst, away = found
        return (
            f"the measured {self.servo.kinematics.names[worst]} jumped by {away:.2f} rad in "
            f"{time_s * 1e3:.0f} ms"
        )

    def _short(self, difference: FloatArray) -> FloatArray:
        return short_way(difference, self.servo.kinematics.continuous)

    def _error(self, state: RobotState) -> FloatArray:
        """Commanded less measured joints."""
        return self._short(self.servo.q - self.servo.expected(state.joints))

    def following_error(
        self, state: RobotState, reference: Reference | None, observe: bool = False
    ) -> FollowingError:
        pose, worst, joint = self.servo.measure(state.joints)
        linear, angular = 0.0, 0.0
        if reference is not None:
            if observe and reference.pose is not None:
                reference.observe(pose)
            linear, angular = reference.ahead_m, reference.ahead_rad
        names = self.servo.kinematics.names
        return _new(FollowingError, (linear, angular, worst, names[joint]))

    # -- motion ----------------------------------------------------------------------------------

    def place(
        self, state: RobotState, before: RobotState | None = None, time_s: float = 0.0
    ) -> None:
        servo = self.servo
        last = servo.v.copy()
        servo.place(np.array(state.joints))
        servo.twist[:] = 0.0
        self.servo.keep_past(self._lag_s)
        self._sent = None
        self.placed = True
        if before is None or time_s < SHORTEST_S or len(before.joints) != servo.joints:
            return
        if self.jump(before, state, time_s):
            return
        v = self._short(np.array(state.joints) - np.array(before.joints)) / time_s
        v = np.where(v * last > 0.0, np.sign(v) * np.minimum(np.abs(v), np.abs(last)), 0.0)
        self._set_velocities(v)

    def catch(self, q: FloatArray, velocities: FloatArray) -> None:
        """Take over at `q` an arm that moves at `velocities` and was not commanded by position."""
        self.servo.place(q)
        self.servo.keep_past(self._lag_s)
        self._set_velocities(np.clip(velocities, -self._highest, self._highest))

    def _set_velocities(self, v: FloatArray) -> None:
        servo = self.servo
        servo.move_at(v)
        self._sent = v.copy()
        servo.twist[:] = servo.motion

    def follow(
        self,
        reference: Reference,
        dt_s: float,
        rates: Mapping[str, float] | None = None,
        slide: bool = True,
    ) -> float:
        assert reference.pose is not None
        servo = self.servo
        if self._relaxed is not None:
            servo.posture = self._relaxed(servo.q)
        joint_rates = None
        if rates:
            joint_rates = np.array([rates.get(name, 0.0) for name in servo.kinematics.names])
        twist = reference.linear, reference.angular
        share = servo.tick(reference.pose, twist, dt_s, joint_rates, slide=slide)
        if servo.projects and (reachable := servo.reachable) is not None:
            reference.pose = reachable
        reference.pose = servo.moved(reference.pose, dt_s)
        return share

    def brake(self, dt_s: float) -> None:
        self.servo.brake(dt_s)

    def halt(self) -> None:
        self.servo.move_at(self._still)
        self.servo.twist[:] = 0.0
        self._sent = None

    def approach(self, state: RobotState, dt_s: float) -> None:
        servo = self.servo
        kinematics = servo.kinematics
        rate = self._error(state) / -APPROACH_TIME_S
        kinematics.update(servo.q)
        twist = kinematics.jacobian.dot(rate)
        over = max(
            float((np.abs(rate) / self._highest).max()) / APPROACH_SHARE,
            float(np.linalg.norm(twist[:3])) / APPROACH_SPEED_M_S,
            float(np.linalg.norm(twist[3:])) / APPROACH_SPEED_RAD_S,
            1.0,
        )
        servo.tick_joints(servo.q.copy(), rate / over, dt_s)

    # -- commands to the robot -------------------------------------------------------------------

    def command(
        self, state: RobotState, dt_s: float, approaching: bool = False, blind: bool = False
    ) -> RobotCommand:
        servo = self.servo
        if self._lag_s > 0.0:
            servo.record_command(state.stamp_s)
        # A velocity-controlled one would keep its error for ever.
        v = self._still if approaching else servo.v
        if self.kind is _JOINT:
            positions, speeds = servo.targets()
            if approaching:
                speeds = tuple(v.tolist())
            return _new(JointCommand, (positions, speeds, (), _JOINT))
        if self.kind is CommandKind.JOINT_VELOCITY:
            v = self._velocities(None if blind else state, v, dt_s, approaching)
            return JointVelocityCommand(tuple(v.tolist()))
        kinematics = self._sent_as
        kinematics.update(servo.q)
        lines = kinematics.placement.rotation @ (kinematics.jacobian @ servo.v).reshape(2, 3).T
        linear, angular = lines.T.tolist()
        return PoseCommand(
            to_pose(kinematics.placement), Twist(Vector3(*linear), Vector3(*angular))
        )

    def _velocities(
        self, state: RobotState | None, wanted: FloatArray, dt_s: float, approaching: bool
    ) -> FloatArray:
        """`wanted` plus the correction of the robot's position, within limits."""
        servo, highest = self.servo, self._highest
        most = CORRECTION_SHARE * highest
        v = wanted
        if state is not None:
            v = wanted + np.clip(self.velocity_gain_1_s * self._error(state), -most, most)
        if approaching:
            # No operator steers the correction either.
            kinematics = servo.kinematics
            kinematics.update(servo.q)
            speed = float(np.linalg.norm(kinematics.jacobian[:3].dot(v)))
            v = v / max(1.0, speed / APPROACH_SPEED_M_S)
        v = np.clip(v, -highest, highest)
        if self._sent is None:
            self._sent = np.zeros(servo.joints)
        step = servo.kinematics.acceleration * dt_s
        self._sent = np.clip(v, self._sent - step, self._sent + step)
        return self._sent

    def held_by(self) -> str:
        status, servo = self.servo.status(), self.servo
        if status.smallest_singular_value < SINGULAR:
            value = status.smallest_singular_value
            return f"the arm is stretched to the edge of its reach, or singular ({value:.3f})"
        bounds = servo.kinematics
        margin = np.minimum(servo.q - bounds.lower, bounds.upper - servo.q)
        nearest = int(np.argmin(margin))
        if margin[nearest] < AT_LIMIT_RAD:
            return f"{bounds.names[nearest]} is at its limit, {servo.q[nearest]:.4f} rad"
        if status.active_pairs:
            return status.nearest_in_words
        return ""
