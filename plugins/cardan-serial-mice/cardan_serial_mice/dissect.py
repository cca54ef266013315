"""scapy layers of the packets of serial 6-DoF devices: Magellan (and Spaceball 5000), Spaceball
1003 to 4000, SpaceOrb 360.

Counts are raw, in the device's own axes. Written from descriptions of the devices, independent of
Cardan's codec, for cross-checks.

`MagellanPacket(data)` and `SpaceballPacket(data)` dissect one packet of the device with the CR at
its end, `SpaceOrbPacket(data)` one from its header to its checksum; to a broken layer with the
`reason` if the bytes are not a packet. They never raise. Checksums and codes are computed when a
packet is built.
"""

from __future__ import annotations

import functools
import operator
from typing import Any, ClassVar

from cardan_dissect._scapy import (
    BitField,
    ByteField,
    Field,
    Packet,
    ShortField,
    SignedShortField,
    StrField,
    StrFixedLenField,
)
from cardan_dissect.layers import Block

CR = b"\r"


class SerialPacket(Block):
    """Packet; bytes after it belong to the next one."""


class Broken(SerialPacket):
    """Bytes that are not a packet."""

    fields_desc = [StrField("data", b"")]

    fault: ClassVar[staticmethod[[bytes], str | None]]
    """Returns why bytes are not a packet of the device, None if they are one."""

    @property
    def reason(self) -> str:
        """Fault of the bytes."""
        return self.fault(self.data) or ""


class TextPacket(SerialPacket):
    """A letter, then `rest`: text and CR."""

    @property
    def text(self) -> bytes:
        """Text between the letter and the CR."""
        return bytes(self.rest).removesuffix(CR)


# Magellan

NIBBLES = b"0AB3D56GH9:K<MN?"
"""Characters of 0 to 15, each of even parity."""
NIBBLE_OF = {char: value for value, char in enumerate(NIBBLES)}
WORD_ZERO = 0x8000
SIX_BIT_ZERO = 2048
SIX_BIT_EXCEPTIONS = {28: 0xDC, 32: 0xE0, 62: 0x3E}


def _six_bit_code(value: int) -> int:
    if value in SIX_BIT_EXCEPTIONS:
        return SIX_BIT_EXCEPTIONS[value]
    return value | (0x40 if value.bit_count() % 2 else 0x80)


SIX_BITS = bytes(map(_six_bit_code, range(64)))
"""Bytes of 0 to 63."""
SIX_BITS_OF = {code: value for value, code in enumerate(SIX_BITS)}
MAGELLAN_MOTION_BYTES, MAGELLAN_COMPRESSED_BYTES = 26, 16
MAGELLAN_KEY_BYTES = (5, 6)


class NibblesField(Field[int, bytes]):
    """`digits` coded nibbles, the high one first, with the offset `zero`."""

    __slots__ = ["digits", "zero"]

    def __init__(self, name: str, default: int, digits: int, zero: int = 0) -> None:
        self.digits, self.zero = digits, zero
        Field.__init__(self, name, default, f"{digits}s")

    def i2m(self, pkt: Any, x: int | None) -> bytes:
        value = (x or 0) + self.zero
        shifts = range(4 * (self.digits - 1), -1, -4)
        return bytes(NIBBLES[value >> shift & 15] for shift in shifts)

    def m2i(self, pkt: Any, x: bytes) -> int:
        return functools.reduce(lambda n, char: n << 4 | NIBBLE_OF[char], x, 0) - self.zero


class SixBitsField(Field[int, bytes]):
    """Two coded groups of six bits, the high one first, with the offset `zero`."""

    __slots__ = ["zero"]

    def __init__(self, name: str, default: int | None, zero: int = 0) -> None:
        self.zero = zero
        Field.__init__(self, name, default, "2s")

    def i2m(self, pkt: Any, x: int | None) -> bytes:
        value = (x or 0) + self.zero
        return bytes((SIX_BITS[value >> 6 & 63], SIX_BITS[value & 63]))

    def m2i(self, pkt: Any, x: bytes) -> int:
        return (SIX_BITS_OF[x[0]] << 6 | SIX_BITS_OF[x[1]]) - self.zero


def _end() -> Any:
    return StrFixedLenField("end", CR, 1)


class MagellanMotion(SerialPacket):
    """X right, Y up, Z towards the user, rotations A, B, C right-handed about them."""

    fields_desc = [
        StrFixedLenField("letter", b"d", 1),
        *(NibblesField(axis, 0, 4, WORD_ZERO) for axis in ("x", "y", "z", "a", "b", "c")),
        _end(),
    ]


