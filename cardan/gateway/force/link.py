"""The packets between a session and a force node, one for each message.

Both run on one computer, so numbers are little-endian as they lie there and times are of the
monotonic clock that the system's processes share. Every packet begins with the magic b"CDNF", the
version and its kind:

=====  ==========  ==========================================================================
kind   who         what follows
=====  ==========  ==========================================================================
1      session     State: flags u8, 0 u8, sequence u64, stamp s, pose x y z m and w x y z, wrench
                   N and N·m, then the hand map: linear 9, offset 3 m, rotation 9; all f64
2      node        Force: 0 u16, sequence u64, stamp s, force x y z N; all f64
3      session     Refusal: 0 u16, why, UTF-8
=====  ==========  ==========================================================================

Decoding never raises: bytes that are not a message give None.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from cardan.common.haptics import WorldMap
from cardan.spatial import is_finite
from cardan.types import Frame, Pose, Quaternion, RobotLink, RobotState, Vector3, Wrench

MAGIC = b"CDNF"
VERSION = 1
KIND_STATE, KIND_FORCE, KIND_REFUSAL = 1, 2, 3

_HEAD = struct.Struct("<4sBB")
_STATE = struct.Struct("<4sBBBxQd7d6d21d")
_FORCE = struct.Struct("<4sBB2xQd3d")
_REFUSAL_AT = _HEAD.size + 2

STATE_BYTES, FORCE_BYTES = _STATE.size, _FORCE.size
MAX_PACKET_BYTES = 1024

HAS_POSE, HAS_WRENCH, WRENCH_IN_TOOL, HAS_MAP, READY = 1, 2, 4, 8, 16

MAX_FORCE_N = 1000.0
"""Largest force for a hand: a message with more is rejected."""

_NO_POSE = (0.0,) * 7
_NO_WRENCH = (0.0,) * 6
_NO_MAP = (0.0,) * 21


class StateMessage(NamedTuple):
    """State of the robot at one control instant, as the session knows it."""

    sequence: int
    """Counts the session's messages."""
    stamp_s: float
    ready: bool
    """True if a command would move the robot."""
    pose: Pose | None
    wrench: Wrench | None
    world: WorldMap | None
    """Map from the hand's position to the TCP's; None while clutched out."""

    def robot_state(self) -> RobotState:
        """Return it as a RobotState."""
        return RobotState(
            stamp_s=self.stamp_s,
            link=RobotLink.LIVE,
            session=0,
            sequence=self.sequence,
            period_s=0.0,
            joints=(),
            external_axes=(),
            pose=self.pose,
            hold_reason="" if self.ready else "not ready",
            wrench=self.wrench,
        )


class ForceMessage(NamedTuple):
    """A force for the hand."""

    sequence: int
    """Counts the node's messages; a session drops a message whose count does not increase."""
    stamp_s: float
    """Stamp of the robot's state, or of the sensor's reading, from which it was computed."""
    force: Vector3
    """N, as rendered to the hand, along the axes of the robot's base."""


class RefusalMessage(NamedTuple):
    """Reason for refusing a node; the connection ends."""

    reason: str


Message = StateMessage | ForceMessage | RefusalMessage


def encode_state(message: StateMessage) -> bytes:
    """Encode as one packet."""
    pose, wrench, world = message.pose, message.wrench, message.world
    flags = READY if message.ready else 0
    where, forces, hand = _NO_POSE, _NO_WRENCH, _NO_MAP
    if pose is not None:
        flags |= HAS_POSE
        where = (*pose.position, *pose.orientation)
    if wrench is not None:
        flags |= HAS_WRENCH | (WRENCH_IN_TOOL if wrench.frame is Frame.TOOL else 0)
        forces = (*wrench.force, *wrench.torque)
    if world is not None:
        flags |= HAS_MAP
        hand = (*world.linear, *world.offset, *world.rotation)
    return _STATE.pack(
        MAGIC, VERSION, KIND_STATE, flags, message.sequence, message.stamp_s, *where, *forces, *hand
    )  # fmt: skip


def encode_force(message: ForceMessage) -> bytes:
    """Encode as one packet."""
    return _FORCE.pack(
        MAGIC, VERSION, KIND_FORCE, message.sequence, message.stamp_s, *message.force
    )


def encode_refusal(message: RefusalMessage) -> bytes:
    """Encode as one packet; a reason that is too long is cut."""
    text = message.reason.encode()[: MAX_PACKET_BYTES - _REFUSAL_AT]
    return _HEAD.pack(MAGIC, VERSION, KIND_REFUSAL) + b"\0\0" + text


def decode(packet: bytes) -> Message | None:
    """Decode the message in `packet`; None if it is malformed or has invalid numbers."""
    if len(packet) < _REFUSAL_AT:
        return None
    magic, version, kind = _HEAD.unpack_from(packet)
    if magic != MAGIC or version != VERSION:
        return None
    if kind == KIND_STATE:
        return _state(packet)
    if kind == KIND_FORCE:
        return _force(packet)
    if kind == KIND_REFUSAL and len(packet) <= MAX_PACKET_BYTES:
        return RefusalMessage(packet[_REFUSAL_AT:].decode(errors="replace"))
    return None


def _force(packet: bytes) -> ForceMessage | None:
    if len(packet) != FORCE_BYTES:
        return None
    _, _, _, sequence, stamp_s, x, y, z = _FORCE.unpack(packet)
    # A NaN is not below the limit either.
    if not (math.isfinite(stamp_s) and x * x + y * y + z * z <= MAX_FORCE_N * MAX_FORCE_N):
        return None
    return ForceMessage(sequence, stamp_s, Vector3(x, y, z))


def _state(packet: bytes) -> StateMessage | None:
    if len(packet) != STATE_BYTES:
        return None
    _, _, _, flags, sequence, stamp_s, *values = _STATE.unpack(packet)
    if not (math.isfinite(stamp_s) and is_finite(tuple(values))):
        return None
    pose = wrench = world = None
    if flags & HAS_POSE:
        turn = Quaternion(*values[3:7])
        if abs(math.hypot(*turn) - 1.0) > 1e-3:
            return None
        pose = Pose(Vector3(*values[:3]), turn)
    if flags & HAS_WRENCH:
        frame = Frame.TOOL if flags & WRENCH_IN_TOOL else Frame.BASE
        wrench = Wrench(Vector3(*values[7:10]), Vector3(*values[10:13]), frame)
    if flags & HAS_MAP:
        linear, rotation = _matrix(values[13:22]), _matrix(values[25:34])
        world = WorldMap(linear, Vector3(*values[22:25]), rotation)
    return StateMessage(sequence, stamp_s, bool(flags & READY), pose, wrench, world)


def _matrix(v: list[float]) -> tuple[float, float, float, float, float, float, float, float, float]:
    return (v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8])
