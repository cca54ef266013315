"""Bytes of simple message to values and back. Decoding never raises: a value, or `Malformed`."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache
from itertools import chain
from typing import Any, NamedTuple

from cardan.protocols.simple_message import messages as m
from cardan.protocols.simple_message.codes import MessageType as T, name_of
from cardan.protocols.simple_message.framing import (
    HEADER_BYTES,
    PREFIX_BYTES,
    ByteOrder,
    detect_byte_order,
)

_J = m.JOINTS
_POINT = (f"i i f {_J}f {_J}f {_J}f").split()
_TOP_BYTES = PREFIX_BYTES + HEADER_BYTES

# The fields of each body in order: i int32, f real, Nf N reals in one tuple.
_LAYOUTS: dict[type, str] = {
    m.Empty: "",
    m.JointPosition: f"i {_J}f",
    m.JointTrajPt: f"i {_J}f f f",
    m.RobotStatus: "i i i i i i i",
    m.JointTrajPtFull: f"i i i f {_J}f {_J}f {_J}f",
    m.JointFeedback: f"i i f {_J}f {_J}f {_J}f",
    m.MotionCtrl: f"i i i {_J}f",
    m.MotionReply: f"i i i i i {_J}f",
    m.ReadIo: "I",
    m.ReadIoReply: "I I",
    m.WriteIo: "I I",
    m.WriteIoReply: "I",
    m.IoCtrlReply: "i i",
    m.ReadRegister: "I",
    m.ReadRegisterReply: "I I",
    m.WriteRegister: "I I",
    m.WriteRegisterReply: "I",
    m.SelectTool: "i i i",
    m.JointVelocity: f"i i i f {_J}f {_J}f {_J}f",
    m.VelocityInfoRequest: "i",
    m.VelocityInfo: f"i i i i i i {_J}f {_J}f {_J}f {_J}f",
}

_BODIES: dict[int, tuple[type, ...]] = {
    T.PING: (m.Empty,),
    T.GET_VERSION: (m.Empty,),
    T.JOINT_POSITION: (m.JointPosition,),
    T.JOINT_TRAJ_PT: (m.JointTrajPt,),
    T.ROBOT_STATUS: (m.RobotStatus,),
    T.JOINT_TRAJ_PT_FULL: (m.JointTrajPtFull,),
    T.JOINT_FEEDBACK: (m.JointFeedback,),
    T.MOTO_MOTION_CTRL: (m.MotionCtrl,),
    T.MOTO_MOTION_REPLY: (m.MotionReply,),
    T.MOTO_READ_IO_BIT: (m.ReadIo,),
    T.MOTO_READ_IO_BIT_REPLY: (m.ReadIoReply,),
    T.MOTO_WRITE_IO_BIT: (m.WriteIo,),
    T.MOTO_WRITE_IO_BIT_REPLY: (m.WriteIoReply,),
    T.MOTO_READ_IO_GROUP: (m.ReadIo,),
    T.MOTO_READ_IO_GROUP_REPLY: (m.ReadIoReply,),
    T.MOTO_WRITE_IO_GROUP: (m.WriteIo,),
    T.MOTO_WRITE_IO_GROUP_REPLY: (m.WriteIoReply,),
    T.MOTO_IOCTRL_REPLY: (m.IoCtrlReply,),
    T.MOTO_READ_MREGISTER: (m.ReadRegister, m.ReadRegisterReply),
    T.MOTO_WRITE_MREGISTER: (m.WriteRegister, m.WriteRegisterReply),
    T.MOTO_SELECT_TOOL: (m.SelectTool,),
    T.MOTO_JOINT_VELOCITY: (m.JointVelocity,),
    T.MOTO_VELOCITY_INFO: (m.VelocityInfoRequest, m.VelocityInfo),
}
"""Where a type has several bodies, their lengths tell them apart."""


class _Fixed:
    """A body whose length never changes."""

    def __init__(self, body: type[Any], order: ByteOrder, real: str) -> None:
        self.body = body
        parts = _LAYOUTS[body].split()
        words = "".join(parts).replace("f", real)
        self.struct = struct.Struct(f"{order.value}{words}")
        self.whole = struct.Struct(f"{order.value}iiii{words}")
        self.flat = all(len(part) == 1 for part in parts)
        slices, at = list[tuple[int, int]](), 0
        for part in parts:
            many = int(part[:-1] or 1)
            slices.append((at, at + many if len(part) > 1 else 0))
            at += many
        self._slices = slices
        self._make = body._make

    def unpack(self, data: bytes) -> Any:
        values = self.struct.unpack_from(data, _TOP_BYTES)
        if self.flat:
            return self._make(values)
        return self._make(
            [values[first:last] if last else values[first] for first, last in self._slices]
        )

    def pack(self, length: int, message: m.Message) -> bytes:
        body: Sequence[Any] = message.body
        top = (length, message.msg_type, message.comm_type, message.reply_code)
        if self.flat:
            return self.whole.pack(*top, *body)
        values = list(top)
        for value, (_, last) in zip(body, self._slices, strict=True):
            if last:
                values += value
            else:
                values.append(value)
        return self.whole.pack(*values)


class _Ends(NamedTuple):
    """A body of a head and a number of groups."""

    head: struct.Struct
    group: struct.Struct
    fixed: int
    """So many groups always; 0: as many as the head says."""


class Wire:
    """Simple message in one byte order and with one length of reals.

    MotoROS and the drivers of other vendors that were built for it have reals of 4 bytes;
    `real_bytes` 8 is for those built with double precision.
    """

    def __init__(self, byte_order: ByteOrder = ByteOrder.LITTLE, real_bytes: int = 4) -> None:
        if real_bytes not in (4, 8):
            raise ValueError(f"real_bytes: {real_bytes!r} is not allowed; it must be 4 or 8")
        self.byte_order, self.real_bytes = byte_order, real_bytes
        real = "f" if real_bytes == 4 else "d"
        self._order, self._real = byte_order.value, real
        self._top = struct.Struct(f"{self._order}4i")
        fixed = {body: _Fixed(body, byte_order, real) for body in _LAYOUTS}
        self._fixed = fixed
        self._by_length: dict[tuple[int, int], _Fixed] = {
            (msg_type, fixed[body].struct.size): fixed[body]
            for msg_type, bodies in _BODIES.items()
            for body in bodies
        }
        point = self._struct("".join(_POINT))
        self._point = point
        groups: dict[int, _Ends] = {
            T.MOTO_JOINT_TRAJ_PT_FULL_EX: _Ends(self._struct("ii"), point, 0),
            T.MOTO_JOINT_VELOCITY_EX: _Ends(self._struct("ii"), point, 0),
            T.MOTO_JOINT_FEEDBACK_EX: _Ends(self._struct("i"), point, m.MAX_GROUPS),
            T.MOTO_RT_JOINT_STATE_EX: _Ends(self._struct("iii"), self._struct(f"i{2 * _J}f"), 0),
            T.MOTO_RT_JOINT_COMMAND_EX: _Ends(self._struct("ii"), self._struct(f"i{_J}f"), 0),
        }
        self._groups = {
            **groups,
            T.OLD_JOINT_TRAJ_PT_FULL_EX: groups[T.MOTO_JOINT_TRAJ_PT_FULL_EX],
            T.OLD_JOINT_FEEDBACK_EX: groups[T.MOTO_JOINT_FEEDBACK_EX],
        }
        self._dh = self._struct(f"{m.MAX_GROUPS * m.DH_LINKS * 4}f")

    def _struct(self, words: str) -> struct.Struct:
        return struct.Struct(self._order + words.replace("f", self._real))

    # -- to bytes ---------------------------------------------------------------------------------

    def encode(self, message: m.Message) -> bytes:
        """The bytes of `message`, prefix included. ValueError names what does not fit."""
        body = message.body
        fixed = self._fixed.get(type(body))
        try:
            if fixed is not None:
                return fixed.pack(HEADER_BYTES + fixed.struct.size, message)
            data = self._pack(body)
        except (struct.error, OverflowError, TypeError, ValueError) as error:
            raise ValueError(f"{body!r} cannot be sent: {error}") from None
        top = self._top.pack(
            HEADER_BYTES + len(data), message.msg_type, message.comm_type, message.reply_code
        )
        return top + data

    def _pack(self, body: m.Body) -> bytes:
        if isinstance(body, m.Raw):
            return body.data
        if isinstance(body, m.DhParameters):
            return self._dh.pack(*chain.from_iterable(chain.from_iterable(body.groups)))
        if isinstance(body, (m.JointTrajPtFullEx, m.JointVelocityEx)):
            groups: Sequence[Any] = body[1]
            return self._pack_groups(
                self._groups[T.MOTO_JOINT_TRAJ_PT_FULL_EX], (len(groups), body.sequence), groups
            )
        if isinstance(body, m.JointFeedbackEx):
            if len(body.feedback) != m.MAX_GROUPS:
                raise ValueError(f"{len(body.feedback)} groups; it must be {m.MAX_GROUPS}")
            kind = self._groups[T.MOTO_JOINT_FEEDBACK_EX]
            return self._pack_groups(kind, (body.groups,), body.feedback)
        if isinstance(body, m.RtJointState):
            head = (body.message_id, body.mode, len(body.states))
            return self._pack_groups(self._groups[T.MOTO_RT_JOINT_STATE_EX], head, body.states)
        if isinstance(body, m.RtJointCommand):
            return self._pack_groups(
                self._groups[T.MOTO_RT_JOINT_COMMAND_EX],
                (body.message_id, len(body.commands)),
                body.commands,
            )
        raise ValueError("no message has such a body")

    @staticmethod
    def _pack_groups(kind: _Ends, head: tuple[int, ...], groups: Sequence[Any]) -> bytes:
        if len(groups) > m.MAX_GROUPS:
            raise ValueError(f"{len(groups)} groups; at most {m.MAX_GROUPS}")
        parts = [kind.head.pack(*head)]
        for group in groups:
            values: list[float] = []
            for value in group:
                if isinstance(value, tuple):
                    values += value
                else:
                    values.append(value)
            parts.append(kind.group.pack(*values))
        return b"".join(parts)

    # -- from bytes -------------------------------------------------------------------------------

    def decode(self, data: bytes) -> m.Message | m.Malformed:
        """The message in `data`: one whole message, prefix included."""
        if len(data) < _TOP_BYTES:
            return m.Malformed(f"{len(data)} B, less than a header")
        length, msg_type, comm_type, reply_code = self._top.unpack_from(data)
        if length != len(data) - PREFIX_BYTES:
            return m.Malformed(
                f"prefix {length}, but {len(data) - PREFIX_BYTES} B follow", msg_type
            )
        fixed = self._by_length.get((msg_type, length - HEADER_BYTES))
        if fixed is not None:
            return m.Message(msg_type, comm_type, reply_code, fixed.unpack(data))
        body = self._unpack(msg_type, data[_TOP_BYTES:])
        if isinstance(body, m.Malformed):
            return body
        return m.Message(msg_type, comm_type, reply_code, body)

    def decode_datagram(self, data: bytes) -> m.Message | m.Malformed:
        """The message at the start of `data`; NTNU's fork sends more bytes than its prefix says."""
        if len(data) >= PREFIX_BYTES:
            length = self._top.unpack_from(data.ljust(_TOP_BYTES, b"\0"))[0]
            if HEADER_BYTES <= length < len(data) - PREFIX_BYTES:
                data = data[: PREFIX_BYTES + length]
        return self.decode(data)

    def _unpack(self, msg_type: int, data: bytes) -> m.Body | m.Malformed:
        if msg_type in self._groups:
            return self._unpack_groups(msg_type, data)
        if msg_type == T.MOTO_GET_DH_PARAMETERS:
            if not data:
                return m.Empty()
            if len(data) == self._dh.size:
                return _dh_parameters(self._dh.unpack(data))
            return self._wrong_length(msg_type, data, (0, self._dh.size))
        if msg_type in _BODIES:
            sizes = [self._fixed[body].struct.size for body in _BODIES[msg_type]]
            return self._wrong_length(msg_type, data, sizes)
        return m.Raw(data)

    @staticmethod
    def _wrong_length(msg_type: int, data: bytes, sizes: Sequence[int]) -> m.Malformed:
        allowed = " or ".join(map(str, sizes))
        name = name_of(T, msg_type)
        return m.Malformed(f"{name} with a body of {len(data)} B; it must be {allowed}", msg_type)

    def _unpack_groups(self, msg_type: int, data: bytes) -> m.Body | m.Malformed:
        kind = self._groups[msg_type]
        if len(data) < kind.head.size:
            return self._wrong_length(msg_type, data, (kind.head.size,))
        head = kind.head.unpack_from(data)
        told = head[0] if msg_type not in _COUNTED_LAST else head[-1]
        if not 0 <= told <= m.MAX_GROUPS:
            return m.Malformed(f"{name_of(T, msg_type)} of {told} groups", msg_type)
        there = kind.fixed or told
        size = kind.head.size + there * kind.group.size
        # NTNU's firmware always sends the groups it could have.
        if len(data) != size and not (msg_type in _COUNTED_LAST and len(data) > size):
            return self._wrong_length(msg_type, data, (size,))
        groups = [
            kind.group.unpack_from(data, kind.head.size + index * kind.group.size)
            for index in range(there)
        ]
        if msg_type == T.MOTO_RT_JOINT_STATE_EX:
            states = tuple(m.RtGroupState(v[0], v[1 : 1 + _J], v[1 + _J :]) for v in groups)
            return m.RtJointState(head[0], head[1], states)
        if msg_type == T.MOTO_RT_JOINT_COMMAND_EX:
            return m.RtJointCommand(head[0], tuple(m.RtGroupCommand(v[0], v[1:]) for v in groups))
        points = tuple(
            m.JointFeedback(
                v[0], v[1], v[2], v[3 : 3 + _J], v[3 + _J : 3 + 2 * _J], v[3 + 2 * _J :]
            )
            for v in groups
        )
        if kind.fixed:
            return m.JointFeedbackEx(told, points)
        if msg_type == T.MOTO_JOINT_VELOCITY_EX:
            return m.JointVelocityEx(head[1], points)
        return m.JointTrajPtFullEx(head[1], points)


_COUNTED_LAST = (T.MOTO_RT_JOINT_STATE_EX, T.MOTO_RT_JOINT_COMMAND_EX)
"""The number of groups is the last word of the head; of the others it is the first."""


def _dh_parameters(values: Sequence[float]) -> m.DhParameters:
    links = [m.DhLink(*values[at : at + 4]) for at in range(0, len(values), 4)]
    return m.DhParameters(
        tuple(tuple(links[at : at + m.DH_LINKS]) for at in range(0, len(links), m.DH_LINKS))
    )


_made = cache(Wire)


def wire(byte_order: ByteOrder = ByteOrder.LITTLE, real_bytes: int = 4) -> Wire:
    """The `Wire` for these; made once."""
    return _made(byte_order, real_bytes)


def detect_wire(frame: bytes) -> Wire | None:
    """The wire in which `frame`, one whole message, is right; None when in none of them.

    Reals of 8 bytes show in the length of a message that has any; of others 4 are assumed.
    """
    order = detect_byte_order(frame)
    if order is None:
        return None
    for real_bytes in (4, 8):
        found = wire(order, real_bytes)
        if isinstance(found.decode(frame), m.Message):
            return found
    return None
