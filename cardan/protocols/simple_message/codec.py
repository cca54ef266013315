"""Codec of simple message. Decoding never raises: see `MalformedMessage`."""

from __future__ import annotations

import operator
import struct
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import chain
from typing import Any, cast, get_args, get_type_hints

from cardan.protocols.simple_message import messages as m
from cardan.protocols.simple_message.codes import MessageType as T, name_of
from cardan.protocols.simple_message.framing import (
    HEADER_BYTES,
    PREFIX_BYTES,
    ByteOrder,
    detect_byte_order,
)

_TOP_BYTES = PREFIX_BYTES + HEADER_BYTES

_BODIES: Mapping[int, tuple[type[m.Body], ...]] = {
    int(each): bodies for each, bodies in m.BODIES.items()
}
_LETTERS = {int: "i", m.Unsigned: "I", float: "f", m.Joints: f"{m.JOINTS}f"}


def _hints(body: type[Any]) -> list[Any]:
    return list(get_type_hints(body, include_extras=True).values())


def letters(body: type[Any]) -> list[str]:
    """Return struct's letters of each field of a body on the wire: "f" for a real of either length,
    "" for a field of several records."""
    return [_LETTERS.get(hint, "") for hint in _hints(body)]


class _Record:
    """A body, or a group in one, of constant length."""

    def __init__(self, body: type[Any], order: ByteOrder, real: str) -> None:
        parts = self._parts(body)
        words = "".join(parts).replace("f", real)
        self.struct = struct.Struct(f"{order.value}{words}")
        self.whole = struct.Struct(f"{order.value}iiii{words}")
        places, at = list[int | slice](), 0
        for part in parts:
            many = int(part[:-1] or 1)
            places.append(at if len(part) == 1 else slice(at, at + many))
            at += many
        self._lists = [isinstance(place, slice) for place in places]
        self._shaped = operator.itemgetter(*places) if any(self._lists) else None
        self._make = body._make

    def _parts(self, body: type[Any]) -> list[str]:
        """Return the letters of each field."""
        return letters(body)

    def unpack(self, data: bytes, at: int = _TOP_BYTES) -> Any:
        values = self.struct.unpack_from(data, at)
        return self._make(values if self._shaped is None else self._shaped(values))

    def pack(self, message: m.Message) -> bytes:
        length = HEADER_BYTES + self.struct.size
        body: Sequence[Any] = message.body
        top = (length, message.msg_type, message.comm_type, message.reply_code)
        if self._shaped is None:
            return self.whole.pack(*top, *body)
        values: list[Any] = list(top)
        for value, listed in zip(body, self._lists, strict=True):
            if listed:
                values += value
            else:
                values.append(value)
        return self.whole.pack(*values)


class _DhRecord(_Record):
    """All links of all groups."""

    def _parts(self, body: type[Any]) -> list[str]:
        return [f"{m.MAX_GROUPS * m.DH_LINKS * len(m.DhLink._fields)}f"]

    def unpack(self, data: bytes, at: int = _TOP_BYTES) -> m.DhParameters:
        values = self.struct.unpack_from(data, at)
        links = [m.DhLink(*values[n : n + 4]) for n in range(0, len(values), 4)]
        return m.DhParameters(
            tuple(tuple(links[n : n + m.DH_LINKS]) for n in range(0, len(links), m.DH_LINKS))
        )

    def pack(self, message: m.Message) -> bytes:
        groups = cast(m.DhParameters, message.body).groups
        flat = tuple(chain.from_iterable(chain.from_iterable(groups)))
        return super().pack(message._replace(body=cast(Any, (flat,))))


class _Groups:
    """A body of some words followed by groups. One of the words is the number of groups."""

    def __init__(self, body: type[Any], order: ByteOrder, real: str) -> None:
        *words, groups = _hints(body)
        self.group = _Record(get_args(groups)[0], order, real)
        self._fixed = m.MAX_GROUPS if body is m.JointFeedbackEx else 0
        """Fixed number of groups on the wire; 0: the number of groups in the body."""
        self._counted_last = body in (m.RtJointState, m.RtJointCommand)
        """True: the number is the last word, otherwise the first. NTNU's firmware, whose bodies
        these are, always sends the largest number of groups."""
        self.head = struct.Struct(f"{order.value}{len(words) + (not self._fixed)}i")
        self.least = self.head.size + self._fixed * self.group.struct.size
        self._make = body._make

    def unpack(self, msg_type: int, data: bytes) -> m.Body | m.MalformedMessage:
        if len(data) < self.head.size:
            return _wrong_length(msg_type, data, (self.head.size,))
        words = self.head.unpack_from(data)
        count = words[-1 if self._counted_last else 0]
        if not 0 <= count <= m.MAX_GROUPS:
            return m.MalformedMessage(f"{name_of(T, msg_type)} of {count} groups", msg_type)
        ends = range(
            self.head.size,
            self.head.size + (self._fixed or count) * self.group.struct.size + 1,
            self.group.struct.size,
        )
        if len(data) != ends[-1] and not (self._counted_last and len(data) > ends[-1]):
            return _wrong_length(msg_type, data, (ends[-1],))
        groups = tuple([self.group.unpack(data, at) for at in ends[:-1]])
        if not self._fixed:
            words = words[:-1] if self._counted_last else words[1:]
        return self._make((*words, groups))  # type: ignore[no-any-return]

    def pack(self, body: Sequence[Any]) -> bytes:
        *words, groups = body
        if self._fixed and len(groups) != self._fixed:
            raise ValueError(f"{len(groups)} groups; it must be {self._fixed}")
        if len(groups) > m.MAX_GROUPS:
            raise ValueError(f"{len(groups)} groups; at most {m.MAX_GROUPS}")
        if not self._fixed:
            words.insert(len(words) if self._counted_last else 0, len(groups))
        data = [self.head.pack(*words)]
        for group in groups:
            values: list[Any] = []
            for value in group:
                if isinstance(value, tuple):
                    values += value
                else:
                    values.append(value)
            data.append(self.group.struct.pack(*values))
        return b"".join(data)


