"""A haptic device on the bus, under the names of YARP's wrapper for ROS 2.

The names are those of the present wrapper, and those of the paper of 2026 ("Bilateral haptic
teleoperation bridging YARP and ROS 2 ecosystems", Table 1), one table for each. Sources:
robotology/yarp-devices-ros2, hapticDevice_nws_ros2 and yarp_control_msgs. Its units are corrected:
N and N·m, and poses along the axes of the hand frame. No limits or checks of forces here: a
program's feedback goes to `FeedbackSink`, and is treated like any force.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from cardan.bus.node import BusNode, Publisher, Received, ServiceRequest
from cardan.drivers.haptic import HapticDevice
from cardan.drivers.ihaptic import IHapticDevice
from cardan.errors import CardanError, CommandError, DriverError
from cardan.gateway.bus.arm_topics import OK, WARN, DiagnosticStatus
from cardan.gateway.bus.serving import Results, key_end
from cardan.protocols.ros2.cdr import MalformedCdr, Message, Template, codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.parameters import (
    Declared,
    ParameterError,
    ParameterKind,
    ParameterServer,
    set_result,
)
from cardan.protocols.ros2.refusals import refusal
from cardan.protocols.ros2.type_description import TYPE_DESCRIPTION, describe_type
from cardan.protocols.ros2.zenoh import PARAMETERS_QOS
from cardan.types import Pose, Quaternion, Vector3

POSE, WRENCH = "geometry_msgs/msg/Pose", "geometry_msgs/msg/Wrench"
TRANSFORM, VECTOR = "geometry_msgs/msg/Transform", "geometry_msgs/msg/Vector3"
BUTTONS, FORCE_MODE = "std_msgs/msg/Int32MultiArray", "std_msgs/msg/Bool"
JOINTS = "sensor_msgs/msg/JointState"
TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"
GET_MAX = "yarp_control_msgs/srv/GetMaxFeedback"
GET_TRANSFORM = "yarp_control_msgs/srv/GetTransformation"
SET_TRANSFORM = "yarp_control_msgs/srv/SetTransformation"
EVENTS, EVENT = "/parameter_events", "rcl_interfaces/msg/ParameterEvent"

MODES = ("cartesian", "joint")
MODE = Declared(
    "mode_feedback", ParameterKind.STRING,
    "Quantity of the feedback: a force in N, or the torques of three joints in N·m", choices=MODES,
)  # fmt: skip

MAX_FEEDBACK = 8
"""Messages of all publishers together that are taken in one cycle; the newest counts."""

LOOK_PERIOD_S = 0.01
"""Period of checks for requests, of which one is answered each time: a delay of 10 ms goes
unnoticed, and a flood of them takes little of the loop's time."""

MESSAGE_BYTES, REQUEST_BYTES = 1024, 256
"""Longest message and request that are read, twice the longest valid ones: longer ones would delay
the loop, by milliseconds for a request for many parameters."""

MAX_SENDERS = 64
"""Publishers whose last outcome is remembered."""


class FeedbackSink(Protocol):
    """Receives the feedback that programs publish."""

    why_no_torques: str
    """Reason why joint torques are refused here; empty: they are accepted if the device takes
    them."""

    def give(self, publisher: int, sequence: int, asked: Vector3, now_s: float) -> str:
        """Take a feedback along the axes of the transformation, N, or the torques of the joints,
        N·m. Return why not; empty when it was taken."""

    def stop(self) -> str:
        """Render no feedback until the next one. Return why not."""


class _State(Protocol):
    """State that the tables below read and set; implemented by HapticServer."""

    haptic: IHapticDevice

    def stop(self) -> None:
        """End the feedback. Raises CardanError."""

    def set_mode(self, mode: str) -> None:
        """Set the kind of feedback. Raises CardanError."""


