"""scapy layers of spacenavd's socket: the handshake, its events, requests and replies.

Every value is a 32-bit word in the byte order of the machine; these layers read the little-endian
ones. Written from a description of spacenavd and libspnav, independent of Cardan's codec, for
cross-checks.

`SpnavFromServer(record)` and `SpnavFromClient(record)` dissect one record, 32 bytes, or the four of
a handshake or of a sensitivity of version 0; to SpnavBroken for other bytes. They never raise.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from cardan_dissect._scapy import (
    ByteField,
    FieldListField,
    LEIntField,
    LEShortField,
    LESignedIntField,
    Packet,
    StrField,
    XByteField,
)
from cardan_dissect.layers import Block, LEFloatField

RECORD_BYTES, WORD_BYTES = 32, 4
HANDSHAKE = 0x7FAA5500
REQUEST_MARK = 0x7FAA
"""Upper half of the first word of libspnav's requests; a server looks at the lower one only."""
FIRST_REQUEST = 0x1000
"""Lowest valid code of a request."""
MOTION, PRESS, RELEASE, DEVICE, CONFIG, RAW_AXIS, RAW_BUTTON = range(7)
EVENT_MASK = {
    0x01: "motion",
    0x02: "button",
    0x04: "device",
    0x08: "config",
    0x10: "raw axis",
    0x20: "raw button",
}
CONTINUED = 0x10000
"""Flag in the last word of a packet of a string that is not its first."""
STRING_BYTES = 24
NO_WORDS: Any = [0] * 6
FAILED = -1

SET_NAME = 0x1000
# Settings of the requests SCFG_... (even numbers from 0x3000 on) and GCFG_... (odd).
_SETTINGS = {
    "SENS": "f",
    "SENS_AXIS": "ffffff",
    "DEADZONE": "ii",
    "INVERT": "iiiiii",
    "AXISMAP": "ii",
    "BNMAP": "ii",
    "BNACTION": "ii",
    "KBMAP": "ii",
    "SWAPYZ": "i",
    "LED": "i",
    "GRAB": "i",
    "SERDEV": "text",
    "REPEAT": "i",
}
REQUESTS: dict[int, tuple[str, str]] = {
    SET_NAME: ("SET_NAME", "text"),
    0x1001: ("SET_SENS", "f"),
    0x1002: ("GET_SENS", "f"),
    0x1003: ("SET_EVMASK", "i"),
    0x1004: ("GET_EVMASK", "i"),
    0x2000: ("DEV_NAME", "text"),
    0x2001: ("DEV_PATH", "text"),
    0x2002: ("DEV_NAXES", "i"),
    0x2003: ("DEV_NBUTTONS", "i"),
    0x2004: ("DEV_USBID", "ii"),
    0x2005: ("DEV_TYPE", "i"),
    **{
        0x3000 + 2 * n + way: (f"{'SG'[way]}CFG_{name}", data)
        for n, (name, data) in enumerate(_SETTINGS.items())
        for way in (0, 1)
    },
    0x3FFE: ("CFG_SAVE", ""),
    0x3FFF: ("CFG_RESTORE", ""),
    0x4000: ("CFG_RESET", ""),
}
"""Name of each request, and the types of its data: `f` a float, `i` an integer, or a string."""

_SERIAL_DEVICES = (
    "Spaceball 1003/2003", "Spaceball 3003", "Spaceball 4000", "Magellan",
    "Spaceball 5000 (serial)", "CadMan (serial)",
)  # fmt: skip
_USB_DEVICES = (
    "SpaceMouse Plus XT", "CadMan", "SpaceMouse Classic", "Spaceball 5000", "SpaceTraveler",
    "SpacePilot", "SpaceNavigator", "SpaceExplorer", "SpaceNavigator for Notebooks",
    "SpacePilot Pro", "SpaceMouse Pro", "NuLOOQ", "SpaceMouse Wireless", "SpaceMouse Pro Wireless",
    "SpaceMouse Enterprise", "SpaceMouse Compact", "SpaceMouse Module",
)  # fmt: skip
DEVICE_TYPES = {
    0: "unknown",
    **dict(enumerate(_SERIAL_DEVICES, 0x100)),
    **dict(enumerate(_USB_DEVICES, 0x200)),
}


class Record(Block):
    """Record; bytes after it belong to the next one."""


def _event(kind: int, *names: str) -> list[Any]:
    """Return a word for each name, and padding words to the end of the record."""
    unused = 7 - len(names)
    return [
        LEIntField("type", kind),
        *(LESignedIntField(name, 0) for name in names),
        *(LESignedIntField(f"unused_{n}", 0) for n in range(unused)),
    ]


class SpnavMotion(Record):
    """Axes of spacenavd: right, up, away, left-handed. `period_ms` is since the previous motion."""

    fields_desc = _event(MOTION, "x", "y", "z", "rx", "ry", "rz", "period_ms")


class SpnavPress(Record):
    fields_desc = _event(PRESS, "button", "pressed")


