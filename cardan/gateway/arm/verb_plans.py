"""Planning of the verbs' motions from arguments and parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Literal, NamedTuple

from cardan.common.arm_libraries import np
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.arrival import Arrival
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.joint_space_arm import PREFERRED, JointSpaceArm
from cardan.gateway.arm.motions.base import CommandedMotion, Deceleration
from cardan.gateway.arm.motions.joint_trajectory import FollowJointTrajectory
from cardan.gateway.arm.motions.joints import FollowJoints
from cardan.gateway.arm.motions.line import FollowLine
from cardan.gateway.arm.motions.torque import TorqueMotion
from cardan.gateway.arm.motions.trajectory_motion import TOLERANCE_RAD
from cardan.gateway.arm.motions.twist import FollowTwist
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.vocab import FrameCode, Parameter, ProfileCode, State
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import FloatArray, short_way, to_pose
from cardan.gateway.motion.joint_trajectory import SHORTEST_STEP_S, JointTrajectory
from cardan.gateway.motion.planner import MOST_SAMPLES, Planner, check_workspace
from cardan.gateway.motion.shaping import PoseShaper, PoseShaperLimits
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.gateway.motion.trajectories import (
    HoldTrajectory,
    LineLimits,
    LineTrajectory,
    PointToPointTrajectory,
    SplineTrajectory,
    samples,
)
from cardan.robots import ArmModel
from cardan.spatial import (
    compose,
    limit_norm,
    multiply,
    norm,
    normalized,
    rotate,
    rotation_between,
    subtract,
)
from cardan.types import CommandKind, Frame, Pose, RobotCapabilities, Twist, Vector3, Wrench

ALREADY_THERE_RAD = 1e-6

WAY_SAMPLES = 33
"""Samples of a straight joint motion for the workspace check: between them the TCP moves little
beyond its edge."""

SPEED_SAMPLES = 33
"""Samples of a joint motion at which the TCP's speed is checked: every 6 degrees of half a turn."""

BEGINS_RAD = 0.05
"""Largest distance, rad or m, of a trajectory's first point from the arm: MoveIt itself allows 0.01
by default."""

TRAJECTORY_STEP_RAD = 0.05
"""Longest motion of a joint between two samples of a trajectory."""

WORTH_A_NOTE = 0.995
"""Share of the speed below which a slower trajectory is reported: planners use the limits fully."""

_STILL = 1e-9


class Plan(NamedTuple):
    """A planned motion, or none if the arm is at its goal."""

    motion: CommandedMotion | None
    duration_s: float
    note: str = ""


def there_already() -> Plan:
    """Plan of an arm that is at its goal."""
    return Plan(None, 0.0, "the arm is there already")


