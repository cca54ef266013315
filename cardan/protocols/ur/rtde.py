"""Real-Time Data Exchange (RTDE): packets on TCP port 30004.

A packet is its size (uint16, inclusive), its type (uint8) and a payload, all big-endian. The client
negotiates the version, sets up recipes (names of variables; the controller answers with their types
and a number), and starts; then a data package is a recipe's number and its values. This is protocol
version 2; in version 1 outputs have neither a frequency nor a number.

Source: UR's RTDE guide (public).
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from operator import itemgetter
from typing import Any, Final, NamedTuple

from cardan.protocols.ur.framing import StreamReader

RTDE_PORT: Final = 30004
VERSION: Final = 2
VERSIONS: Final = (1, 2)
"""Versions of the protocol."""
LARGEST: Final = 0xFFFF
"""Most bytes of a packet; its size has 16 bits."""

_HEADER = struct.Struct(">HB")
_DATA_HEAD = struct.Struct(">HBB")
_WORD = struct.Struct(">H")
_VERSION_REPLY = struct.Struct(">4I")
_LONGEST_TEXT: Final = _HEADER.size + 2 * 256 + 1
"""Most bytes of a packet with a message, the longest before the version is negotiated."""
_FREQUENCY = struct.Struct(">d")


class PacketType(enum.IntEnum):
    """Type of a packet; a reply has its request's."""

    PROTOCOL_VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


_KINDS: Final = frozenset(PacketType)
_SETUPS: Final = (PacketType.OUTPUTS, PacketType.INPUTS)
_DATA: Final = int(PacketType.DATA)


class TextLevel(enum.IntEnum):
    """Severity of a text message."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


class MalformedPayload(NamedTuple):
    """A payload that cannot be decoded."""

    reason: str


class Accepted(NamedTuple):
    """Reply to the version, to start and to pause."""

    kind: PacketType
    accepted: bool


class ControllerVersion(NamedTuple):
    """Version of the controller's software."""

    major: int
    minor: int
    bugfix: int
    build: int


E_SERIES_RATE_HZ: Final = 500.0
CB3_RATE_HZ: Final = 125.0
CB3_MAJOR: Final = 3
"""Major version of PolyScope: 3 is a CB3; 5 and later are e-Series and successors."""


def control_rate_hz(version: ControllerVersion | None) -> float:
    """Return the rate of a controller's control loop; an e-Series' if the version is unknown."""
    return CB3_RATE_HZ if version is not None and version.major <= CB3_MAJOR else E_SERIES_RATE_HZ


class TextMessage(NamedTuple):
    """Text message."""

    text: str
    source: str
    level: int


class RecipeSetup(NamedTuple):
    """A client's request for a recipe."""

    kind: PacketType
    """OUTPUTS or INPUTS."""
    names: tuple[str, ...]
    frequency_hz: float = 0.0
    """Rate of outputs, Hz."""


class SetupReply(NamedTuple):
    """Number of the recipe, 0 if refused, and the type of each of its variables, or NOT_FOUND, or
    IN_USE. In version 1 outputs have no number: 1 if all were found."""

    kind: PacketType
    recipe: int
    types: tuple[str, ...]


class Data(NamedTuple):
    """Data package, whose recipe defines its values. In version 1 a controller's has no number:
    0."""

    recipe: int
    values: bytes


class ControlRequest(NamedTuple):
    """A request without a payload, or with the requested protocol version."""

    kind: PacketType
    version: int = 0


NOT_FOUND: Final = "NOT_FOUND"
IN_USE: Final = "IN_USE"


def packet(kind: PacketType, payload: bytes = b"") -> bytes:
    """Encode a packet. Raises ValueError if it is too long."""
    size = _HEADER.size + len(payload)
    if size > LARGEST:
        raise ValueError(f"{size} bytes: an RTDE packet has at most {LARGEST}")
    return _HEADER.pack(size, kind) + payload