def _wrong_length(msg_type: int, data: bytes, sizes: Iterable[int]) -> m.MalformedMessage:
    allowed = " or ".join(map(str, sizes))
    name = name_of(T, msg_type)
    return m.MalformedMessage(
        f"{name} with a body of {len(data)} B; it must be {allowed}", msg_type
    )


class WireFormat:
    """Simple message in one byte order and with one length of reals.

    MotoROS and other vendors' drivers built for it have reals of 4 bytes; `real_bytes` 8 is for
    those built with double precision.
    """

    def __init__(self, byte_order: ByteOrder = ByteOrder.LITTLE, real_bytes: int = 4) -> None:
        if real_bytes not in (4, 8):
            raise ValueError(f"real_bytes: {real_bytes!r} is not allowed; it must be 4 or 8")
        self.byte_order, self.real_bytes = byte_order, real_bytes
        real = "f" if real_bytes == 4 else "d"
        self._top = struct.Struct(f"{byte_order.value}4i")
        self._records: dict[type[m.Body], _Record] = {}
        self._groups: dict[type[m.Body], _Groups] = {}
        for body in {body for bodies in m.BODIES.values() for body in bodies}:
            if body is m.DhParameters:
                self._records[body] = _DhRecord(body, byte_order, real)
            elif "" in letters(body):
                self._groups[body] = _Groups(body, byte_order, real)
            else:
                self._records[body] = _Record(body, byte_order, real)
        self._by_length = {
            (int(msg_type), self._records[body].struct.size): self._records[body]
            for msg_type, bodies in m.BODIES.items()
            for body in bodies
            if body in self._records
        }

    def request_bytes(self, msg_type: T) -> int:
        """Return the length of a request of this type, prefix included, without its groups."""
        body = m.BODIES[msg_type][0]
        record = self._records.get(body)
        return _TOP_BYTES + (self._groups[body].least if record is None else record.struct.size)

    def encode(self, message: m.Message) -> bytes:
        """Encode `message`, prefix included. Raises ValueError that names the part that does not
        fit."""
        body = message.body
        record = self._records.get(type(body))
        try:
            if record is not None:
                return record.pack(message)
            if isinstance(body, m.Raw):
                data = body.data
            elif type(body) in self._groups:
                data = self._groups[type(body)].pack(body)
            else:
                raise ValueError("no message has such a body")
        except (struct.error, OverflowError, TypeError, ValueError) as error:
            raise ValueError(f"{body!r} cannot be sent: {error}") from None
        top = self._top.pack(
            HEADER_BYTES + len(data), message.msg_type, message.comm_type, message.reply_code
        )
        return top + data

    def decode(self, data: bytes) -> m.Message | m.MalformedMessage:
        """Decode one complete message, prefix included."""
        if len(data) < _TOP_BYTES:
            return m.MalformedMessage(f"{len(data)} B, less than a header")
        length, msg_type, comm_type, reply_code = self._top.unpack_from(data)
        if length != len(data) - PREFIX_BYTES:
            return m.MalformedMessage(
                f"prefix {length}, but {len(data) - PREFIX_BYTES} B follow", msg_type
            )
        record = self._by_length.get((msg_type, length - HEADER_BYTES))
        if record is not None:
            return m.Message(msg_type, comm_type, reply_code, record.unpack(data))
        body = self._unpack(msg_type, data[_TOP_BYTES:])
        if isinstance(body, m.MalformedMessage):
            return body
        return m.Message(msg_type, comm_type, reply_code, body)

    def _unpack(self, msg_type: int, data: bytes) -> m.Body | m.MalformedMessage:
        bodies = _BODIES.get(msg_type)
        if bodies is None:
            return m.Raw(data)
        if bodies[0] in self._groups:
            return self._groups[bodies[0]].unpack(msg_type, data)
        return _wrong_length(msg_type, data, (self._records[each].struct.size for each in bodies))

    def decode_datagram(self, data: bytes) -> m.Message | m.MalformedMessage:
        """Decode the message at the start of `data`; NTNU's fork sends more bytes than its prefix
        tells."""
        if len(data) >= PREFIX_BYTES:
            length = self._top.unpack_from(data.ljust(_TOP_BYTES, b"\0"))[0]
            if HEADER_BYTES <= length < len(data) - PREFIX_BYTES:
                data = data[: PREFIX_BYTES + length]
        return self.decode(data)


_made = cache(WireFormat)


def wire(byte_order: ByteOrder = ByteOrder.LITTLE, real_bytes: int = 4) -> WireFormat:
    """Return the `WireFormat` for these, cached."""
    return _made(byte_order, real_bytes)


def detect_wire(frame: bytes) -> WireFormat | None:
    """Return the format in which `frame`, one complete message, is valid; None if there is none.

    The length of a message with reals tells their size; without reals, 4 bytes are assumed.
    """
    order = detect_byte_order(frame)
    if order is None:
        return None
    for real_bytes in (4, 8):
        found = wire(order, real_bytes)
        if isinstance(found.decode(frame), m.Message):
            return found
    return None