class _Service(NamedTuple):
    name: str
    type_name: str
    answer: Callable[[_State, Message], Message]
    """Makes the response; raises CardanError, whose text is the answer then."""
    changes: bool = False
    """True if it changes the device's output; False for a stop of the force."""


class _Taken(NamedTuple):
    topic: str
    type_name: str
    value: Callable[[Message], Any]
    """Converts a message to its value; raises CommandError."""


class HapticNames(NamedTuple):
    """A set of names."""

    state: tuple[str, ...]
    """Published topics."""
    feedback: _Taken
    services: tuple[_Service, ...]
    others: tuple[_Taken, ...] = ()
    """Further topics that are subscribed to."""


# -- values ---------------------------------------------------------------------------------------


def _xyz(v: Vector3) -> Message:
    return {"x": v[0], "y": v[1], "z": v[2]}


def _vector(message: Message) -> Vector3:
    return Vector3(message["x"], message["y"], message["z"])


def _effort(message: Message) -> Vector3:
    effort = message["effort"]
    if len(effort) != 3:
        raise CommandError(f"feedback takes three numbers of effort, not {len(effort)}")
    return Vector3(*effort)


def _pose_of(transform: Message) -> Pose:
    p, q = transform["translation"], transform["rotation"]
    return Pose(_vector(p), Quaternion(q["w"], q["x"], q["y"], q["z"]))


def _get_transform(server: _State, _request: Message) -> Message:
    position, q, _ = server.haptic.get_transformation()
    rotation = {"x": q.x, "y": q.y, "z": q.z, "w": q.w}
    return {"transform": {"translation": _xyz(position), "rotation": rotation}}


def _set_transform(server: _State, request: Message) -> Message:
    server.haptic.set_transformation(_pose_of(request["transform"]))
    return {}


def _get_max(server: _State, _request: Message) -> Message:
    return {"max_feedback": _xyz(server.haptic.get_max_feedback())}


def _stop(server: _State, _request: Message) -> Message:
    server.stop()
    return {"message": "the feedback is stopped"}


def _set_force_mode(server: _State, request: Message) -> Message:
    mode = MODES[0 if request["data"] else 1]
    server.set_mode(mode)
    return {"message": mode}


def _get_force_mode(server: _State, _request: Message) -> Message:
    return {"message": mode_of(server.haptic)}


def mode_of(haptic: IHapticDevice) -> str:
    """Return the present mode, one of MODES."""
    return MODES[0 if haptic.is_cartesian_force_mode_enabled() else 1]


# -- the tables -----------------------------------------------------------------------------------

PRESENT = HapticNames(
    ("state/pose", "state/buttons"),
    _Taken("feedback", VECTOR, _vector),
    (
        _Service("stop_feedback", TRIGGER, _stop),
        _Service("get_max_feedback", GET_MAX, _get_max),
        _Service("get_transform", GET_TRANSFORM, _get_transform),
        _Service("set_transform", SET_TRANSFORM, _set_transform, changes=True),
    ),
)
"""Names of the present wrapper; with the parameter mode_feedback."""

PAPER = HapticNames(
    ("state/pose", "state/buttons", "state/force_feedback", "state/transform", "state/force_mode"),
    _Taken("feedback", JOINTS, _effort),
    (
        _Service("stop_feedback", TRIGGER, _stop),
        _Service("set_force_mode", SET_BOOL, _set_force_mode, changes=True),
        _Service("state/force_mode", TRIGGER, _get_force_mode),
        _Service("state/max_force_feedback", GET_MAX, _get_max),
        _Service("state/transform", GET_TRANSFORM, _get_transform),
        _Service("set_transformation", SET_TRANSFORM, _set_transform, changes=True),
    ),
    (_Taken("set_transformation", TRANSFORM, _pose_of),),
)
"""Names of the paper; force_mode and set_transformation also as the topics of earlier versions."""

ALL = (PRESENT, PAPER)


