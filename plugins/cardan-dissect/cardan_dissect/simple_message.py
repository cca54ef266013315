"""scapy layers of ROS-Industrial's simple message as MotoROS uses it, with velocity mode.

Positions are rad, speeds rad/s, accelerations rad/s² (m, m/s, m/s² for a linear axis), times s.
Written from the protocol's description, independent of Cardan's codec.

`SimpleMessage(data)` dissects the message at the beginning of `data` to the layer of its type, or
to SimpleMessageBroken for an unknown type or length; it never raises. The rest of `data` is its
payload, dissected likewise: a TCP segment can hold several messages.

Byte order and size of the reals differ between controllers and are not transmitted. Each layer has
both as fields of no bytes, `byte_order` ("<" or ">") and `real_bytes` (4, or 8 with other vendors);
dissecting finds the first by the prefix, the second by the length. Building fills in a missing
prefix, numbers of groups, and zeros up to the full length of a list.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from cardan_dissect._scapy import (
    TCP,
    UDP,
    EnumField,
    Field,
    Packet,
    StrField,
    bind_bottom_up,
    bind_top_down,
)
from cardan_dissect.ports import (
    SIMPLE_MESSAGE_PORTS,
    SIMPLE_MESSAGE_RT_CONTROL_PORT,
    SIMPLE_MESSAGE_RT_PORT,
)

PREFIX_BYTES, HEADER_BYTES = 4, 12
LEAST_PREFIX, MOST_PREFIX = HEADER_BYTES, 0xFFFF
JOINTS, GROUPS, LINKS = 10, 4, 32
TOPIC, REQUEST, REPLY = 1, 2, 3
COMM_TYPES = {0: "invalid", TOPIC: "topic", REQUEST: "request", REPLY: "reply"}
REPLY_CODES = {0: "unused", 1: "SUCCESS", 2: "FAILURE"}
TIME, POSITION, VELOCITY, ACCELERATION = 1, 2, 4, 8


def _numbered(names: dict[int, str]) -> dict[int, str]:
    """Return names of consecutive numbers, from each key on; "-" stands for no name."""
    return {
        number: name
        for first, each in names.items()
        for number, name in enumerate(each.split(), first)
        if name != "-"
    }


NAMES = {
    **_numbered(
        {
            1: "PING GET_VERSION",
            10: "JOINT_POSITION JOINT_TRAJ_PT JOINT_TRAJ ROBOT_STATUS JOINT_TRAJ_PT_FULL "
            "JOINT_FEEDBACK",
            20: "READ_INPUT WRITE_OUTPUT",
            2001: "MOTO_MOTION_CTRL MOTO_MOTION_REPLY READ_IO_BIT READ_IO_BIT_REPLY WRITE_IO_BIT "
            "WRITE_IO_BIT_REPLY READ_IO_GROUP READ_IO_GROUP_REPLY WRITE_IO_GROUP "
            "WRITE_IO_GROUP_REPLY IOCTRL_REPLY READ_MREGISTER WRITE_MREGISTER",
            2016: "JOINT_TRAJ_PT_FULL_EX JOINT_FEEDBACK_EX SELECT_TOOL - GET_DH_PARAMETERS",
            2030: "RT_JOINT_STATE_EX RT_JOINT_COMMAND_EX",
            2040: "MOTO_JOINT_VELOCITY MOTO_JOINT_VELOCITY_EX MOTO_VELOCITY_INFO",
        }
    ),
    16: "JOINT_TRAJ_PT_FULL_EX (16)",
    17: "JOINT_FEEDBACK_EX (17)",
}
CHECK_MOTION_READY, CHECK_QUEUE_CNT, DISCONNECT = 200101, 200102, 200130
COMMANDS = _numbered(
    {
        200101: "CHECK_MOTION_READY CHECK_QUEUE_CNT",
        200111: "STOP_MOTION START_SERVOS STOP_SERVOS RESET_ALARM",
        200121: "START_TRAJ_MODE STOP_TRAJ_MODE",
        200130: "DISCONNECT",
        200140: "START_RT_MODE STOP_RT_MODE CHECK_TIMEOUT_CNT",
        200151: "START_VEL_MODE STOP_VEL_MODE",
    }
)
SUCCESS, BUSY, FAILURE, INVALID, ALARM, NOT_READY, MP_FAILURE = range(7)
RESULTS = _numbered({0: "SUCCESS BUSY FAILURE INVALID ALARM NOT_READY MP_FAILURE"})
INVALID_SUBCODES = _numbered(
    {
        3000: "UNSPECIFIED MSGSIZE MSGHEADER MSGTYPE GROUPNO SEQUENCE COMMAND",
        3010: "DATA DATA_START_POS DATA_POSITION DATA_SPEED DATA_ACCEL DATA_INSUFFICIENT DATA_TIME "
        "DATA_TOOLNO",
        3040: "VEL_SEQUENCE VEL_NOT_FINITE",
    }
)
NOT_READY_SUBCODES = _numbered(
    {
        5000: "UNSPECIFIED ALARM ERROR ESTOP NOT_PLAY NOT_REMOTE SERVO_OFF HOLD NOT_STARTED "
        "WAITING_ROS SKILLSEND PFL_ACTIVE INC_MOVE_ERROR",
        5040: "NOT_IN_VEL_MODE VEL_WATCHDOG OTHER_MODE_ACTIVE",
    }
)
SUBCODES = {
    FAILURE: NOT_READY_SUBCODES,  # CHECK_MOTION_READY returns FALSE with the subcodes of NOT_READY.
    INVALID: INVALID_SUBCODES,
    NOT_READY: NOT_READY_SUBCODES,
}
"""By result."""
IO_RESULTS = _numbered(
    {
        0: "OK",
        1001: "READ_ADDRESS_INVALID WRITE_ADDRESS_INVALID WRITE_VALUE_INVALID READ_API_ERROR "
        "WRITE_API_ERROR",
    }
)
TRI_STATES = {-1: "unknown", 0: "no", 1: "yes"}
MODES = {-1: "unknown", 1: "MANUAL", 2: "AUTO"}
ACTIVE_MODES = {0: "none", 1: "trajectory", 2: "velocity"}
ZEROS = (0.0,) * JOINTS


def byte_order(data: bytes | bytearray) -> str:
    """Return struct's sign for the byte order of a message, by its prefix."""
    return "<" if LEAST_PREFIX <= int.from_bytes(data[:4], "little") <= MOST_PREFIX else ">"


