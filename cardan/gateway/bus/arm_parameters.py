"""The parameters of an arm's node: ROS 2's parameter services over the interface's parameters.

Names are those of the paper's Cartesian server if it has them (Łukawski et al. 2025, Table 1); the
session's request worker reads and sets them, so that setting waits until the arm rests.
"""

from __future__ import annotations

import enum
import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from cardan.bus.node import BusNode, ServiceRequest
from cardan.common.bounds import Range
from cardan.errors import CardanError
from cardan.gateway.arm.parameters import find_rule
from cardan.gateway.arm.requests import MotionNote, PacketError, Request
from cardan.gateway.arm.vocab import FrameCode, Parameter, PolicyCode, ProfileCode, Stream
from cardan.gateway.bus.serving import CommandServer
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.parameters import (
    Declared,
    ParameterError,
    ParameterKind,
    ParameterServer,
    Value,
    set_result,
)
from cardan.protocols.ros2.refusals import refusal
from cardan.protocols.ros2.type_description import TYPE_DESCRIPTION, describe_type
from cardan.protocols.ros2.zenoh import PARAMETERS_QOS

EVENTS = "/parameter_events"
EVENT_TYPE = "rcl_interfaces/msg/ParameterEvent"

MAX_SET = 64
"""Most parameters that one request may set: an arm has fewer."""


class _Named(NamedTuple):
    """A parameter of the arm under its name on ROS 2."""

    name: str
    key: Parameter
    description: str
    codes: Mapping[str, enum.IntEnum] = {}
    """Texts of a parameter whose value is a code."""

    def declared(self) -> Declared:
        """Declaration for the node."""
        rule = find_rule(self.key)
        if self.codes:
            return Declared(
                self.name, ParameterKind.STRING, self.description, choices=tuple(self.codes)
            )
        accepted = rule.accepted
        assert isinstance(accepted, Range)
        lowest, highest = accepted.lowest, accepted.highest
        if accepted.above:  # A descriptor's ends are allowed.
            lowest = math.nextafter(lowest, math.inf)
        if accepted.below:
            highest = math.nextafter(highest, -math.inf)
        description = f"{self.description}, {accepted.unit}" if accepted.unit else self.description
        return Declared(
            self.name, ParameterKind.DOUBLE, description, lowest, highest,
            constraints=rule.allowed,
        )  # fmt: skip

    def to_ros(self, value: float) -> Value:
        """Convert the value of the arm's parameter to ROS 2's."""
        if not self.codes:
            return float(value)
        return next(text for text, code in self.codes.items() if code == value)

    def from_ros(self, value: Value) -> float:
        """Convert a checked value of ROS 2 to the arm's."""
        return float(self.codes[str(value)] if self.codes else value)


PARAMETERS = (
    _Named(
        "preset_streaming_cmd", Parameter.STREAM, "Streaming command that is accepted",
        {
            "none": Stream.NONE, "pose": Stream.POSE, "twist": Stream.TWIST,
            "wrench": Stream.WRENCH, "joint": Stream.JOINT,
        },
    ),
    _Named(
        "frame", Parameter.FRAME, "Frame of all commands: the robot's base, or its TCP",
        {"base": FrameCode.BASE, "tcp": FrameCode.TCP},
    ),
    _Named("gain", Parameter.GAIN, "Gain on the position error of velocity-controlled robots"),
    _Named("trajectory_duration", Parameter.TRAJECTORY_DURATION, "Shortest duration of movl"),
    _Named("trajectory_reference_speed", Parameter.TRAJECTORY_SPEED, "Speed of movl"),
    _Named(
        "trajectory_reference_acceleration", Parameter.TRAJECTORY_ACCELERATION,
        "Acceleration of movl and movv",
    ),
    _Named(
        "cmc_period", Parameter.CONTROL_PERIOD,
        "Period that `gain` refers to; the arm's own is that of its robot",
    ),
    _Named("wait_period", Parameter.WAIT_PERIOD, "Period at which `wait` checks for arrival"),
    _Named("rotation_reference_speed", Parameter.ROTATION_SPEED, "Angular speed of movl"),
    _Named(
        "rotation_reference_acceleration", Parameter.ROTATION_ACCELERATION,
        "Angular acceleration of movl and movv",
    ),
    _Named(
        "trajectory_reference_jerk", Parameter.TRAJECTORY_JERK,
        "Jerk of movl where trajectory_profile is jerk",
    ),
    _Named(
        "rotation_reference_jerk", Parameter.ROTATION_JERK,
        "Angular jerk of movl where trajectory_profile is jerk",
    ),
    _Named(
        "trajectory_profile", Parameter.PROFILE, "How movl gains and loses speed",
        {"trapezoid": ProfileCode.TRAPEZOID, "jerk": ProfileCode.JERK},
    ),
    _Named(
        "servo_policy", Parameter.POLICY,
        "What is kept where the arm cannot follow: the path, or the reach",
        {"path": PolicyCode.PATH, "reach": PolicyCode.REACH},
    ),
    _Named(
        "stream_timeout", Parameter.STREAM_TIMEOUT, "Silence of a stream after which the arm brakes"
    ),
    _Named("joint_speed_share", Parameter.JOINT_SPEED, "Share of the joints' speeds in movj, relj"),
    _Named(
        "joint_acceleration_share", Parameter.JOINT_ACCELERATION,
        "Share of the joints' accelerations in movj, relj",
    ),
    _Named("pose_damping", Parameter.DAMPING, "Smoothing of streamed poses"),
)  # fmt: skip
"""All parameters of the interface, those of the paper first."""

