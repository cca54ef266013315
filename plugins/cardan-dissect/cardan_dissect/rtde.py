"""scapy layers of RTDE, version 2: packets between clients and Universal Robots controllers.

Everything is big-endian. Written from the protocol's page (docs/universal-robots.md), independent
of Cardan's codec, for cross-checks.

A request and its reply have the same type; the caller gives the direction: `RtdeRequest(data)`
dissects the packet that `data` begins with as a client's, `RtdeReply(data)` as a controller's, to
the layer of its type, or to RtdeRequestBroken or RtdeReplyBroken; they never raise. The rest of
`data` is the payload, dissected likewise: a TCP segment can hold several packets. Building fills in
sizes.

Names and types of a data packet's values are in its recipe, which an earlier packet has:
`values_of` decodes them with it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from typing import Any

from cardan_dissect._scapy import (
    TCP,
    ByteEnumField,
    ByteField,
    Field,
    FieldLenField,
    Packet,
    ShortField,
    StrField,
    StrLenField,
    bind_bottom_up,
    bind_top_down,
)
from cardan_dissect.ports import RTDE_PORTS

HEADER_BYTES = 3
VERSION_TYPE, CONTROLLER_TYPE, TEXT_TYPE, DATA_TYPE = 86, 118, 77, 85
OUTPUTS_TYPE, INPUTS_TYPE, START_TYPE, PAUSE_TYPE = 79, 73, 83, 80
NAMES = {
    VERSION_TYPE: "PROTOCOL_VERSION",
    CONTROLLER_TYPE: "CONTROLLER_VERSION",
    TEXT_TYPE: "TEXT",
    DATA_TYPE: "DATA",
    OUTPUTS_TYPE: "OUTPUTS",
    INPUTS_TYPE: "INPUTS",
    START_TYPE: "START",
    PAUSE_TYPE: "PAUSE",
}
LEVELS = {0: "exception", 1: "error", 2: "warning", 3: "information"}
NO_RECIPE = 0

_ONE = {"BOOL": "?", "UINT8": "B", "UINT32": "I", "INT32": "i", "UINT64": "Q", "DOUBLE": "d"}
_SEVERAL = {"VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I"}


class FrequencyField(Field[float, float]):
    """f64."""

    def __init__(self, name: str, default: float) -> None:
        Field.__init__(self, name, default, ">d")


class WordField(Field[int, int]):
    """u32."""

    def __init__(self, name: str, default: int) -> None:
        Field.__init__(self, name, default, ">I")


def _rest(fixed: int) -> Any:
    """Return the length of a field that takes the rest of a packet after `fixed` body bytes."""
    return lambda pkt: max((pkt.size or 0) - HEADER_BYTES - fixed, 0)


def _header(kind: int) -> list[Any]:
    return [ShortField("size", None), ByteEnumField("kind", kind, NAMES)]


class Rtde(Packet):
    """Packet of either direction."""

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        if self.size is None:
            pkt = struct.pack(">H", len(pkt)) + pkt[2:]
        return pkt + pay


class RtdeRequest(Rtde):
    """Packet of a client; dissects to the layer of its type."""

    name = "RTDE request"

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        return _verdict_and_layer(_pkt, REQUESTS)[0] or RtdeRequestBroken

    def guess_payload_class(self, payload: bytes) -> type[Packet]:
        return RtdeRequest


class RtdeReply(Rtde):
    """Packet of a controller; dissects to the layer of its type."""

    name = "RTDE reply"

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        return _verdict_and_layer(_pkt, REPLIES)[0] or RtdeReplyBroken

    def guess_payload_class(self, payload: bytes) -> type[Packet]:
        return RtdeReply


class _PacketField(StrField):
    """Bytes of a packet by its size; all remaining ones if it has none."""

    def getfield(self, pkt: Any, s: bytes) -> tuple[bytes, bytes]:
        size = struct.unpack_from(">H", s)[0] if len(s) >= 2 else 0
        end = size if HEADER_BYTES <= size <= len(s) else len(s)
        return s[end:], s[:end]


class RtdeRequestBroken(RtdeRequest):
    """Client's bytes that are not a packet, with the `reason`."""

    fields_desc = [_PacketField("data", b"")]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        return pkt + pay

    @property
    def reason(self) -> str:
        """Fault of the header or the length."""
        return _verdict_and_layer(self.data, REQUESTS)[1]


