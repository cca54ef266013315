"""Encoding of the answers of every control cycle, in one ``struct`` call.

They are EgmSensor messages of type CORRECTION, byte for byte equal to those of
:mod:`cardan.protocols.egm.encode`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from cardan.protocols.egm.units import MM_PER_M, RAD_PER_DEG, SNAP
from cardan.types import Pose, Twist

_POSE = struct.Struct("<7sd1sd1sd3sd1sd1sd1sd")
_POSE_AND_SPEED = struct.Struct("<7sd1sd1sd3sd1sd1sd1sd5sd1sd1sd1sd1sd1sd")
_SIX = struct.Struct("<5sd1sd1sd1sd1sd1sd")

# Prefix of the first double of each part: tags and lengths down to it.
_PLANNED_POSE = b"\x12\x45\x12\x43\x0a\x1b\x09"
_ORIENT = b"\x12\x24\x09"
_PLANNED_JOINTS = b"\x12\x38\x0a\x36\x09"
_SPEED_JOINTS = b"\x1a\x38\x0a\x36\x09"
_SPEED_CARTESIANS = b"\x1a\x38\x12\x36\x09"
# Fields 1 to 4 as doubles.
_1, _2, _3, _4 = b"\x09", b"\x11", b"\x19", b"\x21"


def encode_pose_reply(
    seqno: int, tm_ms: int, pose: Pose, twist: Twist | None, suffix: bytes = b""
) -> bytes:
    """Encode `pose` with the speed `twist`; their frame is ignored, since the controller has its
    own.

    `suffix` ends the message (see `encode_rapid_to_robot`).
    """
    (x, y, z), (u0, u1, u2, u3), _ = pose
    if twist is None:
        planned = _POSE.pack(
            _PLANNED_POSE, x * MM_PER_M, _2, y * MM_PER_M, _3, z * MM_PER_M,
            _ORIENT, u0, _2, u1, _3, u2, _4, u3,
        )  # fmt: skip
        return _header(seqno, tm_ms) + planned + suffix
    (vx, vy, vz), (wx, wy, wz), _ = twist
    planned = _POSE_AND_SPEED.pack(
        _PLANNED_POSE, x * MM_PER_M, _2, y * MM_PER_M, _3, z * MM_PER_M,
        _ORIENT, u0, _2, u1, _3, u2, _4, u3,
        _SPEED_CARTESIANS, vx * MM_PER_M, _1, vy * MM_PER_M, _1, vz * MM_PER_M,
        _1, wx / RAD_PER_DEG + SNAP - SNAP,
        _1, wy / RAD_PER_DEG + SNAP - SNAP,
        _1, wz / RAD_PER_DEG + SNAP - SNAP,
    )  # fmt: skip
    return _header(seqno, tm_ms) + planned + suffix


def encode_joint_reply(
    seqno: int,
    tm_ms: int,
    joints_rad: Sequence[float],
    velocities_rad_s: Sequence[float] | None,
    suffix: bytes = b"",
) -> bytes:
    """Encode six `joints_rad` with six `velocities_rad_s`.

    `suffix` ends the message (see `encode_rapid_to_robot`).
    """
    planned = _six_angles(_PLANNED_JOINTS, joints_rad)
    if velocities_rad_s is None:
        return _header(seqno, tm_ms) + planned + suffix
    speed = _six_angles(_SPEED_JOINTS, velocities_rad_s)
    return _header(seqno, tm_ms) + planned + speed + suffix


def _six_angles(start: bytes, angles_rad: Sequence[float]) -> bytes:
    a, b, c, d, e, f = angles_rad
    return _SIX.pack(
        start, a / RAD_PER_DEG + SNAP - SNAP,
        _1, b / RAD_PER_DEG + SNAP - SNAP,
        _1, c / RAD_PER_DEG + SNAP - SNAP,
        _1, d / RAD_PER_DEG + SNAP - SNAP,
        _1, e / RAD_PER_DEG + SNAP - SNAP,
        _1, f / RAD_PER_DEG + SNAP - SNAP,
    )  # fmt: skip


_HEADER_STARTS = tuple(bytes((0x0A, 4 + length, 0x08)) for length in range(11))
"""First bytes of headers, by the lengths of their two numbers."""


def _header(seqno: int, tm_ms: int) -> bytes:
    first, second = _varint(seqno), _varint(tm_ms)
    start = _HEADER_STARTS[len(first) + len(second)]
    return start + first + b"\x10" + second + b"\x18\x03"


def _varint(number: int) -> bytes:
    """Encode `number` modulo 2^32."""
    number &= 0xFFFF_FFFF
    if number < 0x80:
        return bytes((number,))
    if number < 0x4000:
        return bytes((number & 0x7F | 0x80, number >> 7))
    if number < 0x20_0000:
        return bytes((number & 0x7F | 0x80, number >> 7 & 0x7F | 0x80, number >> 14))
    if number < 0x1000_0000:
        return bytes(
            (
                number & 0x7F | 0x80,
                number >> 7 & 0x7F | 0x80,
                number >> 14 & 0x7F | 0x80,
                number >> 21,
            )
        )
    return bytes(
        (
            number & 0x7F | 0x80,
            number >> 7 & 0x7F | 0x80,
            number >> 14 & 0x7F | 0x80,
            number >> 21 & 0x7F | 0x80,
            number >> 28,
        )
    )
