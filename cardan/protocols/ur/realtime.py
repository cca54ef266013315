"""Real-time interface, TCP port 30003: scripts in, and a packet out in each control cycle.

A packet is its size (int32, inclusive) and doubles, big-endian; later versions append to them: 1060
bytes in 3.2, 1108 from 3.5 on and in 5.0, 1116 in 5.4, 1140 in 5.9, 1220 from 5.10 on. Source: UR's
guide to the real-time interface (public).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from cardan.protocols.ur.framing import StreamReader

REALTIME_PORT: Final = 30003
LARGEST: Final = 1 << 16
"""Longest packet of a controller, bytes."""

_SIZE = struct.Struct(">i")


class RealtimeField(NamedTuple):
    """Doubles of a packet."""

    variable: str
    """Variable of RTDE; empty if there is none."""
    width: int
    since: tuple[tuple[int, int], ...] = ((3, 2), (5, 0))
    """First version of each major one that has it."""


_ELBOW = ((3, 5), (5, 0))

FIELDS: Final[tuple[RealtimeField, ...]] = (
    RealtimeField("timestamp", 1),
    RealtimeField("target_q", 6),
    RealtimeField("target_qd", 6),
    RealtimeField("target_qdd", 6),
    RealtimeField("target_current", 6),
    RealtimeField("target_moment", 6),
    RealtimeField("actual_q", 6),
    RealtimeField("actual_qd", 6),
    RealtimeField("actual_current", 6),
    RealtimeField("joint_control_output", 6),
    RealtimeField("actual_TCP_pose", 6),
    RealtimeField("actual_TCP_speed", 6),
    RealtimeField("actual_TCP_force", 6),
    RealtimeField("target_TCP_pose", 6),
    RealtimeField("target_TCP_speed", 6),
    RealtimeField("actual_digital_input_bits", 1),
    RealtimeField("joint_temperatures", 6),
    RealtimeField("actual_execution_time", 1),
    RealtimeField("", 1),
    RealtimeField("robot_mode", 1),
    RealtimeField("joint_mode", 6),
    RealtimeField("safety_mode", 1),
    RealtimeField("", 6),
    RealtimeField("actual_tool_accelerometer", 3),
    RealtimeField("", 6),
    RealtimeField("speed_scaling", 1),
    RealtimeField("actual_momentum", 1),
    RealtimeField("", 2),
    RealtimeField("actual_main_voltage", 1),
    RealtimeField("actual_robot_voltage", 1),
    RealtimeField("actual_robot_current", 1),
    RealtimeField("actual_joint_voltage", 6),
    RealtimeField("actual_digital_output_bits", 1),
    RealtimeField("runtime_state", 1),
    RealtimeField("elbow_position", 3, _ELBOW),
    RealtimeField("elbow_velocity", 3, _ELBOW),
    RealtimeField("safety_status", 1, ((5, 4),)),
    RealtimeField("", 3, ((5, 9),)),
    RealtimeField("payload", 1, ((5, 10),)),
    RealtimeField("payload_cog", 3, ((5, 10),)),
    RealtimeField("payload_inertia", 6, ((5, 10),)),
)


class RealtimeForm:
    """Packet format of a version."""

    def __init__(self, version: tuple[int, int]) -> None:
        self.fields = tuple(
            field
            for field in FIELDS
            if any(since[0] == version[0] and since <= version for since in field.since)
        )
        self._struct = struct.Struct(f"{_SIZE.format}{sum(field.width for field in self.fields)}d")

    @property
    def size(self) -> int:
        """Length of a packet, bytes."""
        return self._struct.size

    def pack(self, value: Callable[[str], Any]) -> bytes:
        """Encode a packet; `value` returns a variable of RTDE."""
        numbers: list[float] = []
        for name, width, _ in self.fields:
            if not name:
                numbers += [0.0] * width
            elif width == 1:
                numbers.append(value(name))
            else:
                numbers += value(name)
        return self._struct.pack(self.size, *numbers)

    def read(self, packet: bytes) -> dict[str, tuple[float, ...]] | None:
        """Decode the variables of RTDE in a packet of this or a later version; None if it is
        shorter."""
        if len(packet) < self.size:
            return None
        numbers, at, found = self._struct.unpack_from(packet), 1, {}
        for name, width, _ in self.fields:
            if name:
                found[name] = numbers[at : at + width]
            at += width
        return found


class RealtimeReader(StreamReader):
    """Splitter of a TCP stream into packets."""

    def take(self) -> bytes | None:
        """Return the next packet with its size; None if it is incomplete."""
        pending = self._pending
        if self.failure or len(pending) < _SIZE.size:
            return None
        (size,) = _SIZE.unpack_from(pending)
        if not _SIZE.size < size <= LARGEST:
            self.failure = f"a packet of {size} bytes: not a real-time interface"
            return None
        if len(pending) < size:
            return None
        packet = bytes(pending[:size])
        del pending[:size]
        return packet
