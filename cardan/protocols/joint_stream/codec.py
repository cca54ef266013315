"""Codec of the joint stream, little-endian. Decoding never raises: it gives a value or a reason."""

from __future__ import annotations

import enum
import math
import struct
from functools import cache
from typing import NamedTuple

MAGIC = b"CJST"
VERSION = 1
MAX_JOINTS = 16
MAX_REASON_BYTES = 255

_STATE, _COMMAND = 1, 2
_HEADER = struct.Struct("<4sBBBBIId")
"""Magic, version, kind, mode, joints, session, sequence, stamp."""
_STATE_FIXED = 1 + 7 + 6
"""Count of numbers in a state besides those of the joints: period, TCP pose, TCP wrench."""

MAX_DATAGRAM_BYTES = _HEADER.size + 4 + 8 * (3 * MAX_JOINTS + _STATE_FIXED) + 1 + MAX_REASON_BYTES
_HALF = 1 << 31


class ControlMode(enum.IntEnum):
    """Quantity that the drives follow, or that a command requests."""

    HOLD = 0
    POSITION = 1
    VELOCITY = 2
    TORQUE = 3


_MODES = {int(mode): mode for mode in ControlMode}
_VECTORS = {
    ControlMode.HOLD: 0,
    ControlMode.POSITION: 2,
    ControlMode.VELOCITY: 1,
    ControlMode.TORQUE: 1,
}
"""Number of values per joint in a command."""


class MalformedDatagram(NamedTuple):
    """Datagram of another protocol, or an unusable one."""

    reason: str


class ArmState(NamedTuple):
    """State that the controller measured in one of its cycles."""

    session: int
    """Number that changes when the controller restarts."""
    sequence: int
    """Count of the session's states; wraps at 2^32."""
    stamp_s: float
    """Time by the controller's clock, s."""
    mode: ControlMode
    acknowledged: int
    """Sequence of the newest accepted command; 0 before any."""
    period_s: float
    """Cycle of the controller, s."""
    positions: tuple[float, ...]
    """rad or m, kinematic order."""
    velocities: tuple[float, ...]
    torques: tuple[float, ...]
    """Torques of the drives, N·m or N."""
    pose: tuple[float, ...]
    """TCP in the base frame: x y z in m, then the unit quaternion w x y z."""
    wrench: tuple[float, ...]
    """Wrench of the TCP on the environment, base axes, about the TCP: N, then N·m."""
    reason: str = ""
    """Reason why commands do not act; empty when they do."""


class ArmCommand(NamedTuple):
    """Command to the arm from now on."""

    session: int
    """Session it is meant for; 0 in a hold that requests states."""
    sequence: int
    """Count from 1; wraps at 2^32."""
    stamp_s: float
    """Time by the sender's clock, s."""
    mode: ControlMode
    values: tuple[float, ...] = ()
    """Values in rad, rad/s or N·m by mode (m, m/s, N for a prismatic joint); none in a hold."""
    feed_forward: tuple[float, ...] = ()
    """Speed at `values`, rad/s or m/s; only in mode POSITION, as many as values."""


@cache
def _doubles(count: int) -> struct.Struct:
    return struct.Struct(f"<{count}d")


@cache
def _state_body(joints: int) -> struct.Struct:
    return struct.Struct(f"<I{3 * joints + _STATE_FIXED}dB")


def is_newer(sequence: int, than: int) -> bool:
    """True when `sequence` comes after `than`, across the wrap at 2^32."""
    return 0 < (sequence - than) & 0xFFFFFFFF < _HALF


def encode_state(state: ArmState) -> bytes:
    """Encode `state`; truncate a too long reason. Raises ValueError for wrong lengths."""
    joints = len(state.positions)
    if not (
        1 <= joints <= MAX_JOINTS
        and len(state.velocities) == len(state.torques) == joints
        and len(state.pose) == 7
        and len(state.wrench) == 6
    ):
        raise ValueError(f"a state has 1 to {MAX_JOINTS} joints, 7 pose and 6 wrench values")
    reason = state.reason.encode()
    if len(reason) > MAX_REASON_BYTES:
        reason = reason[:MAX_REASON_BYTES].decode(errors="ignore").encode()
    head = _HEADER.pack(
        MAGIC, VERSION, _STATE, state.mode, joints, state.session, state.sequence, state.stamp_s
    )
    body = _state_body(joints).pack(
        state.acknowledged,
        state.period_s,
        *state.positions,
        *state.velocities,
        *state.torques,
        *state.pose,
        *state.wrench,
        len(reason),
    )
    return head + body + reason