class GroupPoint(NamedTuple):
    """A group in 2016, 2017 and 2041."""

    group: int = 0
    valid_fields: int = 0
    time_s: float = 0.0
    positions: tuple[float, ...] = ZEROS
    velocities: tuple[float, ...] = ZEROS
    accelerations: tuple[float, ...] = ZEROS


class GroupState(NamedTuple):
    """A group in 2030."""

    group: int = 0
    positions: tuple[float, ...] = ZEROS
    velocities: tuple[float, ...] = ZEROS


class GroupCommand(NamedTuple):
    """A group in 2031."""

    group: int = 0
    velocities: tuple[float, ...] = ZEROS


class DhLink(NamedTuple):
    """A link in the reply to 2020; eight of each group, four groups."""

    theta: float = 0.0
    d: float = 0.0
    a: float = 0.0
    alpha: float = 0.0


class _Described(Field[Any, Any]):
    """Value of no bytes that describes the encoding of the others."""

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        return s


class ByteOrderField(_Described):
    """struct's sign."""

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, str]:
        return s, byte_order(s)


class RealBytesField(_Described):
    """4 or 8."""

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, int]:
        return s, 8 if _fit(type(pkt), s) == 8 else 4


class _Word:
    """A 32-bit integer in the packet's byte order."""

    words, reals = 1, 0
    letter = "i"

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        return s + struct.pack(pkt.byte_order + self.letter, val or 0)

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, int]:
        return s[4:], struct.unpack_from(pkt.byte_order + self.letter, s)[0]


class WordField(_Word, Field[Any, Any]):
    """i32."""


class UnsignedField(_Word, Field[Any, Any]):
    """u32."""

    letter = "I"


class WordEnumField(_Word, EnumField[Any]):
    """i32 with names."""


class UnsignedEnumField(_Word, EnumField[Any]):
    """u32 with names."""

    letter = "I"


