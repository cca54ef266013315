"""The verbs of the Cartesian interface as methods: each checks, plans and starts a motion.

Verbs may be called from any thread: slow work (inverse kinematics, dry runs) is done beside the
loop, which only ever holds the controller's lock for a moment.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from cardan.common.arm_libraries import np
from cardan.errors import CardanError, ConfigurationError, MotionRefusedError
from cardan.gateway.arm import parameters as prm
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.joint_space_arm import PREFERRED, JointSpaceArm
from cardan.gateway.arm.motions.joint_trajectory import FollowJointTrajectory
from cardan.gateway.arm.motions.torque import TorqueMotion
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.replay_requests import CommandHeader, argument_text
from cardan.gateway.arm.states import Authority
from cardan.gateway.arm.status import VERBS
from cardan.gateway.arm.streams import Streams
from cardan.gateway.arm.validation import (
    FramedPose,
    Target,
    checked_action,
    checked_distance,
    checked_name,
    checked_pose,
    joint_numbers,
    six_numbers,
    six_of,
)
from cardan.gateway.arm.verb_plans import Plan, VerbPlans, kinds_in_words
from cardan.gateway.arm.verb_results import (
    ControllerStatus,
    Motion,
    Outcome,
    Rehearsal,
    Stat,
)
from cardan.gateway.arm.verb_table import preset_of
from cardan.gateway.arm.vocab import (
    Action,
    Begins,
    Parameter,
    PolicyCode,
    State,
    Stream,
    vocab_text,
)
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import FloatArray, to_pose
from cardan.gateway.kinematics.collision import CollisionModel, Obstacle
from cardan.gateway.motion.joint_trajectory import JointTrajectory
from cardan.gateway.motion.planner import Planner, check_workspace
from cardan.gateway.operator.input import OperatorInput
from cardan.gateway.operator.mapping import MappingOptions, TwistMapping
from cardan.gateway.servo.choice import choose_servo
from cardan.gateway.servo.options import Policy
from cardan.robots import ArmModel, BodyShape
from cardan.spatial import is_finite
from cardan.types import (
    IDENTITY,
    CommandKind,
    Frame,
    Pose,
    RobotCapabilities,
    RobotLink,
    RobotState,
    Twist,
    Vector3,
    Wrench,
)

AT_REST_SHARE = 0.02
"""Share of each joint's speed above which a robot counts as moved by something else."""

_TO_POLICY = {PolicyCode.PATH: Policy.PATH, PolicyCode.REACH: Policy.REACH}
_TO_CODE = {policy: code for code, policy in _TO_POLICY.items()}

_Prepare = Callable[[FloatArray], Plan]


