"""Codec of messages as plain CDR, version 1: the encoding that all middlewares of ROS 2 share.

A message is a dictionary of its fields, nested messages are dictionaries within; ``uint8[]``,
``byte[]`` and ``char[]`` are bytes, other arrays lists. Decoding never raises: it gives a message,
or a reason. A message that is published repeatedly, with constant texts and lengths, is a
:class:`Template`: it costs one ``struct.pack_into`` for each group of numbers.

Source: OMG DDS-XTypes 1.3, 7.4.3.4 ("XCDR1, PLAIN_CDR"); alignment counts from behind the four
bytes of the encapsulation.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from operator import itemgetter
from typing import Any, NamedTuple

from cardan.protocols.ros2.interfaces import DUMMY_MEMBER, Field, message_type, revised

Message = dict[str, Any]
"""Fields of a message by name, in wire order."""

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Header of plain CDR, little-endian."""

_CODES = {
    "bool": "?", "int8": "b", "uint8": "B", "char": "B", "byte": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_SIZES = {code: struct.calcsize(f"<{code}") for code in _CODES.values()}
_PADDING = (b"", *(bytes(count) for count in range(1, 8)))
_EMPTY = struct.Struct("")
_LENGTH = {order: struct.Struct(f"{order}I") for order in "<>"}


class CdrError(ValueError):
    """A message does not fit its type; the text names the field and the reason."""


class MalformedCdr(NamedTuple):
    """Bytes that are no message of the type."""

    reason: str


class _Numbers(NamedTuple):
    """Consecutive numbers of fixed size: the leaves from `first`."""

    first: int
    codes: str


class _Array(NamedTuple):
    """Numbers, texts or messages of one type."""

    leaf: int
    field: Field
    code: str = ""
    """Number format; empty for texts and messages."""


class _Text(NamedTuple):
    leaf: int
    field: Field


_Step = _Numbers | _Array | _Text
_Shape = tuple[tuple[str, Any], ...]
"""Shape of a message: each field's name with its leaf's index, or with the nested shape."""


def _ends_empty(name: str) -> bool:
    """True if a message is empty, or its last field is an empty message."""
    last = message_type(name).fields[-1]
    return last.name == DUMMY_MEMBER or (last.nested and not last.array and _ends_empty(last.base))


@cache
def _padded(order: str, codes: str, phase: int) -> struct.Struct:
    """Format of the aligned numbers `codes`, beginning at a position that is `phase` modulo 8."""
    text, position = order, phase
    for code in codes:
        size = _SIZES[code]
        gap = -position % size
        text += f"{gap}x{code}" if gap else code
        position += gap + size
    return struct.Struct(text)


class Codec:
    """Encodes and decodes messages of one type."""

    def __init__(self, name: str) -> None:
        """Compile the codec. Raises InterfaceError for an unknown type."""
        self.name = name
        self._leaves = 0
        self._steps: list[_Step] = []
        self._shape = self._shape_of(name)
        self._ends_empty = _ends_empty(name)
        self._whole = self._ends_whole()

    def _shape_of(self, name: str) -> _Shape:
        shape: list[tuple[str, Any]] = []
        for field in message_type(name).fields:
            if field.nested and not field.array:
                shape.append((field.name, self._shape_of(field.base)))
                continue
            leaf = self._leaves
            self._leaves += 1
            shape.append((field.name, leaf))
            code = _CODES.get(field.base, "")
            if field.array:
                self._steps.append(_Array(leaf, field, code))
            elif not code:
                self._steps.append(_Text(leaf, field))
            elif self._steps and isinstance(last := self._steps[-1], _Numbers):
                self._steps[-1] = _Numbers(last.first, last.codes + code)
            else:
                self._steps.append(_Numbers(leaf, code))
        return tuple(shape)

    def encode(self, message: Mapping[str, Any]) -> bytes:
        """Encode `message` with its encapsulation, at exact length. Raises CdrError."""
        parts = [ENCAPSULATION]
        self._write(message, parts, 0)
        return b"".join(parts)

    def decode(self, data: bytes) -> Message | MalformedCdr:
        """Decode the message in `data`, of either byte order; trailing zeros are tolerated."""
        found = self._decoded(data)
        if found is None and self._ends_empty:
            # A message without fields has one byte, which some programs omit.
            found = self._decoded(b"".join((data, b"\0")))
        if found is None:
            return MalformedCdr(f"{self.name}: {len(data) - len(ENCAPSULATION)} bytes are too few")
        return found

    def _decoded(self, data: bytes) -> Message | MalformedCdr | None:
        """Decode the message in `data`; None if it is longer than the type."""
        order = {b"\x00\x01": "<", b"\x00\x00": ">"}.get(bytes(data[:2]))
        if order is None or len(data) < len(ENCAPSULATION):
            return MalformedCdr(
                f"no plain CDR: it begins with {bytes(data[:4]).hex(' ') or 'nothing'}"
            )
        body = memoryview(data)[len(ENCAPSULATION) :]
        reader = _Reader(body, order)
        try:
            message = self._read(reader)
        except _ShortError:
            return None
        except _BadError as error:
            return MalformedCdr(f"{self.name}: {error}")
        if any(body[reader.position :]):
            rest = len(body) - reader.position
            return MalformedCdr(f"{self.name}: {rest} bytes are too many")
        return message

    def exact(self, data: bytes) -> bytes:
        """Strip up to three zeros that pad `data` behind its message, as DDS does; return it
        unchanged if it is not a message of this type."""
        if self._whole:
            return data
        body = memoryview(data)[len(ENCAPSULATION) :]
        reader = _Reader(body, ">" if data[1:2] == b"\0" else "<")
        try:
            self._read(reader)
        except (_ShortError, _BadError):
            return data
        rest = body[reader.position :]
        return data if len(rest) > 3 or any(rest) else data[: len(data) - len(rest)]

    @property
    def whole(self) -> bool:
        """True if its length is always a multiple of four bytes."""
        return self._whole

    def _ends_whole(self) -> bool:
        last = self._steps[-1]
        if isinstance(last, _Text):
            return False
        if isinstance(last, _Numbers):
            return _SIZES[last.codes[-1]] >= 4
        if last.field.nested:
            return codec_of(last.field.base).whole
        return bool(last.code) and _SIZES[last.code] >= 4

    # -- encoding --------------------------------------------------------------------------------

    def _write(self, message: Mapping[str, Any], parts: list[bytes], position: int) -> int:
        values: list[Any] = []
        try:
            _flatten(self._shape, message, values)
        except KeyError as error:
            raise CdrError(f"{self.name}: the field {error} is missing") from None
        except (TypeError, AttributeError):
            raise CdrError(f"{self.name}: {message!r:.80} is not a message") from None
        for step in self._steps:
            if isinstance(step, _Numbers):
                form = _padded("<", step.codes, position & 7)
                last = step.first + len(step.codes)
                try:
                    parts.append(form.pack(*values[step.first : last]))
                except (struct.error, OverflowError) as error:
                    raise CdrError(f"{self.name}: {error}") from None
                position += form.size
            elif isinstance(step, _Text):
                position = self._write_text(values[step.leaf], step.field, parts, position)
            else:
                position = self._write_array(values[step.leaf], step, parts, position)
        return position

    def _write_text(self, text: Any, field: Field, parts: list[bytes], position: int) -> int:
        if not isinstance(text, str) or "\0" in text:
            raise CdrError(f"{self.name}: {field.name}: {text!r:.80} is not a text without NUL")
        data = text.encode("utf-8", "replace")
        if field.most_characters and len(data) > field.most_characters:
            raise CdrError(f"{self.name}: {field.name}: longer than {field.most_characters} bytes")
        gap = -position & 3
        parts.append(_PADDING[gap] + _LENGTH["<"].pack(len(data) + 1) + data + b"\0")
        return position + gap + 4 + len(data) + 1

    def _write_array(self, values: Any, step: _Array, parts: list[bytes], position: int) -> int:
        field = step.field
        if isinstance(values, (str, Mapping)) or not isinstance(values, Iterable):
            raise CdrError(f"{self.name}: {field.name}: {values!r:.80} is not an array")
        values = values if isinstance(values, (Sequence, bytes)) else list(values)
        count = len(values)
        if (field.array == "fixed" and count != field.length) or (
            field.array == "bounded" and count > field.length
        ):
            raise CdrError(f"{self.name}: {field.name} takes {field.length} elements, not {count}")
        if field.array != "fixed":
            gap = -position & 3
            parts.append(_PADDING[gap] + _LENGTH["<"].pack(count))
            position += gap + 4
        if not count:
            return position
        if field.nested:
            codec = codec_of(field.base)
            for each in values:
                position = codec._write(each, parts, position)
            return position
        if not step.code:
            for each in values:
                position = self._write_text(each, field, parts, position)
            return position
        gap = -position % _SIZES[step.code]
        try:
            data = struct.pack(f"<{count}{step.code}", *values)
        except (struct.error, OverflowError) as error:
            raise CdrError(f"{self.name}: {field.name}: {error}") from None
        parts.append(_PADDING[gap] + data)
        return position + gap + len(data)

    # -- decoding ----------------------------------------------------------------------------------

    def _read(self, reader: _Reader) -> Message:
        values: list[Any] = []
        for step in self._steps:
            if isinstance(step, _Numbers):
                values += reader.numbers(step.codes)
            elif isinstance(step, _Text):
                values.append(reader.text(step.field))
            else:
                values.append(self._read_array(step, reader))
        return _built(self._shape, values)

    def _read_array(self, step: _Array, reader: _Reader) -> Any:
        field = step.field
        count = field.length if field.array == "fixed" else reader.length(field)
        if field.nested:
            codec = codec_of(field.base)
            return [codec._read(reader) for _ in range(count)]
        if not step.code:
            return [reader.text(field) for _ in range(count)]
        return reader.array(step.code, count)


def _flatten(shape: _Shape, message: Mapping[str, Any], values: list[Any]) -> None:
    for name, inner in shape:
        if isinstance(inner, int):
            values.append(message[name])
        else:
            _flatten(inner, message[name], values)


def _built(shape: _Shape, values: Sequence[Any]) -> Message:
    return {
        name: values[inner] if isinstance(inner, int) else _built(inner, values)
        for name, inner in shape
    }


class _ShortError(Exception):
    """The bytes end before the message."""


class _BadError(Exception):
    """The bytes contradict the type."""


class _Reader:
    """Reader of values from the bytes after an encapsulation."""

    def __init__(self, body: memoryview, order: str) -> None:
        self.position = 0
        self._body, self._order = body, order

    def numbers(self, codes: str) -> tuple[Any, ...]:
        form = _padded(self._order, codes, self.position & 7)
        end = self.position + form.size
        if end > len(self._body):
            raise _ShortError
        values = form.unpack_from(self._body, self.position)
        self.position = end
        return values

    def length(self, field: Field) -> int:
        """Read the number of following elements: each has at least one byte."""
        count: int = self.numbers("I")[0]
        if field.array == "bounded" and count > field.length:
            raise _BadError(f"{field.name} has {count} elements; allowed: {field.length}")
        if count > len(self._body) - self.position:
            raise _ShortError
        return count

    def array(self, code: str, count: int) -> Any:
        if not count:
            return b"" if code == "B" else []
        size = _SIZES[code]
        begin = self.position + -self.position % size
        end = begin + count * size
        if end > len(self._body):
            raise _ShortError
        self.position = end
        if code == "B":
            return bytes(self._body[begin:end])
        return list(struct.unpack_from(f"{self._order}{count}{code}", self._body, begin))

    def text(self, field: Field) -> str:
        (count,) = self.numbers("I")
        end = self.position + count
        if end > len(self._body):
            raise _ShortError
        data = bytes(self._body[self.position : end])
        self.position = end
        data = data.rstrip(b"\0")
        if b"\0" in data:
            raise _BadError(f"{field.name} has a NUL, which no text has")
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            raise _BadError(f"{field.name} is not UTF-8") from None
        if field.most_characters and len(data) > field.most_characters:
            raise _BadError(f"{field.name} is longer than {field.most_characters} bytes")
        return text


@cache
def codec_of(name: str) -> Codec:
    """Return the codec of the message with the full name `name`. Raises InterfaceError."""
    return Codec(name)


def decoded(name: str, data: bytes) -> tuple[str, Message | MalformedCdr]:
    """Decode the message with the full name `name`; return it with its type, which may be a later,
    longer revision of `name`. Raises InterfaceError."""
    for each in filter(None, (revised(name), name)):
        message = codec_of(each).decode(data)
        if not isinstance(message, MalformedCdr):
            return each, message
    return name, message


class Template:
    """An encoded message whose numbers are overwritten in place; texts and lengths stay.

    ::

        pose = Template("geometry_msgs/msg/PoseStamped", message)
        set_stamp, set_pose = pose.slot("header.stamp"), pose.slot("pose")
        set_stamp(sec, nanosec)
        set_pose(x, y, z, qx, qy, qz, qw)
        publish(pose.data)
    """

    def __init__(self, name: str, message: Mapping[str, Any]) -> None:
        """Encode the initial message. Raises CdrError and InterfaceError."""
        self.data = bytearray(codec_of(name).encode(message))
        """Encoded message, always complete."""
        reader = _Reader(memoryview(bytes(self.data))[len(ENCAPSULATION) :], "<")
        self._places: dict[str, tuple[int, str]] = {}
        self._slots: dict[str, Callable[..., None]] = {}
        _find_places(codec_of(name), reader, "", self._places)

    def slot(self, path: str) -> Callable[..., None]:
        """Return a function that overwrites all numbers at `path` in wire order: of a field
        ("header.stamp.sec"), an array of numbers ("position"), or a message of numbers only
        ("pose", "transforms.0.transform"). Raises KeyError if there are no numbers."""
        if path not in self._slots:
            begin, form = self._numbers(path)
            self._slots[path] = partial(form.pack_into, self.data, begin)
        return self._slots[path]

    def reader(self, *paths: str) -> Callable[[bytes], tuple[float, ...] | None]:
        """Return a function that reads the numbers at `paths`, in wire order, from a message that
        equals this one otherwise; it returns None for any other. Raises KeyError as `slot` does."""
        places = sorted(map(self._numbers, paths), key=itemgetter(0))
        whole, position = bytes(self.data), 0
        same: list[tuple[slice, bytes]] = []
        for begin, form in (*places, (len(whole), _EMPTY)):
            same.append((slice(position, begin), whole[position:begin]))
            position = begin + form.size

        def read(data: bytes) -> tuple[float, ...] | None:
            if len(data) != len(whole):
                return None
            for part, content in same:
                if data[part] != content:
                    return None
            values: tuple[float, ...] = ()
            for begin, form in places:
                values += form.unpack_from(data, begin)
            return values

        return read

    def _numbers(self, path: str) -> tuple[int, struct.Struct]:
        """Return the position and format of the numbers at `path`. Raises KeyError."""
        places = [
            place
            for name, place in self._places.items()
            if name == path or name.startswith(f"{path}.")
        ]
        begin, codes = places[0][0] if places else 0, "".join(codes for _, codes in places)
        if not codes:
            raise KeyError(f"there are no numbers at {path}")
        if not all(codes for _, codes in places):
            raise KeyError(f"there is more than numbers at {path}")
        form = _padded("<", codes, begin & 7)
        last, last_codes = places[-1]
        if begin + form.size != last + len(last_codes) * _SIZES[last_codes[0]]:
            raise KeyError(f"there is more than numbers at {path}")
        return len(ENCAPSULATION) + begin, form


def _find_places(
    codec: Codec, reader: _Reader, path: str, places: dict[str, tuple[int, str]]
) -> None:
    """Find the numbers of a message by path: their position in the body, and codes; none for a
    text."""
    names = dict(_leaf_names(codec._shape, path))
    for step in codec._steps:
        if isinstance(step, _Numbers):
            for leaf, code in enumerate(step.codes, step.first):
                reader.numbers(code)
                places[names[leaf]] = (reader.position - _SIZES[code], code)
        elif isinstance(step, _Text):
            reader.text(step.field)
            places[names[step.leaf]] = (reader.position, "")
        elif step.field.nested:
            count = step.field.length if step.field.array == "fixed" else reader.length(step.field)
            for index in range(count):
                inside = f"{names[step.leaf]}.{index}."
                _find_places(codec_of(step.field.base), reader, inside, places)
        elif (count := len(codec._read_array(step, reader))) and step.code:
            place = reader.position - count * _SIZES[step.code]
            places[names[step.leaf]] = (place, step.code * count)


def _leaf_names(shape: _Shape, path: str) -> Iterator[tuple[int, str]]:
    for name, inner in shape:
        if isinstance(inner, int):
            yield inner, path + name
        else:
            yield from _leaf_names(inner, f"{path}{name}.")
