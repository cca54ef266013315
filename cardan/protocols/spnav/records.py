"""Codec of the spacenavd protocol's records.

Everything but the handshake and the version 0 sensitivity is a record of eight 32-bit words in the
host's byte order, because it never leaves the computer. Axes are spacenavd's: x right, y up, z away
from the operator. The triad is left-handed; rotations are right-handed, each about its axis. Values
are counts, of which a full deflection gives a number that depends on the device. Source:
spacenavd's and libspnav's description of the protocol (FreeSpacenav).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from cardan.protocols.spnav.codes import REQUEST_TAG, Code

RECORD_BYTES = 32
WORD_BYTES = 4
DATA_WORDS = 7
STATUS = 6
"""Index of the status word in a reply's data."""
OK, FAILED = 0, -1

MOTION, PRESS, RELEASE, DEVICE, CONFIG, RAW_AXIS, RAW_BUTTON = range(7)
"""First words of events."""
ADDED, REMOVED = 0, 1
"""Second word of a device event."""

MAX_BUTTONS = 256
"""Limit of button numbers; spacenavd itself knows fewer."""


_HANDSHAKE_TAG = 0x7FAA5500
_HANDSHAKE_MASK = 0xFFFFFF00

_RECORD = struct.Struct("=8i")
_EIGHT = _RECORD.unpack
_UNSIGNED = struct.Struct("=I")
_FLOAT = struct.Struct("=f")

Data = tuple[int, int, int, int, int, int, int]
Axes = tuple[float, float, float, float, float, float]


class MotionEvent(NamedTuple):
    """Event 0: the deflection, counts in spacenavd's axes."""

    x: int
    y: int
    z: int
    rx: int
    ry: int
    rz: int
    period_ms: int
    """Time since the previous motion, ms."""


class Button(NamedTuple):
    """Events 1 and 2: a button was pressed or released."""

    number: int
    pressed: bool


class DeviceChange(NamedTuple):
    """Event 3: a device was added or removed."""

    added: bool
    id: int
    device_type: int
    """One of `DEVICE_TYPES`."""
    vendor_id: int
    product_id: int


class ConfigChange(NamedTuple):
    """Event 4: a setting of the daemon was changed."""

    code: int
    data: tuple[int, int, int, int, int, int]


class RawAxis(NamedTuple):
    """Event 5: an axis of the device, before dead zone and mapping."""

    axis: int
    value: int


class RawButton(NamedTuple):
    """Event 6: a button of the device, before mapping."""

    number: int
    pressed: bool


class ServerReply(NamedTuple):
    """Reply of a server."""

    word: int
    data: Data

    @property
    def code(self) -> int:
        """Code of the request that it answers."""
        return self.word & 0xFFFF

    @property
    def ok(self) -> bool:
        """True if the request was granted."""
        return self.data[STATUS] >= OK


class MalformedRecord(NamedTuple):
    """Bytes that mean nothing; `reason` is "of an unknown type", "with an impossible value" or "of
    the wrong length"."""

    reason: str
    word: int
    """First word; 0 if there is none."""


Event = MotionEvent | Button | DeviceChange | ConfigChange | RawAxis | RawButton
ServerRecord = Event | ServerReply | MalformedRecord


def decode_server_record(record: bytes) -> ServerRecord:
    """Decode a record from a server. Never raises."""
    if len(record) != RECORD_BYTES:
        return MalformedRecord("of the wrong length", 0)
    words = _EIGHT(record)
    kind, a, b, c, d, e, f, g = words
    if kind == MOTION:
        return MotionEvent(a, b, c, d, e, f, g)
    if kind in (PRESS, RELEASE):
        if not 0 <= a < MAX_BUTTONS:
            return MalformedRecord("with an impossible value", kind)
        return Button(a, kind == PRESS)
    if kind == DEVICE:
        if b < 0 or a not in (ADDED, REMOVED):
            return MalformedRecord("with an impossible value", kind)
        return DeviceChange(a == ADDED, b, c, d, e)
    if kind == CONFIG:
        return ConfigChange(a, words[2:])
    if kind == RAW_AXIS:
        return RawAxis(a, b)
    if kind == RAW_BUTTON:
        return RawButton(a, b != 0)
    if kind & 0xFFFF0000 == REQUEST_TAG or kind & 0xFFFF in _CODES:
        return ServerReply(kind, words[1:])
    return MalformedRecord("of an unknown type", kind)


_CODES = frozenset(Code)


def encode_request(code: int, data: Sequence[int] = ()) -> bytes:
    """Encode a request as libspnav does; missing data are zero.

    Raises ValueError for values that do not fit.
    """
    if not 0 <= code <= 0xFFFF:
        raise ValueError(f"request code is {code:#x}; allowed: 0 to 0xffff")
    if len(data) > DATA_WORDS:
        raise ValueError(f"{len(data)} words of data; allowed: up to {DATA_WORDS}")
    return encode_words(REQUEST_TAG | code, (*data, *(0,) * (DATA_WORDS - len(data))))


def encode_reply(word: int, data: Sequence[int] = (), status: int = OK) -> bytes:
    """Encode the answer to a request whose first word was `word`; up to six words of data."""
    if len(data) > STATUS:
        raise ValueError(f"{len(data)} words of data; allowed: up to {STATUS}")
    return encode_words(word, (*data, *(0,) * (STATUS - len(data)), status))


def encode_handshake(version: int) -> bytes:
    """Encode the word that requests `version`, or grants it (0 to 255)."""
    if not 0 <= version <= 0xFF:
        raise ValueError(f"protocol version is {version}; allowed: 0 to 255")
    return _UNSIGNED.pack(_HANDSHAKE_TAG | version)


def decode_handshake(word: bytes) -> int | None:
    """Decode the version that four bytes request or grant; None if they are something else."""
    (value,) = _UNSIGNED.unpack(word)
    if value & _HANDSHAKE_MASK != _HANDSHAKE_TAG:
        return None
    version: int = value & 0xFF
    return version


def encode_sensitivity(sensitivity: float) -> bytes:
    """Encode the request of a version 0 client to scale its motion.

    Raises ValueError for a value that is no finite 32-bit float.
    """
    try:
        return _FLOAT.pack(sensitivity)
    except OverflowError:
        raise ValueError(f"sensitivity is {sensitivity!r}; allowed: a 32-bit float") from None


# ---------------------------------------------------------------------------------------------
# Axes


def to_robot_axes(
    counts: Sequence[int], full_scale: float, rotation_full_scale: float | None = None
) -> Axes:
    """Convert spacenavd's counts to deflections in -1..1 (x forward, y left, z up, right-handed).

    `rotation_full_scale` is that of rotations, if it differs.
    """
    scale = full_scale if rotation_full_scale is None else rotation_full_scale
    x, y, z = (min(1.0, max(-1.0, count / full_scale)) for count in counts[:3])
    rx, ry, rz = (min(1.0, max(-1.0, count / scale)) for count in counts[3:])
    return (z, -x, y, rz, -rx, ry)


def encode_words(word: int, data: Sequence[int]) -> bytes:
    """Encode a record of `word` and seven words. Raises ValueError for values that do not fit 32
    bits."""
    try:
        return _RECORD.pack(word, *data)
    except struct.error:
        raise ValueError(f"{word:#x}, {tuple(data)}: not all of them fit 32 bits") from None
