"""The Cartesian controller: verbs start motions, each tick moves them on by one period.

Control logic only; time comes in with the robot's states. Verbs and `tick` may be called from
different threads: what takes long (inverse kinematics, dry runs) is worked out beside the loop.
"""

from __future__ import annotations

import enum
import math
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from cardan.errors import CardanError, ConfigurationError, MotionRefusedError
from cardan.gateway.arm import parameters as prm
from cardan.gateway.arm.checks import (
    Six,
    Target,
    Workspace,
    check_workspace,
    checked_pose,
    six_numbers,
    six_of,
)
from cardan.gateway.arm.codes import (
    Action,
    FrameCode,
    Parameter,
    PolicyCode,
    ProfileCode,
    State,
    Stream,
    vocab,
    vocab_text,
)
from cardan.gateway.arm.motions import (
    Activity,
    Braking,
    Deceleration,
    FollowJoints,
    FollowLine,
    FollowPoseStream,
    FollowTwist,
    FollowTwistStream,
    Recover,
    TorqueLimits,
    TorqueMotion,
    shortest,
)
from cardan.gateway.arm.planner import Margins, Planner
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import FloatArray, to_pose
from cardan.gateway.kinematics.collision import CollisionModel, Obstacle
from cardan.gateway.motion.paths import JointPath, LinePath, PathLimits
from cardan.gateway.motion.reference import ReferenceLimits
from cardan.gateway.motion.shaping import PoseShaper, PoseShaperLimits
from cardan.gateway.servo.lag import ResponseLag
from cardan.gateway.servo.servo import (
    Policy,
    Servo,
    ServoOptions,
    ServoStatus,
    servo_steps,
)
from cardan.robots import ArmModel, BodyShape
from cardan.spatial import (
    add,
    compose,
    is_finite,
    limit_norm,
    multiply,
    norm,
    normalized,
    rotate,
    rotation_between,
    subtract,
)
from cardan.types import (
    NEVER_S,
    ZERO_TWIST,
    CommandKind,
    Frame,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
    Twist,
    Vector3,
    Wrench,
)

DRIVES = (CommandKind.JOINT, CommandKind.JOINT_VELOCITY, CommandKind.POSE)
"""Commands that a motion can be sent as, the best one first."""

ALREADY_THERE_RAD = 1e-6

RECOVERED_SHARE = 0.2
"""Of the following-error limit: a command that is brought back to the arm is near enough."""

MODEL_TOLERANCE_M = 5e-3
MODEL_TOLERANCE_RAD = 0.02
"""Most that a robot which is commanded by pose may differ from its model."""

CLOCK_SET_BACK_S = 1.0
"""A sender's stamp that is older by more than any network delays is from a clock that was set."""

AT_REST_SHARE = 0.02
"""Of each joint's speed: a robot that reports more moves by somebody else's will."""

_TO_POLICY = {PolicyCode.PATH: Policy.PATH, PolicyCode.REACH: Policy.REACH}


@dataclass(frozen=True, kw_only=True)
class ControllerOptions:
    """What a motion may do, beside the parameters that its users set."""

    drive: CommandKind | None = None
    """The command that motions are sent as; None: the best of those that the robot takes."""
    workspace_m: Workspace = (None, None, None)
    """Range of the TCP along each base axis; None: unbounded."""
    stream_speed_m_s: float = 0.25
    """Of streams and movv."""
    stream_acceleration_m_s2: float = 1.0
    stream_rotation_speed_rad_s: float = 1.0
    stream_rotation_acceleration_rad_s2: float = 4.0
    stream_jerk_m_s3: float = 20.0
    stream_rotation_jerk_rad_s3: float = 80.0
    stream_prediction_s: float = 0.0
    """For how long the reference of streamed poses goes on as the last ones went, at most; the
    period of the stream takes its delay away. 0: it only ever goes to the newest pose."""
    stream_step_m: float = 0.2
    """Farthest that a streamed pose may be from where the TCP is told to be."""
    stream_step_rad: float = 1.0
    stream_lease_s: float = 1.0
    """For which a silent owner keeps its stream."""
    stop_deceleration_m_s2: float = 1.0
    stop_deceleration_rad_s2: float = 4.0
    following_error_rad: float = 0.2
    """Between measured and commanded joints, rad (m for a prismatic one); more trips."""
    longest_step_s: float = 0.05
    """Longest time one tick may advance."""
    stall_s: float = 0.5
    """Longest time between two states; after more, nothing goes on."""
    force_n: float = 100.0
    """Most that a wrench may exert."""
    torque_nm: float = 20.0
    force_slew_n_s: float = 500.0
    torque_slew_nm_s: float = 100.0
    torque_speed_share: float = 0.5
    """Of each joint's speed: faster, a torque motion runs away and is stopped."""
    margins: Margins = field(default_factory=Margins)
    servo: ServoOptions = field(default_factory=ServoOptions)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == "stream_prediction_s" and value == 0.0:
                continue
            if isinstance(value, float) and not 0.0 < value < math.inf:
                raise ConfigurationError(name, f"must be a number > 0, not {value}")
        for axis, bounds in zip("xyz", self.workspace_m, strict=True):
            if bounds is not None and not bounds[0] < bounds[1]:
                raise ConfigurationError(
                    "workspace_m", f"{axis} goes from low to high, not {bounds}"
                )


class Outcome(enum.Enum):
    """How a motion stands."""

    WAITING = "waiting"
    """Accepted; what moved before is still coming to rest."""
    RUNNING = "running"
    DONE = "done"
    REFUSED = "refused"
    """Impossible from where the motion before it came to rest."""
    ABORTED = "aborted"


class Motion:
    """What a verb started."""

    def __init__(self, verb: str, ends: bool) -> None:
        self.verb = verb
        self.ends = ends
        """True for movj, relj and movl, which `wait` waits for."""
        self.outcome = Outcome.WAITING
        self.reason = ""
        """Why it was aborted or refused."""
        self.note = ""
        """What was changed of what was asked for, in words; empty when nothing was."""
        self.duration_s = math.inf
        """As planned; infinite for a motion without end."""
        self.error: MotionRefusedError | None = None

    @property
    def over(self) -> bool:
        """True when nothing more will come of it."""
        return self.outcome not in (Outcome.WAITING, Outcome.RUNNING)

    def __repr__(self) -> str:
        return f"Motion({self.verb}, {self.outcome.value}{f': {self.reason}' * bool(self.reason)})"