class HapticServer:
    """Publishes a haptic device and takes feedback for it. For the loop's thread; never blocks."""

    def __init__(
        self,
        node: BusNode,
        device: HapticDevice,
        haptic: IHapticDevice,
        feedback: FeedbackSink | None,
        *,
        period_s: float,
    ) -> None:
        """`node` is open and used by this server alone. `haptic` belongs to `device`; without a
        `feedback` the device is published and no feedback is taken. `period_s`: shortest time
        between two states."""
        self.haptic = haptic
        self.refused = 0
        """Messages and requests that were refused."""
        self.inhibited = ""
        """Reason why only stops of the feedback are taken; empty: all is."""
        self._node, self._device, self._feedback = node, device, feedback
        self._period_s = period_s
        self._due_s = self._look_s = -math.inf
        self._topics = _Topics(node, device, haptic)
        self._parameters = ParameterServer((MODE,))
        self._events: Publisher | None = None
        self._results: Results | None = None
        self._taken: list[tuple[Callable[[], Received | None], dict[str, _Taken]]] = []
        self._services: list[tuple[Callable[[], ServiceRequest | None], _Service]] = []
        self._next = 0
        """Index of the service that is checked first the next time."""
        self._unnumbered = itertools.count(1)
        self._results_sent: dict[bytes, str] = {}
        """Last reason published to each sender of feedback; empty if accepted."""
        if feedback is not None:
            self._serve()

    def _serve(self) -> None:
        node = self._node
        self._results = Results(node)
        self._events = node.publisher(EVENTS, EVENT, PARAMETERS_QOS)
        topics: dict[str, dict[str, _Taken]] = {}
        services: dict[str, _Service] = {}
        for names in ALL:
            for taken in (names.feedback, *names.others):
                end = key_end(node.key_of("/", taken.type_name))
                topics.setdefault(taken.topic, {})[end] = taken
            services |= {each.name: each for each in names.services}
        for topic, types in topics.items():
            first = next(iter(types.values()))
            subscription = node.subscription(f"~/{topic}", first.type_name, MAX_FEEDBACK)
            self._taken.append((subscription.poll, types))
        for service in services.values():
            self._services.append(
                (node.service(f"~/{service.name}", service.type_name).poll, service)
            )
        for service in self._parameter_services():
            served = node.service(f"~/{service.name}", service.type_name, PARAMETERS_QOS)
            self._services.append((served.poll, service))

    def _parameter_services(self) -> Sequence[_Service]:
        table = self._parameters

        def of(answer: Callable[[Message], Message]) -> Callable[[_State, Message], Message]:
            return lambda _server, request: answer(request)

        return (
            *(
                _Service(name, f"rcl_interfaces/srv/{kind}", of(answer), name.startswith("set_"))
                for name, kind, answer in (
                    ("get_parameters", "GetParameters", self._get),
                    ("get_parameter_types", "GetParameterTypes", table.get_types),
                    ("describe_parameters", "DescribeParameters", table.describe),
                    ("list_parameters", "ListParameters", table.list_names),
                    ("set_parameters", "SetParameters", self._set),
                    ("set_parameters_atomically", "SetParametersAtomically", self._set_all),
                )
            ),
            _Service("get_type_description", TYPE_DESCRIPTION, of(describe_type)),
        )

    # -- for the loop ----------------------------------------------------------------------------

    def poll(self, now_s: float) -> None:
        """Take the feedback that has arrived, and answer a request from time to time."""
        for poll, types in self._taken:
            for _ in range(MAX_FEEDBACK):
                packet = poll()
                if packet is None:
                    break
                self._take(packet, types, now_s)
        if now_s - self._look_s >= LOOK_PERIOD_S:
            self._look_s = now_s
            self._answer_one()

    def publish(self, now_s: float, now_ns: int) -> None:
        """Publish the device if it is due; `now_s` monotonic, `now_ns` since the epoch."""
        if now_s < self._due_s:
            return
        due_s = self._due_s + self._period_s
        self._due_s = due_s if due_s > now_s else now_s + self._period_s
        self._topics.publish(now_ns)
        if self._events is not None:
            values = {MODE.name: mode_of(self.haptic)}
            event = self._parameters.event(self._node.full_name, values, now_ns)
            if event is not None:
                self._events.put(codec_of(EVENT).encode(event), now_ns)

    def part(self) -> DiagnosticStatus:
        """Return the diagnostics of the device and of its commands."""
        haptic = self._device.haptics()
        values = {
            "state": haptic.state.value,
            "mode_feedback": mode_of(self.haptic),
            "force_n": math.hypot(*haptic.force),
            "refused": self.refused,
        }
        level = WARN if haptic.reason or self.refused else OK
        words = f"{self.refused} messages or requests refused" if self.refused else "all read"
        return DiagnosticStatus("haptic", level, haptic.reason or words, values=values)

    # -- what the tables set ---------------------------------------------------------------------

    def stop(self) -> None:
        """End the feedback. Raises CardanError."""
        if self._feedback is not None and (why := self._feedback.stop()):
            raise CommandError(why)

    def set_mode(self, mode: str) -> None:
        """Set the kind of feedback, one of MODES, after setting it to zero. Raises CardanError."""
        if mode == mode_of(self.haptic):
            return
        if mode == MODES[1]:
            if self._feedback is not None and self._feedback.why_no_torques:
                raise CommandError(self._feedback.why_no_torques)
            self.stop()
            self.haptic.set_joint_torque_mode()
        else:
            self.stop()
            self.haptic.set_cartesian_force_mode()

    # -- feedback --------------------------------------------------------------------------------

    def _take(self, packet: Received, types: dict[str, _Taken], now_s: float) -> None:
        attachment = packet.attachment
        if attachment is None:  # It is from no ROS node: a later message is newer.
            gid, sequence = packet.zid.encode(), next(self._unnumbered)
        else:
            gid, sequence = attachment.gid, attachment.sequence
        taken = types.get(key_end(packet.key))
        name = next(iter(types.values())).topic
        try:
            if self.inhibited:
                raise CommandError(f"{name}: {self.inhibited}")
            if taken is None:
                wanted = " or ".join(each.type_name for each in types.values())
                raise CommandError(f"{name} takes {wanted}, not {packet.key.split('/')[-2]}")
            message = _decoded(taken.type_name, packet.data, MESSAGE_BYTES)
            if isinstance(message, MalformedCdr):
                raise CommandError(f"{name}: {message.reason}")
            value = taken.value(message)
            if isinstance(value, Pose):
                self.haptic.set_transformation(value)
            elif self._feedback is not None:
                publisher = int.from_bytes(gid, "little")
                if why := self._feedback.give(publisher, sequence, value, now_s):
                    raise CommandError(why)
        except CardanError as error:
            self.refused += 1
            self._tell(gid, name, sequence, str(error))
        else:
            self._tell(gid, name, sequence, "")

    def _tell(self, gid: bytes, command: str, sequence: int, reason: str) -> None:
        """Publish a changed outcome of a publisher's messages."""
        if self._results_sent.get(gid) == reason or self._results is None:
            return
        if gid not in self._results_sent and len(self._results_sent) >= MAX_SENDERS:
            self._results_sent.pop(next(iter(self._results_sent)))
        self._results_sent[gid] = reason
        outcome = "refused" if reason else "accepted"
        self._results.put(command, sequence, outcome, reason, "haptic")

    # -- services --------------------------------------------------------------------------------

    def _answer_one(self) -> None:
        count = len(self._services)
        for offset in range(count):
            at = (self._next + offset) % count
            poll, service = self._services[at]
            packet = poll()
            if packet is not None:
                self._next = (at + 1) % count
                self._answer(packet, service)
                return

    def _answer(self, packet: ServiceRequest, service: _Service) -> None:
        request = _decoded(f"{service.type_name}_Request", packet.data, REQUEST_BYTES)
        try:
            if service.changes and self.inhibited:
                raise CommandError(f"{service.name}: {self.inhibited}")
            if isinstance(request, MalformedCdr):
                raise CommandError(f"{service.name}: {request.reason}")
            response = default_message(f"{service.type_name}_Response")
            response |= service.answer(self, request)
        except CardanError as error:
            self.refused += 1
            response = refusal(service.type_name, str(error))
        else:
            if "success" in response:
                response["success"] = True
        packet.reply(codec_of(f"{service.type_name}_Response").encode(response), time.time_ns())

    def _get(self, request: Message) -> Message:
        return self._parameters.get(request, {MODE.name: mode_of(self.haptic)})

    def _set(self, request: Message) -> Message:
        return {"results": [set_result(self._set_one([each])) for each in request["parameters"]]}

    def _set_all(self, request: Message) -> Message:
        return {"result": set_result(self._set_one(request["parameters"]))}

    def _set_one(self, parameters: Sequence[Message]) -> str:
        """Set parameters together. Return why not."""
        try:
            for value in self._parameters.checked_group(parameters).values():
                self.set_mode(str(value))
        except (ParameterError, CardanError) as error:
            self.refused += 1
            return str(error)
        return ""


