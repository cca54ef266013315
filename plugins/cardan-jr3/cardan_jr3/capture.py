"""The sensor's boards in captures of a CAN bus (link type 227, LINKTYPE_CAN_SOCKETCAN)."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from cardan_dissect.capture import CapturedPacket
from cardan_dissect.network import Segment
from cardan_dissect.reader import CUT, Decoded, Dissector, Found, Message, Numbers
from cardan_jr3 import protocol as jr3_can

CAN_SOCKETCAN = 227
LINK_TYPES = frozenset((CAN_SOCKETCAN,))
HEADER_BYTES = 8
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
HELD_FRAMES = 64
"""Number of frames kept of a node that is not identified yet."""


class CapturedCanFrame(NamedTuple):
    """Data frame with an 11-bit identifier; `cut` if the capture has only a part of it."""

    identifier: int
    data: bytes
    cut: bool


def parse(packet: CapturedPacket) -> CapturedCanFrame | None:
    """Return the data frame in a packet; None for extended, remote, error and broken frames."""
    if packet.link_type != CAN_SOCKETCAN or len(packet.data) < HEADER_BYTES:
        return None
    word, size = struct.unpack_from("!IB", packet.data)  # the word is big-endian in any capture
    if word & (EXTENDED | REMOTE | ERROR):
        return None
    data = packet.data[HEADER_BYTES : HEADER_BYTES + size]
    return CapturedCanFrame(word & 0x7FF, data, len(data) < size)


class Jr3Can(Dissector):
    """JR3 force-torque sensors' boards on CAN.

    Any CANopen bus uses the boards' identifiers as well. A node is taken for a board when its
    FORCES are followed by its MOMENTS with the same counter, then with the frames from and to it
    shortly before; or if the user names it.
    """

    name = "JR3"
    page = "../plugins/cardan-jr3/README.md"
    link_types = LINK_TYPES
    options = (
        Numbers(
            "jr3_nodes",
            "jr3-node",
            "ID",
            "Take this CAN node for a JR3",
            "node id",
            range(1, jr3_can.MAX_NODE_ID + 1),
        ),
    )

    def __init__(self, numbers: Mapping[str, frozenset[int]]) -> None:
        super().__init__(numbers)
        self._boards = set(numbers["jr3_nodes"])
        self._held: dict[int, deque[tuple[CapturedPacket, CapturedCanFrame]]] = {}
        self._forces: dict[int, int] = {}
        """Counter of the FORCES whose MOMENTS have not arrived, by node."""
        self._samples: dict[int, int] = {}
        """Counter of the newest complete sample, by node."""

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Found:
        frame = parse(packet)
        if frame is None:
            return
        opcode, node = frame.identifier & ~jr3_can.NODE_MASK, frame.identifier & jr3_can.NODE_MASK
        sync = frame.identifier == jr3_can.Opcode.SYNC
        if node in self._boards or (sync and self._boards):
            yield self._message(packet, frame, node)
        elif opcode >= jr3_can.Opcode.ACK and node:
            held = self._held.setdefault(node, deque(maxlen=HELD_FRAMES))
            before = _value(held[-1][1]) if held else None
            held.append((packet, frame))
            if _is_sample(before, _value(frame)):
                self._boards.add(node)
                for earlier in self._held.pop(node):
                    yield self._message(*earlier, node)

    def _message(self, packet: CapturedPacket, frame: CapturedCanFrame, node: int) -> Message:
        self.packets += 1
        where = f"JR3 node {node}" if node else "CAN"
        value = CUT if frame.cut else _value(frame)
        remarks = []
        if isinstance(value, jr3_can.Forces):
            if node in self._forces:
                remarks.append("NO MOMENTS BEFORE")
            self._forces[node] = value.counter
        elif isinstance(value, jr3_can.Moments):
            if self._forces.pop(node, None) != value.counter:
                remarks.append("NO FORCES OF THIS COUNTER")
            elif self._samples.get(node) == value.counter:
                remarks.append("SAME SAMPLE AGAIN")
            else:
                self._samples[node] = value.counter
        elif isinstance(value, jr3_can.Bootup):
            self._samples.pop(node, None)
        if isinstance(value, str):
            decoded = Decoded(None, "CAN frame", value)
        elif value is None:
            decoded = Decoded({"data": frame.data}, f"CAN 0x{frame.identifier:03x}")
        else:
            decoded = Decoded(value, remarks=tuple(remarks))
        return Message(packet, where, decoded, frame.data)


def _value(frame: CapturedCanFrame) -> Any:
    """Decode a message of a board or host; a text: why it is malformed; None: of neither."""
    value = jr3_can.decode_from_board(frame.identifier, frame.data)
    if isinstance(value, jr3_can.Malformed):
        return f"{jr3_can.Opcode(value.opcode).name} {value.reason}"
    return value or jr3_can.decode_from_host(frame.identifier, frame.data)


def _is_sample(first: Any, second: Any) -> bool:
    """Return True if two successive messages of a node are a board's sample."""
    return (
        isinstance(first, jr3_can.Forces)
        and isinstance(second, jr3_can.Moments)
        and first.counter == second.counter
    )
