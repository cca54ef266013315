"""CAN frames as the bytes of events: as Linux writes them into captures."""

from __future__ import annotations

import struct

from cardan_jr3.protocol import CanFrame

_FORM = struct.Struct(">IB3x")
_NOT_PLAIN = 0xE000_0000
"""Extended, remote and error frames."""


def pack(frame: CanFrame) -> bytes:
    """`frame` as an event has it."""
    return _FORM.pack(frame.arbitration_id, len(frame.data)) + frame.data


def unpack(data: bytes) -> CanFrame | None:
    """The data frame with an eleven-bit identifier; None for anything else. Never raises."""
    if len(data) < _FORM.size:
        return None
    word, size = _FORM.unpack_from(data)
    if word & _NOT_PLAIN:
        return None
    return CanFrame(word & 0x7FF, data[_FORM.size : _FORM.size + size])