def _decoded(type_name: str, data: bytes, longest: int) -> Message | MalformedCdr:
    if len(data) > longest:
        return MalformedCdr(f"{len(data)} bytes are too many for {type_name}: at most {longest}")
    return codec_of(type_name).decode(data)


class _Topics:
    """The state of a haptic device."""

    def __init__(self, node: BusNode, device: HapticDevice, haptic: IHapticDevice) -> None:
        self._device, self._haptic = device, haptic
        types = {
            "state/pose": POSE,
            "state/buttons": BUTTONS,
            "state/force_feedback": WRENCH,
            "state/transform": TRANSFORM,
            "state/force_mode": FORCE_MODE,
        }
        names = dict.fromkeys(name for each in ALL for name in each.state)
        self._publishers = {name: node.publisher(f"~/{name}", types[name]) for name in names}
        templates = {
            name: Template(types[name], default_message(types[name]))
            for name in names
            if types[name] != BUTTONS
        }
        self._data: dict[str, bytes | bytearray] = {
            name: template.data for name, template in templates.items()
        }
        pose, transform = templates["state/pose"], templates["state/transform"]
        self._set_position, self._set_orientation = pose.slot("position"), pose.slot("orientation")
        self._set_translation = transform.slot("translation")
        self._set_rotation = transform.slot("rotation")
        self._set_force = templates["state/force_feedback"].slot("force")
        self._set_mode = templates["state/force_mode"].slot("data")
        self._buttons: tuple[bool, ...] | None = None

    def publish(self, now_ns: int) -> None:
        """Publish all topics of one instant; no pose while the device has none."""
        haptic = self._haptic
        try:
            position, (w, x, y, z), _ = haptic.get_pose()
        except DriverError:
            known = False
        else:
            known = True
            self._set_position(*position)
            self._set_orientation(x, y, z, w)
        position, (w, x, y, z), _ = haptic.get_transformation()
        self._set_translation(*position)
        self._set_rotation(x, y, z, w)
        self._set_force(*haptic.from_hand(self._device.haptics().force))
        self._set_mode(haptic.is_cartesian_force_mode_enabled())
        held = haptic.get_buttons()
        if held != self._buttons:
            self._buttons = held
            message = default_message(BUTTONS) | {"data": [int(each) for each in held]}
            self._data["state/buttons"] = codec_of(BUTTONS).encode(message)
        for name, publisher in self._publishers.items():
            if known or name != "state/pose":
                publisher.put(self._data[name], now_ns)
