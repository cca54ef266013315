"""ROS 2: CDR, keys, tokens, discovery, parameters, actions, and what serves an arm on the bus."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from functools import cache
from typing import Any, Literal

from cardan.errors import CardanError
from cardan.gateway.bus.remote import parse_address
from cardan.protocols.ros2 import names, zenoh
from cardan.protocols.ros2.actions import Goals
from cardan.protocols.ros2.cdr import CdrError, Codec, MalformedCdr, codec_of
from cardan.protocols.ros2.definitions import TEXT
from cardan.protocols.ros2.interfaces import (
    FILES,
    InterfaceError,
    full_name,
    message_type,
    parse_message,
)
from cardan.protocols.ros2.messages import MessageError, completed, default_message, json_text
from cardan.protocols.ros2.parameters import (
    Declared,
    ParameterError,
    ParameterKind,
    ParameterServer,
)
from cardan.sim_peers.ros2_arm import controllers
from cardan.sim_peers.ros2_arm.options import RosArmOptions
from cardan_dds import wire
from fuzz.target import Form, Packets, Target
from fuzz.targets.common import all_finite, same, text_of
from tests.gateway.bus import bench as arm_bench


@cache
def type_names() -> tuple[str, ...]:
    """All messages that Cardan has a definition of, those of services and actions, too."""
    found = []
    for name in FILES:
        kind = name.split("/")[1]
        suffixes = {
            "msg": ("",),
            "srv": ("_Request", "_Response", "_Event"),
            "action": ("_Goal", "_Result", "_Feedback", "_SendGoal_Request", "_FeedbackMessage"),
        }[kind]
        found += [name + suffix for suffix in suffixes]
    return tuple(found)


def _sample(name: str, deep: int = 2) -> dict[str, Any]:
    """A message with an element in each of its sequences, and texts."""
    message = default_message(name)
    for field in message_type(name).fields:
        if field.array in ("sequence", "bounded"):
            if field.nested:
                message[field.name] = [_sample(field.base, deep - 1)] if deep else []
            elif field.base == "string":
                message[field.name] = ["a", "joint_1"][: field.length or 2]
            elif field.base in ("uint8", "byte", "char"):
                message[field.name] = b"\x01"
            elif field.base == "bool":
                message[field.name] = [True]
            else:
                message[field.name] = [1, 2][: field.length or 2]
        elif field.nested and not field.array:
            message[field.name] = _sample(field.base, deep)
        elif field.base == "string" and not field.array:
            message[field.name] = "text"[: field.most_characters or 9]
    return message


@cache
def _cdr_seeds() -> tuple[bytes, ...]:
    """Each message after the number of its type, in two bytes."""
    found = []
    for number, name in enumerate(type_names()):
        head = number.to_bytes(2, "little")
        found.append(head + codec_of(name).encode(default_message(name)))
        found.append(head + codec_of(name).encode(_sample(name)))
    return tuple(found)


def _cdr(data: bytes) -> object:
    number = int.from_bytes(data[:2], "little") % len(type_names())
    name, body = type_names()[number], data[2:]
    codec: Codec = codec_of(name)
    found = codec.decode(body)
    codec.exact(body)
    if isinstance(found, MalformedCdr):
        return found.reason[len(name) :]
    encoded = codec.encode(found)
    again = codec.decode(encoded)
    same(again, found)
    json_text(name, found)
    wire.exact(name, wire.padded(body))
    return number, len(body) > 64


def _message_json(data: bytes) -> object:
    """A message as JSON of a program, after the name of the type."""
    try:
        table = json.loads(data)
    except (ValueError, RecursionError):
        return None
    if not isinstance(table, dict):
        return False
    name = table.get("type")
    if not isinstance(name, str):
        return False
    full = full_name(name)
    message = completed(full, table.get("msg"))
    encoded = codec_of(full).encode(message)
    found = codec_of(full).decode(encoded)
    assert isinstance(found, dict), found
    json.loads(json_text(full, message))
    return full


@cache
def _json_seeds() -> tuple[bytes, ...]:
    found = []
    for name in type_names():
        if "_Event" not in name:
            text = json_text(name, _sample(name))
            found.append(f'{{"type": "{name}", "msg": {text}}}'.encode())
    found.append(b'{"type": "std_msgs/Header", "msg": {"stamp": {"secs": 1, "nsecs": 2}}}')
    return tuple(found)


def _definition(data: bytes) -> object:
    found = parse_message("fuzz_msgs/msg/Fuzz", text_of(data))
    return len(found.fields) > 1, len(found.constants) > 0


def _definitions() -> Iterator[bytes]:
    for name, text in itertools.islice(FILES.items(), 0, None, 7):
        if "/msg/" in name:
            yield text.encode()
    yield b'float64[<=7] value 1.0\nstring<=4 name "a # b"\nint32 A=4 # comment\n'
    yield TEXT[:600].encode()


def _zenoh(data: bytes) -> object:
    attachment = zenoh.Attachment.decode(data)
    if attachment is not None:
        same(zenoh.Attachment.decode(attachment.encode()), attachment)
        attachment.follows(0, 0)
    text = text_of(data)
    entity = zenoh.Entity.parse(text)
    if entity is not None:
        assert entity.full_node.endswith(entity.node)
        if entity.kind == zenoh.NODE or entity.type_name:
            try:
                again = zenoh.Entity.parse(entity.token(0))
            except InterfaceError:
                return "a type that is none"
            assert again is not None
            same(again.qos, entity.qos)
    zenoh.Qos.parse(text)
    names.type_of_dds(text)
    return attachment is not None, entity is not None and entity.kind


def _zenoh_seeds() -> Iterator[bytes]:
    yield zenoh.Attachment(7, 1_700_000_000_000_000_000, bytes(range(16))).encode()
    for kind in ("MP", "MS", "SS", "SC"):
        yield (
            zenoh.Entity(
                "aa11",
                "0",
                "4",
                kind,
                "/",
                "arm",
                "/arm/cmd",
                "geometry_msgs/msg/Twist",
                "RIHS01_ab",
            )
            .token(0)
            .encode()
        )
    yield zenoh.Entity("aa11", "0", "0", zenoh.NODE, "/ns", "arm").token(3).encode()
    yield zenoh.Qos(False, True, 4711, True).text().encode()


def _dds(data: bytes) -> object:
    packet = wire.ServicePacket.decode(data)
    if packet is not None:
        same(wire.ServicePacket.decode(packet.encode())[:2], packet[:2])  # type: ignore[index]
    found = []
    for gid_bytes in (16, 24):
        announced = wire.Announcement.decode(data, gid_bytes)
        found.append(announced is not None)
        if announced is not None:
            again = wire.Announcement.decode(announced.encode(gid_bytes), gid_bytes)
            assert again is not None, announced
            graph = wire.DdsGraph()
            graph.announce(announced)
            graph.nodes()
            graph.forget(announced.participant)
    pairs = wire.parsed_user_data(data)
    topic, _, kind = text_of(data).partition("|")
    name = wire.ros_name(topic, kind)
    return packet is not None, tuple(found), len(pairs) > 0, name and name.prefix


def _dds_seeds() -> Iterator[bytes]:
    cdr = codec_of("std_srvs/srv/Trigger_Response").encode({"success": True, "message": "ok"})
    yield wire.ServicePacket(0x1234, 7, cdr).encode()
    node = wire.NodeInfo("/ns/arm", (bytes(range(16)),), (bytes(range(16, 32)),) * 2)
    for gid_bytes in (16, 24):
        yield wire.Announcement(bytes(range(16)), (node, wire.NodeInfo("/b"))).encode(gid_bytes)
    yield wire.user_data({"typehash": "RIHS01_ab", "serviceid": "1.2.3"})
    for topic in ("rt/arm/cmd", "rq/arm/stopRequest", "rr/arm/stopReply"):
        yield f"{topic}|std_srvs::srv::dds_::Trigger_Request_".encode()


def _names(data: bytes) -> object:
    text = text_of(data)
    results: list[object] = []
    for function in (names.checked_name, full_name, parse_address, message_type):
        try:
            function(text)
            results.append(True)
        except (ValueError, CardanError) as error:
            results.append(type(error).__name__)
    return tuple(results)


_DECLARED = (
    Declared("speed", ParameterKind.DOUBLE, "a speed", 0.0, 1.0),
    Declared("count", ParameterKind.INTEGER, "a count", 0, 10),
    Declared("mode", ParameterKind.STRING, "a mode", choices=("a", "b")),
    Declared("on.it", ParameterKind.BOOL, "a switch"),
    Declared("name", ParameterKind.STRING, "read", read_only=True),
)
_VALUES: dict[str, Any] = {"speed": 0.5, "count": 3, "mode": "a", "on.it": True, "name": "x"}
_SERVICES = ("GetParameters", "GetParameterTypes", "DescribeParameters", "ListParameters")


def _parameters(data: bytes) -> object:
    """Requests to the parameter services, and what is answered, as bytes."""
    server = ParameterServer(_DECLARED)
    which = (*_SERVICES, "SetParameters")[data[0] % 5] if data else "GetParameters"
    request = codec_of(f"rcl_interfaces/srv/{which}_Request").decode(data[1:])
    if isinstance(request, MalformedCdr):
        return which
    if which == "SetParameters":
        try:
            found = server.checked_group(request["parameters"])
        except ParameterError as error:
            return error
        return tuple(found)
    answers = (server.get, lambda r, _v: server.get_types(r), lambda r, _v: server.describe(r))
    answers = (*answers, lambda r, _v: server.list_names(r))
    response = answers[_SERVICES.index(which)](request, _VALUES)
    codec_of(f"rcl_interfaces/srv/{which}_Response").encode(response)
    return which, len(data) > 40


def _parameter_seeds() -> Iterator[bytes]:
    names_of = [each.name for each in _DECLARED]
    for number, which in enumerate(_SERVICES[:3]):
        codec = codec_of(f"rcl_interfaces/srv/{which}_Request")
        yield bytes([number]) + codec.encode({"names": [*names_of, "strange"]})
    codec = codec_of("rcl_interfaces/srv/ListParameters_Request")
    yield b"\x03" + codec.encode({"prefixes": ["on"], "depth": 1})
    codec = codec_of("rcl_interfaces/srv/SetParameters_Request")
    value = default_message("rcl_interfaces/msg/ParameterValue")
    changes = [
        {"name": "speed", "value": {**value, "type": 3, "double_value": 0.7}},
        {"name": "mode", "value": {**value, "type": 4, "string_value": "b"}},
        {"name": "count", "value": {**value, "type": 2, "integer_value": 4}},
    ]
    yield b"\x04" + codec.encode({"parameters": changes})
    yield b"\x04" + codec.encode({"parameters": changes[:1]})


def _goals(packets: Packets) -> object:
    goals, now_s = Goals(), 0.0
    codec = codec_of("action_msgs/srv/CancelGoal_Request")
    status = codec_of("action_msgs/msg/GoalStatusArray")
    response = codec_of("action_msgs/srv/CancelGoal_Response")
    found: list[object] = []
    for packet in packets:
        now_s += 1.0
        goal = goals.accept(packet[:16].ljust(16, b"\0"), int(now_s * 1e9), now_s)
        if goal is not None and packet[16:17] > b"\x80":
            goals.execute(goal)
        request = codec.decode(packet[17:])
        if not isinstance(request, MalformedCdr):
            answer, going = goals.cancel(request)
            response.encode(answer)
            found.append((answer["return_code"], len(going) > 0))
        status.encode(goals.status_array())
    return tuple(found)


def _goal_packets() -> Iterator[Packets]:
    codec = codec_of("action_msgs/srv/CancelGoal_Request")
    ids = [bytes([number]) * 16 for number in range(4)]
    cancels = [
        codec.encode(
            {"goal_info": {"goal_id": {"uuid": each}, "stamp": {"sec": sec, "nanosec": 0}}}
        )
        for each, sec in ((ids[0], 0), (ids[1], 2), (bytes(16), 0), (bytes(16), 1))
    ]
    yield tuple(identity + b"\xff" + cancel for identity, cancel in zip(ids, cancels, strict=True))
    yield tuple(identity + b"\0" for identity in ids)


JOINT_STATE = "sensor_msgs/msg/JointState"


def _ros_arm(packets: Packets) -> object:
    """The simulated controllers of a ROS 2 arm take any message of their topics."""
    found: list[object] = []
    for controller in ("position", "velocity", "joint_state", "trajectory"):
        drive: Literal["dynamic", "ideal"] = "dynamic" if controller == "joint_state" else "ideal"
        arm = controllers.RosArm(RosArmOptions(controller=controller, drive=drive))
        now_s = 0.0
        for packet in packets:
            now_s += 0.02
            arm.receive(packet)
            for message in arm.cycle(now_s):
                all_finite(codec_of(JOINT_STATE).decode(bytes(message.data)))
            found.append(arm.taken > 0)
    return tuple(found[:8])


def _ros_arm_packets() -> Iterator[Packets]:
    names = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    names += ["wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
    array = codec_of("std_msgs/msg/Float64MultiArray")
    state = codec_of("sensor_msgs/msg/JointState")
    trajectory = codec_of("trajectory_msgs/msg/JointTrajectory")
    six = [0.0, -1.5, 1.0, 0.2, 0.3, 0.0]
    point = _sample("trajectory_msgs/msg/JointTrajectoryPoint")
    point |= {"positions": six, "velocities": [0.0] * 6, "accelerations": [], "effort": []}
    point["time_from_start"] = {"sec": 1, "nanosec": 5}
    message = {**default_message("trajectory_msgs/msg/JointTrajectory"), "joint_names": names}
    states = {**default_message("sensor_msgs/msg/JointState"), "name": names, "position": six}
    layout = default_message("std_msgs/msg/Float64MultiArray")
    yield (
        array.encode({**layout, "data": six}),
        state.encode({**states, "velocity": [0.1] * 6}),
        trajectory.encode({**message, "points": [point]}),
    )
    yield (array.encode({**layout, "data": [0.1] * 6}),) * 3


# -- an arm's server ------------------------------------------------------------------------------


@cache
def _served() -> tuple[tuple[str, str], ...]:
    """Topics that an arm subscribes to and services that it offers, with their types."""
    return tuple(arm_bench.Bench(("servo", "crtk", "fzi", "cmd_vel", "yarp")).node.types.items())


def _arm_server(packets: Packets) -> object:
    """Anything on any topic and service of an arm, each after the number of the name; afterwards
    it still answers."""
    bench = arm_bench.Bench(("servo", "crtk", "fzi", "cmd_vel", "yarp"))
    for packet in packets:
        name, type_name = _served()[packet[0] % len(_served())] if packet else _served()[0]
        if "/srv/" in type_name or "/action/" in type_name:
            bench.call(f"/{name}", data=packet[1:])
        else:
            bench.publish(f"/{name}", data=packet[1:])
            bench.poll(0.01)
    asked = bench.call("//arm/stop", {})
    assert asked.answer["success"], asked.answer
    return len(bench.requests) > 1, bench.malformed > 0, tuple(r.verb for r in bench.requests[:3])


@cache
def _arm_packets() -> tuple[Packets, ...]:
    found = []
    for number, (_name, type_name) in enumerate(_served()):
        served = "/srv/" in type_name or "/action/" in type_name
        name = f"{type_name}_Request" if served else type_name
        try:
            codec = codec_of(name)
        except InterfaceError:
            continue
        head = bytes([number])
        found.append(
            (head + codec.encode(default_message(name)), head + codec.encode(_sample(name)))
        )
    return tuple(found)


TARGETS = (
    Target("ros2.cdr", Form.BYTES, _cdr, _cdr_seeds, longest=8192),
    Target(
        "ros2.json_message",
        Form.JSON,
        _message_json,
        _json_seeds,
        raises=(InterfaceError, MessageError, CdrError),
        longest=120_000,
    ),
    Target("ros2.definition", Form.TEXT, _definition, _definitions, raises=(InterfaceError,)),
    Target(
        "ros2.zenoh",
        Form.TEXT,
        _zenoh,
        _zenoh_seeds,
        words=(b"/", b"%", b"@ros2_lv", b"::", b":", b",", b"MP", b"NN", b"dds_"),
    ),
    Target("ros2.dds", Form.BYTES, _dds, _dds_seeds, words=(b"=", b";", b"rt/", b"::dds_::")),
    Target(
        "ros2.names",
        Form.TEXT,
        _names,
        lambda: (b"/arm/cmd", b"~/x", b"geometry_msgs/Pose", b"tcp/127.0.0.1:7447", b"a/b@c"),
        longest=4096,
    ),
    Target("ros2.parameters", Form.BYTES, _parameters, _parameter_seeds, longest=4096),
    Target("ros2_arm.peer", Form.PACKETS, _ros_arm, _ros_arm_packets, longest=4096, slow_s=0.3),
    Target("ros2.arm_server", Form.PACKETS, _arm_server, _arm_packets, longest=4096, slow_s=1.0),
    Target("ros2.goals", Form.PACKETS, _goals, _goal_packets, longest=4096),
)