# -- the client's packets --------------------------------------------------------------------------


def ask_version(version: int = VERSION) -> bytes:
    """Encode the request for a protocol version."""
    return packet(PacketType.PROTOCOL_VERSION, _WORD.pack(version))


def ask_outputs(frequency_hz: float, names: Sequence[str]) -> bytes:
    """Encode the request for data packages with these variables."""
    return packet(PacketType.OUTPUTS, _FREQUENCY.pack(frequency_hz) + ",".join(names).encode())


def ask_inputs(names: Sequence[str]) -> bytes:
    """Encode the request to write these variables."""
    return packet(PacketType.INPUTS, ",".join(names).encode())


def text(message: str, source: str, level: TextLevel, version: int = VERSION) -> bytes:
    """Encode a text message; text and source are truncated to 255 bytes, and version 1 has no
    source."""
    said, by = message.encode()[:255], source.encode()[:255]
    if version == 1:
        return packet(PacketType.TEXT, bytes([level]) + said)
    return packet(
        PacketType.TEXT, bytes([len(said)]) + said + bytes([len(by)]) + by + bytes([level])
    )


# -- the controller's packets ----------------------------------------------------------------------


def reply_accepted(kind: PacketType, accepted: bool) -> bytes:
    """Encode the answer to a version, to start or to pause."""
    return packet(kind, bytes([accepted]))


def reply_version(version: ControllerVersion) -> bytes:
    """Encode the answer to the request for the controller's version."""
    return packet(PacketType.CONTROLLER_VERSION, _VERSION_REPLY.pack(*version))


def reply_setup(reply: SetupReply, version: int = VERSION) -> bytes:
    """Encode the answer to a setup."""
    types = ",".join(reply.types).encode()
    numbered = version != 1 or reply.kind is PacketType.INPUTS
    return packet(reply.kind, bytes([reply.recipe]) + types if numbered else types)


# -- decoding --------------------------------------------------------------------------------------


class PacketReader(StreamReader):
    """Splitter of a TCP stream into packets."""

    @property
    def foreign(self) -> bool:
        """True if the next bytes are no answer to the version but another protocol's, provided that
        no RTDE came before. Text counts as that by its size, whatever its type byte."""
        if len(self._pending) < _HEADER.size:
            return False
        size, kind = _HEADER.unpack_from(self._pending)
        return kind not in _KINDS or size > _LONGEST_TEXT

    @property
    def foreign_request(self) -> bool:
        """The same for a client's first packet, which may be a recipe request of any length before
        the version is negotiated."""
        return self.foreign and self._pending[_WORD.size] not in _SETUPS

    def take(self) -> tuple[int, bytes] | None:
        """Return the type and payload of the next packet; None if it is incomplete."""
        pending = self._pending
        if self.failure or len(pending) < _HEADER.size:
            return None
        size, kind = _HEADER.unpack_from(pending)
        if size < _HEADER.size:
            self.failure = f"a packet of {size} bytes: not an RTDE server"
            return None
        if len(pending) < size:
            return None
        payload = bytes(pending[_HEADER.size : size])
        del pending[:size]
        return kind, payload


def speaks_rtde(said: bytes) -> bool | None:
    """True if a server's first bytes after the version request are RTDE; None if more are
    needed."""
    reader = PacketReader()
    reader.feed(said)
    if reader.foreign:
        return False
    found = reader.take()
    if found is None:
        return False if reader.failure else None
    return not isinstance(read_reply(*found), MalformedPayload)


Reply = Accepted | ControllerVersion | TextMessage | SetupReply | Data
Asked = ControlRequest | TextMessage | RecipeSetup | Data