class GroupCountField(WordField):
    """i32; default: number of records in the list of groups."""

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        return super().addfield(pkt, s, len(pkt.groups) if val is None else val)


class RealField(Field[Any, Any]):
    """A real of the packet's size."""

    words, reals = 0, 1

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        return s + struct.pack(pkt.byte_order + _letter(pkt.real_bytes), val)

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, float]:
        letter = _letter(pkt.real_bytes)
        return s[pkt.real_bytes :], struct.unpack_from(pkt.byte_order + letter, s)[0]


class RealsField(Field[Any, Any]):
    """Ten reals of the packet's size; fewer are followed by zeros."""

    words, reals = 0, JOINTS
    islist = 1

    def any2i(self, pkt: Any, x: Any) -> Any:
        values = list(x or ())
        if len(values) > JOINTS:
            raise ValueError(f"{self.name}: {len(values)} values, at most {JOINTS}")
        return values + [0.0] * (JOINTS - len(values))

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        return s + struct.pack(f"{pkt.byte_order}{JOINTS}{_letter(pkt.real_bytes)}", *val)

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, list[float]]:
        size = JOINTS * pkt.real_bytes
        form = f"{pkt.byte_order}{JOINTS}{_letter(pkt.real_bytes)}"
        return s[size:], list(struct.unpack_from(form, s))


class RecordsField(Field[Any, Any]):
    """List of as many records as the message's length has room for; `fixed`: constant number, with
    zeros after the given ones."""

    __slots__ = ["fixed", "record", "record_reals", "record_words"]
    words, reals = 0, 0
    islist = 1

    def __init__(self, name: str, record: Any, fixed: int | None = None) -> None:
        self.record, self.fixed = record, fixed
        flat = list(_flat(record()))
        self.record_words = sum(isinstance(value, int) for value in flat)
        self.record_reals = len(flat) - self.record_words
        Field.__init__(self, name, [])

    def any2i(self, pkt: Any, x: Any) -> Any:
        return [self.record(*record) for record in x or ()]

    def form(self, real_bytes: int) -> str:
        """Return struct's letters of one record: the integers come first."""
        return f"{self.record_words}i{self.record_reals}{_letter(real_bytes)}"

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        missing = (self.fixed or 0) - len(val)
        form = pkt.byte_order + self.form(pkt.real_bytes)
        for record in (*val, *(self.record(),) * missing):
            s += struct.pack(form, *_flat(record))
        return s

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, list[Any]]:
        form = struct.Struct(pkt.byte_order + self.form(pkt.real_bytes))
        head = _fixed_bytes(type(pkt), pkt.real_bytes)
        count = max(0, pkt.prefix - HEADER_BYTES - head) // form.size
        end = form.size * count
        return s[end:], [self._shaped(values) for values in form.iter_unpack(s[:end])]

    def _shaped(self, values: tuple[Any, ...]) -> Any:
        rest, shaped = iter(values), []
        for default in self.record():
            if isinstance(default, tuple):
                shaped.append(tuple(next(rest) for _ in default))
            else:
                shaped.append(next(rest))
        return self.record(*shaped)


def _letter(real_bytes: int) -> str:
    return "d" if real_bytes == 8 else "f"


def _flat(record: Any) -> Iterator[Any]:
    for value in record:
        if isinstance(value, tuple | list):
            yield from value
            yield from (0.0,) * (JOINTS - len(value))
        else:
            yield value


def _header(msg_type: int, comm_type: int) -> list[Any]:
    return [
        ByteOrderField("byte_order", "<"),
        RealBytesField("real_bytes", 4),
        WordField("prefix", None),
        WordEnumField("msg_type", msg_type, NAMES),
        WordEnumField("comm_type", comm_type, COMM_TYPES),
        WordEnumField("reply_code", 1 if comm_type == REPLY else 0, REPLY_CODES),
    ]


def _words(*names: str) -> list[Any]:
    return [WordField(name, 0) for name in names]


def _reals(*names: str) -> list[Any]:
    """Return ten of each."""
    return [RealsField(name, []) for name in names]


def _states(*names: str) -> list[Any]:
    return [WordEnumField(name, 0, TRI_STATES) for name in names]


