"""Magellan's serial protocol: the SpaceMouse Classic, Plus and Plus XT, CadMan, Spaceball 5000.

9600 baud, 8N2 (8N1 works), RTS/CTS; RTS and DTR power the device. A packet is a letter, data and
CR, either way. Data are nibbles, each coded as a character of even parity. Frame: X right, Y up,
Z towards the operator; rotations right-handed about these axes.

Source: LogiCad3D's programmer's manual, spacenavd, VRPN, the Linux kernel, published captures.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from cardan_serial_mice.protocol.values import (
    BAD_CHECKSUM,
    BAD_CODE,
    BAD_LENGTH,
    CR,
    UNKNOWN_LETTER,
    LineReader,
    Malformed,
)

BAUD = 9600

ALPHABET = b"0AB3D56GH9:K<MN?"
"""Character of each nibble: its low four bits are the nibble."""

MODE_3D = b"m3"
"""Translation and rotation, all axes."""
EXTENDED_COMPRESSED = b"c33"
"""Translation and rotation, keys beyond the eighth, compressed data with a checksum."""
COMPRESSED_BITS = 0x3
"""Bits of the second nibble of `c`: extended keys and compressed data."""
DEFAULT_SENSITIVITY = b"q00"
PERIODS_60_MS = b"pBB"
"""(2 + 1) · 20 ms, spontaneous and on request."""
QUERY_VERSION = b"vQ"
QUERY_KEYS = b"kQ"
QUERY_EXTENDED = b"cQ"

PLAIN_BYTES = 24
"""Data of a plain `d` packet: 6 x 4 nibbles."""
COMPRESSED_BYTES = 14
"""Data of a compressed `d` packet: 6 x 2 characters and a checksum of two."""

COUNT_MIN, COUNT_MAX = -0x8000, 0x7FFF
COMPRESSED_MIN, COMPRESSED_MAX = -2048, 2047


class MagellanMotion(NamedTuple):
    """`d`: deflections in counts; all zero once when the cap returns to rest."""

    x: int
    y: int
    z: int
    a: int
    b: int
    c: int


class MagellanCompressedMotion(MagellanMotion):
    """The same values from a `d` packet of the compressed mode."""

    __slots__ = ()


class MagellanKeys(NamedTuple):
    """`k`: pressed keys; bits 0 to 7 keys 1 to 8, then `*`, `+`, `-` (or keys 9 on)."""

    mask: int


class MagellanVersion(NamedTuple):
    """`v`: the device's name and version."""

    text: str


class MagellanError(NamedTuple):
    """`e`: error about a command that the device did not understand."""

    code: int
    """1: illegal command; 2: framing error."""
    detail: bytes


class MagellanEcho(NamedTuple):
    """Answer to a command that sets something: usually the command itself."""

    command: bytes


MagellanPacket = (
    MagellanMotion | MagellanKeys | MagellanVersion | MagellanError | MagellanEcho | Malformed
)

_ECHOES = b"mcnqpzbfl"
_D, _K, _V, _E = b"dkve"
_LETTERS_WITHIN_DATA = (b"d", b"k")
"""Letters that cannot be data: one inside a packet begins another packet."""

_HEX = bytes(
    b"0123456789ABCDEF"[ALPHABET.index(byte)] if byte in ALPHABET else ord("x")
    for byte in range(256)
)
_SIX = struct.Struct(">6H")

_CODE_EXCEPTIONS = {28: 0xDC, 32: 0xE0, 62: 0x3E}
_CODE = bytes(
    _CODE_EXCEPTIONS.get(value, value | (0x40 if value.bit_count() % 2 else 0x80))
    for value in range(64)
)
"""Character of each 6-bit value: its low six bits are the value."""
_NO_VALUE = 0xFF
_UNCODE = bytes(_CODE.index(byte) if byte in _CODE else _NO_VALUE for byte in range(256))


