"""The commands of the Cartesian server: topics and services, and their verbs. Source: Łukawski et
al. 2025 ("YARP, ROS 2, Cartesian, web"), Table 1, with the corrections in docs/ros2.md; the
services with an answer, and the result topic, are extensions of Cardan."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from cardan.errors import CardanError, MotionRefusedError
from cardan.gateway.arm.verb_results import Stat
from cardan.gateway.arm.verb_table import POSE, TWIST, VERB_TABLE, WRENCH, Takes, Verb
from cardan.gateway.arm.vocab import Action
from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.refusals import refusal
from cardan.spatial import from_rotation_vector
from cardan.types import Pose, RobotState, Vector3

ROS_ACTIONS = {1: Action.OPEN, 2: Action.CLOSE, 3: Action.STOP}
"""Codes of the gripper on ROS 2; 0 does nothing."""


ASK_SERVICE, ASK_TYPE = "ask", "cardan_msgs/srv/Ask"
"""All verbs as the packets of :mod:`cardan.gateway.arm.requests`, below the arm's node."""

MOTIONS_TOPIC, MOTIONS_TYPE = "motions", "std_msgs/msg/String"
"""Notes of motions that were requested by packets."""


REARM_APART_S = 2.0
"""Least time between two messages that re-arm: `ros2 topic pub` repeats its message each second."""


class Asks(NamedTuple):
    """Request of a message that names its own verb; given as the value of its command."""

    verb: str = ""
    """The verb; empty: none."""


class TopicCommand(NamedTuple):
    """A command that comes as a message on a topic."""

    topic: str
    type_name: str
    verb: str
    value: Callable[[Message], Any]
    """Converts a message to the verb's argument, or an :class:`Asks`; raises MotionRefusedError."""
    depth: int = 8
    """Most messages that wait for their turn: 1 for a stream, whose newest one counts."""
    begins: bool = False
    """True for a stream that chooses its preset by itself."""
    dated: bool = False
    """True for such a stream if only messages with their time of sending may do so."""
    stamped: bool = False
    """For a stream: whether the stamp of its header, if any, is the time of sending."""
    also: tuple[tuple[str, Callable[[Message], Any]], ...] = ()
    """Further types on the same topic, each with its conversion to the argument."""
    always: bool = False
    """True if it is carried out even when it came twice, or after a newer one."""
    apart_s: float = 0.0
    """Time for which its publisher must have sent none before it: for a command that re-arms, which
    a repeating publisher must not trigger."""


class Instant(NamedTuple):
    """State of the arm for the feedback of goals in progress."""

    stamp_ns: int
    """Stamp of the measurement, since the epoch."""
    frame: str
    pose: Pose | None
    """Measured pose of the TCP."""
    robot: RobotState
    desired: tuple[Sequence[float], Sequence[float], int] | None = None
    """Present joint positions and velocities of a trajectory, and the index of its point."""