HEADER_FIELDS = 6
"""Number of header fields in fields_desc; the body's follow."""


class SimpleMessage(Packet):
    """Message of either direction; dissects to the layer of its type."""

    name = "simple message"

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        return _verdict_and_layer(_pkt)[0] or SimpleMessageBroken

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        if self.fields_desc and self.getfieldval("prefix") is None:
            pkt = struct.pack(f"{self.byte_order}i", len(pkt) - PREFIX_BYTES) + pkt[4:]
        return pkt + pay

    def guess_payload_class(self, payload: bytes) -> type[Packet]:
        return SimpleMessage

    @property
    def body_fields(self) -> list[Any]:
        """Fields after the header."""
        return list(self.fields_desc[HEADER_FIELDS:])


class _FrameField(StrField):
    """Bytes of one message, or all if the prefix does not give their number."""

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, bytes]:
        size = frame_bytes(s, byte_order(s)) or len(s)
        return s[size:], s[:size]


class SimpleMessageBroken(SimpleMessage):
    """Bytes that are not a known message, with the `reason`."""

    fields_desc = [_FrameField("data", b"")]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        return pkt + pay

    @property
    def reason(self) -> str:
        """Fault of the prefix, the type or the length."""
        return _verdict_and_layer(self.data)[1]


class Ping(SimpleMessage):
    """Either way."""

    fields_desc = _header(1, REQUEST)


class GetVersion(SimpleMessage):
    """Declared and never served."""

    fields_desc = _header(2, REQUEST)


class JointPosition(SimpleMessage):
    """Controller to client, deprecated."""

    fields_desc = [*_header(10, TOPIC), WordField("sequence", 0), RealsField("positions", [])]


class JointTrajPt(SimpleMessage):
    """Client to controller; the meaning of `velocity` depends on the driver, often a ratio."""

    fields_desc = [
        *_header(11, REQUEST),
        WordField("sequence", 0),
        RealsField("positions", []),
        RealField("velocity", 0.0),
        RealField("duration_s", 0.0),
    ]


class RobotStatus(SimpleMessage):
    """Controller to client."""

    fields_desc = [
        *_header(13, TOPIC),
        *_states("drives_powered", "e_stopped"),
        WordField("error_code", 0),
        *_states("in_error", "in_motion"),
        WordEnumField("mode", 2, MODES),
        *_states("motion_possible"),
    ]


def _point(sequence: bool) -> list[Any]:
    return [
        *_words("group", *(("sequence",) if sequence else ()), "valid_fields"),
        RealField("time_s", 0.0),
        *_reals("positions", "velocities", "accelerations"),
    ]


class JointTrajPtFull(SimpleMessage):
    """Client to controller."""

    fields_desc = [*_header(14, REQUEST), *_point(True)]


class JointFeedback(SimpleMessage):
    """Controller to client."""

    fields_desc = [*_header(15, TOPIC), *_point(False)]


class MotionCtrl(SimpleMessage):
    """Client to controller."""

    fields_desc = [
        *_header(2001, REQUEST),
        *_words("group", "sequence"),
        WordEnumField("command_code", CHECK_MOTION_READY, COMMANDS),
        RealsField("values", []),
    ]


class MotionReply(SimpleMessage):
    """Controller to client; `command_code` is that of MotionCtrl or the type that is answered."""

    fields_desc = [
        *_header(2002, REPLY),
        *_words("group", "sequence"),
        WordEnumField("command_code", CHECK_MOTION_READY, {**NAMES, **COMMANDS}),
        WordEnumField("result", SUCCESS, RESULTS),
        WordField("subcode", 0),
        RealsField("values", []),
    ]


class IoErrorReply(SimpleMessage):
    """Type 2002 from the I/O server: result and subcode in place of group and sequence, and
    zeros."""

    fields_desc = [
        *_header(2002, REPLY),
        WordEnumField("result", INVALID, RESULTS),
        WordEnumField("subcode", 3000, INVALID_SUBCODES),
        *_words("unused_0", "unused_1", "unused_2"),
        RealsField("values", []),
    ]