def read_reply(kind: int, payload: bytes, version: int = VERSION) -> Reply | MalformedPayload:
    """Decode a controller's package of that protocol version."""
    if version == 1 and kind == PacketType.DATA:
        return Data(0, payload)
    if version == 1 and kind == PacketType.OUTPUTS:
        types = _names(payload)
        return SetupReply(PacketType.OUTPUTS, int(bool(types) and TYPES.issuperset(types)), types)
    if version == 1 and kind == PacketType.TEXT and payload:
        return _text_1(payload)
    if kind == PacketType.DATA:
        return (
            Data(payload[0], payload[1:])
            if payload
            else MalformedPayload("a data package of 0 bytes")
        )
    if kind in (PacketType.PROTOCOL_VERSION, PacketType.START, PacketType.PAUSE):
        if len(payload) != 1:
            return MalformedPayload(f"an answer of {len(payload)} bytes, not 1")
        return Accepted(PacketType(kind), payload[0] != 0)
    if kind == PacketType.CONTROLLER_VERSION:
        if len(payload) != _VERSION_REPLY.size:
            return MalformedPayload(f"a version of {len(payload)} bytes, not {_VERSION_REPLY.size}")
        return ControllerVersion(*_VERSION_REPLY.unpack(payload))
    if kind in (PacketType.OUTPUTS, PacketType.INPUTS):
        if not payload:
            return MalformedPayload("a recipe of 0 bytes")
        return SetupReply(PacketType(kind), payload[0], _names(payload[1:]))
    return _text(kind, payload)


def read_request(kind: int, payload: bytes, version: int = VERSION) -> Asked | MalformedPayload:
    """Decode a client's package of that protocol version."""
    if kind == PacketType.DATA:
        return (
            Data(payload[0], payload[1:])
            if payload
            else MalformedPayload("a data package of 0 bytes")
        )
    if kind == PacketType.PROTOCOL_VERSION:
        if len(payload) != _WORD.size:
            return MalformedPayload(f"a version of {len(payload)} bytes, not {_WORD.size}")
        return ControlRequest(PacketType.PROTOCOL_VERSION, _WORD.unpack(payload)[0])
    if kind in (PacketType.CONTROLLER_VERSION, PacketType.START, PacketType.PAUSE):
        return (
            MalformedPayload(f"{len(payload)} bytes too many")
            if payload
            else ControlRequest(PacketType(kind))
        )
    if kind == PacketType.INPUTS:
        return RecipeSetup(PacketType.INPUTS, _names(payload))
    if kind == PacketType.OUTPUTS:
        if version == 1:
            return RecipeSetup(PacketType.OUTPUTS, _names(payload))
        if len(payload) < _FREQUENCY.size:
            return MalformedPayload(f"a setup of {len(payload)} bytes has no frequency")
        (frequency,) = _FREQUENCY.unpack_from(payload)
        return RecipeSetup(PacketType.OUTPUTS, _names(payload[_FREQUENCY.size :]), frequency)
    if version == 1 and kind == PacketType.TEXT and payload:
        return _text_1(payload)
    return _text(kind, payload)


def _text_1(payload: bytes) -> TextMessage:
    return TextMessage(payload[1:].decode("utf-8", "replace"), "", payload[0])


def _names(payload: bytes) -> tuple[str, ...]:
    """Split a list of names, which some clients end with a comma."""
    listed = payload.decode("utf-8", "replace").removesuffix(",")
    return tuple(word.strip() for word in listed.split(",")) if listed else ()


def _text(kind: int, payload: bytes) -> TextMessage | MalformedPayload:
    if kind != PacketType.TEXT:
        return MalformedPayload(f"type {kind} is unknown")
    try:
        said = payload[1 : 1 + payload[0]]
        rest = payload[1 + payload[0] :]
        by = rest[1 : 1 + rest[0]]
        level = rest[1 + rest[0]]
    except IndexError:
        return MalformedPayload("a text message that is cut")
    return TextMessage(said.decode("utf-8", "replace"), by.decode("utf-8", "replace"), level)


# -- recipes ---------------------------------------------------------------------------------------

_CODES: Mapping[str, tuple[str, int]] = {
    "BOOL": ("?", 1),
    "UINT8": ("B", 1),
    "UINT32": ("I", 1),
    "UINT64": ("Q", 1),
    "INT32": ("i", 1),
    "DOUBLE": ("d", 1),
    "VECTOR3D": ("d", 3),
    "VECTOR6D": ("d", 6),
    "VECTOR6INT32": ("i", 6),
    "VECTOR6UINT32": ("I", 6),
}
"""Types of variables: struct's letter of the numbers, and their count."""

TYPES: Final = frozenset(_CODES)
_VALUES_FROM: Final = _HEADER.size + 1
"""Offset of the values in a data package."""


class Recipe:
    """Variables in their order, with the format of their values."""

    def __init__(self, number: int | None, names: Sequence[str], types: Sequence[str]) -> None:
        """Set the types of the variables. `number` None: data packages have no number, as a
        controller's in version 1. Raises ValueError if a type is missing, or not in `TYPES`."""
        self.number = number
        self.names = tuple(names)
        self.types = tuple(types)
        self._struct, self._packet, self._counts = _layout(
            self.names, self.types, number is not None
        )
        self._scalar = all(count == 1 for count in self._counts)
        places, at = [], 0
        for count in self._counts:
            places.append(at if count == 1 else slice(at, at + count))
            at += count
        # With a single index itemgetter would return the value itself.
        self._parted: Callable[[tuple[Any, ...]], tuple[Any, ...]] = (
            itemgetter(*places) if len(places) > 1 else lambda flat: tuple(flat[p] for p in places)
        )
        head = (self._packet.size, _DATA, *(() if number is None else (number,)))
        self._pack = partial(self._packet.pack, *head)
        self.head = (_HEADER if number is None else _DATA_HEAD).pack(*head)
        """First bytes of every data package of the recipe."""

    @property
    def size(self) -> int:
        """Bytes of the values."""
        return self._struct.size

    def unpack(self, values: bytes) -> dict[str, Any] | None:
        """Decode the values by name, vectors as tuples; None if they have the wrong size."""
        if len(values) != self._struct.size:
            return None
        return dict(zip(self.names, self.values(values), strict=True))

    def values(self, data: bytes) -> tuple[Any, ...]:
        """Decode the values in order, vectors as tuples. Raises struct.error for a wrong size."""
        return self._parted(self._struct.unpack(data))

    def alone(self, data: bytes) -> tuple[Any, ...] | None:
        """Decode the values of one complete data package of this recipe with a number; None if
        `data` is anything else."""
        if len(data) != self._packet.size or not data.startswith(self.head):
            return None
        return self._parted(self._struct.unpack_from(data, _VALUES_FROM))

    def pack(self, values: Sequence[Any]) -> bytes:
        """Encode a data package of the values in the order of `names`. Raises struct.error for a
        value that its type cannot hold."""
        flat = values
        if not self._scalar:
            flat = []
            for value, count in zip(values, self._counts, strict=True):
                if count == 1:
                    flat.append(value)
                else:
                    flat.extend(value)
        return self._pack(*flat)


@lru_cache(maxsize=64)
def _layout(
    names: tuple[str, ...], types: tuple[str, ...], numbered: bool
) -> tuple[struct.Struct, struct.Struct, tuple[int, ...]]:
    if len(names) != len(types):
        raise ValueError(f"{len(types)} types for {len(names)} variables")
    layout, counts = "", []
    for name, kind in zip(names, types, strict=True):
        if kind not in _CODES:
            raise ValueError(f"{name}: {kind}")
        code, count = _CODES[kind]
        layout += code * count
        counts.append(count)
    whole = struct.Struct(f"{_HEADER.format}{'B' if numbered else ''}{layout}")
    if whole.size > LARGEST:
        raise ValueError(f"{whole.size} bytes: an RTDE packet has at most {LARGEST}")
    return struct.Struct(f">{layout}"), whole, tuple(counts)
