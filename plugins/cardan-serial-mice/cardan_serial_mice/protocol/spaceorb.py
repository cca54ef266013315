"""The SpaceOrb 360's serial protocol (and the Spaceball Avenger's).

9600 baud, 8N1, no flow control; RTS, DTR and TX power it. A packet is a letter and data bytes with
bit 7 set, the last of them a checksum: the XOR of all bytes is 0 in the low seven bits. A packet
ends at the next letter or CR. Frame: X right, Y up, Z towards the operator; rotations right-handed
about these axes.

Source: the Linux kernel (spaceorb.c), published descriptions and captures.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cardan_serial_mice.protocol.values import (
    BAD_CHECKSUM,
    BAD_LENGTH,
    CR,
    LONGEST_PACKET_BYTES,
    TOO_LONG,
    UNKNOWN_LETTER,
    Malformed,
)

BAUD = 9600
COUNT_MIN, COUNT_MAX = -512, 511
PERIOD_S = 0.033
HEARTBEAT_S = 1.0
"""Longest time between two `K` packets."""
QUERY = b"?"
"""Request for the information packets (`!1`, `!2`)."""

_KEY = b"SpaceWare"
_LETTERS = b"DKREN!P"
_SIZES = {ord("D"): 12, ord("K"): 5, ord("E"): 4, ord("N"): 3}
"""Bytes of the packets of known length."""
_LOW = bytes(byte & 0x7F for byte in range(256))


class OrbMotion(NamedTuple):
    """`D`: buttons, and force and torque in counts."""

    status: int
    x: int
    y: int
    z: int
    rx: int
    ry: int
    rz: int


class OrbKeys(NamedTuple):
    """`K`: pressed buttons, on each change and at least each second."""

    period: int
    """Time since the previous `K` packet, in units of 10 ms, modulo 128."""
    status: int
    """Bits 0 to 5 buttons A to F, 6 rezero."""


class OrbReset(NamedTuple):
    """`R`: its text 1 s after power-up."""

    text: str


class OrbError(NamedTuple):
    """`E`: bit 0 hardware, 1 EEPROM, 2 power brown-out."""

    flags: int


class OrbText(NamedTuple):
    """`!` information, `N` the null region, `P` the period."""

    letter: int
    data: bytes


OrbPacket = OrbMotion | OrbKeys | OrbReset | OrbError | OrbText | Malformed


def decode_orb(packet: bytes) -> OrbPacket:
    """Decode one packet. Never raises."""
    if not packet:
        return Malformed(BAD_LENGTH, CR)
    letter = packet[0]
    if letter not in _LETTERS:
        return Malformed(UNKNOWN_LETTER, letter)
    size = _SIZES.get(letter)
    if len(packet) < 2 or (size is not None and len(packet) != size):
        return Malformed(BAD_LENGTH, letter)
    data = packet.translate(_LOW)
    check = 0
    for byte in data:
        check ^= byte
    if check:
        return Malformed(BAD_CHECKSUM, letter)
    if letter == ord("D"):
        bits = 0
        for byte, key in zip(data[2:11], _KEY, strict=True):
            bits = bits << 7 | byte ^ key
        bits >>= 3
        x, y, z, rx, ry, rz = (
            ((bits >> shift & 0x3FF) ^ 0x200) - 0x200 for shift in range(50, -1, -10)
        )
        return OrbMotion(data[1], x, y, z, rx, ry, rz)
    if letter == ord("K"):
        return OrbKeys(data[1], data[2])
    if letter == ord("E"):
        return OrbError(data[1])
    if letter == ord("R"):
        return OrbReset(data[1:-1].decode("ascii").strip())
    return OrbText(letter, data[1:-1])


def encode_orb_motion(status: int, counts: Sequence[int]) -> bytes:
    """Encode a `D` packet. Raises ValueError for counts beyond 10 bits."""
    if not all(COUNT_MIN <= count <= COUNT_MAX for count in counts):
        raise ValueError(f"counts {tuple(counts)} are not all in -512..511")
    bits = 0
    for count in counts:
        bits = bits << 10 | count & 0x3FF
    bits <<= 3
    data = (bits >> shift & 0x7F for shift in range(56, -1, -7))
    return _packet("D", bytes((status, *(a ^ b for a, b in zip(data, _KEY, strict=True)))))


def encode_orb_keys(period: int, status: int) -> bytes:
    """Encode a `K` packet."""
    return _packet("K", bytes((period & 0x7F, status & 0x7F, 0)))


def encode_orb_reset(text: str) -> bytes:
    """Encode an `R` packet."""
    return _packet("R", text.encode("ascii"))


def encode_orb_error(flags: int) -> bytes:
    """Encode an `E` packet."""
    return _packet("E", bytes((flags & 0x7F, 0)))


def encode_orb_text(letter: str, data: bytes) -> bytes:
    """Encode a `!` or `N` packet."""
    return _packet(letter, data)


def _packet(letter: str, data: bytes) -> bytes:
    check = ord(letter)
    for byte in data:
        check ^= byte & 0x7F
    return letter.encode() + bytes(byte | 0x80 for byte in (*data, check))


class OrbReader:
    """Splits a stream into packets; the first letter after noise ends the noise. Never raises."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self._due = 0
        """Bytes after which the packet is complete; 0: at the next letter."""

    def feed(self, data: bytes) -> list[OrbPacket]:
        """Add received bytes; return the packets that are complete now."""
        packets: list[OrbPacket] = []
        pending = self._pending
        for byte in data:
            if byte < 0x80:
                if pending:
                    self._end(packets)
                if byte != CR:
                    pending.append(byte)
                    self._due = _SIZES.get(byte, 0)
                continue
            pending.append(byte)
            if len(pending) == self._due:
                self._end(packets)
            elif len(pending) > LONGEST_PACKET_BYTES:
                packets.append(Malformed(TOO_LONG, pending[0]))
                pending.clear()
        return packets

    def _end(self, packets: list[OrbPacket]) -> None:
        packets.append(decode_orb(bytes(self._pending)))
        self._pending.clear()
        self._due = 0
