"""Names by which other software commands an arm, and reads its state. Each set of names is a table:
topics and services with their verbs, and topics with the content of the arm's own ones. No limits,
checks or plans here: all commands end at the verbs of the one controller, and those that it cannot
carry out are refused with a reason.

Sources: MoveIt Servo (moveit_servo, its ServoParameters and ServoStatus); CRTK (Collaborative
Robotics Toolkit, api-robot-motion and api-operating-state); FZI cartesian_controllers; YARP's joint
server (robotology/yarp-devices-ros2, controlBoard_nws_ros2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, NoReturn

from cardan.bus.node import BusNode
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.status import ArmStatus, Phase
from cardan.gateway.arm.validation import FramedPose
from cardan.gateway.arm.vocab import Parameter, Stream
from cardan.gateway.bus.arm_topics import ArmNames
from cardan.gateway.bus.commands import (
    Asks,
    ServiceCommand,
    TopicCommand,
    twist_of,
    wrench_of,
)
from cardan.protocols.ros2.cdr import Message, codec_of
from cardan.spatial import rotation_between, scale, subtract
from cardan.types import Frame, Pose, RobotState, Twist, Vector3, Wrench

if TYPE_CHECKING:  # Imports Pinocchio, which sessions without an arm's model do without.
    from cardan.gateway.arm.verb_methods import ArmVerbs

POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
JOINTS = "sensor_msgs/msg/JointState"

STEP_S = 1e-4
"""Time step for the TCP's speed from the speeds of its joints: at 3 rad/s the curvature is 2e-4 of
the distance, and rounding stays negligible."""

NamesOf = Literal["servo", "crtk", "fzi", "cmd_vel", "yarp"]


class PublishedState(NamedTuple):
    """State of the arm as published under other names."""

    stamp_ns: int
    """Stamp of the robot's state, since the epoch."""
    robot: RobotState
    status: ArmStatus
    inhibited: str = ""
    """Reason why nothing may move until re-armed; empty: motion is allowed."""
    commanded: tuple[list[float], list[float]] | None = None
    """Commanded joint positions and velocities; None: not commanded."""
    tcp: Callable[[RobotState], Pose | None] = lambda _robot: None
    """Computes the TCP in the base from the joints of a state; None if they are not the arm's."""

    @classmethod
    def of(
        cls,
        robot: RobotState,
        status: ArmStatus,
        verbs: ArmVerbs | None,
        now_s: float,
        now_ns: int,
    ) -> PublishedState:
        """Make the state of one instant; `now_s` monotonic, `now_ns` since the epoch."""
        stamp_ns = now_ns - int((now_s - robot.stamp_s) * 1e9)
        if verbs is None:
            return cls(stamp_ns, robot, status)
        servo, commanded = verbs.servo, None
        if verbs.controller.engaged:
            commanded = servo.q.tolist(), servo.v.tolist()
        inhibited, tcp = verbs.controller.inhibited, verbs.commanded.reported
        return cls(stamp_ns, robot, status, inhibited, commanded, tcp)

    @property
    def header(self) -> Message:
        """Return a std_msgs/Header with its time."""
        stamp = {"sec": self.stamp_ns // 10**9, "nanosec": self.stamp_ns % 10**9}
        return {"stamp": stamp, "frame_id": ""}

    @property
    def twist(self) -> Twist | None:
        """Measured twist of the TCP along the base's axes; None if the robot does not report the
        speeds of its joints."""
        robot = self.robot
        if not robot.joints or len(robot.velocities) != len(robot.joints):
            return None
        moved = zip(robot.joints, robot.velocities, strict=True)
        now = self.tcp(robot)
        then = self.tcp(robot._replace(joints=tuple(q + v * STEP_S for q, v in moved)))
        if now is None or then is None:
            return None
        return Twist(
            scale(subtract(then.position, now.position), 1.0 / STEP_S),
            scale(rotation_between(now.orientation, then.orientation), 1.0 / STEP_S),
        )

    @property
    def faulty(self) -> bool:
        """True if the arm cannot move until an operator acts."""
        return self.status.phase is Phase.NO_ROBOT or bool(self.inhibited)


class TopicPublication(NamedTuple):
    """A topic with a message of its own."""

    topic: str
    type_name: str
    message: Callable[[PublishedState], Message | None]
    """Makes the message of an instant; None if there is none."""


class Names(NamedTuple):
    """A set of names."""

    topics: tuple[TopicCommand, ...] = ()
    services: tuple[ServiceCommand, ...] = ()
    same: Mapping[str, tuple[str, ...]] = {}
    """Topics with the same messages as the arm's own, by the names of these."""
    published: tuple[TopicPublication, ...] = ()


class ServoScales(NamedTuple):
    """Units of the commands of MoveIt Servo."""

    unitless: bool = True
    """True: shares of the speeds below; False: m/s and rad/s."""
    linear_m_s: float = 0.4
    angular_rad_s: float = 0.8
    joint_rad_s: float = 0.5


# -- values ---------------------------------------------------------------------------------------


class _Frames:
    """Reads the values of stamped messages, in the frames known to the arm."""

    def __init__(self, names: ArmNames, unnamed: Frame | None = None) -> None:
        """`unnamed`: meaning of an empty frame_id; None: refused."""
        self.names = names
        self._frames = {names.tcp: Frame.TOOL, names.base: Frame.BASE}
        if unnamed is not None:
            self._frames[""] = unnamed

    def frame(self, message: Message) -> Frame:
        """Return the frame of a message with a header. Raises MotionRefusedError."""
        given = message["header"]["frame_id"]
        frame = self._frames.get(given)
        if frame is None:
            what = f"the frame {given[:60]!r} is not known" if given else "header.frame_id is empty"
            raise MotionRefusedError(
                f"{what}: it has to be {self.names.base!r} (base) or {self.names.tcp!r} (TCP)"
            )
        return frame

    def pose(self, message: Message) -> FramedPose:
        return FramedPose(Pose.from_ros(message["pose"]), self.frame(message))

    def twist(self, message: Message) -> Twist:
        numbers = twist_of(message["twist"])
        return Twist(Vector3(*numbers[:3]), Vector3(*numbers[3:]), self.frame(message))

    def wrench(self, message: Message) -> Wrench:
        numbers = wrench_of(message["wrench"])
        return Wrench(Vector3(*numbers[:3]), Vector3(*numbers[3:]), self.frame(message))

    def rates(self, given: Sequence[str], values: Sequence[float], what: str) -> list[float]:
        """Return rates of all joints of the arm, rad/s: 0 for those that are not named. Raises
        MotionRefusedError."""
        joints = self.names.joints
        if len(given) != len(values):
            raise MotionRefusedError(f"{len(given)} joint names and {len(values)} {what}")
        unknown = [name for name in given if name not in joints]
        if unknown:
            raise MotionRefusedError(
                f"there is no joint {unknown[0][:60]!r}; the arm has {', '.join(joints)}"
            )
        if len(set(given)) != len(given):
            raise MotionRefusedError(f"a joint is named twice: {', '.join(given)[:200]}")
        found = dict(zip(given, values, strict=True))
        return [found.get(name, 0.0) for name in joints]

    def rates_or_all(self, given: Sequence[str], values: Sequence[float], what: str) -> list[float]:
        """Return rates of all joints, rad/s; without names `values` are in the arm's order."""
        if not given and len(values) == len(self.names.joints):
            return list(values)
        return self.rates(given, values, what)


class _CommandSwitch:
    """Accepts or refuses the commands under one set of names, independently of the others."""

    def __init__(self) -> None:
        self.refusal = ""
        """Reason for refusing commands; empty while they are accepted."""

    def when_on(self, value: Callable[[Message], Any]) -> Callable[[Message], Any]:
        """Return `value`, which raises while there is a reason for refusal."""

        def checked(message: Message) -> Any:
            if self.refusal:
                raise MotionRefusedError(self.refusal)
            return value(message)

        return checked


def _refusing(why: str) -> Callable[[Message], NoReturn]:
    def refuse(_message: Message) -> NoReturn:
        raise MotionRefusedError(why)

    return refuse


def _no_positions(speeds: str, pose: str) -> str:
    """Return why joint positions are refused, with the names of the alternatives."""
    return (
        f"joint positions are not streamed: stream speeds by {speeds}, send a pose by {pose}, or "
        "a plan by the action follow_joint_trajectory"
    )


def _measured_twist(names: ArmNames) -> Callable[[PublishedState], Message | None]:
    """Return a function that makes a geometry_msgs/TwistStamped of the measured twist along the
    base's axes, or None if the robot does not report the speeds of its joints."""

    def tell(shown: PublishedState) -> Message | None:
        twist = shown.twist
        if twist is None:
            return None
        return {
            "header": {**shown.header, "frame_id": names.base},
            "twist": twist.to_ros(),
        }

    return tell


def _stream(topic: str, type_name: str, verb: str, value: Callable[[Message], Any]) -> TopicCommand:
    return TopicCommand(topic, type_name, verb, value, 1, begins=True, stamped=True)


# -- MoveIt Servo ---------------------------------------------------------------------------------

_COMMAND_TYPES = (Stream.JOINT, Stream.TWIST, Stream.POSE)
"""Values of moveit_msgs/srv/ServoCommandType."""

INVALID, NO_WARNING, NEAR_SINGULARITY, AT_SINGULARITY = -1, 0, 1, 2
NEAR_COLLISION, AT_COLLISION, JOINT_BOUND = 4, 5, 6

HALTED = 0.05
"""Share of the requested speed below which the arm counts as halted."""


def servo_names(servo: str, names: ArmNames, scales: ServoScales) -> Names:
    """Return the names of MoveIt Servo, below the name `servo` of its node."""
    frames, commands = _Frames(names), _CommandSwitch()

    def scaled(numbers: Sequence[float], scale: float) -> list[float]:
        if not scales.unitless:
            return list(numbers)
        for number in numbers:
            if not -1.0 <= number <= 1.0:
                raise MotionRefusedError(
                    f"{number:g} is not a share of the full speed, -1 to 1; for m/s and rad/s set "
                    'servo_units = "speed" in [network]'
                )
        return [number * scale for number in numbers]

    def twist(message: Message) -> Twist:
        given = frames.twist(message)
        linear = Vector3(*scaled(given.linear, scales.linear_m_s))
        return Twist(linear, Vector3(*scaled(given.angular, scales.angular_rad_s)), given.frame)

    def jog(message: Message) -> Any:
        if any(message["displacements"]):
            raise MotionRefusedError("displacements are not taken; velocities are")
        rates = frames.rates(message["joint_names"], message["velocities"], "velocities")
        return scaled(rates, scales.joint_rad_s)

    def switch(request: Message) -> dict[Parameter, float]:
        code = request["command_type"]
        if not 0 <= code < len(_COMMAND_TYPES):
            raise MotionRefusedError(f"{code} is not a command type: 0 joints, 1 twist, 2 pose")
        return {Parameter.STREAM: float(_COMMAND_TYPES[code])}

    def pause(request: Message) -> Asks:
        commands.refusal = f"paused; call {servo}/pause_servo with false" if request["data"] else ""
        return Asks("stop" if request["data"] else "")

    return Names(
        (
            _stream(f"{servo}/delta_twist_cmds", TWIST, "twist", commands.when_on(twist)),
            _stream(
                f"{servo}/delta_joint_cmds", "control_msgs/msg/JointJog", "joints",
                commands.when_on(jog),
            ),
            _stream(f"{servo}/pose_target_cmds", POSE, "pose", commands.when_on(frames.pose)),
        ),
        (
            ServiceCommand(
                f"{servo}/switch_command_type", "moveit_msgs/srv/ServoCommandType",
                "set_parameters", switch, lambda _result: {"success": True},
            ),
            ServiceCommand(f"{servo}/pause_servo", "std_srvs/srv/SetBool", "stop", pause),
        ),
        published=(
            TopicPublication(
                f"{servo}/status", "moveit_msgs/msg/ServoStatus",
                lambda shown: servo_status(shown, commands.refusal),
            ),
        ),
    )  # fmt: skip


def servo_status(shown: PublishedState, paused: str = "") -> Message:
    """Make a moveit_msgs/msg/ServoStatus. Its code has one of the limits that act, its text all;
    leaving and approaching a singularity are not distinguished."""
    status, code = shown.status, NO_WARNING
    words = [paused, shown.inhibited, status.message]
    if status.phase is Phase.NO_ROBOT:
        code = INVALID
    elif (arm := status.arm) is not None:
        words += arm.in_words()
        halted = arm.path_speed < HALTED
        if arm.distance_m < 0.0:
            code = AT_COLLISION
        elif arm.slowed:
            if arm.singular:
                code = AT_SINGULARITY if halted else NEAR_SINGULARITY
            elif arm.active_pairs:
                code = AT_COLLISION if halted else NEAR_COLLISION
            elif arm.limiting_joints:
                code = JOINT_BOUND
    return {"code": code, "message": "; ".join(dict.fromkeys(filter(None, words)))}


# -- cmd_vel --------------------------------------------------------------------------------------


def cmd_vel_names(names: ArmNames) -> Names:
    """Return the names of programs that drive by cmd_vel, stamped or not: teleop_twist_keyboard,
    rqt."""
    frames = _Frames(names)

    def stamped(message: Message) -> Any:
        if message["header"]["frame_id"]:
            return frames.twist(message)
        return twist_of(message["twist"])

    return Names(
        (
            TopicCommand(
                "cmd_vel", "geometry_msgs/msg/Twist", "twist", twist_of, 1, begins=True,
                stamped=True, also=((TWIST, stamped),),
            ),
        )
    )  # fmt: skip


# -- FZI's Cartesian controllers ------------------------------------------------------------------


def fzi_names(names: ArmNames) -> Names:
    """Return the names of FZI's cartesian_motion_controller and cartesian_force_controller."""
    frames = _Frames(names)
    return Names(
        (
            _stream("target_frame", POSE, "pose", frames.pose),
            _stream("target_wrench", WRENCH, "wrench", frames.wrench),
        ),
        same={"state/pose": ("current_pose",)},
        published=(TopicPublication("current_twist", TWIST, _measured_twist(names)),),
    )


# -- CRTK -----------------------------------------------------------------------------------------


class _Operating:
    """The operating state of CRTK, for its own commands only."""

    def __init__(self) -> None:
        self.switch = _CommandSwitch()
        self._disabled = False
        self._faulty = False

    @property
    def state(self) -> str:
        """Present operating state. Source: CRTK, api-operating-state."""
        if self._disabled:
            return "DISABLED"
        if self._faulty:
            return "FAULT"
        return "PAUSED" if self.switch.refusal else "ENABLED"

    def command(self, message: Message) -> Asks:
        """Carry out a crtk_msgs/StringStamped. Raises MotionRefusedError."""
        word, state = message["string"], self.state
        made = _TRANSITIONS.get(word)
        if made is None:
            raise MotionRefusedError(
                f"state_command: unknown command {word[:60]!r}; allowed: {', '.join(_TRANSITIONS)}"
            )
        if state not in made:
            raise MotionRefusedError(
                f"state_command: {word} is not possible in {state}, only in {', '.join(made)}"
            )
        if word == "unhome":
            raise MotionRefusedError("state_command: the arm knows its joints; it has no homing")
        if word in ("disable", "pause"):
            self._disabled = word == "disable"
            remedy = "enable" if self._disabled else "resume"
            self.switch.refusal = f"{word}d; send {remedy} on state_command"
            return Asks("stop")
        if word in ("enable", "resume"):
            self._disabled, self.switch.refusal = False, ""
        return Asks("acknowledge" if word == "enable" and state == "FAULT" else "")

    def tell(self, shown: PublishedState) -> Message:
        """Make a crtk_msgs/OperatingState."""
        self._faulty = shown.faulty
        return {
            "header": shown.header,
            "state": self.state,
            "is_homed": bool(shown.robot.joints),
            "is_busy": shown.status.phase in (Phase.MOVING, Phase.BRAKING, Phase.RECOVERING),
        }


_TRANSITIONS = {
    "enable": ("DISABLED", "ENABLED", "FAULT"),
    "disable": ("DISABLED", "ENABLED", "PAUSED", "FAULT"),
    "pause": ("ENABLED", "PAUSED"),
    "resume": ("PAUSED",),
    "home": ("ENABLED",),
    "unhome": ("ENABLED",),
}
"""Words of state_command, with the states in which each is possible."""


def crtk_names(names: ArmNames) -> Names:
    """Return the names of the Collaborative Robotics Toolkit, in the namespace of the arm."""
    frames, operating = _Frames(names, unnamed=Frame.BASE), _Operating()

    def rates(message: Message) -> list[float]:
        return frames.rates_or_all(message["name"], message["velocity"], "velocities")

    def setpoint(shown: PublishedState) -> Message | None:
        if shown.commanded is None:
            return None
        positions, velocities = shown.commanded
        return {
            "header": shown.header,
            "name": list(names.joints),
            "position": positions,
            "velocity": velocities,
            "effort": [],
        }

    opened = operating.switch.when_on
    no_positions = _no_positions("servo_jv", "move_cp")
    return Names(
        (
            _stream("servo_cp", POSE, "pose", opened(frames.pose)),
            _stream("interpolate_cp", POSE, "pose", opened(frames.pose)),
            _stream("servo_cv", TWIST, "twist", opened(frames.twist)),
            _stream("servo_cf", WRENCH, "wrench", opened(frames.wrench)),
            _stream("servo_jv", JOINTS, "joints", opened(rates)),
            *(
                TopicCommand(each, JOINTS, "joints", _refusing(f"{each}: {no_positions}"), 1)
                for each in ("servo_jp", "interpolate_jp")
            ),
            TopicCommand("move_cp", POSE, "movl", opened(frames.pose)),
            TopicCommand("move_jp", JOINTS, "movj", _refusing(f"move_jp: {no_positions}")),
            TopicCommand("state_command", "crtk_msgs/msg/StringStamped", "stop", operating.command),
        ),
        same={
            "state/pose": ("measured_cp",),
            "state/wrench": ("measured_cf",),
            "joint_states": ("measured_js",),
            "state/target": ("setpoint_cp",),
            "state/twist": ("setpoint_cv",),
        },
        published=(
            TopicPublication("measured_cv", TWIST, _measured_twist(names)),
            TopicPublication("setpoint_js", JOINTS, setpoint),
            TopicPublication("operating_state", "crtk_msgs/msg/OperatingState", operating.tell),
        ),
    )


# -- YARP's joint server --------------------------------------------------------------------------


def yarp_names(names: ArmNames) -> Names:
    """Return the names of YARP's controlBoard_nws_ros2, below the arm's node: its topic
    `topic_name` is ~/state, and `msgs_name` is the node."""
    frames = _Frames(names)

    def rates(message: Message) -> list[float]:
        if any(message["ref_accelerations"]):
            raise MotionRefusedError(
                "velocity: ref_accelerations are not taken: the arm's own limits hold; leave them "
                "empty"
            )
        return frames.rates_or_all(message["names"], message["velocities"], "velocities")

    no_positions = _no_positions("velocity", "command/movj")
    return Names(
        (
            TopicCommand(
                "~/velocity", "yarp_control_msgs/msg/Velocity", "joints", rates, 1, begins=True
            ),
            TopicCommand(
                "~/position_direct", "yarp_control_msgs/msg/PositionDirect", "joints",
                _refusing(f"position_direct: {no_positions}"), 1,
            ),
            TopicCommand(
                "~/position", "yarp_control_msgs/msg/Position", "movj",
                _refusing(f"position: {no_positions}"),
            ),
        ),
        same={"joint_states": ("~/state",)},
    )  # fmt: skip


class _PublishedTopic:
    """A topic with a message of its own, which is encoded only when it changes."""

    def __init__(self, node: BusNode, published: TopicPublication) -> None:
        self._publisher = node.publisher(published.topic, published.type_name)
        self._codec, self._message_of = codec_of(published.type_name), published.message
        self._message: Message | None = None
        self._data = b""

    def publish(self, shown: PublishedState, now_ns: int) -> None:
        message = self._message_of(shown)
        if message is None:
            return
        if message != self._message:
            self._message, self._data = message, self._codec.encode(message)
        self._publisher.put(self._data, now_ns)


class NamesTopics:
    """Publishes those messages of the sets of names that the arm's own topics lack. For the
    loop."""

    def __init__(self, node: BusNode, sets: Sequence[Names]) -> None:
        """`node` is open."""
        self._topics = [
            _PublishedTopic(node, published) for names in sets for published in names.published
        ]

    def publish(self, shown: PublishedState, now_ns: int) -> None:
        """Publish one instant."""
        for each in self._topics:
            each.publish(shown, now_ns)


def same_topics(sets: Sequence[Names]) -> dict[str, list[str]]:
    """Return further topics for the messages of the arm's own, of all sets."""
    found: dict[str, list[str]] = {}
    for names in sets:
        for own, others in names.same.items():
            found.setdefault(own, []).extend(others)
    return found


def other_names(
    which: Sequence[NamesOf], names: ArmNames, servo: str, scales: ServoScales
) -> list[Names]:
    """Return the chosen sets of names for an arm."""
    made: dict[str, Callable[[], Names]] = {
        "servo": lambda: servo_names(servo, names, scales),
        "crtk": lambda: crtk_names(names),
        "fzi": lambda: fzi_names(names),
        "cmd_vel": lambda: cmd_vel_names(names),
        "yarp": lambda: yarp_names(names),
    }
    return [made[each]() for each in dict.fromkeys(which)]