class MagellanCompressedMotion(SerialPacket):
    """The same in 12 bits; the checksum is the low 12 bits of the sum of the coded bytes."""

    fields_desc = [
        StrFixedLenField("letter", b"d", 1),
        *(SixBitsField(axis, 0, SIX_BIT_ZERO) for axis in ("x", "y", "z", "a", "b", "c")),
        SixBitsField("checksum", None),
        _end(),
    ]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        if self.checksum is None:
            total = sum(pkt[1:13]) & 0xFFF
            pkt = pkt[:13] + bytes((SIX_BITS[total >> 6], SIX_BITS[total & 63])) + pkt[15:]
        return pkt + pay


class _MagellanKeys(SerialPacket):
    @property
    def keys(self) -> tuple[str, ...]:
        """Pressed keys: "1" to "8", "*", "+", "-"."""
        numbered = self.keys_1_to_4 | self.keys_5_to_8 << 4
        marks = zip(range(3), "*+-", strict=True)
        return (
            *(str(n + 1) for n in range(8) if numbered >> n & 1),
            *(name for bit, name in marks if self.marked_keys >> bit & 1),
        )


def _magellan_keys(*more: str) -> list[Any]:
    names = ("keys_1_to_4", "keys_5_to_8", "marked_keys", *more)
    return [
        StrFixedLenField("letter", b"k", 1),
        *(NibblesField(name, 0, 1) for name in names),
        _end(),
    ]


class MagellanKeys(_MagellanKeys):
    """All keys; bit 0 is the first of each name."""

    fields_desc = _magellan_keys()


class MagellanExtendedKeys(_MagellanKeys):
    """All keys, with the further nibble of the extended mode."""

    fields_desc = _magellan_keys("more_keys")


class MagellanText(TextPacket):
    """A version, an error or the echo of a command: a letter, its argument, CR."""

    fields_desc = [StrFixedLenField("letter", b"v", 1), StrField("rest", CR)]


MAGELLAN_LETTERS = b"vemcnqpzbfl"
"""Letters of packets whose content is text."""


def _magellan_fault(data: bytes) -> str | None:
    if not data.endswith(CR):
        return "does not end with CR"
    letter, body = data[:1], data[1:-1]
    if letter == b"d":
        if len(data) == MAGELLAN_MOTION_BYTES:
            return None if all(c in NIBBLE_OF for c in body) else "d with a character of no nibble"
        if len(data) != MAGELLAN_COMPRESSED_BYTES:
            return f"d of {len(data)} bytes"
        if not all(c in SIX_BITS_OF for c in body):
            return "d with a byte of no six bits"
        total = SIX_BITS_OF[body[12]] << 6 | SIX_BITS_OF[body[13]]
        return None if total == sum(body[:12]) & 0xFFF else "d with a wrong checksum"
    if letter == b"k":
        if len(data) not in MAGELLAN_KEY_BYTES:
            return f"k of {len(data)} bytes"
        return None if all(c in NIBBLE_OF for c in body) else "k with a character of no nibble"
    if letter in (CR, b"") or letter[0] not in MAGELLAN_LETTERS:
        return "unknown letter"
    return None


class MagellanBroken(Broken):
    """No packet of a Magellan."""

    fault = staticmethod(_magellan_fault)