def _pose_feedback(now: Instant) -> Message:
    message = default_message("geometry_msgs/msg/PoseStamped")
    stamp = {"sec": now.stamp_ns // 10**9, "nanosec": now.stamp_ns % 10**9}
    message["header"] = {"stamp": stamp, "frame_id": now.frame}
    if now.pose is not None:
        p, q = now.pose.position, now.pose.orientation
        message["pose"] = {
            "position": {"x": p.x, "y": p.y, "z": p.z},
            "orientation": {"x": q.x, "y": q.y, "z": q.z, "w": q.w},
        }
    return {"pose": message}


def _words_of(reason: str, _error: CardanError | None) -> Message:
    return {"success": not reason, "message": reason}


class ActionCommand(NamedTuple):
    """A motion requested as the goal of an action."""

    action: str
    type_name: str
    verb: str
    value: Callable[[Message], Any] = lambda _goal: None
    """Converts a goal to the verb's argument; raises MotionRefusedError."""
    result: Callable[[str, CardanError | None], Message] = _words_of
    """Makes the result from the reason why the goal was not reached, or "", and the error."""
    feedback: Callable[[Instant], Message] = _pose_feedback


class ServiceCommand(NamedTuple):
    """A command requested by a service."""

    service: str
    type_name: str
    verb: str
    value: Callable[[Message], Any] = lambda _request: None
    """Converts a request to the verb's argument, or an :class:`Asks`; raises MotionRefusedError."""
    answer: Callable[[Any], Message] = lambda _result: {"success": True, "message": ""}
    """Makes the response from the verb's result."""

    def refusal(self, error: CardanError) -> Message:
        """Make the response for a refused verb."""
        return refusal(self.type_name, str(error))


# -- arguments --------------------------------------------------------------------------------


def _vector(message: Mapping[str, Any]) -> tuple[float, float, float]:
    return message["x"], message["y"], message["z"]


def twist_of(message: Mapping[str, Any]) -> list[float]:
    """Convert a geometry_msgs/Twist: m/s, rad/s."""
    return [*_vector(message["linear"]), *_vector(message["angular"])]


def wrench_of(message: Mapping[str, Any]) -> list[float]:
    """Convert a geometry_msgs/Wrench: N, N·m."""
    return [*_vector(message["force"]), *_vector(message["torque"])]


def joint_speeds(names: Sequence[str]) -> Callable[[Message], list[float]]:
    """Return a function: sensor_msgs/JointState to speeds of the joints `names`, in this order."""

    def speeds(message: Message) -> list[float]:
        given, velocities = message["name"], message["velocity"]
        if not velocities:
            raise MotionRefusedError(
                "joints takes speeds (velocity), rad/s or m/s, and the message has none; there is "
                "no stream of joint positions"
            )
        if len(velocities) != len(given):
            raise MotionRefusedError(
                f"joints: {len(velocities)} numbers of velocity for {len(given)} names"
            )
        by_name = dict(zip(given, velocities, strict=True))
        if len(by_name) < len(given) or by_name.keys() != set(names):
            missing = [name for name in names if name not in by_name]
            strange = [name for name in by_name if name not in names]
            words = [
                f"{what} {', '.join(each)}"
                for what, each in (("without", missing), ("with", strange))
                if each
            ]
            raise MotionRefusedError(
                f"joints takes each joint of the arm once; the message is {' and '.join(words)}"
                if words
                else "joints takes each joint of the arm once; the message has one twice"
            )
        return [by_name[name] for name in names]

    return speeds


def action_of(code: int) -> Action:
    """Return the gripper's action of a code on ROS 2."""
    if code not in ROS_ACTIONS:
        raise MotionRefusedError(f"act: {code} is not an action; 1 opens, 2 closes, 3 stops")
    return ROS_ACTIONS[code]


# -- the tables -------------------------------------------------------------------------------


def _stream(verb: str, type_name: str, value: Callable[[Message], Any]) -> TopicCommand:
    return TopicCommand(f"~/command/{verb}", type_name, verb, value, 1, begins=True, dated=True)


def _signal(verb: str, always: bool = False, apart_s: float = 0.0) -> TopicCommand:
    return TopicCommand(
        f"~/command/{verb}", "std_msgs/msg/Empty", verb, lambda _message: None,
        always=always, apart_s=apart_s,
    )  # fmt: skip


class _OnRos(NamedTuple):
    """Representation of a verb's argument on ROS 2."""

    message: str
    """Type of a topic's message."""
    value: Callable[[Message], Any]
    """Converts a message, or the `field` of a request or a goal, to the verb's argument."""
    field: str
    words: str
    """Name of the types of cardan_msgs: the service is of srv/WORDS, the action of action/WORDS."""


_ON_ROS: Mapping[Takes, _OnRos] = {
    POSE: _OnRos("geometry_msgs/msg/Pose", Pose.from_ros, "x", "MovePose"),
    TWIST: _OnRos("geometry_msgs/msg/Twist", twist_of, "xdot", "MoveTwist"),
    WRENCH: _OnRos("geometry_msgs/msg/Wrench", wrench_of, "fd", "ExertWrench"),
}

_KNOWN = [verb for verb in VERB_TABLE.values() if verb.takes in _ON_ROS]
_STREAMS = [verb for verb in _KNOWN if verb.preset is not None]
_ACTS = [verb for verb in _KNOWN if verb.preset is None and verb.changes]
"""Motions, and the choice of a tool."""


def _topic(verb: Verb) -> TopicCommand:
    ros = _ON_ROS[verb.takes]
    return TopicCommand(f"~/command/{verb.name}", ros.message, verb.name, ros.value)


TOPICS = (
    *(
        _stream(verb.name, _ON_ROS[verb.takes].message, _ON_ROS[verb.takes].value)
        for verb in _STREAMS
        if verb.name != "jog"  # the page's
    ),
    *map(_topic, _ACTS),
    TopicCommand(
        "~/command/retract", "std_msgs/msg/Float64", "retract", lambda message: message["data"]
    ),
    TopicCommand(
        "~/command/gripper", "std_msgs/msg/Int32", "act", lambda message: action_of(message["data"])
    ),
    # An operator's commands are topics, too: services do not cross middlewares.
    _signal("stop", always=True),
    _signal("acknowledge", apart_s=REARM_APART_S),
    _signal("acquire"),
    _signal("release"),
)
"""Table 1 of the paper, and an operator's commands."""


def joint_command(names: Sequence[str]) -> TopicCommand:
    """The stream of joint speeds of the arm with these joints, for JointStateTopicSystem."""
    return _stream("joints", "sensor_msgs/msg/JointState", joint_speeds(names))


def _service(verb: Verb) -> ServiceCommand:
    ros = _ON_ROS[verb.takes]
    return ServiceCommand(
        f"~/{verb.name}", f"cardan_msgs/srv/{ros.words}", verb.name,
        lambda request: ros.value(request[ros.field]),
    )  # fmt: skip


def _inverse(positions: tuple[float, ...]) -> Message:
    response = default_message("rl_cartesian_control_msgs/srv/Inv_Response")
    response["q"]["data"] = list(positions)
    response["success"] = True
    return response


def _wait(arrived: bool) -> Message:
    return {"success": arrived, "message": "" if arrived else "it did not arrive"}


SERVICES = (
    ServiceCommand(
        "~/inv", "rl_cartesian_control_msgs/srv/Inv", "inv",
        lambda request: Pose.from_ros(request["x"]), _inverse,
    ),
    ServiceCommand("~/gcmp", "std_srvs/srv/Trigger", "gcmp"),
    ServiceCommand("~/stop", "std_srvs/srv/Trigger", "stop"),
    ServiceCommand("~/acknowledge", "std_srvs/srv/Trigger", "acknowledge"),
    ServiceCommand("~/release", "std_srvs/srv/Trigger", "release"),
    *map(_service, _ACTS),
    ServiceCommand(
        "~/act", "cardan_msgs/srv/Act", "act", lambda request: action_of(request["action"])
    ),
    ServiceCommand(
        "~/wait", "cardan_msgs/srv/Wait", "wait", lambda request: request["timeout"], _wait
    ),
)  # fmt: skip
"""The services of the paper, and the same verbs with an answer. A motion's answer is that it has
begun, or why not; `wait` answers whether it arrived."""


def stat_command(base: str) -> ServiceCommand:
    """Return the command for the TCP pose in the frame `base`, stamped with the time of the
    measurement."""

    def answer(stat: Stat) -> Message:
        x, y, z, *rotation = stat.pose
        pose = Pose(Vector3(x, y, z), from_rotation_vector(Vector3(*rotation)))
        stamp_ns = time.time_ns() - round((time.monotonic() - stat.stamp_s) * 1e9)
        stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
        return {
            "pose": {"header": {"stamp": stamp, "frame_id": base}, "pose": pose.to_ros()},
            "state": int(stat.state),
            "success": True,
            "message": "",
        }

    return ServiceCommand("~/stat", "cardan_msgs/srv/Stat", "stat", answer=answer)


def _action(verb: Verb) -> ActionCommand:
    ros = _ON_ROS[verb.takes]
    return ActionCommand(
        f"~/action/{verb.name}", f"cardan_msgs/action/{ros.words}", verb.name,
        lambda goal: ros.value(goal[ros.field]),
    )  # fmt: skip


ACTIONS = (
    *(_action(verb) for verb in _ACTS if verb.begins_motion),
    ActionCommand("~/action/gcmp", "cardan_msgs/action/CompensateGravity", "gcmp"),
)
"""Motions as actions, which report the arm's pose, and the time and reason of their end."""