def encode_command(command: ArmCommand, joints: int) -> bytes:
    """Encode `command` for an arm with `joints` joints. Raises ValueError for wrong lengths."""
    values = command.values
    if command.mode is ControlMode.POSITION:
        values = (*values, *(command.feed_forward or (0.0,) * joints))
    elif command.feed_forward:
        raise ValueError(f"a {command.mode.name} command has no feed-forward")
    if not 1 <= joints <= MAX_JOINTS or len(values) != joints * _VECTORS[command.mode]:
        raise ValueError(f"{len(values)} values do not fit a {command.mode.name} command")
    head = _HEADER.pack(
        MAGIC,
        VERSION,
        _COMMAND,
        command.mode,
        joints,
        command.session,
        command.sequence,
        command.stamp_s,
    )
    return head + _doubles(len(values)).pack(*values)


def is_command(data: bytes) -> bool:
    """True if the kind of a datagram, which may be malformed, is that of a command."""
    return data[5:6] == bytes((_COMMAND,))


def decode_state(data: bytes) -> ArmState | MalformedDatagram:
    """Decode a state, or return why `data` is invalid."""
    head = _header(data, _STATE)
    if isinstance(head, MalformedDatagram):
        return head
    mode, joints, session, sequence, stamp_s = head
    body = _state_body(joints)
    end = _HEADER.size + body.size
    if len(data) < end or len(data) != end + data[end - 1]:
        return MalformedDatagram(f"a state of {joints} joints in {len(data)} bytes")
    numbers = body.unpack_from(data, _HEADER.size)
    if not all(map(math.isfinite, numbers)):
        return MalformedDatagram("a number is not finite")
    try:
        reason = data[end:].decode()
    except UnicodeDecodeError:
        return MalformedDatagram("the reason is not UTF-8")
    pose = 2 + 3 * joints
    turn = numbers[pose + 3 : pose + 7]
    if abs(math.hypot(*turn) - 1.0) > 1e-3:
        return MalformedDatagram("the orientation is not a unit quaternion")
    if numbers[1] <= 0.0:
        return MalformedDatagram("the period is not above 0")
    return ArmState(
        session,
        sequence,
        stamp_s,
        mode,
        numbers[0],
        numbers[1],
        numbers[2 : 2 + joints],
        numbers[2 + joints : 2 + 2 * joints],
        numbers[2 + 2 * joints : pose],
        numbers[pose : pose + 7],
        numbers[pose + 7 : pose + 13],
        reason,
    )


def decode_command(data: bytes) -> ArmCommand | MalformedDatagram:
    """Decode a command, or return why `data` is invalid. `feed_forward` is complete in mode
    POSITION."""
    head = _header(data, _COMMAND)
    if isinstance(head, MalformedDatagram):
        return head
    mode, joints, session, sequence, stamp_s = head
    count = joints * _VECTORS[mode]
    if len(data) != _HEADER.size + 8 * count:
        return MalformedDatagram(f"a {mode.name} command of {joints} joints in {len(data)} bytes")
    numbers = _doubles(count).unpack_from(data, _HEADER.size)
    if not all(map(math.isfinite, numbers)):
        return MalformedDatagram("a number is not finite")
    if mode is ControlMode.POSITION:
        return ArmCommand(session, sequence, stamp_s, mode, numbers[:joints], numbers[joints:])
    return ArmCommand(session, sequence, stamp_s, mode, numbers)


def _header(data: bytes, kind: int) -> tuple[ControlMode, int, int, int, float] | MalformedDatagram:
    if len(data) < _HEADER.size:
        return MalformedDatagram(f"{len(data)} bytes are too short")
    magic, version, found, number, joints, session, sequence, stamp_s = _HEADER.unpack_from(data)
    if magic != MAGIC:
        return MalformedDatagram("not a joint stream")
    if version != VERSION:
        return MalformedDatagram(f"version {version}, not {VERSION}")
    if found != kind:
        return MalformedDatagram(f"kind {found}, not {kind}")
    if number not in _MODES:
        return MalformedDatagram(f"there is no mode {number}")
    if not 1 <= joints <= MAX_JOINTS:
        return MalformedDatagram(f"{joints} joints, not 1 to {MAX_JOINTS}")
    if not math.isfinite(stamp_s):
        return MalformedDatagram("the stamp is not finite")
    return _MODES[number], joints, session, sequence, stamp_s
