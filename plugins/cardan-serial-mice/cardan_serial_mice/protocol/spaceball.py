"""The Spaceball's serial protocol: Spaceball 1003, 2003, 3003 and 4000 FLX.

9600 baud, 8N1, XON/XOFF in the stream; RTS and DTR up. A packet is a letter, data and CR; in data
`^` escapes CR, XON, XOFF and itself. Integers are big-endian. Motion is the displacement since the
previous packet. Frame: X right, Y up, Z away from the operator (left-handed); a rotation is
right-handed about its axis, as in spacenavd.

Source: spacenavd, libspnavdev, VRPN, the Linux kernel and inputattach.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

from cardan_serial_mice.protocol.values import (
    BAD_CODE,
    BAD_LENGTH,
    CR,
    UNKNOWN_LETTER,
    LineReader,
    Malformed,
)

BAUD = 9600
XON, XOFF = 0x11, 0x13

RESET = b"@RESET"
BINARY = b"CB"
SEND_VECTORS = b"MSSV"
"""Motion data, translation and rotation as vectors; an `M` command enables them."""
RATE_20_HZ = b"P@r@r"
QUERY_KEYS = b"k"

PERIOD_UNIT_S = 1.0 / 16000.0
"""Unit of the period field: a sixteenth of a millisecond."""
LONGEST_PERIOD = 0xFFFF

_ESCAPES = {ord("Q"): XON, ord("S"): XOFF, ord("M"): CR, ord("^"): ord("^")}
_ESCAPED = {value: letter for letter, value in _ESCAPES.items()}
_ESCAPE_PAIR = re.compile(rb"\^(.?)", re.DOTALL)
_TO_ESCAPE = re.compile(rb"[\x11\x13\x0d^]")
_D = struct.Struct(">cH6h")
_FLOW = bytes((XON, XOFF))
_MARK = 0x40
"""Bit that is set in the bytes of keys."""


class SpaceballMotion(NamedTuple):
    """`D`: displacement in the time since the previous packet, counts."""

    period: int
    """That time in sixteenths of a millisecond."""
    tx: int
    ty: int
    tz: int
    rx: int
    ry: int
    rz: int


class SpaceballKeys(NamedTuple):
    """`K`: pressed keys.

    `high`: bits 0 to 2 keys 5 to 7, 3 rezero of a 2003, 4 pick, 5 rezero of a 3003. `low`: bits 0
    to 3 keys 1 to 4, 4 and 5 left and right of a 3003.
    """

    high: int
    low: int


class SpaceballAdvancedKeys(NamedTuple):
    """`.`, of a 4000 FLX: pressed keys.

    `high`: bits 0 to 4 keys 8, 9, A, B, C, 5 which hand. `low`: bits 0 to 5 keys 1 to 6, 7 key 7.
    """

    high: int
    low: int


class SpaceballReset(NamedTuple):
    """`@`: a line of its text after a reset ("1 Spaceball alive and well ...")."""

    text: str


class SpaceballError(NamedTuple):
    """`E`: error of the device; `?`: unknown command."""

    letter: int
    text: str


class SpaceballEcho(NamedTuple):
    """Answer to a command that sets or requests something."""

    letter: int
    data: bytes


SpaceballPacket = (
    SpaceballMotion
    | SpaceballKeys
    | SpaceballAdvancedKeys
    | SpaceballReset
    | SpaceballError
    | SpaceballEcho
    | Malformed
)

_ECHOES = b'CFNPMZYBHT"'


def decode_spaceball(packet: bytes) -> SpaceballPacket:
    """Decode one packet, still escaped, without its CR. Never raises."""
    if not packet:
        return Malformed(BAD_LENGTH, CR)
    letter = packet[0]
    decoded = unescape(packet) if b"^" in packet else packet
    if decoded is None:
        return Malformed(BAD_CODE, letter)
    size = len(decoded)
    if letter == ord("D"):
        if size == _D.size:
            return SpaceballMotion._make(_D.unpack(decoded)[1:])
    elif letter == ord("K"):
        if size == 3:
            return SpaceballKeys(decoded[1], decoded[2])
    elif letter == ord("."):
        if size == 3:
            return SpaceballAdvancedKeys(decoded[1], decoded[2])
    elif letter == ord("@"):
        return SpaceballReset(decoded[1:].decode("ascii", "replace"))
    elif letter in b"E?":
        return SpaceballError(letter, decoded[1:].decode("ascii", "replace"))
    elif letter in _ECHOES:
        return SpaceballEcho(letter, decoded[1:])
    else:
        return Malformed(UNKNOWN_LETTER, letter)
    return Malformed(BAD_LENGTH, letter)


def encode_spaceball_motion(motion: SpaceballMotion) -> bytes:
    """Encode a `D` packet with its CR. Raises ValueError for values beyond 16 bits."""
    try:
        return escape(_D.pack(b"D", *motion)) + b"\r"
    except struct.error as error:
        raise ValueError(f"cannot encode {motion}: {error}") from None


def encode_spaceball_keys(keys: SpaceballKeys | SpaceballAdvancedKeys) -> bytes:
    """Encode a `K` or `.` packet with its CR."""
    letter = ord("K") if isinstance(keys, SpaceballKeys) else ord(".")
    return escape(bytes((letter, keys.high | _MARK, keys.low | _MARK))) + b"\r"


def escape(data: bytes) -> bytes:
    """Escape `data` for a packet."""
    return _TO_ESCAPE.sub(lambda found: bytes((ord("^"), _ESCAPED[found[0][0]])), data)


def unescape(data: bytes) -> bytes | None:
    """Return `data` without its escapes; None for an unknown escape."""
    bad = False

    def plain(found: re.Match[bytes]) -> bytes:
        nonlocal bad
        value = _ESCAPES.get(found[1][0]) if found[1] else None
        bad = bad or value is None
        return bytes((value or 0,))

    decoded = _ESCAPE_PAIR.sub(plain, data)
    return None if bad else decoded


class SpaceballReader(LineReader[SpaceballPacket]):
    """Splits a stream into packets; removes XON, XOFF and line feeds between packets. Never
    raises."""

    def feed(self, data: bytes) -> list[SpaceballPacket]:
        return super().feed(data.translate(None, _FLOW))

    def _decode(self, line: bytes, packets: list[SpaceballPacket]) -> None:
        if line := line.lstrip(b"\n"):
            packets.append(decode_spaceball(line))