_BY_NAME = {each.name: each for each in PARAMETERS}
_BY_ARM_NAME = {find_rule(each.key).name: each for each in PARAMETERS}


def to_ros(values: Mapping[str, float]) -> dict[str, Value]:
    """Convert the values of the arm's parameters, by their names there, to ROS 2's."""
    return {
        _BY_ARM_NAME[name].name: _BY_ARM_NAME[name].to_ros(value) for name, value in values.items()
    }


class ArmParameters:
    """The parameter services of one arm's node, and its events."""

    def __init__(self, node: BusNode, server: CommandServer) -> None:
        """`node` is open; `server` passes requests on and counts refusals."""
        self.table = table = ParameterServer(each.declared() for each in PARAMETERS)
        self._node = node
        self._events = node.publisher(EVENTS, EVENT_TYPE, PARAMETERS_QOS)
        self.inputs: list[tuple[Callable[[], Any], Any]] = []
        """Polls and the clients of the worker that take their packets."""
        for name, kind, client in (
            ("get_parameters", "GetParameters", _GetClient(server, table)),
            ("get_parameter_types", "GetParameterTypes", _Answering(server, table.get_types)),
            ("describe_parameters", "DescribeParameters", _Answering(server, table.describe)),
            ("list_parameters", "ListParameters", _Answering(server, table.list_names)),
            ("set_parameters", "SetParameters", _SetClient(server, table)),
            ("set_parameters_atomically", "SetParametersAtomically", _SetAllClient(server, table)),
        ):
            self._serve(f"~/{name}", f"rcl_interfaces/srv/{kind}", client)
        self._serve("~/get_type_description", TYPE_DESCRIPTION, _Answering(server, describe_type))

    def _serve(self, name: str, type_name: str, client: _ServiceEnd) -> None:
        client.bind(name, type_name)
        service = self._node.service(name, type_name, PARAMETERS_QOS)
        self.inputs.append((service.poll, client))

    def observe(self, values: Mapping[str, float], now_ns: int) -> None:
        """Publish changes of the arm's parameters, by any client. For the loop."""
        event = self.table.event(self._node.full_name, to_ros(values), now_ns)
        if event is not None:
            self._events.put(codec_of(EVENT_TYPE).encode(event), now_ns)


class _ServiceEnd:
    """A service as a client of the worker; malformed requests are refused."""

    def __init__(self, server: CommandServer) -> None:
        self.server = server
        self._waiting: dict[int, tuple[ServiceRequest, Message]] = {}

    def bind(self, name: str, type_name: str) -> None:
        """Set the service's name and type."""
        self.name, self._type = name.rpartition("/")[2], type_name
        self._request = codec_of(f"{type_name}_Request")
        self._response = codec_of(f"{type_name}_Response")

    def take(self, packet: ServiceRequest) -> tuple[int, Message]:
        """Return a new id for a request, and its message. Raises PacketError."""
        number = self.server.next_id()
        message = self._request.decode(packet.data)
        if isinstance(message, MalformedCdr):
            self.server.refused += 1
            reason = f"{self.name}: {message.reason}"
            packet.reply(self._response.encode(refusal(self._type, reason)), time.time_ns())
            raise PacketError(reason, number)
        self._waiting[number] = packet, message
        return number, message

    def respond(self, number: int, response: Message) -> None:
        """Answer the request with this id."""
        packet, _ = self._waiting.pop(number)
        packet.reply(self._response.encode(response), time.time_ns())

    def asked(self, number: int) -> Message:
        """Return the message of a waiting request."""
        return self._waiting[number][1]

    def ended(self, note: MotionNote) -> None:
        """Do nothing: this client begins no motion."""