class SpnavRelease(Record):
    fields_desc = _event(RELEASE, "button", "pressed")


class SpnavDevice(Record):
    """`operation` 0: a device was added, 1: it was removed."""

    fields_desc = _event(DEVICE, "operation", "device", "device_type", "vendor", "product")


class SpnavConfig(Record):
    """Another client changed a setting: the request's code and data."""

    fields_desc = _event(CONFIG, "code", *(f"data_{n}" for n in range(6)))


class SpnavRawAxis(Record):
    """Raw axis before dead zone and mapping."""

    fields_desc = _event(RAW_AXIS, "axis", "value")


class SpnavRawButton(Record):
    fields_desc = _event(RAW_BUTTON, "button", "pressed")


EVENTS = (
    SpnavMotion,
    SpnavPress,
    SpnavRelease,
    SpnavDevice,
    SpnavConfig,
    SpnavRawAxis,
    SpnavRawButton,
)
"""By type."""


class SpnavMessage(Record):
    """Request, or the reply that echoes its first word."""

    fields_desc = [
        LEShortField("code", 0),
        LEShortField("mark", REQUEST_MARK),
        FieldListField("words", NO_WORDS, LESignedIntField("word", 0), count_from=lambda _: 6),
        LESignedIntField("last", 0),
    ]

    @property
    def title(self) -> str:
        """The request's name."""
        return REQUESTS.get(self.code, (f"0x{self.code:04x}",))[0]

    @property
    def is_text(self) -> bool:
        """True if the data are a piece of a string."""
        return REQUESTS.get(self.code, ("", ""))[1] == "text"

    @property
    def values(self) -> tuple[float | int, ...]:
        """Data as numbers of the request's types; for an unknown request all as integers."""
        kinds = REQUESTS.get(self.code, ("", "iiiiii"))[1]
        if kinds == "text":
            return ()
        raw = struct.pack("<6i", *self.words)
        return struct.unpack_from(f"<{kinds}", raw)

    @property
    def text(self) -> bytes:
        """Piece of a string in the data."""
        return struct.pack("<6i", *self.words)[: min(self.remaining, STRING_BYTES)]

    @property
    def remaining(self) -> int:
        """Bytes of the string from this piece on; 0 if the server reports a failure."""
        return 0 if self.last == FAILED else self.last & (CONTINUED - 1)

    @property
    def continued(self) -> bool:
        """True for a piece of a string that is not its first one."""
        return self.last != FAILED and bool(self.last & CONTINUED)


class SpnavRequest(SpnavMessage):
    """Client to server."""


class SpnavReply(SpnavMessage):
    """Server to client; for requests without a string `last` is 0, or -1 if refused."""


class SpnavHandshake(Record):
    """From the client: the requested version; from the server: the granted one."""

    fields_desc = [
        ByteField("version", 1),
        XByteField("mark_low", HANDSHAKE >> 8 & 0xFF),
        LEShortField("mark_high", HANDSHAKE >> 16),
    ]


class SpnavSensitivity(Record):
    """Only message of a client of version 0."""

    fields_desc = [LEFloatField("sensitivity", 1.0)]


class SpnavBroken(Record):
    """Bytes that are not a record, with the `reason`."""

    fields_desc = [StrField("data", b"")]

    @property
    def reason(self) -> str:
        if len(self.data) < RECORD_BYTES:
            return f"a record of {len(self.data)} bytes"
        return f"event of unknown type {struct.unpack_from('<I', self.data)[0]}"


def _word(data: bytes) -> int:
    return int.from_bytes(data[:WORD_BYTES], "little")


def _is_handshake(data: bytes) -> bool:
    return len(data) == WORD_BYTES and _word(data) & 0xFFFFFF00 == HANDSHAKE


class SpnavFromServer(Packet):
    """Server to client."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        if _is_handshake(_pkt):
            return SpnavHandshake
        if len(_pkt) < RECORD_BYTES:
            return SpnavBroken
        word = _word(_pkt)
        if word < len(EVENTS):
            return EVENTS[word]
        # A request's first word is returned unchanged, with libspnav's mark or without.
        is_reply = word >> 16 == REQUEST_MARK or word & 0xFFFF >= FIRST_REQUEST
        return SpnavReply if is_reply else SpnavBroken


class SpnavFromClient(Packet):
    """Client to server."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        if _is_handshake(_pkt):
            return SpnavHandshake
        if len(_pkt) == WORD_BYTES:
            return SpnavSensitivity
        return SpnavRequest if len(_pkt) >= RECORD_BYTES else SpnavBroken


def string_messages(kind: type[SpnavMessage], code: int, text: bytes) -> Sequence[SpnavMessage]:
    """Return the packets of a string, in order; an empty one has a packet too."""
    messages = []
    for at in range(0, max(len(text), 1), STRING_BYTES):
        piece = text[at : at + STRING_BYTES].ljust(STRING_BYTES, b"\0")
        last = len(text) - at | (CONTINUED if at else 0)
        messages.append(kind(code=code, words=list(struct.unpack("<6i", piece)), last=last))
    return messages