def decode_magellan(packet: bytes) -> MagellanPacket:
    """Decode one packet without its CR. Never raises."""
    if not packet:
        return Malformed(BAD_LENGTH, CR)
    letter, data = packet[0], packet[1:]
    if letter == _D:
        if len(data) == PLAIN_BYTES:
            counts = _nibbles(data)
            if counts is None:
                return Malformed(BAD_CODE, letter)
            x, y, z, a, b, c = _SIX.unpack(counts)
            return MagellanMotion(
                x - 0x8000, y - 0x8000, z - 0x8000, a - 0x8000, b - 0x8000, c - 0x8000
            )
        if len(data) == COMPRESSED_BYTES:
            return _decode_compressed(data)
    elif letter == _K:
        if 3 <= len(data) <= 4:
            nibbles = _nibbles(data.ljust(4, b"0"))
            if nibbles is None:
                return Malformed(BAD_CODE, letter)
            one, two = nibbles
            return MagellanKeys(one >> 4 | (one & 15) << 4 | (two >> 4) << 8 | (two & 15) << 12)
    elif letter == _V:
        return MagellanVersion(data.decode("ascii", "replace").strip())
    elif letter == _E:
        return MagellanError(data[0] & 15 if data else 0, data[1:])
    elif letter in _ECHOES:
        return MagellanEcho(packet)
    else:
        return Malformed(UNKNOWN_LETTER, letter)
    return Malformed(BAD_LENGTH, letter)


def encode_magellan_motion(counts: Sequence[int], *, compressed: bool = False) -> bytes:
    """Encode a `d` packet with its CR. Raises ValueError for counts that do not fit."""
    if compressed:
        if not all(COMPRESSED_MIN <= count <= COMPRESSED_MAX for count in counts):
            raise ValueError(f"counts {tuple(counts)} are not all in -2048..2047")
        values = [count + 2048 for count in counts]
        coded = bytes(_CODE[part] for value in values for part in (value >> 6, value & 63))
        total = sum(coded) & 0xFFF
        return b"d" + coded + bytes((_CODE[total >> 6], _CODE[total & 63], CR))
    if not all(COUNT_MIN <= count <= COUNT_MAX for count in counts):
        raise ValueError(f"counts {tuple(counts)} are not all in -32768..32767")
    digits = "".join(f"{count + 0x8000:04x}" for count in counts)
    return b"d" + bytes(ALPHABET[int(digit, 16)] for digit in digits) + b"\r"


def encode_magellan_keys(mask: int, *, extended: bool) -> bytes:
    """Encode a `k` packet with its CR; `extended`: with the keys beyond the eighth other than
    `*`."""
    nibbles = [mask & 15, mask >> 4 & 15, mask >> 8 & (15 if extended else 1)]
    if extended and mask >> 12:
        nibbles.append(mask >> 12 & 15)
    return b"k" + bytes(ALPHABET[nibble] for nibble in nibbles) + b"\r"


class MagellanReader(LineReader[MagellanPacket]):
    """Splits a stream into packets and resynchronizes after noise. Never raises."""

    def _decode(self, line: bytes, packets: list[MagellanPacket]) -> None:
        if not line:
            return
        value = decode_magellan(line)
        packets.append(value)
        if isinstance(value, Malformed):
            begin = max(line.rfind(letter) for letter in _LETTERS_WITHIN_DATA)
            if begin > 0:
                tail = decode_magellan(line[begin:])
                if not isinstance(tail, Malformed):
                    packets.append(tail)


def _nibbles(data: bytes) -> bytes | None:
    """Return the bytes coded by characters of `ALPHABET`, two each."""
    try:
        return bytes.fromhex(data.translate(_HEX).decode())
    except ValueError:
        return None


def _decode_compressed(data: bytes) -> MagellanCompressedMotion | Malformed:
    values = data.translate(_UNCODE)
    if _NO_VALUE in values:
        return Malformed(BAD_CODE, _D)
    if sum(data[:12]) & 0xFFF != values[12] << 6 | values[13]:
        return Malformed(BAD_CHECKSUM, _D)
    x, y, z, a, b, c = (values[i] * 64 + values[i + 1] - 2048 for i in range(0, 12, 2))
    return MagellanCompressedMotion(x, y, z, a, b, c)