class Stat(NamedTuple):
    """Where the TCP is."""

    pose: Six
    """Measured, in the base: m, rotation vector in rad."""
    state: State
    stamp_s: float
    """Local monotonic time of the measurement."""


class ControllerStatus(NamedTuple):
    """The controller's flags and numbers."""

    state: State
    stream: Stream
    """The streaming command that is chosen."""
    ready: bool
    """True when the robot would act on a command."""
    moving: bool
    braking: bool
    torque: bool
    recovering: bool
    """After a trip, until the command is back at the arm."""
    message: str
    """What last ended a motion or a stream, in words."""
    stream_owner: str
    stream_age_s: float
    """Since the newest streamed command; infinite before the first."""
    stream_late: int
    """Streamed commands that came late or twice."""
    stream_scaled: int
    """Streamed twists that were faster than allowed and were slowed, direction kept."""
    following_error_rad: float
    following_joint: str
    trips: int
    refusals: int
    last_refusal: str
    pose: Six | None
    """Where the TCP is told to be; None before anything was commanded."""
    servo: ServoStatus


class _Plan(NamedTuple):
    """A motion that was worked out. No activity: the arm is there already."""

    activity: Activity | TorqueMotion | None
    duration_s: float
    note: str = ""


_Prepare = Callable[[FloatArray], _Plan]


class _StreamLink:
    """Who streams, and how far it has come."""

    def __init__(self, kind: Stream) -> None:
        self.kind = kind
        self.owner: str | None = None
        self.heard_s = NEVER_S
        self.sequence: int | None = None
        self.sent_s = NEVER_S


