"""The server's side of the spacenavd protocol: requests of programs, and answers and events.

Records, axes and sources are those of :mod:`cardan.protocols.spnav`, the client's side.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from cardan.protocols.spnav.codes import NEWEST_VERSION, EventMask
from cardan.protocols.spnav.records import (
    ADDED,
    CONFIG,
    DEVICE,
    MAX_BUTTONS,
    MOTION,
    PRESS,
    RECORD_BYTES,
    RELEASE,
    REMOVED,
    STATUS,
    WORD_BYTES,
    ConfigChange,
    Data,
    DeviceChange,
    MalformedRecord,
    decode_handshake,
    encode_sensitivity,
    encode_words,
)
from cardan.protocols.spnav.streams import Handshake
from cardan.protocols.spnav.strings import CHUNK_BYTES, CONTINUED

MASK_V0 = EventMask.MOTION | EventMask.BUTTON
"""Events of a client without a handshake."""

INT_MIN, INT_MAX = -(2**31), 2**31 - 1


class ClientRequest(NamedTuple):
    """A client's request."""

    word: int
    """First word as received; a reply repeats it."""
    data: Data

    @property
    def code(self) -> int:
        """Code of the request, one of `Code` if it is known."""
        return self.word & 0xFFFF


def decode_request(record: bytes) -> ClientRequest | MalformedRecord:
    """Decode a record from a client of version 1. Never raises.

    Unknown codes are requests, too: a server answers them with `FAILED`.
    """
    if len(record) != RECORD_BYTES:
        return MalformedRecord("of the wrong length", 0)
    words = struct.unpack("=8i", record)
    return ClientRequest(words[0], words[1:])


def encode_motion(counts: Sequence[int], period_ms: int) -> bytes:
    """Encode event 0 of six counts; beyond 32 bits they are clamped."""
    x, y, z, rx, ry, rz = (_clamped(count) for count in counts)
    return encode_words(MOTION, (x, y, z, rx, ry, rz, _clamped(period_ms)))


def encode_button(number: int, pressed: bool) -> bytes:
    """Encode event 1 or 2. Raises ValueError for a number that is not below `MAX_BUTTONS`."""
    if not 0 <= number < MAX_BUTTONS:
        raise ValueError(f"button number is {number}; allowed: 0 to {MAX_BUTTONS - 1}")
    return encode_words(PRESS if pressed else RELEASE, (number, int(pressed), 0, 0, 0, 0, 0))


def encode_device(change: DeviceChange) -> bytes:
    """Encode event 3. Raises ValueError for values beyond 32 bits."""
    added, number, device_type, vendor_id, product_id = change
    op = ADDED if added else REMOVED
    return encode_words(DEVICE, (op, number, device_type, vendor_id, product_id, 0, 0))


def encode_config(change: ConfigChange) -> bytes:
    """Encode event 4. Raises ValueError for values beyond 32 bits."""
    return encode_words(CONFIG, (change.code, *change.data))


def decode_sensitivity(word: bytes) -> float:
    """Decode the sensitivity in four bytes; NaN and infinities are possible."""
    (value,) = struct.unpack("=f", word)
    return float(value)


def float_of(word: int) -> float:
    """Return the float with the bits of the data word `word`."""
    (value,) = struct.unpack("=f", struct.pack("=i", word))
    return float(value)


def bits_of(value: float) -> int:
    """Return the data word of a float. Raises ValueError for a value that is not a 32-bit float."""
    (word,) = struct.unpack("=i", encode_sensitivity(value))
    return int(word)


def from_robot_axes(axes: Sequence[float], full_scale: float) -> tuple[int, ...]:
    """Convert deflections in -1..1 to spacenavd's counts, rounded."""
    x, y, z, rx, ry, rz = axes
    return tuple(round(u * full_scale) for u in (-y, z, x, -ry, rz, rx))


def _clamped(value: int) -> int:
    return min(INT_MAX, max(INT_MIN, value))


class Sensitivity(NamedTuple):
    """Factor for the motion sent to a client of version 0; NaN is possible."""

    value: float


class ClientReader:
    """Reader of a client's bytes, in pieces of any size; at most 31 bytes are kept.

    `newest` is the newest version to speak: 0 takes every handshake for a sensitivity, NaN.
    """

    def __init__(self, newest: int = NEWEST_VERSION) -> None:
        self._newest = newest
        self.version = 0
        """Version in force."""
        self._buffer = b""

    def feed(self, data: bytes) -> list[ClientRequest | Handshake | Sensitivity | MalformedRecord]:
        """Return the values that `data` completes. Never raises.

        `Handshake.version` is the version to grant; it is in force for the bytes that follow.
        """
        buffer = self._buffer + data
        values: list[ClientRequest | Handshake | Sensitivity | MalformedRecord] = []
        at = 0
        while True:
            size = RECORD_BYTES if self.version else WORD_BYTES
            if len(buffer) - at < size:
                break
            piece = buffer[at : at + size]
            at += size
            if self.version:
                values.append(decode_request(piece))
            elif self._newest and (asked := decode_handshake(piece)) is not None:
                self.version = min(asked, self._newest)
                values.append(Handshake(self.version))
            else:
                values.append(Sensitivity(decode_sensitivity(piece)))
        self._buffer = buffer[at:]
        return values


class StringAssembler:
    """Joins a string from the data of its records."""

    def __init__(self) -> None:
        self._text = bytearray()
        self._left: int | None = None
        """Remaining bytes; None: no string has begun."""

    def take(self, data: Data) -> str | MalformedRecord | None:
        """Return the string if `data` ends it, None if more must follow, MalformedRecord out of
        order.

        Invalid UTF-8 is replaced. Never raises.
        """
        left = data[STATUS] & 0xFFFF
        if not data[STATUS] & CONTINUED:
            self._text.clear()
        elif left != self._left:
            self._left = None
            return MalformedRecord("with an impossible value", 0)
        self._text += struct.pack("=6i", *data[:STATUS])[: min(left, CHUNK_BYTES)]
        if left > CHUNK_BYTES:
            self._left = left - CHUNK_BYTES
            return None
        self._left = None
        return self._text.decode(errors="replace")