class VerbPlans:
    """Plans motions with the present parameters. May take milliseconds."""

    def __init__(
        self,
        controller: ArmController,
        commanded: JointSpaceArm,
        model: ArmModel,
        planner: Planner,
        capabilities: RobotCapabilities,
        options: ControllerOptions,
        parameters: dict[Parameter, float],
    ) -> None:
        self.model, self.planner, self.capabilities = model, planner, capabilities
        self.parameters = parameters
        self.measuring = ArmKinematics(model)
        """Kinematics for measured joints, with the tool."""
        self.options = options
        self.deceleration = Deceleration(
            options.stop_deceleration_m_s2, options.stop_deceleration_rad_s2, 0.5
        )
        self._controller, self._commanded = controller, commanded
        self.servo = commanded.servo

    @property
    def tcp_frame(self) -> bool:
        return self.parameters[Parameter.FRAME] == FrameCode.TCP

    def in_base(self, target: Pose, start: FloatArray) -> Pose:
        if not self.tcp_frame:
            return target
        return compose(to_pose(self.planner.forward(start)), target)

    def joints(self, verb: str, target: Pose, start: FloatArray) -> Plan:
        target = self.in_base(target, start)
        return self._joints_to(verb, target, start)

    def relative(self, step: Pose, start: FloatArray) -> Plan:
        now = to_pose(self.planner.forward(start))
        if self.tcp_frame:
            target = compose(now, step)
        else:
            target = Pose(
                Vector3(*(a + b for a, b in zip(now.position, step.position, strict=True))),
                normalized(multiply(step.orientation, now.orientation)),
            )
        return self._joints_to("relj", target, start)

    def _joints_to(self, verb: str, target: Pose, start: FloatArray) -> Plan:
        self.require_drive(verb)
        check_workspace(verb, target.position, self.options.streams.workspace_m)
        kinematics = self.planner.kinematics
        speeds = self.parameters[Parameter.JOINT_SPEED] * kinematics.velocity
        return self._joint_plan(start, self.planner.joint_goal(verb, target, start, speeds))

    def joint_positions(self, verb: str, goal: FloatArray, start: FloatArray) -> Plan:
        """Plan a straight motion of all joints to the positions `goal`, arriving together; its path
        is checked."""
        self.require_drive(verb)
        shares = np.linspace(0.0, 1.0, WAY_SAMPLES)[:, np.newaxis]
        self.planner.check_joint_samples(verb, start + shares * (goal - start))
        return self._joint_plan(start, goal)

    def _joint_plan(self, start: FloatArray, goal: FloatArray) -> Plan:
        kinematics = self.planner.kinematics
        speeds = self.parameters[Parameter.JOINT_SPEED] * kinematics.velocity
        accelerations = self.parameters[Parameter.JOINT_ACCELERATION] * kinematics.acceleration
        if float(np.abs(goal - start).max()) < ALREADY_THERE_RAD:
            return self._stay(start)
        share = self._share_of_speed(start, goal, speeds)
        note = f"slowed to {share:.0%}, for the TCP's speed" if share < 1.0 else ""
        # Not `continuous`: the goal's turns are chosen already.
        path = PointToPointTrajectory(start, goal, share * speeds, accelerations)
        motion = FollowJoints(self.servo, path, self.deceleration, self._arrival)
        return Plan(motion, path.duration_s, note)

    def _stay(self, start: FloatArray) -> Plan:
        """Plan the wait of a command that is at its goal for an arm that is not there yet."""
        if self._is_at(start):
            return there_already()
        motion = FollowJoints(self.servo, HoldTrajectory(start), self.deceleration, self._arrival)
        return Plan(motion, 0.0, "the command is there already")

    def _is_at(self, start: FloatArray) -> bool:
        """Return whether the measured joints are so near `start` that no wait is needed."""
        robot = self._controller.robot
        assert robot is not None
        away = short_way(np.array(robot.joints) - start, self.planner.kinematics.continuous)
        near = min(TOLERANCE_RAD, self.options.arrival.arrival_joint)
        return float(np.abs(away).max()) <= near

    def _share_of_speed(self, start: FloatArray, goal: FloatArray, speeds: FloatArray) -> float:
        """Return the share of the joints' `speeds` at which the TCP keeps its speed limit on the
        whole path."""
        way = goal - start
        rate = way / float((np.abs(way) / speeds).max())
        shares = np.linspace(0.0, 1.0, SPEED_SAMPLES)
        return self._tcp_share([(start + share * way, rate) for share in shares])

    def _tcp_share(self, samples: Iterable[tuple[FloatArray, FloatArray]]) -> float:
        """Return the share of the speed at which the TCP keeps its limit at all of these joint
        positions and velocities."""
        limits, kinematics, share = self.options.limits, self.planner.kinematics, 1.0
        if limits is None:
            return share
        for q, v in samples:
            kinematics.update(q)
            twist = kinematics.jacobian @ v
            share = min(
                share,
                limits.linear_speed_m_s / max(float(np.linalg.norm(twist[:3])), _STILL),
                limits.angular_speed_rad_s / max(float(np.linalg.norm(twist[3:])), _STILL),
            )
        return share

    def trajectory(self, wanted: JointTrajectory, start: FloatArray) -> Plan:
        verb = "trajectory"
        self.require_drive(verb)
        joints = len(wanted.positions[0])
        if joints != len(start):
            raise MotionRefusedError(
                f"{verb}: it has {joints} joints, the arm has {len(start)}; plan it for this arm"
            )
        wanted = self._nearest_turns(wanted, start)
        if wanted.times_s[0] < SHORTEST_STEP_S:
            away = np.abs(np.array(wanted.positions[0]) - start)
            worst = int(away.argmax())
            if away[worst] > BEGINS_RAD:
                raise MotionRefusedError(
                    f"{verb}: it begins with {self.planner.names[worst]} at "
                    f"{wanted.positions[0][worst]:.4f}, which is at {start[worst]:.4f}; plan it "
                    "from where the arm is"
                )
        path = SplineTrajectory(wanted, start)
        planned_s = path.duration_s
        times = samples(path, TRAJECTORY_STEP_RAD, MOST_SAMPLES)
        rows = np.array([path.at(t)[0] for t in times.tolist()])
        self.planner.check_joint_samples(verb, rows)
        share = self._share_of_trajectory(path, times)
        if share < 1.0:
            path.slow(share)
        if 0.0 < wanted.goal_time_s < path.duration_s - planned_s:
            raise MotionRefusedError(
                f"{verb}: the arm's limits make it {path.duration_s:.2f} s; it was planned for "
                f"{planned_s:.2f} s, and may take {wanted.goal_time_s:g} s longer; plan it slower"
            )
        note = ""
        if share < WORTH_A_NOTE:
            note = f"slowed to {share:.0%}, for the limits of the arm"
        if float(np.abs(rows - start).max()) < ALREADY_THERE_RAD and self._is_at(start):
            return there_already()
        motion = FollowJointTrajectory(self.servo, path, self.deceleration, wanted, self._arrival)
        return Plan(motion, path.duration_s, note)

    def _nearest_turns(self, wanted: JointTrajectory, start: FloatArray) -> JointTrajectory:
        """Return the trajectory with whole turns added to continuous joints, as planners omit them,
        so that its first point is as near as possible."""
        positions = np.array(wanted.positions)
        away = positions[0] - start
        turned = short_way(away, self.planner.kinematics.continuous) - away
        return replace(wanted, positions=positions + turned) if turned.any() else wanted

    def _share_of_trajectory(self, path: SplineTrajectory, times: FloatArray) -> float:
        """Return the share of the speed at which joints and TCP keep their limits all the way."""
        kinematics = self.planner.kinematics
        moves = [path.at(t_s) for t_s in times.tolist()]
        speeds = [float((np.abs(v) / kinematics.velocity).max()) for _, v in moves]
        accelerations = [
            float((np.abs(path.acceleration(t_s)) / kinematics.acceleration).max())
            for t_s in times.tolist()
        ]
        within = 1.0 / max(1.0, *speeds), 1.0 / math.sqrt(max(1.0, *accelerations))
        return min(self._tcp_share(moves), *within)

    def line(self, target: Pose, start: FloatArray, relative: bool, verb: str = "movl") -> Plan:
        """Plan a straight line to `target`, in the base, or `relative` to the present TCP."""
        self.require_drive(verb)
        begin = to_pose(self.planner.forward(start))
        target = compose(begin, target) if relative else target
        check_workspace(verb, target.position, self.options.streams.workspace_m)
        if (
            norm(subtract(target.position, begin.position)) < 1e-7
            and norm(rotation_between(begin.orientation, target.orientation)) < 1e-6
        ):
            return self._stay(start)
        path, note = self._path(begin, target)
        rehearsed = self.planner.dry_run(verb, path, start)
        if rehearsed.pace < 1.0:
            slow = f"{rehearsed.slowest} allows {rehearsed.pace:.0%} of the speed in places"
            note = f"{note}; {slow}" if note else slow
        motion = FollowLine(
            self.servo, path, self.planner.retained, self.deceleration, self._arrival
        )
        return Plan(motion, path.duration_s, note)

    def _path(self, begin: Pose, target: Pose) -> tuple[LineTrajectory, str]:
        """Plan the line at the reference speeds, or slower if a longer duration is set."""
        values = self.parameters
        jerk = values[Parameter.PROFILE] == ProfileCode.JERK
        cap_m_s = self.capabilities.linear_speed_m_s or math.inf
        cap_rad_s = self.capabilities.angular_speed_rad_s or math.inf
        linear_m_s2, angular_rad_s2 = self._accelerations
        linear_m_s3, angular_rad_s3 = (
            values[Parameter.TRAJECTORY_JERK],
            values[Parameter.ROTATION_JERK],
        )
        most = self.options.limits
        if most is not None:
            cap_m_s = min(cap_m_s, most.linear_speed_m_s)
            cap_rad_s = min(cap_rad_s, most.angular_speed_rad_s)
            linear_m_s3 = min(linear_m_s3, most.linear_jerk_m_s3 or math.inf)
            angular_rad_s3 = min(angular_rad_s3, most.angular_jerk_rad_s3 or math.inf)
        limits = LineLimits(
            linear_speed_m_s=min(values[Parameter.TRAJECTORY_SPEED], cap_m_s),
            linear_acceleration_m_s2=linear_m_s2,
            linear_jerk_m_s3=linear_m_s3,
            angular_speed_rad_s=min(values[Parameter.ROTATION_SPEED], cap_rad_s),
            angular_acceleration_rad_s2=angular_rad_s2,
            angular_jerk_rad_s3=angular_rad_s3,
        )
        profile: Literal["jerk", "trapezoid"] = "jerk" if jerk else "trapezoid"
        path = LineTrajectory(begin, target, limits, profile=profile)
        wanted_s = values[Parameter.TRAJECTORY_DURATION]
        if wanted_s > path.duration_s:
            path = LineTrajectory(begin, target, limits, profile=profile, duration_s=wanted_s)
        elif wanted_s > 0.0:
            return path, f"{wanted_s:g} s is too short: it takes {path.duration_s:.2f} s"
        return path, ""

    def twist(self, linear: Vector3, angular: Vector3, start: FloatArray) -> Plan:
        self.require_drive("movv")
        now = to_pose(self.planner.forward(start))
        if self.tcp_frame:
            linear, angular = rotate(now.orientation, linear), rotate(now.orientation, angular)
        linear, angular, share = self.slowed(linear, angular)
        note = f"slowed to {share:.0%}, the fastest allowed" if share < 1.0 else ""
        if not any((*linear, *angular)):
            raise MotionRefusedError(
                "movv: a twist of zero moves nothing; call stop to end a motion"
            )
        reference = self.reference(*self._accelerations)
        twist = Twist(linear, angular, Frame.BASE)
        controller = self._controller
        with controller.lock:
            if controller.idle:
                controller.engage()
            motion = FollowTwist(self._commanded, reference, self.deceleration, twist)
        return Plan(motion, math.inf, note)

    def torque(self, state: State, wrench: Wrench | None, start: FloatArray) -> Plan:
        verb = "gcmp" if wrench is None else "forc"
        self.require_torque(verb)
        try:
            motion = self.torque_motion(state)
            motion.check_weight(start)
            if wrench is not None:
                motion.set_wrench(wrench)
        except MotionRefusedError as error:
            raise MotionRefusedError(f"{verb}: {error}") from None
        return Plan(motion, math.inf)

    def torque_motion(self, state: State) -> TorqueMotion:
        return TorqueMotion(state, self.model, self._commanded, self.measuring, self.options.torque)

    def reference(self, linear_m_s2: float, angular_rad_s2: float) -> Reference:
        """Make a reference for streams and movv with these accelerations."""
        limits = replace(
            self.options.streams,
            linear_speed_m_s=self._fastest_m_s,
            linear_acceleration_m_s2=linear_m_s2,
            angular_speed_rad_s=self._fastest_rad_s,
            angular_acceleration_rad_s2=angular_rad_s2,
        )
        return Reference(limits)

    def pose_shaper(self, limits: ReferenceLimits) -> PoseShaper:
        linear_jerk, angular_jerk = limits.linear_jerk_m_s3, limits.angular_jerk_rad_s3
        assert linear_jerk is not None
        assert angular_jerk is not None
        return PoseShaper(
            PoseShaperLimits(
                linear_speed_m_s=limits.linear_speed_m_s,
                linear_acceleration_m_s2=limits.linear_acceleration_m_s2,
                linear_jerk_m_s3=linear_jerk,
                angular_speed_rad_s=limits.angular_speed_rad_s,
                angular_acceleration_rad_s2=limits.angular_acceleration_rad_s2,
                angular_jerk_rad_s3=angular_jerk,
            ),
            damping=self.parameters[Parameter.DAMPING],
        )

    @property
    def _arrival(self) -> Arrival:
        """Make the arrival check of one motion."""
        return Arrival(self.options.arrival, self.capabilities.lag_s)

    @property
    def _accelerations(self) -> tuple[float, float]:
        """Accelerations of lines and movv: those of the parameters, within the limits."""
        linear = self.parameters[Parameter.TRAJECTORY_ACCELERATION]
        angular = self.parameters[Parameter.ROTATION_ACCELERATION]
        limits = self.options.limits
        if limits is None:
            return linear, angular
        return (
            min(linear, limits.linear_acceleration_m_s2),
            min(angular, limits.angular_acceleration_rad_s2),
        )

    @property
    def _fastest_m_s(self) -> float:
        most = self.capabilities.linear_speed_m_s
        return min(self.options.streams.linear_speed_m_s, math.inf if most is None else most)

    @property
    def _fastest_rad_s(self) -> float:
        most = self.capabilities.angular_speed_rad_s
        return min(self.options.streams.angular_speed_rad_s, math.inf if most is None else most)

    def slowed(self, linear: Vector3, angular: Vector3) -> tuple[Vector3, Vector3, float]:
        """Return the twist inside the speed limits, both parts slowed alike, and the factor."""
        share = 1.0
        for part, fastest in ((linear, self._fastest_m_s), (angular, self._fastest_rad_s)):
            speed = norm(part)
            if speed * share > fastest:
                share = fastest / speed
        if share == 1.0:
            return linear, angular, share
        return (
            limit_norm(Vector3(*(share * c for c in linear)), self._fastest_m_s),
            limit_norm(Vector3(*(share * c for c in angular)), self._fastest_rad_s),
            share,
        )

    def require_drive(self, verb: str) -> None:
        if self._commanded.kind is None:
            raise MotionRefusedError(
                f"{verb}: the robot takes {kinds_in_words(self.capabilities)}; "
                f"a motion needs one of {', '.join(kind.value for kind in PREFERRED)}"
            )

    def require_torque(self, verb: str) -> None:
        if CommandKind.TORQUE not in self.capabilities.commands:
            raise MotionRefusedError(
                f"{verb}: the robot takes {kinds_in_words(self.capabilities)}; this needs torque"
            )
        self.require_drive(verb)


def kinds_in_words(capabilities: RobotCapabilities) -> str:
    return ", ".join(sorted(kind.value for kind in capabilities.commands)) or "nothing"