def _io(
    name: str, request: int, reply: int, asked: str, answered: str
) -> tuple[type[SimpleMessage], type[SimpleMessage]]:
    """Return the layers of a request to the I/O server and of its reply, which can have the same
    type."""

    def layer(name: str, fields: list[Any], doc: str) -> type[SimpleMessage]:
        return type(
            name, (SimpleMessage,), {"fields_desc": fields, "__doc__": doc, "__module__": __name__}
        )

    result = UnsignedEnumField("result", 0, IO_RESULTS)
    values = {each: UnsignedField(each, 0) for each in ("address", "value")} | {"result": result}
    return (
        layer(
            name,
            [*_header(request, REQUEST), *(values[each] for each in asked.split())],
            "Client to controller.",
        ),
        layer(
            f"{name}Reply",
            [*_header(reply, REPLY), *(values[each] for each in answered.split())],
            "Controller to client.",
        ),
    )


ReadIoBit, ReadIoBitReply = _io("ReadIoBit", 2003, 2004, "address", "value result")
WriteIoBit, WriteIoBitReply = _io("WriteIoBit", 2005, 2006, "address value", "result")
ReadIoGroup, ReadIoGroupReply = _io("ReadIoGroup", 2007, 2008, "address", "value result")
WriteIoGroup, WriteIoGroupReply = _io("WriteIoGroup", 2009, 2010, "address value", "result")
# The address is the register.
ReadRegister, ReadRegisterReply = _io("ReadRegister", 2012, 2012, "address", "value result")
WriteRegister, WriteRegisterReply = _io("WriteRegister", 2013, 2013, "address value", "result")


class IoCtrlReply(SimpleMessage):
    """Declared and never sent."""

    fields_desc = [
        *_header(2011, REPLY),
        WordEnumField("result", 0, RESULTS),
        WordField("subcode", 0),
    ]


class JointTrajPtFullEx(SimpleMessage):
    """Client to controller, several groups; 16 in old captures."""

    fields_desc = [
        *_header(2016, REQUEST),
        GroupCountField("group_count", None),
        WordField("sequence", 0),
        RecordsField("groups", GroupPoint),
    ]


class JointFeedbackEx(SimpleMessage):
    """Controller to client; always with room for four groups; 17 in old captures."""

    fields_desc = [
        *_header(2017, TOPIC),
        GroupCountField("group_count", None),
        RecordsField("groups", GroupPoint, GROUPS),
    ]


class SelectTool(SimpleMessage):
    """Client to controller."""

    fields_desc = [*_header(2018, REQUEST), *_words("group", "tool", "sequence")]


class GetDhParameters(SimpleMessage):
    """Client to controller."""

    fields_desc = _header(2020, REQUEST)


class DhParameters(SimpleMessage):
    """Controller to client, of the same type as its request."""

    fields_desc = [*_header(2020, REPLY), RecordsField("links", DhLink, LINKS)]


class RtJointState(SimpleMessage):
    """Controller to client in UDP (NTNU fork), often longer than its groups need."""

    fields_desc = [
        *_header(2030, TOPIC),
        *_words("message_id", "mode"),
        GroupCountField("group_count", None),
        RecordsField("groups", GroupState),
    ]


class RtJointCommand(SimpleMessage):
    """Client to controller in UDP (NTNU fork)."""

    fields_desc = [
        *_header(2031, TOPIC),
        WordField("message_id", 0),
        GroupCountField("group_count", None),
        RecordsField("groups", GroupCommand),
    ]


class JointVelocity(SimpleMessage):
    """Client to controller, velocity mode."""

    fields_desc = [*_header(2040, TOPIC), *_point(True)]


class JointVelocityEx(SimpleMessage):
    """Client to controller, velocity mode of several groups."""

    fields_desc = [
        *_header(2041, TOPIC),
        GroupCountField("group_count", None),
        WordField("sequence", 0),
        RecordsField("groups", GroupPoint),
    ]


class VelocityInfo(SimpleMessage):
    """Client to controller."""

    fields_desc = [*_header(2042, REQUEST), WordField("group", 0)]