class MagellanPacket(Packet):
    """A packet of a Magellan, CR included."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        if _magellan_fault(_pkt):
            return MagellanBroken
        if _pkt[:1] == b"d":
            plain = len(_pkt) == MAGELLAN_MOTION_BYTES
            return MagellanMotion if plain else MagellanCompressedMotion
        if _pkt[:1] == b"k":
            return MagellanKeys if len(_pkt) == MAGELLAN_KEY_BYTES[0] else MagellanExtendedKeys
        return MagellanText


# Spaceball

ESCAPE = 0x5E
ESCAPED = {0x11: 0x51, 0x13: 0x53, 0x0D: 0x4D, ESCAPE: ESCAPE}
"""Bytes reserved for flow control and framing, with their codes after `^`."""
UNESCAPED = {code: byte for byte, code in ESCAPED.items()}
SPACEBALL_BYTES = {b"D": 15, b"K": 3, b".": 3}
"""Sizes of decoded packets, without CR."""
SPACEBALL_LETTERS = b"@E?CFNPMZ"
"""Letters of packets whose content is text."""
PERIOD_UNITS_PER_MS = 16


def escape(data: bytes) -> bytes:
    """Escape the bytes of a Spaceball packet for the line, without the CR."""
    return b"".join(
        bytes((ESCAPE, ESCAPED[byte])) if byte in ESCAPED else bytes((byte,)) for byte in data
    )


def unescape(data: bytes) -> bytes | None:
    """Inverse of `escape`; None if a code after `^` is unknown."""
    decoded, bytes_left = bytearray(), iter(data)
    for byte in bytes_left:
        if byte == ESCAPE:
            found = UNESCAPED.get(next(bytes_left, -1))
            if found is None:
                return None
            decoded.append(found)
        else:
            decoded.append(byte)
    return bytes(decoded)


class SpaceballLayer(SerialPacket):
    """A binary packet; its fields are the decoded bytes."""

    def pre_dissect(self, s: bytes) -> bytes:
        return unescape(s[:-1]) or b""

    def post_dissect(self, s: bytes) -> bytes:
        self.raw_packet_cache = self.original  # A rebuilt packet is not decoded again.
        return s

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        return escape(pkt) + CR + pay


class SpaceballMotion(SpaceballLayer):
    """Displacement over a period of 1/16 ms: X right, Y up, Z away."""

    fields_desc = [
        StrFixedLenField("letter", b"D", 1),
        ShortField("period_sixteenths_ms", 0),
        *(SignedShortField(axis, 0) for axis in ("tx", "ty", "tz", "rx", "ry", "rz")),
    ]


class SpaceballKeys(SpaceballLayer):
    """Keys of the 1003 to 3003; some bits mean one thing on one model only."""

    fields_desc = [
        StrFixedLenField("letter", b"K", 1),
        BitField("set_1", 1, 2),
        BitField("rezero_3003", 0, 1),
        BitField("pick", 0, 1),
        BitField("key_8", 0, 1),
        *(BitField(f"key_{n}", 0, 1) for n in (7, 6, 5)),
        BitField("set_2", 1, 2),
        BitField("right_3003", 0, 1),
        BitField("left_3003", 0, 1),
        *(BitField(f"key_{n}", 0, 1) for n in (4, 3, 2, 1)),
    ]


class SpaceballExtendedKeys(SpaceballLayer):
    """Keys of the 4000FLX, whose 10 to 12 are A, B, C."""

    fields_desc = [
        StrFixedLenField("letter", b".", 1),
        BitField("set_1", 1, 2),
        BitField("handed", 0, 1),
        *(BitField(f"key_{n}", 0, 1) for n in (12, 11, 10, 9, 8)),
        BitField("key_7", 0, 1),
        BitField("set_2", 1, 1),
        *(BitField(f"key_{n}", 0, 1) for n in (6, 5, 4, 3, 2, 1)),
    ]


class SpaceballText(TextPacket):
    """A banner, an error or the echo of a command: a letter, text, CR."""

    fields_desc = [StrFixedLenField("letter", b"@", 1), StrField("rest", CR)]


def _spaceball_fault(data: bytes) -> str | None:
    if not data.endswith(CR):
        return "does not end with CR"
    letter = data[:1]
    if letter in SPACEBALL_BYTES:
        decoded = unescape(data[:-1])
        if decoded is None:
            return f"{letter.decode()} with a broken escape"
        if len(decoded) != SPACEBALL_BYTES[letter]:
            return f"{letter.decode()} of {len(decoded)} bytes"
        return None
    return None if letter != CR and letter[0] in SPACEBALL_LETTERS else "unknown letter"


class SpaceballBroken(Broken):
    """No packet of a Spaceball."""

    fault = staticmethod(_spaceball_fault)


class SpaceballPacket(Packet):
    """Packet of a Spaceball as received, CR included."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        if _spaceball_fault(_pkt):
            return SpaceballBroken
        binary = {b"D": SpaceballMotion, b"K": SpaceballKeys, b".": SpaceballExtendedKeys}
        return binary.get(_pkt[:1], SpaceballText)


# SpaceOrb

ORB_LETTERS = b"SpaceWare"
"""Bytes that are combined with those of motion by exclusive or."""
ORB_BYTES = {b"D": 12, b"K": 5, b"E": 4, b"N": 3}
ORB_BUTTONS = ("a", "b", "c", "d", "e", "f", "rezero")
TEN_MS = 10