class CartesianController:
    """The verbs of the Cartesian interface for one arm on one robot driver.

    Positions in m, angles in rad; `frame` (parameter cpf) means the same in every verb: base, or
    relative to the TCP. A verb that is refused raises MotionRefusedError and changes nothing; a
    streamed command answers with the reason, "" when it was taken.
    """

    def __init__(
        self,
        model: ArmModel,
        capabilities: RobotCapabilities,
        options: ControllerOptions | None = None,
        *,
        obstacles: Iterable[Obstacle] = (),
        tool_shapes: Iterable[BodyShape] = (),
        gripper: Callable[[Action], None] | None = None,
    ) -> None:
        """`gripper` passes an action on; without it `act` is refused.

        Raises ConfigurationError where arm and robot do not fit together.
        """
        self.options = options = options or ControllerOptions()
        self.model = model = _narrowed(model, capabilities)
        self.capabilities = capabilities
        self._drive = _drive(options.drive, capabilities)
        obstacles, tool_shapes = tuple(obstacles), tuple(tool_shapes)
        self.planner = Planner(
            model,
            obstacles=obstacles,
            tool_shapes=tool_shapes,
            workspace=options.workspace_m,
            margins=options.margins,
        )
        kinematics = ArmKinematics(model)
        self.servo = Servo(
            kinematics,
            CollisionModel(kinematics, obstacles, tool_shapes),
            options.servo,
            model.task.weights,
        )
        if len(model.joints) > 6:
            self.servo.posture = np.array(model.home)
        self._lag = ResponseLag(capabilities.lag_s, kinematics.continuous)
        self._measuring = ArmKinematics(model)
        self._bare = ArmKinematics(model)
        """Without a tool: what the robot's own controller knows."""
        self._gripper = gripper
        self._lock = threading.RLock()
        """Guards everything that `tick` touches; never held for long."""
        self._planning = threading.RLock()
        """Held by whoever uses `planner`; always taken before `_lock`."""
        self._parameters = prm.defaults()
        self._deceleration = Deceleration(
            options.stop_deceleration_m_s2, options.stop_deceleration_rad_s2, 0.5
        )
        self._robot: RobotState | None = None
        self._engaged = False
        self._generation = 0
        """Counts what makes a plan void: loss of the robot, trips."""
        self._activity: Activity | TorqueMotion | None = None
        self._braking = False
        self._motion: Motion | None = None
        self._waited_for: Motion | None = None
        self._pending: tuple[Motion, _Prepare] | None = None
        self._stream: _StreamLink | None = None
        self._stream_ended = ""
        self._message = ""
        self._following = (0.0, "")
        self._measured = np.zeros(kinematics.joints)
        self._speeds = np.zeros(kinematics.joints)
        self._velocity_sent = np.zeros(kinematics.joints)
        self._rest = np.zeros(kinematics.joints)
        self._trips = self._refusals = self._late = self._scaled = 0
        self._last_refusal = ""

    # -- what it is doing ------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """What is being done; NOT_CONTROLLING as soon as it is told to stop."""
        activity = self._activity
        return State.NOT_CONTROLLING if activity is None or self._braking else activity.state

    @property
    def at_rest(self) -> bool:
        """True when nothing moves by command and nothing is about to."""
        with self._lock:
            return self._idle and self._pending is None

    @property
    def _idle(self) -> bool:
        activity = self._activity
        if activity is None:
            return not self.servo.moving
        return (
            isinstance(activity, (FollowTwistStream, FollowPoseStream))
            and not activity.driven
            and not activity.reference.moving
            and not self.servo.moving
        )

    @property
    def waited_for(self) -> Motion | None:
        """The motion that `wait` is about: the newest, if it is one that ends by itself."""
        return self._waited_for

    @property
    def stamp_s(self) -> float:
        """Time of the newest robot state, s; NEVER_S before the first."""
        return NEVER_S if self._robot is None else self._robot.stamp_s

    def status(self) -> ControllerStatus:
        """Flags and numbers of now."""
        with self._lock:
            robot, stream = self._robot, self._stream
            heard_s = NEVER_S if stream is None else stream.heard_s
            return ControllerStatus(
                state=self.state,
                stream=Stream.NONE if stream is None else stream.kind,
                ready=robot is not None and robot.ready,
                moving=self.servo.moving,
                braking=self._braking,
                torque=isinstance(self._activity, TorqueMotion),
                recovering=isinstance(self._activity, Recover),
                message=self._message,
                stream_owner="" if stream is None or stream.owner is None else stream.owner,
                stream_age_s=math.inf if robot is None else robot.stamp_s - heard_s,
                stream_late=self._late,
                stream_scaled=self._scaled,
                following_error_rad=self._following[0],
                following_joint=self._following[1],
                trips=self._trips,
                refusals=self._refusals,
                last_refusal=self._last_refusal,
                pose=six_of(to_pose(self.servo.placement)) if self._engaged else None,
                servo=self.servo.status(),
            )

    # -- requests --------------------------------------------------------------------------------

    def stat(self) -> Stat:
        """Measured pose of the TCP in the base, state and time of the measurement."""
        with self._lock, self._counted():
            robot = self._require_joints("stat")
            pose = to_pose(self._measuring.forward(np.array(robot.joints)))
            return Stat(six_of(pose), self.state, robot.stamp_s)

    def inv(self, xd: Target) -> tuple[float, ...]:
        """Joint positions (rad, m) that put the TCP at `xd`, on the branch nearest to now.

        Raises OutOfReachError or JointLimitError.
        """
        with self._planning, self._counted():
            target = checked_pose("inv", xd)
            start = self._start("inv")
            target = self._in_base(target, start)
            check_workspace("inv", target.position, self.options.workspace_m)
            return tuple(self.planner.inverse("inv", target, start).tolist())

    def movj(self, xd: Target) -> Motion:
        """Move all joints to the pose `xd`, arriving together; the way of the TCP is free.

        The quickest branch whose whole way is free of collisions is taken.
        """
        with self._counted():
            target = checked_pose("movj", xd)
        return self._launch("movj", True, lambda q: self._plan_joints("movj", target, q))

    def relj(self, xd: Target) -> Motion:
        """The same, relative to where the TCP is: in base axes (translate, R' = exp(dr)·R), or,
        where the frame is tcp, in its own (H·X)."""
        with self._counted():
            step = checked_pose("relj", xd)
        return self._launch("relj", True, lambda q: self._plan_relative(step, q))

    def movl(self, xd: Target) -> Motion:
        """Move the TCP to the pose `xd` along a straight line, turning about one fixed axis."""
        with self._counted():
            target = checked_pose("movl", xd)
        return self._launch("movl", True, lambda q: self._plan_line(target, q))

    def movv(self, xdot: Sequence[float]) -> Motion:
        """Move the TCP with the constant twist `xdot` (m/s, rad/s) until something ends it."""
        with self._counted():
            x, y, z, rx, ry, rz = six_numbers("movv", xdot)
        linear, angular = Vector3(x, y, z), Vector3(rx, ry, rz)
        return self._launch("movv", False, lambda q: self._plan_twist(linear, angular, q))

    def gcmp(self) -> Motion:
        """Carry the arm's own weight and nothing more: it can be led by hand."""
        return self._launch("gcmp", False, lambda q: self._plan_torque(State.GRAVITY, None, q))

    def forc(self, fd: Sequence[float]) -> Motion:
        """Exert the wrench `fd` (N, N·m; base axes, at the TCP) on the world."""
        with self._counted():
            numbers = six_numbers("forc", fd)
            if self._tcp_frame:
                raise MotionRefusedError("forc: wrenches are taken in the base frame only")
            wrench = Wrench(Vector3(*numbers[:3]), Vector3(*numbers[3:]), Frame.BASE)
            with self._lock:
                activity = self._activity
                if isinstance(activity, TorqueMotion) and activity.state is State.FORCE:
                    activity.set_wrench(wrench)
                    assert self._motion is not None
                    return self._motion
        return self._launch("forc", False, lambda q: self._plan_torque(State.FORCE, wrench, q))

    def stop(self) -> None:
        """Brake along the path, then hold. Always works, also without a robot."""
        with self._lock:
            self._drop_pending("stopped")
            self._end_stream("stopped")
            self._end_motion(Outcome.ABORTED, "stopped")
            self._brake()

    def motion_done(self, motion: Motion) -> bool:
        """True when `motion` is over, however it ended."""
        return motion.over

    def tool(self, x: Target) -> None:
        """Fix a link to the arm's own TCP: it replaces the one before, zeros take it off.

        All later poses, twists and wrenches refer to the new TCP.
        """
        with self._planning, self._lock, self._counted():
            tool = checked_pose("tool", x)
            self._require_idle("tool")
            self._end_stream("the tool was changed")
            self._activity = None
            self.planner.set_tool(tool)
            for kinematics in (self.servo.kinematics, self._measuring):
                assert isinstance(kinematics, ArmKinematics)
                kinematics.set_tool(tool)

    def act(self, code: Action | int | str) -> None:
        """Tell the gripper to close, open or stop."""
        with self._counted():
            try:
                action = Action(vocab(code) if isinstance(code, str) else code)
            except ValueError:
                action = Action.NONE
            if action not in (Action.CLOSE, Action.OPEN, Action.STOP):
                allowed = "accg (close), acog (open), acsg (stop)"
                raise MotionRefusedError(f"act: allowed are {allowed}, not {code!r}")
            if self._gripper is None:
                raise MotionRefusedError("act: this arm has no gripper")
            try:
                self._gripper(action)
            except CardanError as error:
                raise MotionRefusedError(f"act: {error}") from error

    def start_pending(self) -> Motion | None:
        """Work out and start the motion that waited for the arm to rest; None if there is none.

        To be called beside the loop until the motion is no longer WAITING, because it takes
        milliseconds. Raises nothing: a motion that turns out impossible is REFUSED.
        """
        with self._planning:
            with self._lock:
                if self._pending is None or not self._idle:
                    return None
                motion, prepare = self._pending
                generation = self._generation
            try:
                with self._counted():
                    plan = prepare(self._start(motion.verb))
                    with self._lock:
                        self._require_generation(generation)
                        if self._pending is not None and self._pending[0] is motion:
                            self._pending = None
                            self._begin(motion, plan)
            except MotionRefusedError as error:
                with self._lock:
                    if not motion.over:
                        motion.outcome, motion.reason = Outcome.REFUSED, str(error)
                        motion.error = error
                    if self._pending is not None and self._pending[0] is motion:
                        self._pending = None
            return motion

    # -- parameters ------------------------------------------------------------------------------

    def get_parameter(self, key: prm.Key) -> float:
        """A parameter by its code or name; codes as doubles. Raises ConfigurationError."""
        rule = prm.find_rule(key)
        if rule.key is Parameter.STREAM:
            stream = self._stream
            return float(Stream.NONE if stream is None else stream.kind)
        return self._parameters[rule.key]

    def get_parameters(self) -> dict[str, float]:
        """All parameters by name."""
        return {rule.name: self.get_parameter(rule.key) for rule in prm.RULES}

    def set_parameter(self, key: prm.Key, value: prm.Value) -> None:
        """Set a parameter by its code or name. Refused while a motion is under way.

        Raises ConfigurationError for what is not accepted, MotionRefusedError for the moment.
        """
        self.set_parameters({key: value})

    def set_parameters(self, values: Mapping[prm.Key, prm.Value]) -> None:
        """Set all of `values`, or, where one of them is refused, none."""
        with self._planning, self._lock, self._counted():
            found = prm.checked_group(values)
            names = ", ".join(vocab_text(key) for key in found)
            self._require_idle(f"setting {names}")
            stream = found.pop(Parameter.STREAM, None)
            before = dict(self._parameters)
            self._parameters.update(found)
            try:
                if stream is not None:
                    self._choose_stream(Stream(int(stream)))
            except MotionRefusedError:
                self._parameters = before
                raise
            self.servo.policy = _TO_POLICY[PolicyCode(int(self._parameters[Parameter.POLICY]))]

    def _choose_stream(self, kind: Stream) -> None:
        verb = f"streaming {vocab_text(kind)}"
        options = self.options
        if kind is Stream.NONE:
            self._end_stream("no streaming command is chosen")
            self._activity = None
            return
        if kind is Stream.WRENCH:
            self._require_torque(verb)
        else:
            self._require_drive(verb)
        start = self._start(verb)
        activity: Activity | TorqueMotion
        if kind is Stream.WRENCH:
            activity = self._torque_motion(State.NOT_CONTROLLING)
            activity.check_weight(start)
            self._engage()
        else:
            self._engage()
            limits = self._reference_limits(
                options.stream_acceleration_m_s2, options.stream_rotation_acceleration_rad_s2
            )
            if kind is Stream.POSE:
                activity = FollowPoseStream(
                    self.servo,
                    limits,
                    self._deceleration,
                    self._pose_shaper(limits),
                    options.stream_prediction_s,
                )
            else:
                activity = FollowTwistStream(self.servo, limits, self._deceleration)
        self._activity, self._braking = activity, False
        self._stream, self._stream_ended = _StreamLink(kind), ""

    # -- streams ---------------------------------------------------------------------------------

    def pose(
        self,
        x: Target,
        *,
        owner: str = "",
        sequence: int | None = None,
        stamp_s: float | None = None,
    ) -> str:
        """Go to the pose `x` now. Answers why not, or "".

        `owner` names who streams; `sequence` or `stamp_s` (sender's clock), where given, have to
        grow.
        """

        def of(given: Pose, now: Pose, _before: Pose) -> Pose:
            return compose(now, given) if self._tcp_frame else given

        return self._send_pose("pose", x, of, owner, sequence, stamp_s)

    def jog(
        self,
        dx: Target,
        *,
        owner: str = "",
        sequence: int | None = None,
        stamp_s: float | None = None,
    ) -> str:
        """Move the pose that is gone to by `dx` (m, rotation vector in rad); see `pose`.

        Relative jogging: the deltas of a stream add up, so none is lost, however they are
        bunched. In base axes p + d and exp(dr)·R, with the TCP frame H·X. Needs the stream
        command `pose`, follows the parameter poseDamping, and is refused where the sum would run
        away from the arm.
        """

        def of(given: Pose, _now: Pose, before: Pose) -> Pose:
            if self._tcp_frame:
                return compose(before, given)
            return Pose(
                add(before.position, given.position),
                normalized(multiply(given.orientation, before.orientation)),
                Frame.BASE,
            )

        return self._send_pose("jog", dx, of, owner, sequence, stamp_s)

    def _send_pose(
        self,
        verb: str,
        given: Target,
        of: Callable[[Pose, Pose, Pose], Pose],
        owner: str,
        sequence: int | None,
        stamp_s: float | None,
    ) -> str:
        """Aim the pose stream at `of` what is given, the commanded pose and the target before."""
        try:
            with self._planning, self._counted():
                pose = checked_pose(verb, given)
                with self._lock:
                    activity = self._streaming(Stream.POSE, owner, sequence, stamp_s)
                    assert isinstance(activity, FollowPoseStream)
                    start = self.servo.q.copy()
                    now = to_pose(self.servo.placement)
                    target = of(pose, now, activity.target or now)
                check_workspace(verb, target.position, self.options.workspace_m)
                self._check_step(now, target)
                self.planner.inverse_nearby(verb, target, start)
                with self._lock:
                    if self._activity is not activity or self._stream is None:
                        raise MotionRefusedError(f"{verb}: {self._stream_ended}")
                    activity.aim(target, self.stamp_s)
                    self._hear(self._stream, owner, sequence, stamp_s)
        except MotionRefusedError as error:
            return str(error)
        return ""

    def _check_step(self, now: Pose, target: Pose) -> None:
        step_m = norm(subtract(target.position, now.position))
        step_rad = norm(rotation_between(now.orientation, target.orientation))
        if step_m > self.options.stream_step_m or step_rad > self.options.stream_step_rad:
            raise MotionRefusedError(
                f"pose: a step of {step_m:.3f} m and {step_rad:.3f} rad; allowed: "
                f"{self.options.stream_step_m:.3f} m and {self.options.stream_step_rad:.3f} rad"
            )

    def twist(
        self,
        xdot: Sequence[float],
        *,
        owner: str = "",
        sequence: int | None = None,
        stamp_s: float | None = None,
    ) -> str:
        """Move with the twist `xdot` (m/s, rad/s) now; see `pose`. Too fast a one is slowed."""
        try:
            with self._lock, self._counted():
                x, y, z, rx, ry, rz = six_numbers("twist", xdot)
                activity = self._streaming(Stream.TWIST, owner, sequence, stamp_s)
                assert isinstance(activity, FollowTwistStream)
                linear, angular, share = self._slowed(Vector3(x, y, z), Vector3(rx, ry, rz))
                self._scaled += share < 1.0
                frame = Frame.TOOL if self._tcp_frame else Frame.BASE
                asked = any((*linear, *angular))
                activity.target = Twist(linear, angular, frame) if asked else ZERO_TWIST
                assert self._stream is not None
                self._hear(self._stream, owner, sequence, stamp_s)
        except MotionRefusedError as error:
            return str(error)
        return ""

    def wrench(
        self,
        w: Sequence[float],
        *,
        owner: str = "",
        sequence: int | None = None,
        stamp_s: float | None = None,
    ) -> str:
        """Exert the wrench `w` (N, N·m, at the TCP) on the world now; see `pose`."""
        try:
            with self._lock, self._counted():
                numbers = six_numbers("wrench", w)
                activity = self._streaming(Stream.WRENCH, owner, sequence, stamp_s)
                assert isinstance(activity, TorqueMotion)
                frame = Frame.TOOL if self._tcp_frame else Frame.BASE
                activity.set_wrench(Wrench(Vector3(*numbers[:3]), Vector3(*numbers[3:]), frame))
                assert self._stream is not None
                self._hear(self._stream, owner, sequence, stamp_s)
        except MotionRefusedError as error:
            return str(error)
        return ""

    def _streaming(
        self, kind: Stream, owner: str, sequence: int | None, stamp_s: float | None
    ) -> Activity | TorqueMotion:
        """The activity of the stream, if this command may act on it."""
        name, stream = vocab_text(kind), self._stream
        if stream is None:
            why = f": {self._stream_ended}" if self._stream_ended else ""
            raise MotionRefusedError(
                f"{name}: choose this streaming command first (parameter cpsc){why}"
            )
        if stream.kind is not kind:
            raise MotionRefusedError(f"{name}: the streaming command is {vocab_text(stream.kind)}")
        if sequence is not None and (isinstance(sequence, bool) or not isinstance(sequence, int)):
            raise MotionRefusedError(f"{name}: the sequence number {sequence!r} is not an integer")
        if stamp_s is not None and not (
            isinstance(stamp_s, (int, float)) and math.isfinite(stamp_s)
        ):
            raise MotionRefusedError(f"{name}: the stamp {stamp_s!r} is not a time in seconds")
        leased = self.stamp_s - stream.heard_s < self.options.stream_lease_s
        if stream.owner is not None and stream.owner != owner:
            if leased or self._driven:
                raise MotionRefusedError(f"{name}: {stream.owner!r} owns the stream")
        elif (sequence is not None and stream.sequence is not None) and (
            sequence <= stream.sequence
        ):
            self._late += 1
            raise MotionRefusedError(
                f"{name}: number {sequence} came after number {stream.sequence}"
            )
        elif stamp_s is not None and 0.0 <= stream.sent_s - stamp_s < CLOCK_SET_BACK_S:
            self._late += 1
            raise MotionRefusedError(
                f"{name}: sent at {stamp_s:.6f} s, after one of {stream.sent_s:.6f} s"
            )
        activity = self._activity
        assert activity is not None
        return activity

    def _hear(
        self, stream: _StreamLink, owner: str, sequence: int | None, stamp_s: float | None
    ) -> None:
        if stream.owner != owner:
            stream.owner, stream.sequence, stream.sent_s = owner, None, NEVER_S
        stream.heard_s = self.stamp_s
        stream.sequence = stream.sequence if sequence is None else sequence
        stream.sent_s = stream.sent_s if stamp_s is None else stamp_s

    @property
    def _driven(self) -> bool:
        """True while the silence of the stream would let something go on."""
        activity = self._activity
        return (
            isinstance(activity, (FollowTwistStream, FollowPoseStream, TorqueMotion))
            and activity.driven
        )

    def _watch_stream(self, now_s: float) -> None:
        stream = self._stream
        if stream is None or not self._driven:
            return
        age_s = now_s - stream.heard_s
        if age_s <= self._parameters[Parameter.STREAM_TIMEOUT]:
            return
        activity = self._activity
        self._end_stream(f"the stream was silent for {age_s:.3f} s")
        if isinstance(activity, TorqueMotion):
            activity.release()
        else:
            self._brake()

    def _end_stream(self, reason: str) -> None:
        if self._stream is not None:
            self._stream = None
            self._stream_ended = self._message = reason

    # -- the loop --------------------------------------------------------------------------------

    def tick(self, state: RobotState) -> RobotCommand:
        """The command for the control instant that `state` reports."""
        with self._lock:
            before, self._robot = self._robot, state
            if not self._usable(state, before):
                return HoldCommand()
            self._measure(state)
            if not self._engaged:
                return HoldCommand()
            if state.alarm and (self._activity is not None or self._pending is not None):
                self._abort(state.alarm)
                self._brake()
            dt_s = min(state.period_s, self.options.longest_step_s)
            self._watch_stream(state.stamp_s)
            activity = self._activity
            if isinstance(activity, TorqueMotion):
                reason = activity.runaway(self._measured, self._speeds)
                if not reason:
                    if dt_s > 0.0:
                        self.servo.place(self._measured)
                    return activity.tick(self._measured, max(dt_s, 0.0))
                self._abort(reason)
                self._trips += 1
                self._brake()
            self._supervise()
            for step_s in servo_steps(dt_s):
                self._move(step_s)
            return self._command(dt_s)

    def _usable(self, state: RobotState, before: RobotState | None) -> bool:
        """True when the robot would act on a command; ends everything when it would not."""
        n = self.servo.joints
        reason = ""
        if not state.ready:
            reason = state.hold_reason or f"the robot is {state.link.value}"
            if state.link is RobotLink.LOST:
                reason = "the robot fell silent"
        elif len(state.joints) != n or not all(map(math.isfinite, state.joints)):
            reason = f"the robot reports {len(state.joints)} joint positions of {n}, or no numbers"
        elif before is not None and state.session != before.session:
            self._disengage("the robot's controller started a new session")
        elif before is not None and state.stamp_s - before.stamp_s > self.options.stall_s:
            stalled_s = state.stamp_s - before.stamp_s
            self._disengage(f"this computer stalled for {stalled_s:.2f} s")
        if reason:
            self._disengage(reason)
        return not reason

    def _disengage(self, reason: str) -> None:
        """Forget all motion: where the robot is when it comes back is not known."""
        self._generation += 1
        if self._engaged:
            self._abort(reason)
            self._engaged = False
        elif self._pending is not None:
            self._drop_pending(reason)
        self._activity, self._braking = None, False
        self.servo.v[:] = 0.0

    def _measure(self, state: RobotState) -> None:
        joints = np.array(state.joints)
        if len(state.velocities) == len(joints) and is_finite(state.velocities):
            self._speeds = np.array(state.velocities)
        elif state.period_s > 0.0 and self._engaged:
            self._speeds = (joints - self._measured) / state.period_s
        self._measured = joints

    def _supervise(self) -> None:
        measured = self._lag.expected(self._measured, self.servo.q)
        error = np.abs(shortest(self.servo.kinematics, measured - self.servo.q))
        worst = int(np.argmax(error))
        self._following = float(error[worst]), self.servo.kinematics.names[worst]
        activity = self._activity
        if isinstance(activity, Recover):
            activity.measured = self._measured
            return
        if error[worst] <= self.options.following_error_rad:
            return
        self._abort(
            f"{self._following[1]} is {error[worst]:.3f} rad away from where it was told to be; "
            f"allowed: {self.options.following_error_rad:.3f} rad"
        )
        self._trips += 1
        self._generation += 1
        self._activity = Recover(self.servo, RECOVERED_SHARE * self.options.following_error_rad)
        self._braking = False

    def _move(self, dt_s: float) -> None:
        activity = self._activity
        if activity is None:
            if self.servo.moving:
                self.servo.brake(dt_s)
            return
        assert not isinstance(activity, TorqueMotion)
        over, reason = activity.tick(dt_s)
        if over and reason and isinstance(activity, Recover):
            self._disengage(reason)
        elif over:
            self._activity, self._braking = None, False
            if reason:
                self._end_motion(Outcome.ABORTED, reason)
            else:
                self._end_motion(Outcome.DONE, "")

    def _command(self, dt_s: float) -> RobotCommand:
        servo = self.servo
        self._lag.note(servo.q, self.stamp_s)
        if self._drive is CommandKind.JOINT:
            # Joints that go to where the arm is do not take it along.
            v = self._rest if isinstance(self._activity, Recover) else servo.v
            return JointCommand(tuple(servo.q.tolist()), tuple(v.tolist()))
        if self._drive is CommandKind.JOINT_VELOCITY:
            return self._velocity_command(dt_s)
        bare = self._bare
        bare.update(servo.q)
        placement = bare.placement
        rotation = placement.rotation
        twist = bare.jacobian.dot(servo.v)
        linear, angular = rotation.dot(twist[:3]), rotation.dot(twist[3:])
        return PoseCommand(
            to_pose(placement),
            Twist(Vector3(*linear.tolist()), Vector3(*angular.tolist()), Frame.BASE),
        )

    def _velocity_command(self, dt_s: float) -> RobotCommand:
        """The velocity, and what brings back an arm that sags: the error times the gain."""
        servo, sent = self.servo, self._velocity_sent
        parameters = self._parameters
        gain = prm.feedback_gain_1_s(
            parameters[Parameter.GAIN], parameters[Parameter.CONTROL_PERIOD]
        )
        bounds = servo.kinematics
        wanted = servo.v + gain * (servo.q - self._measured)
        change = bounds.acceleration * dt_s
        wanted = np.clip(wanted, sent - change, sent + change)
        np.clip(wanted, -bounds.velocity, bounds.velocity, out=sent)
        return JointVelocityCommand(tuple(sent.tolist()))

    # -- starting and ending ---------------------------------------------------------------------

    def _launch(self, verb: str, ends: bool, prepare: _Prepare) -> Motion:
        """Work the motion out and start it, or have it wait until the arm is at rest."""
        with self._planning, self._counted():
            with self._lock:
                start = self._start(verb)
                generation = self._generation
            plan = prepare(start)
            with self._lock:
                self._require_generation(generation)
                motion = Motion(verb, ends)
                self._drop_pending(f"{verb} took over")
                if self._idle:
                    self._begin(motion, plan)
                else:
                    # It was worked out from where the arm was, to refuse early what is wrong;
                    # it starts from where the arm comes to rest.
                    self._end_stream(f"{verb} took over")
                    self._end_motion(Outcome.ABORTED, f"{verb} took over")
                    self._brake()
                    self._pending = motion, prepare
                    self._waited_for = motion
                return motion

    def _begin(self, motion: Motion, plan: _Plan) -> None:
        self._waited_for = motion
        motion.duration_s, motion.note = plan.duration_s, plan.note
        if plan.activity is None:
            motion.outcome = Outcome.DONE
            return
        self._end_stream(f"{motion.verb} took over")
        self._engage()
        self._activity, self._braking = plan.activity, False
        motion.outcome = Outcome.RUNNING
        self._motion, self._message = motion, ""

    def _engage(self) -> None:
        """Command the robot from now on; from where it is, if nobody did before."""
        if not self._engaged:
            self.servo.place(self._measured)
            self._lag.reset()
            self._velocity_sent[:] = 0.0
            self._engaged = True

    def _brake(self) -> None:
        activity = self._activity
        if activity is None or self._braking:
            return
        if isinstance(activity, TorqueMotion):
            # Position first, at the measured speed, so that the arm neither drops nor jerks.
            self.servo.place(self._measured)
            fastest = self.servo.kinematics.velocity
            self.servo.v[:] = np.clip(self._speeds, -fastest, fastest)
            self._velocity_sent[:] = self.servo.v
            self._activity = Braking(self.servo)
        elif isinstance(activity, Recover):
            return
        else:
            activity.brake()
        self._braking = True

    def _abort(self, reason: str) -> None:
        self._message = reason
        self._drop_pending(reason)
        self._end_stream(reason)
        self._end_motion(Outcome.ABORTED, reason)

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

    # -- what motions are made of ----------------------------------------------------------------

    @property
    def _tcp_frame(self) -> bool:
        return self._parameters[Parameter.FRAME] == FrameCode.TCP

    def _in_base(self, target: Pose, start: FloatArray) -> Pose:
        if not self._tcp_frame:
            return target
        return compose(to_pose(self.planner.forward(start)), target)

    def _plan_joints(self, verb: str, target: Pose, start: FloatArray) -> _Plan:
        target = self._in_base(target, start)
        return self._plan_joints_to(verb, target, start)

    def _plan_relative(self, step: Pose, start: FloatArray) -> _Plan:
        now = to_pose(self.planner.forward(start))
        if self._tcp_frame:
            target = compose(now, step)
        else:
            target = Pose(
                Vector3(*(a + b for a, b in zip(now.position, step.position, strict=True))),
                normalized(multiply(step.orientation, now.orientation)),
            )
        return self._plan_joints_to("relj", target, start)

    def _plan_joints_to(self, verb: str, target: Pose, start: FloatArray) -> _Plan:
        self._require_drive(verb)
        check_workspace(verb, target.position, self.options.workspace_m)
        kinematics = self.planner.kinematics
        speeds = self._parameters[Parameter.JOINT_SPEED] * kinematics.velocity
        accelerations = self._parameters[Parameter.JOINT_ACCELERATION] * kinematics.acceleration
        goal = self.planner.joint_goal(verb, target, start, speeds)
        if float(np.abs(goal - start).max()) < ALREADY_THERE_RAD:
            return _Plan(None, 0.0, "the arm is there already")
        # Not `continuous`: the goal's turns are chosen already.
        path = JointPath(start, goal, speeds, accelerations)
        return _Plan(FollowJoints(self.servo, path, self._deceleration), path.duration_s)

    def _plan_line(self, target: Pose, start: FloatArray) -> _Plan:
        self._require_drive("movl")
        begin = to_pose(self.planner.forward(start))
        target = compose(begin, target) if self._tcp_frame else target
        check_workspace("movl", target.position, self.options.workspace_m)
        if (
            norm(subtract(target.position, begin.position)) < 1e-7
            and norm(rotation_between(begin.orientation, target.orientation)) < 1e-6
        ):
            return _Plan(None, 0.0, "the arm is there already")
        path, note = self._line(begin, target)
        rehearsed = self.planner.dry_run("movl", path, start)
        if rehearsed.pace < 1.0:
            slow = f"{rehearsed.slowest} allows {rehearsed.pace:.0%} of the speed in places"
            note = f"{note}; {slow}" if note else slow
        activity = FollowLine(self.servo, path, self.planner.followed, self._deceleration)
        return _Plan(activity, path.duration_s, note)

    def _line(self, begin: Pose, target: Pose) -> tuple[LinePath, str]:
        """The line at the reference speeds, or slower where a longer duration is set."""
        values = self._parameters
        jerk = values[Parameter.PROFILE] == ProfileCode.JERK
        cap_m_s = self.capabilities.linear_speed_m_s or math.inf
        cap_rad_s = self.capabilities.angular_speed_rad_s or math.inf
        limits = PathLimits(
            linear_speed_m_s=min(values[Parameter.TRAJECTORY_SPEED], cap_m_s),
            linear_acceleration_m_s2=values[Parameter.TRAJECTORY_ACCELERATION],
            linear_jerk_m_s3=values[Parameter.TRAJECTORY_JERK],
            angular_speed_rad_s=min(values[Parameter.ROTATION_SPEED], cap_rad_s),
            angular_acceleration_rad_s2=values[Parameter.ROTATION_ACCELERATION],
            angular_jerk_rad_s3=values[Parameter.ROTATION_JERK],
        )
        profile: Literal["jerk", "trapezoid"] = "jerk" if jerk else "trapezoid"
        path = LinePath(begin, target, limits, profile=profile)
        wanted_s = values[Parameter.TRAJECTORY_DURATION]
        if wanted_s > path.duration_s:
            path = LinePath(begin, target, limits, profile=profile, duration_s=wanted_s)
        elif wanted_s > 0.0:
            return path, f"{wanted_s:g} s is too short: it takes {path.duration_s:.2f} s"
        return path, ""

    def _plan_twist(self, linear: Vector3, angular: Vector3, start: FloatArray) -> _Plan:
        self._require_drive("movv")
        now = to_pose(self.planner.forward(start))
        if self._tcp_frame:
            linear, angular = rotate(now.orientation, linear), rotate(now.orientation, angular)
        linear, angular, share = self._slowed(linear, angular)
        note = f"slowed to {share:.0%}, the fastest allowed" if share < 1.0 else ""
        if not any((*linear, *angular)):
            raise MotionRefusedError("movv: a twist of zero moves nothing")
        limits = self._reference_limits(
            self._parameters[Parameter.TRAJECTORY_ACCELERATION],
            self._parameters[Parameter.ROTATION_ACCELERATION],
        )
        twist = Twist(linear, angular, Frame.BASE)
        with self._lock:
            if self._idle:
                self._engage()
            activity = FollowTwist(self.servo, limits, self._deceleration, twist)
        return _Plan(activity, math.inf, note)

    def _plan_torque(self, state: State, wrench: Wrench | None, start: FloatArray) -> _Plan:
        verb = "gcmp" if wrench is None else "forc"
        self._require_torque(verb)
        try:
            activity = self._torque_motion(state)
            activity.check_weight(start)
            if wrench is not None:
                activity.set_wrench(wrench)
        except MotionRefusedError as error:
            raise MotionRefusedError(f"{verb}: {error}") from None
        return _Plan(activity, math.inf)

    def _torque_motion(self, state: State) -> TorqueMotion:
        options = self.options
        limits = TorqueLimits(
            options.force_n,
            options.torque_nm,
            options.force_slew_n_s,
            options.torque_slew_nm_s,
            options.torque_speed_share,
        )
        return TorqueMotion(state, self.model, self._measuring, limits)

    def _reference_limits(self, linear_m_s2: float, angular_rad_s2: float) -> ReferenceLimits:
        options = self.options
        return ReferenceLimits(
            linear_speed_m_s=self._fastest_m_s,
            linear_acceleration_m_s2=linear_m_s2,
            angular_speed_rad_s=self._fastest_rad_s,
            angular_acceleration_rad_s2=angular_rad_s2,
            linear_jerk_m_s3=options.stream_jerk_m_s3,
            angular_jerk_rad_s3=options.stream_rotation_jerk_rad_s3,
            workspace_m=options.workspace_m,
        )

    def _pose_shaper(self, limits: ReferenceLimits) -> PoseShaper:
        return PoseShaper(
            PoseShaperLimits(
                linear_speed_m_s=limits.linear_speed_m_s,
                linear_acceleration_m_s2=limits.linear_acceleration_m_s2,
                linear_jerk_m_s3=self.options.stream_jerk_m_s3,
                angular_speed_rad_s=limits.angular_speed_rad_s,
                angular_acceleration_rad_s2=limits.angular_acceleration_rad_s2,
                angular_jerk_rad_s3=self.options.stream_rotation_jerk_rad_s3,
            ),
            damping=self._parameters[Parameter.DAMPING],
        )

    @property
    def _fastest_m_s(self) -> float:
        most = self.capabilities.linear_speed_m_s
        return min(self.options.stream_speed_m_s, math.inf if most is None else most)

    @property
    def _fastest_rad_s(self) -> float:
        most = self.capabilities.angular_speed_rad_s
        return min(self.options.stream_rotation_speed_rad_s, math.inf if most is None else most)

    def _slowed(self, linear: Vector3, angular: Vector3) -> tuple[Vector3, Vector3, float]:
        """The twist inside the speed limits, both parts slowed alike, and by how much."""
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

    # -- what has to be so -----------------------------------------------------------------------

    def _counted(self) -> _Counted:
        return _Counted(self)

    def _require_joints(self, verb: str) -> RobotState:
        robot = self._robot
        if robot is None:
            raise MotionRefusedError(f"{verb}: nothing was heard of the robot yet")
        if len(robot.joints) != self.servo.joints:
            raise MotionRefusedError(
                f"{verb}: the robot reports {len(robot.joints)} joint positions, "
                f"{self.model.name} has {self.servo.joints} joints"
            )
        if not is_finite(robot.joints):
            raise MotionRefusedError(f"{verb}: the robot reports joints that are not numbers")
        return robot

    def _start(self, verb: str) -> FloatArray:
        """Joint positions that a motion would start from: the commanded ones, or, where nothing
        is commanded, the measured ones."""
        with self._lock:
            robot = self._require_joints(verb)
            if verb != "inv":
                if not robot.ready:
                    why = robot.hold_reason or f"the robot is {robot.link.value}"
                    raise MotionRefusedError(f"{verb}: {why}")
                if robot.alarm:
                    raise MotionRefusedError(f"{verb}: {robot.alarm}")
                if isinstance(self._activity, Recover):
                    raise MotionRefusedError(f"{verb}: coming back to the arm; {self._message}")
            if self._engaged:
                commanded: FloatArray = self.servo.q.copy()
                return commanded
            if verb != "inv":
                self._check_measured(verb, robot)
            return np.array(robot.joints)

    def _check_measured(self, verb: str, robot: RobotState) -> None:
        """Before the first command: the robot rests, and is what its model says."""
        if self._drive is CommandKind.POSE and robot.pose is not None:
            model = to_pose(self._bare.forward(np.array(robot.joints)))
            distance = norm(subtract(model.position, robot.pose.position))
            angle = norm(rotation_between(model.orientation, robot.pose.orientation))
            if distance > MODEL_TOLERANCE_M or angle > MODEL_TOLERANCE_RAD:
                raise MotionRefusedError(
                    f"{verb}: the robot's TCP is {distance * 1e3:.1f} mm and {angle:.3f} rad away "
                    f"from where {self.model.name} has it; tool and work object must be the model's"
                )
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
            not self._idle and not isinstance(self._activity, TorqueMotion)
        ):
            raise MotionRefusedError(f"{verb}: the arm is still moving")
        if isinstance(self._activity, TorqueMotion):
            raise MotionRefusedError(f"{verb}: refused while torques are commanded; stop first")

    def _require_drive(self, verb: str) -> None:
        if self._drive is None:
            raise MotionRefusedError(
                f"{verb}: the robot takes {_kinds(self.capabilities)}; "
                f"a motion needs one of {', '.join(kind.value for kind in DRIVES)}"
            )

    def _require_torque(self, verb: str) -> None:
        if CommandKind.TORQUE not in self.capabilities.commands:
            raise MotionRefusedError(
                f"{verb}: the robot takes {_kinds(self.capabilities)}; this needs torque"
            )
        self._require_drive(verb)

    def _require_generation(self, generation: int) -> None:
        if generation != self._generation or self._robot is None or not self._robot.ready:
            why = self._message or "the robot is not ready"
            raise MotionRefusedError(f"overtaken while it was worked out: {why}")


class _Counted:
    """Counts refusals on their way out."""

    def __init__(self, controller: CartesianController) -> None:
        self._controller = controller

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, (MotionRefusedError, ConfigurationError)):
            self._controller._refusals += 1
            self._controller._last_refusal = str(error)


def _kinds(capabilities: RobotCapabilities) -> str:
    return ", ".join(sorted(kind.value for kind in capabilities.commands)) or "nothing"


def _drive(wanted: CommandKind | None, capabilities: RobotCapabilities) -> CommandKind | None:
    if wanted is None:
        return next((kind for kind in DRIVES if kind in capabilities.commands), None)
    if wanted not in DRIVES or wanted not in capabilities.commands:
        raise ConfigurationError("drive", f"{wanted.value}: the robot takes {_kinds(capabilities)}")
    return wanted


def _narrowed(model: ArmModel, capabilities: RobotCapabilities) -> ArmModel:
    """The arm with the limits of its robot driver, where those are tighter."""
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