class VelocityInfoReply(SimpleMessage):
    """Controller to client, of the same type as its request."""

    fields_desc = [
        *_header(2042, REPLY),
        WordField("version", 1),
        WordField("ipc_us", 4000),
        WordField("watchdog_ms", 100),
        WordEnumField("active_mode", 0, ACTIVE_MODES),
        WordField("number_of_groups", 1),
        WordField("axes", 6),
        *_reals("v_max", "a_max", "pos_min", "pos_max"),
    ]


MOTION_PORT, STATE_PORT, IO_PORT = SIMPLE_MESSAGE_PORTS
SENT: tuple[tuple[type[Packet], dict[str, int], tuple[type[SimpleMessage], ...]], ...] = (
    (TCP, {"dport": MOTION_PORT}, (
        Ping, GetVersion, JointTrajPt, JointTrajPtFull, JointTrajPtFullEx, MotionCtrl, SelectTool,
        GetDhParameters, JointVelocity, JointVelocityEx, VelocityInfo,
    )),
    (TCP, {"sport": MOTION_PORT}, (MotionReply, DhParameters, VelocityInfoReply)),
    (TCP, {"sport": STATE_PORT}, (JointPosition, RobotStatus, JointFeedback, JointFeedbackEx)),
    (TCP, {"dport": IO_PORT}, (
        ReadIoBit, ReadIoGroup, WriteIoBit, WriteIoGroup, ReadRegister, WriteRegister,
    )),
    (TCP, {"sport": IO_PORT}, (
        ReadIoBitReply, ReadIoGroupReply, WriteIoBitReply, WriteIoGroupReply, ReadRegisterReply,
        WriteRegisterReply, IoErrorReply, IoCtrlReply,
    )),
    (UDP, {"dport": SIMPLE_MESSAGE_RT_PORT}, (RtJointState,)),
    (UDP, {"sport": SIMPLE_MESSAGE_RT_PORT}, (RtJointCommand,)),
)  # fmt: skip
"""All layers, by transport and the port of the controller."""


def _catalog() -> dict[int, tuple[type[SimpleMessage], ...]]:
    layers: dict[int, tuple[type[SimpleMessage], ...]] = {}
    for layer in (layer for _, _, group in SENT for layer in group if layer is not IoErrorReply):
        msg_type = layer().msg_type
        layers[msg_type] = (*layers.get(msg_type, ()), layer)
    return {**layers, 16: layers[2016], 17: layers[2017]}


CATALOG = _catalog()
"""Layers by type; the second is that of a reply with the type of its request."""


def _fixed_bytes(layer: type[Packet], real_bytes: int) -> int:
    """Return the bytes of a body without its records."""
    body: Any = layer.fields_desc[HEADER_FIELDS:]
    return sum(4 * field.words + real_bytes * field.reals for field in body)


def _fit(layer: type[Packet], data: bytes) -> int:
    """Return the size of reals with which `data` has the length of the layer; 0: no size fits."""
    order = byte_order(data)
    size = struct.unpack_from(f"{order}i", data)[0] - HEADER_BYTES
    body = layer.fields_desc[HEADER_FIELDS:]
    records = body[-1] if body and isinstance(body[-1], RecordsField) else None
    for real_bytes in (4, 8):
        rest = size - _fixed_bytes(layer, real_bytes)
        if records is None:
            if rest == 0:
                return real_bytes
            continue
        each = 4 * records.record_words + real_bytes * records.record_reals
        if rest >= 0 and rest % each == 0 and rest // each in _counts(layer, records, data, order):
            return real_bytes
    return 0


def _counts(layer: type[Packet], records: RecordsField, data: bytes, order: str) -> range:
    """Return the possible numbers of records."""
    if records.record is DhLink:
        return range(LINKS, LINKS + 1)
    words = [field.name for field in layer.fields_desc[HEADER_FIELDS:]]
    at = PREFIX_BYTES + HEADER_BYTES + 4 * words.index("group_count")
    if len(data) < at + 4:
        return range(0)
    announced = struct.unpack_from(f"{order}i", data, at)[0]
    if not 0 <= announced <= GROUPS:
        return range(0)
    return range(records.fixed or announced, GROUPS + 1)