def _orb_checksum(data: bytes) -> int:
    return functools.reduce(operator.xor, data, 0) & 0x7F


class SpaceOrbLayer(SerialPacket):
    """Packet with bit 7 set in all bytes but the first, and values in their low seven bits; the
    last byte makes the exclusive or of all 0."""

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        if self.checksum is None:
            pkt = pkt[:-1] + bytes((0x80 | _orb_checksum(pkt[:-1]),))
        return pkt + pay


def _orb_buttons() -> list[Any]:
    return [BitField("high", 1, 1), *(BitField(name, 0, 1) for name in reversed(ORB_BUTTONS))]


class OrbAxesField(Field[Any, bytes]):
    """Six values of 10 bits, X Y Z and rotations about them, and three bits of 0."""

    islist = 1

    def __init__(self, name: str, default: list[int]) -> None:
        Field.__init__(self, name, default, "9s")

    def any2i(self, pkt: Any, x: Any) -> Any:
        return list(x) if isinstance(x, tuple) else x

    def i2m(self, pkt: Any, x: Any) -> bytes:
        bits = functools.reduce(lambda n, value: n << 10 | value & 0x3FF, x, 0) << 3
        sevens = (bits >> shift & 0x7F for shift in range(56, -1, -7))
        return bytes(0x80 | s ^ letter for s, letter in zip(sevens, ORB_LETTERS, strict=True))

    def m2i(self, pkt: Any, x: bytes) -> Any:
        mixed = ((byte ^ letter) & 0x7F for byte, letter in zip(x, ORB_LETTERS, strict=True))
        bits = functools.reduce(lambda n, seven: n << 7 | seven, mixed, 0) >> 3
        values = (bits >> shift & 0x3FF for shift in range(50, -1, -10))
        return [(value ^ 0x200) - 0x200 for value in values]


class SpaceOrbMotion(SpaceOrbLayer):
    """X right, Y up, Z towards the user, right-handed."""

    fields_desc = [
        StrFixedLenField("letter", b"D", 1),
        *_orb_buttons(),
        OrbAxesField("axes", [0] * 6),
        ByteField("checksum", None),
    ]


class SpaceOrbKeys(SpaceOrbLayer):
    """At least every second; the period is the time since the last one, in 10 ms."""

    fields_desc = [
        StrFixedLenField("letter", b"K", 1),
        BitField("high_period", 1, 1),
        BitField("period_10_ms", 0, 7),
        *_orb_buttons(),
        ByteField("reserved", 0x80),
        ByteField("checksum", None),
    ]


class SpaceOrbError(SpaceOrbLayer):
    fields_desc = [
        StrFixedLenField("letter", b"E", 1),
        BitField("high", 1, 1),
        BitField("unused", 0, 4),
        BitField("brown_out", 0, 1),
        BitField("eeprom", 0, 1),
        BitField("hardware", 0, 1),
        ByteField("reserved", 0x80),
        ByteField("checksum", None),
    ]


class SpaceOrbText(SpaceOrbLayer):
    """The banner after power-up (`R`), an answer (`!`) or the null region (`N`); its last byte is
    the checksum."""

    fields_desc = [StrFixedLenField("letter", b"R", 1), StrField("rest", b"")]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        return pkt + pay

    @property
    def text(self) -> bytes:
        """Text without letter and checksum, bit 7 cleared."""
        return bytes(byte & 0x7F for byte in bytes(self.rest)[:-1])


def _orb_fault(data: bytes) -> str | None:
    letter = data[:1]
    if letter not in (*ORB_BYTES, b"R", b"!"):
        return "unknown letter"
    if letter in ORB_BYTES and len(data) != ORB_BYTES[letter]:
        return f"{letter.decode()} of {len(data)} bytes"
    if not all(byte & 0x80 for byte in data[1:]):
        return f"{letter.decode()} with a byte without bit 7"
    return f"{letter.decode()} with a wrong checksum" if _orb_checksum(data) else None


class SpaceOrbBroken(Broken):
    """No packet of a SpaceOrb."""

    fault = staticmethod(_orb_fault)


class SpaceOrbPacket(Packet):
    """Packet of a SpaceOrb, from its header to its checksum."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        if _orb_fault(_pkt):
            return SpaceOrbBroken
        binary = {b"D": SpaceOrbMotion, b"K": SpaceOrbKeys, b"E": SpaceOrbError}
        return binary.get(_pkt[:1], SpaceOrbText)
