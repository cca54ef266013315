"""CAN frames as bytes of events, in the format that Linux writes into captures."""

from __future__ import annotations

import struct

from cardan_jr3.protocol import CanFrame

_FORM = struct.Struct(">IB3x")
_NOT_PLAIN = 0xE000_0000
"""Extended, remote and error frames."""


def pack(frame: CanFrame) -> bytes:
    """Encode `frame` as an event's bytes."""
    return _FORM.pack(frame.arbitration_id, len(frame.data)) + frame.data


def unpack(data: bytes) -> CanFrame | None:
    """Decode a data frame with an 11-bit identifier; None for anything else. Never raises."""
    if len(data) < _FORM.size:
        return None
    word, size = _FORM.unpack_from(data)
    if word & _NOT_PLAIN:
        return None
    return CanFrame(word & 0x7FF, data[_FORM.size : _FORM.size + size])