class ArmVerbs:
    """The verbs of the Cartesian interface for one arm: one source of motion among others.

    Positions in m, angles in rad; `frame` (parameter cpf) means the same in every verb: base, or
    relative to the TCP. A verb that is refused raises MotionRefusedError and changes nothing; a
    streamed command returns the reason, or "".
    """

    def __init__(
        self,
        controller: ArmController,
        commanded: JointSpaceArm,
        model: ArmModel,
        capabilities: RobotCapabilities,
        options: ControllerOptions | None = None,
        *,
        obstacles: Iterable[Obstacle] = (),
        tool_shapes: Iterable[BodyShape] = (),
        gripper: Callable[[Action], None] | None = None,
    ) -> None:
        """Verbs for an existing controller; `alone` makes one. `gripper` carries out an action;
        without it `act` is refused."""
        self.options = options = options or ControllerOptions()
        self.controller, self.commanded, self.model = controller, commanded, model
        self.servo = commanded.servo
        self.capabilities = capabilities
        collision = commanded.servo.collision
        self.planner = Planner(
            model,
            obstacles=tuple(obstacles),
            tool_shapes=tuple(tool_shapes),
            movers=[each.shapes for each in commanded.neighbors],
            mover_frames=commanded.neighbor_frames,
            ignored=() if collision is None else collision.ignored,
            workspace=options.streams.workspace_m,
            margins=options.margins,
        )
        self.planner.set_tool(commanded.tool)
        self.parameters = values = prm.defaults()
        values[Parameter.GAIN] = (
            commanded.velocity_gain_1_s * values[Parameter.CONTROL_PERIOD] / 1000.0
        )
        values[Parameter.POLICY] = float(_TO_CODE[commanded.servo.policy])
        self.plans = VerbPlans(
            controller, commanded, model, self.planner, capabilities, options, self.parameters
        )
        self.plans.measuring.set_tool(commanded.tool)
        self.streams = Streams(controller, commanded, self.plans)
        self._gripper = gripper
        self.planning = threading.RLock()
        """Held by the thread that uses `planner`; always taken before the controller's lock."""
        self._motion: Motion | None = None
        self._waited_for: Motion | None = None
        self._pending: tuple[Motion, _Prepare] | None = None
        self._message = ""
        self._voided = ""
        """Reason why the last plans became invalid."""
        self._refusals = 0
        self._last_refusal = ""
        controller.listener = self

    @classmethod
    def alone(
        cls,
        model: ArmModel,
        capabilities: RobotCapabilities,
        options: ControllerOptions | None = None,
        *,
        obstacles: Iterable[Obstacle] = (),
        tool_shapes: Iterable[BodyShape] = (),
        gripper: Callable[[Action], None] | None = None,
        mapping: MappingOptions | None = None,
    ) -> ArmVerbs:
        """Verbs with a controller of their own; with a `mapping` an operator device moves the arm,
        too. Raises ConfigurationError if arm and robot do not fit together."""
        options = options or ControllerOptions()
        model = narrowed(model, capabilities)
        drive = _drive(options.drive, capabilities)
        obstacles, tool_shapes = tuple(obstacles), tuple(tool_shapes)
        if obstacles and not options.i_accept_links_without_bodies:
            model.require_bodies("obstacles")
        kinematics = ArmKinematics(model)
        servo = choose_servo(
            kinematics,
            CollisionModel(kinematics, obstacles, tool_shapes),
            options.servo,
            model.task.weights,
        )
        if len(model.joints) > 6:
            servo.posture = np.array(model.home)
        commanded = JointSpaceArm(
            servo,
            frozenset() if drive is None else frozenset({drive}),
            capabilities.lag_s,
            sent_as=ArmKinematics(model),
            tcp_tolerance_m=options.tcp_tolerance_m,
        )
        values = prm.defaults()
        commanded.velocity_gain_1_s = prm.feedback_gain_1_s(
            values[Parameter.GAIN], values[Parameter.CONTROL_PERIOD]
        )
        limits = replace(options.streams, linear_jerk_m_s3=None, angular_jerk_rad_s3=None)
        age_s = options.watchdogs.device_age_s
        operator = None
        if mapping is not None:
            operator = OperatorInput(TwistMapping(mapping), limits, (), age_s)
        controller = ArmController(
            commanded,
            limits,
            options.watchdogs,
            operator,
            Authority(options.authority),
            period_s=capabilities.period_s,
            output_limits=commanded.output_limits(capabilities),
        )
        return cls(
            controller,
            commanded,
            model,
            capabilities,
            options,
            obstacles=obstacles,
            tool_shapes=tool_shapes,
            gripper=gripper,
        )

    # -- state -----------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """State of the arm; NOT_CONTROLLING from a stop on."""
        current = self.controller.motion
        if current is None or self.controller.braking:
            return State.NOT_CONTROLLING
        return current.state

    @property
    def at_rest(self) -> bool:
        """True when no command moves the arm or is about to."""
        with self.controller.lock:
            controller = self.controller
            return controller.idle and not controller.recovering and self._pending is None

    @property
    def waited_for(self) -> Motion | None:
        """Motion that `wait` waits for: the newest, if it ends by itself."""
        return self._waited_for

    @property
    def stamp_s(self) -> float:
        """Time of the newest robot state, s; NEVER_S before the first."""
        return self.controller.stamp_s

    def status(self) -> ControllerStatus:
        """Return the present flags and numbers."""
        controller, streams = self.controller, self.streams
        with controller.lock:
            robot, error = controller.robot, controller.following_error
            return ControllerStatus(
                state=self.state,
                stream=streams.kind,
                ready=robot is not None and robot.ready,
                moving=self.commanded.moving,
                braking=controller.braking,
                torque=isinstance(controller.motion, TorqueMotion),
                recovering=controller.recovering,
                message=self._message,
                stream_owner=streams.owner,
                stream_age_s=streams.age_s,
                stream_late=streams.late,
                stream_scaled=streams.scaled,
                following_error_rad=error.joint_error,
                following_joint=error.joint,
                trips=controller.trips,
                refusals=self._refusals,
                last_refusal=self._last_refusal,
                pose=six_of(self.commanded.pose) if controller.engaged else None,
                servo=self.servo.status(),
                authority=controller.authority.state(),
            )

    def desired(self) -> tuple[list[float], list[float], int] | None:
        """Return the present joint positions and velocities of a trajectory, and the index of its
        point; None if none is followed."""
        current = self.controller.motion
        if not isinstance(current, FollowJointTrajectory):
            return None
        positions, velocities = current.desired()
        return positions.tolist(), velocities.tolist(), current.point

    # -- ends of motions -------------------------------------------------------------------------

    def invalidate(self, reason: str) -> None:
        """End all motions under way or planned (called by the controller)."""
        self._voided = reason
        self._drop_pending(reason)
        self._end_stream(reason)
        self._end_motion(Outcome.ABORTED, reason)

    def finished(self, reason: str) -> None:
        """Take the end of the motion (called by the controller)."""
        self._end_motion(Outcome.ABORTED if reason else Outcome.DONE, reason)

    # -- requests --------------------------------------------------------------------------------

    def stat(self) -> Stat:
        """Measured TCP pose and joints, and the commanded TCP pose."""
        with self.controller.lock, self._counted():
            robot = self._require_joints("stat")
            pose = to_pose(self.plans.measuring.forward(np.array(robot.joints)))
            commanded, target = self.commanded, None
            if self.controller.engaged:
                target = six_of(commanded.pose)
            linear, angular, _frame = commanded.twist
            return Stat(
                six_of(pose),
                self.state,
                robot.stamp_s,
                robot.joints,
                target,
                (*linear, *angular),
                robot.link is RobotLink.LIVE,
            )

    def inv(self, xd: Target) -> tuple[float, ...]:
        """Return joint positions (rad, m) for the TCP at `xd`, on the branch nearest to the present
        ones. Raises OutOfReachError or JointLimitError."""
        with self.planning, self._counted():
            target = checked_pose("inv", xd)
            start = self._start("inv")
            target = self.plans.in_base(target, start)
            check_workspace("inv", target.position, self.options.streams.workspace_m)
            return tuple(self.planner.inverse("inv", target, start).tolist())

    def rehearse_line(self, xd: Target) -> Rehearsal:
        """Rehearse the straight line from here to the pose `xd` in the base, without moving: its
        obstacle, if any, and its duration."""
        verb = "rehearse_line"
        target = checked_pose(verb, xd)
        return self._rehearse(verb, lambda q: self.plans.line(target, q, False, verb))

    def rehearse_joints(self, q: Sequence[float]) -> Rehearsal:
        """The same for the straight motion of all joints to the positions `q`, rad or m."""
        verb = "rehearse_joints"
        goal = np.array(joint_numbers(verb, q, self.servo.joints))
        return self._rehearse(verb, lambda start: self.plans.joint_positions(verb, goal, start))

    def _rehearse(self, verb: str, prepare: _Prepare) -> Rehearsal:
        with self.planning:
            if self.commanded.moving:
                # From where it begins is not known, and the loop needs the time.
                return Rehearsal("the arm moves: this is checked when it rests", "", 0.0)
            try:
                plan = prepare(self._start(verb, claims=False))
            except MotionRefusedError as error:
                why = str(error).removeprefix(f"{verb}: ")
                return Rehearsal(why, "", 0.0)
        return Rehearsal("", plan.note, plan.duration_s)

    def movj(self, xd: Target, *, source: str = VERBS) -> Motion:
        """Move all joints to the pose `xd`, arriving together. Takes the quickest branch whose path
        is free of collisions; the path of the TCP is not specified."""
        with self._counted():
            target = checked_pose("movj", xd)
        return self._launch("movj", True, lambda q: self.plans.joints("movj", target, q), source)

    def relj(self, xd: Target, *, source: str = VERBS) -> Motion:
        """Move all joints to a pose relative to that of the TCP: in base axes (translate, R' =
        exp(dr)·R), or, if the frame is tcp, in its own (H·X)."""
        with self._counted():
            step = checked_pose("relj", xd)
        return self._launch("relj", True, lambda q: self.plans.relative(step, q), source)

    def movl(self, xd: Target | FramedPose, *, source: str = VERBS) -> Motion:
        """Move the TCP to the pose `xd` along a straight line, turning about one fixed axis."""
        framed = xd.frame if isinstance(xd, FramedPose) else None
        with self._counted():
            target = checked_pose("movl", xd.pose if isinstance(xd, FramedPose) else xd)

        def prepare(start: FloatArray) -> Plan:
            relative = self.plans.tcp_frame if framed is None else framed is Frame.TOOL
            return self.plans.line(target, start, relative)

        return self._launch("movl", True, prepare, source)

    def retract(self, distance_m: float, *, source: str = VERBS) -> Motion:
        """Move the TCP back by `distance_m` along the tool's own z axis, without turning."""
        with self._counted():
            back = Vector3(0.0, 0.0, -checked_distance("retract", distance_m))
        step = Pose(back, IDENTITY)
        return self._launch(
            "retract", True, lambda q: self.plans.line(step, q, True, "retract"), source
        )

    def trajectory(self, wanted: JointTrajectory, *, source: str = VERBS) -> Motion:
        """Follow joint positions over time that another program planned, such as MoveIt. The
        trajectory must begin at the arm's position, at rest, except for whole turns of continuous
        joints, which are added to all of it. It is slowed as a whole to the arm's limits; its whole
        path must be free, as in movj."""
        return self._launch("trajectory", True, lambda q: self.plans.trajectory(wanted, q), source)

    def movv(self, xdot: Sequence[float], *, source: str = VERBS) -> Motion:
        """Move the TCP with the constant twist `xdot` (m/s, rad/s) until something ends it."""
        with self._counted():
            x, y, z, rx, ry, rz = six_numbers("movv", xdot)
        linear, angular = Vector3(x, y, z), Vector3(rx, ry, rz)
        return self._launch("movv", False, lambda q: self.plans.twist(linear, angular, q), source)

    def gcmp(self, *, source: str = VERBS) -> Motion:
        """Hold the arm's own weight only: a person can lead it."""
        return self._launch(
            "gcmp", False, lambda q: self.plans.torque(State.GRAVITY, None, q), source
        )

    def forc(self, fd: Sequence[float], *, source: str = VERBS) -> Motion:
        """Exert the wrench `fd` (N, N·m; base axes, at the TCP) on the world."""
        with self._counted():
            numbers = six_numbers("forc", fd)
            if self.plans.tcp_frame:
                raise MotionRefusedError("forc: wrenches are taken in the base frame only")
            wrench = Wrench(Vector3(*numbers[:3]), Vector3(*numbers[3:]), Frame.BASE)
            with self.controller.lock:
                current, motion = self.controller.motion, self._motion
                if (
                    isinstance(current, TorqueMotion)
                    and current.state is State.FORCE
                    and motion is not None
                ):
                    self._require_authority("forc", source)
                    current.set_wrench(wrench)
                    return motion
        return self._launch(
            "forc", False, lambda q: self.plans.torque(State.FORCE, wrench, q), source
        )

    def stop(self, *, source: str = VERBS) -> None:
        """Brake along the path, then hold. Always works, also without a robot or authority."""
        with self.controller.lock:
            self.controller.stop("stopped", source)

    def tool(self, x: Target, *, source: str = VERBS) -> None:
        """Fix a link to the arm's own TCP: it replaces the one before, zeros remove it. All later
        poses, twists and wrenches refer to the new TCP."""
        with self.planning, self.controller.lock, self._counted():
            tool = checked_pose("tool", x)
            self._require_idle("tool")
            self._require_authority("tool", source)
            self._end_stream("the tool was changed")
            self.planner.set_tool(tool)
            for kinematics in (self.servo.kinematics, self.plans.measuring):
                assert isinstance(kinematics, ArmKinematics)
                kinematics.set_tool(tool)
            self.controller.drop()

    def act(self, code: Action | int | str, *, source: str = VERBS) -> None:
        """Command the gripper to close, open or stop; `source` needs the authority for it."""
        with self._counted():
            action = checked_action(code)
            if self._gripper is None:
                raise MotionRefusedError("act: this arm has no gripper")
            with self.controller.lock:
                refusal = self.controller.authority.take(source, self.controller.stamp_s)
            if refusal:
                raise MotionRefusedError(f"act: {refusal}")
            try:
                self._gripper(action)
            except CardanError as error:
                raise MotionRefusedError(f"act: {error}") from error

    def start_pending(self) -> Motion | None:
        """Plan and start the motion that waited for the arm to rest; None if there is none. Call it
        beside the loop, since it takes milliseconds, until the motion is no longer WAITING. Raises
        nothing: an impossible motion is REFUSED."""
        with self.planning:
            with self.controller.lock:
                if self._pending is None or not self.controller.idle:
                    return None
                motion, prepare = self._pending
                plan_epoch = self.controller.plan_epoch
            try:
                with self._counted():
                    plan = prepare(self._start(motion.verb, motion.source))
                    with self.controller.lock:
                        self._require_plan_epoch(motion.verb, plan_epoch, motion.source)
                        if self._pending is not None and self._pending[0] is motion:
                            self._pending = None
                            self._begin(motion, plan)
            except MotionRefusedError as error:
                with self.controller.lock:
                    if not motion.over:
                        motion.outcome, motion.reason = Outcome.REFUSED, str(error)
                        motion.error = error
                    if self._pending is not None and self._pending[0] is motion:
                        self._pending = None
            return motion

    def hand_over(self, to: str, *, source: str = VERBS) -> None:
        """Pass the authority over the arm from `source` to the source `to`, after a stop. Raises
        MotionRefusedError if `source` has none."""
        controller = self.controller
        checked_name("hand_over", to)
        with (
            controller.lock,
            self._counted(),
            controller.recorded_request("hand_over", argument_text(to, source)),
        ):
            refusal = controller.authority.hand_over(source, to, controller.stamp_s)
            if refusal:
                raise MotionRefusedError(f"hand_over: {refusal}")
            controller.stop(f"authority was handed over to {to!r}")

    def acquire(self, *, source: str = VERBS) -> None:
        """Take or renew the authority over the arm for `source`, without moving anything. Raises
        MotionRefusedError if another source has it."""
        controller = self.controller
        with (
            controller.lock,
            self._counted(),
            controller.recorded_request("acquire", argument_text(source)),
        ):
            refusal = controller.authority.take(source, controller.stamp_s)
            if refusal:
                raise MotionRefusedError(f"acquire: {refusal}")

    def release(self, source: str = VERBS) -> None:
        """Give up the authority of `source` before its lease ends; its motion, if any, is
        stopped."""
        controller = self.controller
        with controller.lock, controller.recorded_request("release", argument_text(source)):
            if controller.authority.owner == source and not controller.idle:
                controller.stop(f"{source!r} gave up its authority over the arm")
            controller.authority.release(source)

    def acknowledge(self) -> None:
        """Re-arm after implausible measured joints, or after a recovery that did not reach the
        robot: continue from the measured position. Raises MotionRefusedError while it is too early.
        """
        with self._counted():
            why = self.controller.acknowledge()
            if why:
                raise MotionRefusedError(f"acknowledge: {why}")

    # -- parameters ------------------------------------------------------------------------------

    def get_parameter(self, key: prm.Key) -> float:
        """A parameter by its code or name; codes as doubles. Raises ConfigurationError."""
        rule = prm.find_rule(key)
        if rule.key is Parameter.STREAM:
            return float(self.streams.kind)
        return self.parameters[rule.key]

    def get_parameters(self) -> dict[str, float]:
        """All parameters by name."""
        return {rule.name: self.get_parameter(rule.key) for rule in prm.RULES}

    def set_parameter(self, key: prm.Key, value: prm.Value, *, source: str = VERBS) -> None:
        """Set a parameter by its code or name. Refused while a motion is under way.

        Raises ConfigurationError for an invalid value, MotionRefusedError at a wrong moment.
        """
        self.set_parameters({key: value}, source=source)

    def set_parameters(self, values: Mapping[prm.Key, prm.Value], *, source: str = VERBS) -> None:
        """Set all of `values`, or none if one is refused."""
        with (
            self.planning,
            self.controller.lock,
            self._counted(),
            contextlib.ExitStack() as opened,
        ):
            found = prm.checked_group(values)
            argument = argument_text(list(found.items()), source)
            opened.enter_context(self.controller.recorded_request("set_parameters", argument))
            names = ", ".join(vocab_text(key) for key in found)
            self._require_idle(f"setting {names}")
            stream = found.pop(Parameter.STREAM, None)
            if stream is None:
                # It moves nothing: its sender does not block others from the arm afterwards.
                holds = self.controller.authority.owner == source
                self._require_authority(f"setting {names}", source, claims=holds)
            before = dict(self.parameters)
            self.parameters.update(found)
            try:
                if stream is not None:
                    self.streams.choose(
                        Stream(int(stream)),
                        lambda verb: self._start(verb, source, claims=False),
                        source,
                    )
            except MotionRefusedError:
                self.parameters.update(before)
                raise
            self.commanded.velocity_gain_1_s = prm.feedback_gain_1_s(
                self.parameters[Parameter.GAIN], self.parameters[Parameter.CONTROL_PERIOD]
            )
            self.servo.policy = _TO_POLICY[PolicyCode(int(self.parameters[Parameter.POLICY]))]

    # -- streams ---------------------------------------------------------------------------------

    def stream(
        self,
        verb: str,
        value: Sequence[float] | Target | FramedPose | Twist | Wrench,
        *,
        owner: str = "",
        sequence: int | None = None,
        stamp_s: float | None = None,
        begins: Begins | None = None,
    ) -> str:
        """Carry out the streamed command `verb` (one with a preset) now; return why not, or "".
        `owner` is the streaming source; `sequence` or `stamp_s` (sender's clock), if given, must
        grow. `begins`: whether the command may choose its own preset while nothing moves the arm
        and no streaming command, or one without its sender, is chosen; None: never."""
        sender = CommandHeader(owner, sequence, stamp_s, self.stamp_s)
        self.streams.hear(sender)
        began = False
        if begins is not None and self.may_choose(verb, begins, owner):
            try:
                began = self._begin_stream(verb, begins, owner or VERBS)
            except MotionRefusedError as error:
                return str(error)
        # Poses are checked by the inverse kinematics, which takes milliseconds.
        plans = self.planning if verb in ("pose", "jog") else contextlib.nullcontext()
        try:
            with plans, self._counted():
                getattr(self.streams, verb)(value, sender)
        except MotionRefusedError as error:
            if began:
                self.take_back(preset_of(verb), str(error))
            return str(error)
        return ""

    def may_choose(self, verb: str, begins: Begins, source: str) -> bool:
        """Return whether the streamed command `verb` may choose its preset: none is chosen, or, if
        its stream has just begun and the arm rests, the chosen one is its sender's own or its
        sender has no authority any more."""
        streams = self.streams
        if streams.kind is Stream.NONE:
            return True
        if begins is not Begins.NEW or streams.kind is preset_of(verb) or not streams.owner:
            return False
        if self.commanded.moving:
            return False
        return streams.owner == source or streams.owner != self.controller.authority.owner

    def goes_on(self, begins: Begins, source: str) -> bool:
        """Return whether the stream that fell silent last belongs to `source`, which continues
        it."""
        return begins is Begins.GOING_ON and self.streams.silenced == source

    def _begin_stream(self, verb: str, begins: Begins, source: str) -> bool:
        """Choose the preset of `verb`; return False if one was chosen meanwhile."""
        with self.planning, self.controller.lock:
            if not self.may_choose(verb, begins, source):
                return False
            why_not = "" if self.goes_on(begins, source) else begins.value
            refusal = why_not or self.controller.authority.refuses(source)
            if refusal:
                with self._counted():
                    raise MotionRefusedError(f"{verb}: {refusal}")
            self.set_parameters({Parameter.STREAM: preset_of(verb)}, source=source)
            return True

    def take_back(self, kind: Stream, reason: str) -> None:
        """Undo the choice of the preset `kind` by an invalid command."""
        argument = argument_text(kind, reason)
        with (
            self.planning,
            self.controller.lock,
            self.controller.recorded_request("take_back", argument),
        ):
            if self.streams.kind is kind and not self.streams.owner:
                self.streams.end(reason)
                self.controller.drop()

    # -- starting and ending ---------------------------------------------------------------------

    def _launch(self, verb: str, ends: bool, prepare: _Prepare, source: str) -> Motion:
        """Plan the motion and start it, or keep it until the arm is at rest."""
        with self.planning, self._counted():
            with self.controller.lock:
                start = self._start(verb, source)
                plan_epoch = self.controller.plan_epoch
            plan = prepare(start)
            with self.controller.lock:
                self._require_plan_epoch(verb, plan_epoch, source)
                motion = Motion(verb, ends, source)
                self._drop_pending(f"{verb} took over")
                if self.controller.idle:
                    self._begin(motion, plan)
                else:
                    # It was planned from where the arm was, to refuse early; it starts from where
                    # the arm comes to rest.
                    self._end_stream(f"{verb} took over")
                    self._end_motion(Outcome.ABORTED, f"{verb} took over")
                    self.controller.brake()
                    self._pending = motion, prepare
                    self._waited_for = motion
                return motion

    def _begin(self, motion: Motion, plan: Plan) -> None:
        self._waited_for = motion
        motion.duration_s, motion.note = plan.duration_s, plan.note
        if plan.motion is None:
            motion.outcome = Outcome.DONE
            return
        self._end_stream(f"{motion.verb} took over")
        self.controller.engage()
        self.controller.begin(plan.motion)
        motion.outcome = Outcome.RUNNING
        self._motion, self._message = motion, ""

    def _end_stream(self, reason: str) -> None:
        if self.streams.end(reason):
            self._message = reason

    def _end_motion(self, outcome: Outcome, reason: str) -> None:
        motion, self._motion = self._motion, None
        if motion is not None:
            motion.outcome, motion.reason = outcome, reason
            self._message = reason

    def _drop_pending(self, reason: str) -> None:
        if self._pending is not None:
            motion = self._pending[0]
            motion.outcome, motion.reason = Outcome.ABORTED, reason
            self._pending = None

    # -- conditions ------------------------------------------------------------------------------

    def _counted(self) -> _Counted:
        return _Counted(self)

    def _require_joints(self, verb: str) -> RobotState:
        robot = self.controller.robot
        if robot is None:
            raise MotionRefusedError(f"{verb}: no state of the robot was received yet")
        if len(robot.joints) != self.servo.joints:
            raise MotionRefusedError(
                f"{verb}: the robot reports {len(robot.joints)} joint positions, "
                f"{self.model.name} has {self.servo.joints} joints"
            )
        if not is_finite(robot.joints):
            raise MotionRefusedError(f"{verb}: the robot reports joints that are not numbers")
        return robot

    def _start(self, verb: str, source: str = VERBS, claims: bool = True) -> FloatArray:
        """Return the joint positions from which a motion would start: the commanded ones, or, if
        nothing is commanded, the measured ones. `claims`: `source` takes the authority."""
        with self.controller.lock:
            robot = self._require_joints(verb)
            if verb != "inv":
                why = robot.hold_reason or self.controller.not_ready
                if why or not robot.ready:
                    raise MotionRefusedError(f"{verb}: {why or 'the robot is not ready'}")
                if robot.alarm:
                    raise MotionRefusedError(f"{verb}: {robot.alarm}")
                if claims:
                    self._require_authority(verb, source)
                elif self.controller.inhibited:
                    raise MotionRefusedError(f"{verb}: {self.controller.inhibited}")
            if self.controller.engaged:
                commanded: FloatArray = self.servo.q.copy()
                return commanded
            if verb != "inv":
                self._check_measured(verb, robot)
            return np.array(robot.joints)

    def _check_measured(self, verb: str, robot: RobotState) -> None:
        """Check before the first command that the robot rests and agrees with its model."""
        misfit = self.commanded.obstacle(robot, True)
        if misfit:
            raise MotionRefusedError(f"{verb}: {misfit}")
        if robot.velocities:
            share = np.abs(robot.velocities) / self.servo.kinematics.velocity
            fastest = int(np.argmax(share))
            if share[fastest] > AT_REST_SHARE:
                raise MotionRefusedError(
                    f"{verb}: {self.servo.kinematics.names[fastest]} moves already, at "
                    f"{robot.velocities[fastest]:.3f} rad/s"
                )

    def _require_idle(self, verb: str) -> None:
        if self.state is not State.NOT_CONTROLLING:
            raise MotionRefusedError(f"{verb}: refused while in {vocab_text(self.state)}")
        if self._pending is not None or (
            not self.controller.idle and not isinstance(self.controller.motion, TorqueMotion)
        ):
            raise MotionRefusedError(f"{verb}: the arm is still moving")
        if isinstance(self.controller.motion, TorqueMotion):
            raise MotionRefusedError(f"{verb}: refused while torques are commanded; stop first")

    def _require_authority(self, verb: str, source: str, claims: bool = True) -> None:
        """Refuse a `source` that may not act; `claims`: it takes or renews the authority."""
        controller = self.controller
        authority = controller.authority
        refusal = controller.inhibited
        if not refusal and (claims or authority.refuses(source)):
            refusal = authority.take(source, controller.stamp_s)
        if refusal:
            raise MotionRefusedError(f"{verb}: {refusal}")

    def _require_plan_epoch(self, verb: str, plan_epoch: int, source: str) -> None:
        """Refuse a plan that became invalid while it was computed."""
        robot = self.controller.robot
        if plan_epoch != self.controller.plan_epoch or robot is None or not robot.ready:
            why = self.controller.not_ready or self._voided or "the robot is not ready"
            raise MotionRefusedError(f"superseded while it was planned: {why}")
        self._require_authority(verb, source)


