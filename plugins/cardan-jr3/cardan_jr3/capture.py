"""CAN frames as Linux writes them into a capture (link type 227, LINKTYPE_CAN_SOCKETCAN)."""

from __future__ import annotations

import struct
from typing import NamedTuple

from cardan.dissect.capture import CapturedPacket

CAN_SOCKETCAN = 227
LINK_TYPES = frozenset((CAN_SOCKETCAN,))
HEADER_BYTES = 8
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000


class CapturedCanFrame(NamedTuple):
    """A data frame with an identifier of 11 bits; `cut` when the capture lacks a part of it."""

    identifier: int
    data: bytes
    cut: bool


def parse(packet: CapturedPacket) -> CapturedCanFrame | None:
    """The data frame in a packet; None for extended, remote, error and broken frames."""
    if packet.link_type != CAN_SOCKETCAN or len(packet.data) < HEADER_BYTES:
        return None
    word, size = struct.unpack_from("!IB", packet.data)  # the word is big-endian in any capture
    if word & (EXTENDED | REMOTE | ERROR):
        return None
    data = packet.data[HEADER_BYTES : HEADER_BYTES + size]
    return CapturedCanFrame(word & 0x7FF, data, len(data) < size)