class _Answering(_ServiceEnd):
    """Client that is answered at once, without the arm."""

    def __init__(self, server: CommandServer, answer: Callable[[Message], Message]) -> None:
        super().__init__(server)
        self._answer = answer

    def decode(self, packet: ServiceRequest) -> None:
        number, message = self.take(packet)
        self.respond(number, self._answer(message))

    def done(self, request: Request, result: Any) -> None:
        """Do nothing: it requests nothing of the arm."""

    def refused(self, number: int | None, error: CardanError) -> None:
        """Do nothing: a malformed request was answered already."""


class _GetClient(_ServiceEnd):
    """Answers with the arm's values."""

    def __init__(self, server: CommandServer, table: ParameterServer) -> None:
        super().__init__(server)
        self._table = table

    def decode(self, packet: ServiceRequest) -> Request:
        number, _ = self.take(packet)
        return Request(number, self.server.source(packet), "get_parameters")

    def done(self, request: Request, result: Mapping[str, float]) -> None:
        self._answer(request.id, to_ros(result))

    def refused(self, number: int | None, error: CardanError) -> None:
        """Answer without values, which a session without an arm's model lacks."""
        if number in self._waiting:
            self._answer(number, {})

    def _answer(self, number: int, values: Mapping[str, Value]) -> None:
        self.respond(number, self._table.get(self.asked(number), values))


@dataclass(frozen=True)
class _Change:
    """A single change of a request to set several parameters."""

    number: int
    """Id of this change."""
    request: int
    """Id of the whole request."""
    index: int
    values: Mapping[Parameter, float]
    source: str
    packet: ServiceRequest


def _values_of(group: Mapping[str, Value]) -> dict[Parameter, float]:
    return {_BY_NAME[name].key: _BY_NAME[name].from_ros(value) for name, value in group.items()}


class _SetClient(_ServiceEnd):
    """Sets each parameter by a separate request to the arm."""

    def __init__(self, server: CommandServer, table: ParameterServer) -> None:
        super().__init__(server)
        self._table = table
        self._lock = threading.Lock()
        self._changes: dict[int, _Change] = {}
        self._results: dict[int, list[Message | None]] = {}

    def decode(self, packet: ServiceRequest | _Change) -> Request | None:
        if isinstance(packet, _Change):
            request = Request(packet.number, packet.source, "set_parameters", packet.values)
            return self.server.watched(request, packet.packet)
        number, message = self.take(packet)
        asked = message["parameters"]
        if len(asked) > MAX_SET:
            why = set_result(f"at most {MAX_SET} parameters are set at once, not {len(asked)}")
            self.respond(number, {"results": [why] * len(asked)})
            return None
        results: list[Message | None] = []
        changes, source = [], self.server.source(packet)
        for index, parameter in enumerate(asked):
            try:
                name, value = self._table.checked(parameter)
            except ParameterError as error:
                results.append(set_result(str(error)))
                continue
            results.append(None)
            values = _values_of({name: value})
            changes.append(_Change(self.server.next_id(), number, index, values, source, packet))
        with self._lock:
            self._results[number] = results
            self._changes |= {change.number: change for change in changes}
        for change in changes:
            self.server.offer(self, change)
        if not changes:
            self._finish(number)
        return None

    def done(self, request: Request, result: Any) -> None:
        self._note(request.id, "")

    def refused(self, number: int | None, error: CardanError) -> None:
        self._note(number, str(error))

    def _note(self, number: int | None, reason: str) -> None:
        with self._lock:
            change = self._changes.pop(number or 0, None)
            if change is None:
                return
            results = self._results[change.request]
            results[change.index] = set_result(reason)
            complete = None not in results
        if complete:
            self._finish(change.request)

    def _finish(self, number: int) -> None:
        with self._lock:
            results = self._results.pop(number)
        self.respond(number, {"results": results})


class _SetAllClient(_ServiceEnd):
    """Sets all parameters of a request, or none."""

    def __init__(self, server: CommandServer, table: ParameterServer) -> None:
        super().__init__(server)
        self._table = table

    def decode(self, packet: ServiceRequest) -> Request | None:
        number, message = self.take(packet)
        try:
            if len(message["parameters"]) > MAX_SET:
                raise ParameterError(f"at most {MAX_SET} parameters are set at once")
            group = self._table.checked_group(message["parameters"])
        except ParameterError as error:
            self.respond(number, {"result": set_result(str(error))})
            return None
        if not group:
            self.respond(number, {"result": set_result()})
            return None
        source = self.server.source(packet)
        request = Request(number, source, "set_parameters", _values_of(group))
        return self.server.watched(request, packet)

    def done(self, request: Request, result: Any) -> None:
        self.respond(request.id, {"result": set_result()})

    def refused(self, number: int | None, error: CardanError) -> None:
        if number in self._waiting:
            self.respond(number, {"result": set_result(str(error))})