class _Counted:
    """Counter of refusals."""

    def __init__(self, verbs: ArmVerbs) -> None:
        self._verbs = verbs

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, (MotionRefusedError, ConfigurationError)):
            self._verbs._refusals += 1
            self._verbs._last_refusal = str(error)


def _drive(wanted: CommandKind | None, capabilities: RobotCapabilities) -> CommandKind | None:
    if wanted is None:
        return next((kind for kind in PREFERRED if kind in capabilities.commands), None)
    if wanted not in PREFERRED or wanted not in capabilities.commands:
        raise ConfigurationError(
            "drive", f"{wanted.value}: the robot takes {kinds_in_words(capabilities)}"
        )
    return wanted


def narrowed(model: ArmModel, capabilities: RobotCapabilities) -> ArmModel:
    """Return the arm with its robot driver's limits if those are tighter."""
    n = len(model.joints)
    if capabilities.joints != n:
        raise ConfigurationError(
            "arm", f"{model.name} has {n} joints, the robot has {capabilities.joints}"
        )
    limits = capabilities.limits
    if limits is None:
        return model
    joints = tuple(
        joint._replace(
            lower=max(joint.lower, limits.lower[i]),
            upper=min(joint.upper, limits.upper[i]),
            velocity=min(joint.velocity, limits.velocity[i]),
            acceleration=min(joint.acceleration, limits.acceleration[i]),
        )
        for i, joint in enumerate(model.joints)
    )
    return model._replace(joints=joints)
