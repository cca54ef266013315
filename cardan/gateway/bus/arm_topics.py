"""Topics of a session's arm: state, transforms, description, diagnostics, log.

All messages of one instant are published together, after the robot's answer has been sent: the
first one wakes Zenoh's sender, which costs ten times as much as each further one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from cardan.bus.node import BusNode, Publisher
from cardan.gateway.arm.status import ArmStatus
from cardan.gateway.arm.vocab import State, Stream
from cardan.protocols.ros2.cdr import Message, Template, codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.zenoh import LATCHED_QOS, ROSOUT_QOS
from cardan.spatial import compose, inverse
from cardan.types import IDENTITY_POSE, Pose, RobotState

DIAGNOSTICS_PERIOD_S = 1.0
"""Period of /diagnostics, as rqt_robot_monitor expects: it shows a part as stale after 5 s."""

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostics."""

LOG_INFO, LOG_WARN, LOG_ERROR = 20, 30, 40
"""Levels of /rosout."""

NS = 1_000_000_000

_STATUS, _STRING = "cardan_msgs/msg/ArmStatus", "std_msgs/msg/String"
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

_NO_NAMES: Mapping[str, Sequence[str]] = {}


@dataclass(frozen=True)
class ArmNames:
    """Names of an arm in messages."""

    joints: tuple[str, ...]
    base: str = "base_link"
    flange: str = "tool0"
    tcp: str = "tcp"


@dataclass
class DiagnosticStatus:
    """Row of /diagnostics."""

    name: str
    """Name of the part of the session: "robot"."""
    level: int
    message: str
    hardware_id: str = ""
    values: Mapping[str, object] = field(default_factory=dict)