def frame_bytes(data: bytes, order: str) -> int | None:
    """Return the bytes of the message at the beginning of `data` by its prefix; None without a
    valid prefix or a whole message."""
    if len(data) < PREFIX_BYTES:
        return None
    prefix = struct.unpack_from(f"{order}i", data)[0]
    if not LEAST_PREFIX <= prefix <= MOST_PREFIX or len(data) < PREFIX_BYTES + prefix:
        return None
    return PREFIX_BYTES + int(prefix)


def _verdict_and_layer(data: bytes) -> tuple[type[SimpleMessage] | None, str]:
    """Return the layer of the message at the beginning of `data`, or why there is none."""
    if not data:
        return None, "empty"
    if len(data) < PREFIX_BYTES:
        return None, "shorter than its prefix"
    order = byte_order(data)
    prefix = struct.unpack_from(f"{order}i", data)[0]
    if not LEAST_PREFIX <= prefix <= MOST_PREFIX:
        return None, f"prefix outside {LEAST_PREFIX} to {MOST_PREFIX}"
    if len(data) < PREFIX_BYTES + prefix:
        return None, "shorter than its prefix says"
    msg_type, comm_type = struct.unpack_from(f"{order}ii", data, PREFIX_BYTES)
    layers = CATALOG.get(msg_type)
    if layers is None:
        if msg_type in NAMES:
            return None, f"{NAMES[msg_type]} has no layout on the wire"
        return None, f"unknown message type {msg_type}"
    for layer in reversed(layers) if comm_type == REPLY else layers:
        if _fit(layer, data):
            return (IoErrorReply if _is_io_error(data, msg_type, order) else layer), ""
    return None, f"{NAMES[msg_type]} of {prefix - HEADER_BYTES} bytes"


def _is_io_error(data: bytes, msg_type: int, order: str) -> bool:
    """Return True for an I/O error: a genuine reply has a command; the I/O server's is zero after
    two words."""
    if msg_type != 2002:
        return False
    end = PREFIX_BYTES + struct.unpack_from(f"{order}i", data)[0]
    result, subcode = struct.unpack_from(f"{order}ii", data, 16)
    return result == INVALID and subcode in INVALID_SUBCODES and not any(data[24:end])


def malformed(layer: Packet) -> str | None:
    """Return why a dissected message is malformed or unknown; None: it is neither."""
    return layer.reason if isinstance(layer, SimpleMessageBroken) else None


REPLIES = tuple(layer for _, _, group in SENT for layer in group if layer().comm_type == REPLY)
TOPICS = (JointPosition, RobotStatus, JointFeedback, JointFeedbackEx, RtJointState, RtJointCommand)


def remarks(layer: SimpleMessage) -> Iterator[str]:
    """Yield unusual values of a well-formed message."""
    if isinstance(layer, REPLIES):
        usual = {REPLY}
    elif isinstance(layer, Ping):
        usual = {REQUEST, REPLY}
    else:
        usual = {TOPIC} if isinstance(layer, TOPICS) else {TOPIC, REQUEST}
    if layer.comm_type not in usual:
        yield f"comm_type {layer.comm_type}"
    if (layer.comm_type == REPLY) != (layer.reply_code in (1, 2)):
        yield f"reply_code {layer.reply_code}"
    for field in layer.body_fields:
        value = layer.getfieldval(field.name)
        if isinstance(field, RealField | RealsField | RecordsField):
            nested = value if isinstance(value, list) else [value]
            flat = [
                v for item in nested for v in (_flat(item) if isinstance(item, tuple) else [item])
            ]
            if not all(map(math.isfinite, flat)):
                yield f"{field.name} not finite"


for _port in (*SIMPLE_MESSAGE_PORTS, SIMPLE_MESSAGE_RT_CONTROL_PORT):
    bind_bottom_up(TCP, SimpleMessage, dport=_port)
    bind_bottom_up(TCP, SimpleMessage, sport=_port)
bind_bottom_up(UDP, SimpleMessage, dport=SIMPLE_MESSAGE_RT_PORT)
bind_bottom_up(UDP, SimpleMessage, sport=SIMPLE_MESSAGE_RT_PORT)
for _below, _end, _layers in SENT:
    for _layer in _layers:
        bind_top_down(_below, _layer, **_end)