class RtdeReplyBroken(RtdeReply):
    """Controller's bytes that are not a packet, with the `reason`."""

    fields_desc = [_PacketField("data", b"")]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        return pkt + pay

    @property
    def reason(self) -> str:
        """Fault of the header or the length."""
        return _verdict_and_layer(self.data, REPLIES)[1]


class RtdeAskVersion(RtdeRequest):
    """Request for a version of the protocol."""

    fields_desc = [*_header(VERSION_TYPE), ShortField("version", 2)]


class RtdeAskController(RtdeRequest):
    """Request for the version of the controller's software."""

    fields_desc = _header(CONTROLLER_TYPE)


class RtdeAskOutputs(RtdeRequest):
    """Request for data packets with these variables, at a frequency."""

    fields_desc = [
        *_header(OUTPUTS_TYPE),
        FrequencyField("frequency_hz", 125.0),
        StrLenField("variables", b"", length_from=_rest(8)),
    ]


class RtdeAskInputs(RtdeRequest):
    """Request to write these variables."""

    fields_desc = [
        *_header(INPUTS_TYPE),
        StrLenField("variables", b"", length_from=_rest(0)),
    ]


class RtdeStart(RtdeRequest):
    """Request to start data packets."""

    fields_desc = _header(START_TYPE)


class RtdePause(RtdeRequest):
    """Request to pause data packets."""

    fields_desc = _header(PAUSE_TYPE)


class RtdeVersionReply(RtdeReply):
    """Reply: the version of the protocol is accepted or not."""

    fields_desc = [*_header(VERSION_TYPE), ByteField("accepted", 1)]


class RtdeController(RtdeReply):
    """Version of the controller's software."""

    fields_desc = [
        *_header(CONTROLLER_TYPE),
        WordField("major", 0),
        WordField("minor", 0),
        WordField("bugfix", 0),
        WordField("build_number", 0),
    ]


class RtdeOutputs(RtdeReply):
    """The number of a recipe of outputs, and the types of its variables."""

    fields_desc = [
        *_header(OUTPUTS_TYPE),
        ByteField("recipe", NO_RECIPE),
        StrLenField("types", b"", length_from=_rest(1)),
    ]


class RtdeInputs(RtdeReply):
    """The number of a recipe of inputs, and the types of its variables."""

    fields_desc = [
        *_header(INPUTS_TYPE),
        ByteField("recipe", NO_RECIPE),
        StrLenField("types", b"", length_from=_rest(1)),
    ]


class RtdeStarted(RtdeReply):
    """Reply: data packets start or not."""

    fields_desc = [*_header(START_TYPE), ByteField("accepted", 1)]


class RtdePaused(RtdeReply):
    """Reply: data packets pause or not."""

    fields_desc = [*_header(PAUSE_TYPE), ByteField("accepted", 1)]


def _text() -> list[Any]:
    return [
        *_header(TEXT_TYPE),
        FieldLenField("message_bytes", None, length_of="message", fmt="B"),
        StrLenField("message", b"", length_from=lambda pkt: pkt.message_bytes),
        FieldLenField("source_bytes", None, length_of="source", fmt="B"),
        StrLenField("source", b"", length_from=lambda pkt: pkt.source_bytes),
        ByteEnumField("level", 3, LEVELS),
    ]


def _data() -> list[Any]:
    return [
        *_header(DATA_TYPE),
        ByteField("recipe", 1),
        StrLenField("values", b"", length_from=_rest(1)),
    ]


class RtdeTextRequest(RtdeRequest):
    """Text message of a client."""

    fields_desc = _text()


class RtdeText(RtdeReply):
    """Text message of the controller."""

    fields_desc = _text()


class RtdeInputData(RtdeRequest):
    """Values of inputs."""

    fields_desc = _data()


class RtdeOutputData(RtdeReply):
    """Values of outputs."""

    fields_desc = _data()


_SEEN_OF_REQUESTS = (
    RtdeAskVersion,
    RtdeAskController,
    RtdeAskOutputs,
    RtdeAskInputs,
    RtdeStart,
    RtdePause,
    RtdeTextRequest,
    RtdeInputData,
)
_SEEN_OF_REPLIES = (
    RtdeVersionReply,
    RtdeController,
    RtdeOutputs,
    RtdeInputs,
    RtdeStarted,
    RtdePaused,
    RtdeText,
    RtdeOutputData,
)
REQUESTS: dict[int, type[RtdeRequest]] = {each().kind: each for each in _SEEN_OF_REQUESTS}
REPLIES: dict[int, type[RtdeReply]] = {each().kind: each for each in _SEEN_OF_REPLIES}
"""Layers by their types."""