class _Stamped:
    """A topic whose messages have constant texts: the numbers are overwritten in place."""

    def __init__(
        self, node: BusNode, names: Sequence[str], type_name: str, message: Message, *slots: str
    ) -> None:
        """`names`: all topics on which these messages are published."""
        template = Template(type_name, message)
        self._publishers = [node.publisher(name, type_name) for name in names]
        self._data = template.data
        self._stamp = template.slot(f"{_header_of(type_name)}stamp")
        self.slots: tuple[Callable[..., None], ...] = tuple(map(template.slot, slots))

    def put(self, stamp_ns: int, now_ns: int) -> None:
        self._stamp(stamp_ns // NS, stamp_ns % NS)
        for publisher in self._publishers:
            publisher.put(self._data, now_ns)


def _header_of(type_name: str) -> str:
    return "transforms.0.header." if type_name.endswith("TFMessage") else "header."


class Diagnostics:
    """Publisher of the faults of each part of a node on /diagnostics."""

    def __init__(self, node: BusNode) -> None:
        self._node = node
        self._publisher = node.publisher("/diagnostics", _DIAGNOSTICS)
        self._due_s = -math.inf

    def put(
        self, parts: Callable[[], Sequence[DiagnosticStatus]], now_s: float, now_ns: int
    ) -> None:
        """Publish at most once a second; `parts` is called only then."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + DIAGNOSTICS_PERIOD_S
        rows = [
            {
                "level": part.level,
                "name": f"{self._node.full_name}: {part.name}",
                "message": part.message,
                "hardware_id": part.hardware_id,
                "values": [
                    {"key": str(key), "value": str(value)} for key, value in part.values.items()
                ],
            }
            for part in parts()
        ]
        message = {"header": {"stamp": _time(now_ns), "frame_id": ""}, "status": rows}
        self._publisher.put(codec_of(_DIAGNOSTICS).encode(message), now_ns)


class ArmTopics:
    """Publishes the state of one arm. For the loop's thread."""

    def __init__(
        self,
        node: BusNode,
        names: ArmNames,
        *,
        period_s: float,
        robot_description: str = "",
        scene: str = "",
        tool: Pose = IDENTITY_POSE,
        transforms: Literal["all", "tool", "none"] = "all",
        same: Mapping[str, Sequence[str]] = _NO_NAMES,
    ) -> None:
        """`period_s`: shortest time between two instants that are published. `node` is open; its
        name is the prefix of the arm's own topics, its namespace that of the usual topics of
        robots. `scene`: that of the arm, as JSON.

        `transforms`: "all": base to flange (/tf) and flange to TCP (/tf_static); "tool": only the
        latter, because a robot_state_publisher has the others. `same`: further topics for the
        messages of "joint_states", "state/pose", "state/target", "state/twist" and "state/wrench".
        """
        self._node, self._names = node, names
        self.period_s = period_s
        """Shortest time between two instants that are published."""
        self._same = same
        self._due_s = -math.inf
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": names.base}
        self._joints = [
            node.publisher(name, "sensor_msgs/msg/JointState")
            for name in ("joint_states", *same.get("joint_states", ()))
        ]
        self._joint_states: dict[tuple[bool, bool], Template] = {}
        """Templates by presence of velocities and torques."""
        self._pose = self._geometry("~/state/pose", "PoseStamped", "pose", header)
        self._target = self._geometry("~/state/target", "PoseStamped", "pose", header)
        self._twist = self._geometry("~/state/twist", "TwistStamped", "twist", header)
        self._wrench = self._geometry("~/state/wrench", "WrenchStamped", "wrench", header)
        self._status = node.publisher("~/state/status", _STATUS)
        self._status_texts: tuple[object, ...] = ()
        self._status_template: Template | None = None
        """Template of the newest status; None until its texts have occurred twice."""
        self._shown: tuple[ArmStatus, Message] | None = None
        """Status and message of the newest instant."""
        self._diagnostics = Diagnostics(node)
        self._rosout = node.publisher("/rosout", "rcl_interfaces/msg/Log", ROSOUT_QOS)
        self._snapshots = node.publisher("~/state/snapshot", _STRING)
        self._transform: _Stamped | None = None
        self._latched: list[Publisher] = []
        self._from_tool = None if tool == IDENTITY_POSE else inverse(tool)
        if transforms == "all":
            moving = default_message("geometry_msgs/msg/TransformStamped")
            moving |= {"header": header, "child_frame_id": names.flange}
            self._transform = _Stamped(
                node,
                ("/tf",),
                "tf2_msgs/msg/TFMessage",
                {"transforms": [moving]},
                "transforms.0.transform",
            )
        if transforms != "none":
            fixed = {
                "header": {**header, "frame_id": names.flange},
                "child_frame_id": names.tcp,
                "transform": _transform(tool),
            }
            self._latch("/tf_static", "tf2_msgs/msg/TFMessage", {"transforms": [fixed]})
        if robot_description:
            self._latch("robot_description", _STRING, {"data": robot_description})
        self._scene = node.publisher("~/scene", _STRING, LATCHED_QOS)
        if scene:
            self._scene.put(codec_of(_STRING).encode({"data": scene}), 0)

    def _geometry(self, name: str, kind: str, field_name: str, header: Message) -> _Stamped:
        type_name = f"geometry_msgs/msg/{kind}"
        message = {**default_message(type_name), "header": header}
        names = (name, *self._same.get(name.removeprefix("~/"), ()))
        return _Stamped(self._node, names, type_name, message, field_name)

    def _latch(self, name: str, type_name: str, message: Message) -> None:
        publisher = self._node.publisher(name, type_name, LATCHED_QOS)
        publisher.put(codec_of(type_name).encode(message), 0)
        self._latched.append(publisher)

    # -- for the loop ----------------------------------------------------------------------------

    def due(self, now_s: float) -> bool:
        """Return whether the state is due for publication."""
        return now_s >= self._due_s

    def publish(
        self,
        state: RobotState,
        pose: Pose | None,
        status: ArmStatus,
        flags: Mapping[str, Any],
        now_s: float,
        now_ns: int,
    ) -> None:
        """Publish one instant. `pose`: the measured TCP; `flags`: the fields of ArmStatus that are
        the Cartesian interface's; `now_s` monotonic, `now_ns` since the epoch."""
        due_s = self._due_s + self.period_s
        self._due_s = due_s if due_s > now_s else now_s + self.period_s
        stamp_ns = now_ns - int((now_s - state.stamp_s) * NS)
        self._put_joints(state, stamp_ns, now_ns)
        if pose is not None:
            numbers = _pose_numbers(pose)
            self._pose.slots[0](*numbers)
            self._pose.put(stamp_ns, now_ns)
            if self._transform is not None:
                if self._from_tool is not None:
                    numbers = _pose_numbers(compose(pose, self._from_tool))
                self._transform.slots[0](*numbers)
                self._transform.put(stamp_ns, now_ns)
        if status.pose is not None:
            self._target.slots[0](*_pose_numbers(status.pose))
            self._target.put(stamp_ns, now_ns)
        self._twist.slots[0](*status.twist.linear, *status.twist.angular)
        self._twist.put(stamp_ns, now_ns)
        if (wrench := state.wrench) is not None:
            self._wrench.slots[0](*wrench.force, *wrench.torque)
            self._wrench.put(stamp_ns, now_ns)
        self._put_status(status, flags, stamp_ns, now_ns)

    def _put_joints(self, state: RobotState, stamp_ns: int, now_ns: int) -> None:
        count = len(self._names.joints)
        if not count or len(state.joints) != count:
            return
        moving, loaded = len(state.velocities) == count, len(state.torques) == count
        template = self._joint_states.get((moving, loaded))
        if template is None:
            template = self._joint_states[moving, loaded] = self._joint_state(moving, loaded)
        template.slot("header.stamp")(stamp_ns // NS, stamp_ns % NS)
        template.slot("position")(*state.joints)
        if moving:
            template.slot("velocity")(*state.velocities)
        if loaded:
            template.slot("effort")(*state.torques)
        for publisher in self._joints:
            publisher.put(template.data, now_ns)

    def _joint_state(self, moving: bool, loaded: bool) -> Template:
        zeros = [0.0] * len(self._names.joints)
        message = default_message("sensor_msgs/msg/JointState") | {
            "name": list(self._names.joints),
            "position": zeros,
            "velocity": zeros if moving else [],
            "effort": zeros if loaded else [],
        }
        return Template("sensor_msgs/msg/JointState", message)

    def _put_status(
        self, status: ArmStatus, flags: Mapping[str, Any], stamp_ns: int, now_ns: int
    ) -> None:
        limits = () if status.arm is None else tuple(status.arm.in_words())
        texts = (status.phase, status.message, status.authority.owner, limits)
        numbers: Message = {
            "state": int(State.NOT_CONTROLLING),
            "stream": int(Stream.NONE),
            "ready": False,
            "moving": False,
            "lead_used": status.lead_used,
            "trips": status.trips,
            **flags,
        }
        self._shown = status, numbers
        same, self._status_texts = texts == self._status_texts, texts
        if same and (template := self._status_template) is not None:
            template.slot("header.stamp")(stamp_ns // NS, stamp_ns % NS)
            for name, number in numbers.items():
                template.slot(name)(number)
            self._status.put(template.data, now_ns)
            return
        message: Message = {
            "header": {"stamp": _time(stamp_ns), "frame_id": self._names.base},
            "phase": status.phase.value,
            "message": status.message,
            "authority": status.authority.owner,
            "limits": limits,
            **numbers,
        }
        # A template costs several messages: not for a text that changes all the time.
        self._status_template = Template(_STATUS, message) if same else None
        self._status.put(codec_of(_STATUS).encode(message), now_ns)

    def put_snapshot(self, text: str, now_ns: int) -> None:
        """Publish the session's snapshot as JSON."""
        self._snapshots.put(codec_of(_STRING).encode({"data": text}), now_ns)

    def put_diagnostics(self, parts: Sequence[DiagnosticStatus], now_s: float, now_ns: int) -> None:
        """Publish the faults of each part, at most once a second; with the newest status, for
        clients without cardan_msgs."""
        self._diagnostics.put(lambda: [*parts, *self._arm_part()], now_s, now_ns)

    def _arm_part(self) -> list[DiagnosticStatus]:
        if self._shown is None:
            return []
        status, numbers = self._shown
        limits = () if status.arm is None else status.arm.in_words()
        values = {
            **numbers,
            "state": State(numbers["state"]).name.lower(),
            "stream": Stream(numbers["stream"]).name.lower(),
            "phase": status.phase.value,
            "authority": status.authority.owner,
            "limits": ", ".join(limits),
        }
        level = WARN if status.message else OK
        return [DiagnosticStatus("arm", level, status.message or status.phase.value, values=values)]

    def log(self, level: int, text: str, now_ns: int) -> None:
        """Publish a line on /rosout."""
        message = default_message("rcl_interfaces/msg/Log")
        message |= {
            "stamp": _time(now_ns),
            "level": level,
            "name": self._node.full_name[1:].replace("/", "."),
            "msg": text,
        }
        self._rosout.put(codec_of("rcl_interfaces/msg/Log").encode(message), now_ns)


def _time(ns: int) -> Message:
    return {"sec": ns // NS, "nanosec": ns % NS}


def _pose_numbers(pose: Pose) -> tuple[float, ...]:
    w, x, y, z = pose.orientation
    return (*pose.position, x, y, z, w)


def _transform(pose: Pose) -> Message:
    w, x, y, z = pose.orientation
    place = pose.position
    return {
        "translation": {"x": place.x, "y": place.y, "z": place.z},
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }
