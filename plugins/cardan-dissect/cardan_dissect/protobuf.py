"""Protobuf (proto2 wire format) as scapy fields and packets, for building and dissecting.

A message is a :class:`ProtoMessage` whose ``fields_desc`` lists :class:`ProtoField` objects and
ends with ``*TAIL``. A field that is not on the wire is None. Dissecting never raises: fields
outside the schema are kept in ``unknown``, and everything from the first invalid byte on in
``rest``; :func:`faults` returns the errors. Building writes the fields in the order of
``fields_desc``, then ``unknown`` and ``rest`` unchanged; scapy's ``RawVal`` in place of a value
inserts any bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple

from cardan_dissect._scapy import Field
from cardan_dissect.layers import Block

VARINT, FIXED64, LENGTH, GROUP, GROUP_END, FIXED32 = range(6)
MAX_VARINT_BYTES = 10
MAX_TAG = 2**32 - 1


class WireError(ValueError):
    """Bytes that are not protobuf, with the reason."""


class Item(NamedTuple):
    """Tagged value, found at data[start:end]."""

    number: int
    wire_type: int
    value: Any  # int for a varint, else the bytes of the value.
    start: int
    end: int


def _varint(data: bytes, offset: int) -> tuple[int, int]:
    value = 0
    for count, byte in enumerate(data[offset : offset + MAX_VARINT_BYTES]):
        value |= (byte & 0x7F) << 7 * count
        if byte < 0x80:
            return value & (2**64 - 1), offset + count + 1
    if len(data) - offset < MAX_VARINT_BYTES:
        raise WireError("ends inside a varint")
    raise WireError(f"varint longer than {MAX_VARINT_BYTES} bytes")


def _tag(data: bytes, offset: int) -> tuple[int, int, int]:
    tag, offset = _varint(data, offset)
    if not 8 <= tag <= MAX_TAG:
        raise WireError("field number out of range")
    return tag >> 3, tag & 7, offset


def _value(data: bytes, wire_type: int, offset: int) -> tuple[Any, int]:
    if wire_type == VARINT:
        return _varint(data, offset)
    if wire_type == LENGTH:
        length, offset = _varint(data, offset)
    elif wire_type in (FIXED64, FIXED32):
        length = 8 if wire_type == FIXED64 else 4
    else:
        raise WireError(f"wire type {wire_type} where a value should begin")
    if offset + length > len(data):
        raise WireError("ends inside a field")
    return data[offset : offset + length], offset + length


def _group_end(data: bytes, number: int, offset: int) -> int:
    """Return the offset after the group that field `number` opened, with nested groups."""
    opened = [number]
    while opened:
        if offset >= len(data):
            raise WireError("ends inside a group")
        inner, wire_type, offset = _tag(data, offset)
        if wire_type == GROUP:
            opened.append(inner)
        elif wire_type == GROUP_END:
            if opened.pop() != inner:
                raise WireError("group closed by another field number")
        else:
            _, offset = _value(data, wire_type, offset)
    return offset


def scan(data: bytes) -> Iterator[Item]:
    """Yield the tagged values of a message in wire order. Raises WireError at the first invalid
    one."""
    offset = 0
    while offset < len(data):
        start = offset
        number, wire_type, offset = _tag(data, start)
        if wire_type == GROUP:
            end = _group_end(data, number, offset)
            yield Item(number, wire_type, data[offset:end], start, end)
        else:
            value, end = _value(data, wire_type, offset)
            yield Item(number, wire_type, value, start, end)
        offset = end


def varint(value: int) -> bytes:
    """Encode `value` as a varint; a negative one as its 64-bit two's complement."""
    value &= 2**64 - 1
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def tagged(number: int, wire_type: int, body: bytes) -> bytes:
    """Encode a tag and its body; a length-delimited one has a length between."""
    if wire_type == LENGTH:
        body = varint(len(body)) + body
    return varint(number << 3 | wire_type) + body


class ProtoField(Field[Any, Any]):
    """Field of a message; `number` as in the schema, value None if absent."""

    __slots__ = ["number", "required"]
    wire_types: tuple[int, ...] = (VARINT,)

    def __init__(self, name: str, number: int, required: bool = False) -> None:
        self.number, self.required = number, required
        Field.__init__(self, name, None, "B")

    def take(self, old: Any, item: Item) -> Any:
        """Return the value after one more occurrence on the wire."""
        raise NotImplementedError

    def finish(self, taken: Any) -> Any:
        """Return the value after the last occurrence."""
        return taken

    def encode(self, value: Any) -> bytes:
        """Encode the value with its tag."""
        raise NotImplementedError

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        return s if val is None else s + self.encode(val)


class UInt(ProtoField):
    """uint32 or, with bits=64, uint64. Building does not cut a value to the width."""

    __slots__ = ["bits"]

    def __init__(self, name: str, number: int, required: bool = False, bits: int = 32) -> None:
        self.bits = bits
        ProtoField.__init__(self, name, number, required)

    def take(self, old: Any, item: Item) -> int:
        return int(item.value) & (1 << self.bits) - 1

    def encode(self, value: Any) -> bytes:
        return tagged(self.number, VARINT, varint(int(value)))


class Bool(UInt):
    """bool; anything but 0 is true."""

    def take(self, old: Any, item: Item) -> bool:
        return bool(item.value)


class Enum(UInt):
    """An enum, an int in the packet; building takes the name as well."""

    __slots__ = ["names"]

    def __init__(
        self, name: str, number: int, names: tuple[str, ...], required: bool = False
    ) -> None:
        self.names = names
        UInt.__init__(self, name, number, required)

    def any2i(self, pkt: Any, x: Any) -> Any:
        return self.names.index(x) if isinstance(x, str) else x

    def i2repr(self, pkt: Any, x: Any) -> str:
        return self.symbol(x) if isinstance(x, int) else repr(x)

    def symbol(self, value: int) -> str:
        """Return the name of `value`, or the number itself if the schema has none."""
        return self.names[value] if 0 <= value < len(self.names) else str(value)

    def take(self, old: Any, item: Item) -> int:
        value = UInt.take(self, old, item)
        return value - 2**32 if value >= 2**31 else value


class Double(ProtoField):
    """double."""

    wire_types = (FIXED64,)

    def take(self, old: Any, item: Item) -> float:
        return float(struct.unpack("<d", item.value)[0])

    def encode(self, value: Any) -> bytes:
        return tagged(self.number, FIXED64, struct.pack("<d", value))


class Doubles(ProtoField):
    """repeated double, at most `most` of them by the protocol. Written unpacked, read both ways."""

    __slots__ = ["most"]
    wire_types = (FIXED64, LENGTH)
    islist = 1

    def __init__(self, name: str, number: int, most: int = 6) -> None:
        self.most = most
        ProtoField.__init__(self, name, number)

    def any2i(self, pkt: Any, x: Any) -> Any:
        return list(x) if isinstance(x, tuple) else x

    def take(self, old: list[float] | None, item: Item) -> list[float]:
        if len(item.value) % 8:
            raise WireError("packed doubles of a length that is no multiple of 8")
        return [*(old or ()), *struct.unpack(f"<{len(item.value) // 8}d", item.value)]

    def encode(self, value: Any) -> bytes:
        return b"".join(tagged(self.number, FIXED64, struct.pack("<d", v)) for v in value)


class Message(ProtoField):
    """Sub-message, or bytes to be sent in its place.

    `layout` is its class, or a function that chooses the class from the content.
    """

    __slots__ = ["layout"]
    wire_types = (LENGTH,)
    holds_packets = 1

    def __init__(
        self, name: str, number: int, layout: Callable[[bytes], Any], required: bool = False
    ) -> None:
        self.layout = layout
        ProtoField.__init__(self, name, number, required)

    def take(self, old: bytes | None, item: Item) -> bytes:
        # Joined contents are the merged message, by the format's rule for repeated occurrences. A
        # broken one must not borrow its missing bytes from the next.
        for _ in scan(old or b""):
            pass
        return (old or b"") + item.value

    def finish(self, taken: bytes) -> Any:
        return self.layout(taken)

    def encode(self, value: Any) -> bytes:
        return tagged(self.number, LENGTH, bytes(value))


class Verbatim(Field[Any, Any]):
    """Bytes that are sent as received."""

    def __init__(self, name: str) -> None:
        Field.__init__(self, name, b"", "B")

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        return s + bytes(val)


TAIL = (Verbatim("unknown"), Verbatim("rest"))


class ProtoMessage(Block):
    """Protobuf message; see the module's text."""

    _by_number: ClassVar[dict[int, ProtoField]] = {}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls._by_number = {f.number: f for f in cls.fields_desc if isinstance(f, ProtoField)}

    def do_dissect(self, s: bytes) -> bytes:
        taken: dict[str, Any] = {}
        unknown, end = b"", 0
        try:
            for item in scan(s):
                field = self._by_number.get(item.number)
                if field is None or item.wire_type not in field.wire_types:
                    unknown += s[item.start : item.end]
                else:
                    taken[field.name] = field.take(taken.get(field.name), item)
                end = item.end
        except WireError:
            pass
        for field in self._by_number.values():
            if field.name in taken:
                self.fields[field.name] = field.finish(taken[field.name])
        for name, verbatim in (("unknown", unknown), ("rest", s[end:])):
            if verbatim:
                self.fields[name] = verbatim
        # Without raw_packet_cache: scapy's misses a change two messages down.
        self.explicit = 1
        return b""


def faults(message: ProtoMessage) -> Iterator[str]:
    """Why the bytes of `message` are not that message: broken wire format, required field absent.

    Few different texts, so that they can be counted.
    """
    name = type(message).__name__
    for field in message._by_number.values():
        value = message.getfieldval(field.name)
        if isinstance(value, ProtoMessage):
            yield from faults(value)
        elif value is None and field.required:
            yield f"{name} lacks {field.name}"
    if message.rest:
        yield f"{name}: {_reason(message)}"


def _reason(message: ProtoMessage) -> str:
    try:
        for item in scan(message.rest):
            field = message._by_number.get(item.number)
            if field is not None and item.wire_type in field.wire_types:
                field.take(None, item)
    except WireError as error:
        return str(error)
    return "repeats a broken sub-message"


def unknown_numbers(message: ProtoMessage) -> list[int]:
    """Return field numbers kept in `unknown`, those of sub-messages included, in order."""
    numbers = []
    for value in message.fields.values():
        if isinstance(value, ProtoMessage):
            numbers += unknown_numbers(value)
    return numbers + [item.number for item in scan(message.unknown)]