_LENGTHS: dict[type[Packet], tuple[int, bool]] = {
    RtdeAskVersion: (2, False),
    RtdeAskController: (0, False),
    RtdeAskOutputs: (8, True),
    RtdeAskInputs: (0, True),
    RtdeStart: (0, False),
    RtdePause: (0, False),
    RtdeVersionReply: (1, False),
    RtdeController: (16, False),
    RtdeOutputs: (1, True),
    RtdeInputs: (1, True),
    RtdeStarted: (1, False),
    RtdePaused: (1, False),
    RtdeInputData: (1, True),
    RtdeOutputData: (1, True),
}
"""Bytes of each body, and whether it may be longer. Texts contain their lengths."""


def packet_bytes(data: bytes | bytearray) -> int | None:
    """Return the size of the packet at the beginning of `data`; None if the size is missing or
    wrong."""
    if len(data) < HEADER_BYTES:
        return None
    size = int(struct.unpack_from(">H", data)[0])
    return size if size >= HEADER_BYTES else None


def _verdict_and_layer(data: bytes, layers: Any) -> tuple[type[Packet] | None, str]:
    """Return the layer of the packet at the beginning of `data`, or why there is none."""
    if not data:
        return None, "empty"
    if len(data) < HEADER_BYTES:
        return None, "shorter than its header"
    size = packet_bytes(data)
    if size is None:
        return None, "a size below 3"
    if size > len(data):
        return None, "shorter than its size says"
    kind, body = data[2], data[HEADER_BYTES:size]
    layer = layers.get(kind)
    if layer is None:
        return None, f"unknown type {kind}"
    return (layer, "") if _fits(layer, body) else (None, f"{NAMES[kind]} of {len(body)} bytes")


def _fits(layer: type[Packet], body: bytes) -> bool:
    if layer not in _LENGTHS:
        return _counted(body) == len(body)
    fixed, more = _LENGTHS[layer]
    return len(body) == fixed or (more and len(body) > fixed)


def _counted(body: bytes) -> int:
    """Return the bytes of a text message by its two lengths; -1 if they are missing."""
    if not body or len(body) < 2 + body[0]:
        return -1
    return 3 + body[0] + body[1 + body[0]]


def malformed(layer: Packet) -> str | None:
    """Return why a dissected packet is malformed or unknown; None: it is neither."""
    if isinstance(layer, (RtdeRequestBroken, RtdeReplyBroken)):
        return layer.reason
    return next(_wrong_values(layer), None)


def _wrong_values(layer: Packet) -> Iterator[str]:
    for field in ("variables", "types", "message", "source"):
        text = getattr(layer, field, b"")
        try:
            text.decode()
        except UnicodeDecodeError:
            yield f"{field} not UTF-8"
    if isinstance(layer, RtdeAskOutputs) and not math.isfinite(layer.frequency_hz):
        yield "frequency_hz not finite"


def listed(text: bytes) -> tuple[str, ...]:
    """Split names or types at commas; a trailing one is ignored."""
    words = text.decode("utf-8", "replace").split(",")
    if not words[-1]:
        words.pop()
    return tuple(word.strip() for word in words)


def values_of(types: Sequence[str], values: bytes) -> list[Any] | None:
    """Return the values of a data packet whose recipe has these types, arrays as tuples; None if
    they do not fit."""
    found: list[Any] = []
    at = 0
    for kind in types:
        form = _ONE.get(kind) or _SEVERAL.get(kind)
        if form is None or at + struct.calcsize(f">{form}") > len(values):
            return None
        read = struct.unpack_from(f">{form}", values, at)
        found.append(read[0] if kind in _ONE else read)
        at += struct.calcsize(f">{form}")
    return found if at == len(values) else None


for _port in RTDE_PORTS:
    bind_bottom_up(TCP, RtdeRequest, dport=_port)
    bind_bottom_up(TCP, RtdeReply, sport=_port)
    for _request in _SEEN_OF_REQUESTS:
        bind_top_down(TCP, _request, dport=_port)
    for _reply in _SEEN_OF_REPLIES:
        bind_top_down(TCP, _reply, sport=_port)
