"""CAN frames of a JR3 force-torque sensor behind uc3m's mbed board: frames to values and back.

Eleven-bit identifiers: an operation code plus the node id, 1 to 127; only SYNC has no node id.
Integers are little-endian.

Source: roboticslab-uc3m/jr3-mbed-firmware, jr3-mbed-firmware-can and yarp-devices (Jr3Mbed).
"""

from __future__ import annotations

import enum
import math
import struct
from typing import Any, NamedTuple

MAX_NODE_ID = 127
NODE_MASK = 0x7F
"""Bits of an identifier that hold the node id; the rest is the operation code."""

COUNTER_MODULUS = 1 << 16
RAW_MIN, RAW_MAX = -32768, 32767
MAX_CUTOFF_HZ = 655.35
MAX_PERIOD_US = 0xFFFFFFFF


class Opcode(enum.IntEnum):
    """Operation codes: the identifier without the node id."""

    SYNC = 0x080
    ACK = 0x100
    START_SYNC = 0x180
    START_ASYNC = 0x200
    STOP = 0x280
    ZERO_OFFS = 0x300
    SET_FILTER = 0x380
    GET_STATE = 0x400
    GET_FS_FORCES = 0x480
    GET_FS_MOMENTS = 0x500
    RESET = 0x580
    FORCES = 0x600
    MOMENTS = 0x680
    BOOTUP = 0x700
    GRIPPER_PWM = 0x780


class State(enum.IntEnum):
    """The board's state in every acknowledgment."""

    READY = 0
    NOT_INITIALIZED = 1


class CanFrame(NamedTuple):
    """Data frame with an 11-bit identifier."""

    arbitration_id: int
    data: bytes


# -- from the host ------------------------------------------------------------------------------


class Sync(NamedTuple):
    """Request of one pair of FORCES and MOMENTS from every acquiring board. Not acknowledged."""


class StartSync(NamedTuple):
    """Acquire, and send a pair at each SYNC."""

    cutoff_centihz: int
    """Cut-off of the board's low-pass filter, 0.01 Hz; 0: unfiltered."""


class StartAsync(NamedTuple):
    """Acquire, and send a pair every `period_us`."""

    cutoff_centihz: int
    period_us: int


class Stop(NamedTuple):
    """Stop acquiring; the counter and the data start again from 0."""


class ZeroOffs(NamedTuple):
    """Take the present filtered value as zero. One sample of zeros follows."""


class SetFilter(NamedTuple):
    """Change the cut-off while acquiring."""

    cutoff_centihz: int


class GetState(NamedTuple):
    """Request an acknowledgment."""


class GetFsForces(NamedTuple):
    """Query the full scales of the forces, N."""


class GetFsMoments(NamedTuple):
    """Query the full scales of the moments, 0.1 N·m."""


class Reset(NamedTuple):
    """Read the sensor's calibration again; acknowledged once it is read."""


class GripperPwm(NamedTuple):
    """Duty of the gripper on the same board, -100 to 100 %. Not acknowledged."""

    percent: float


HostMessage = (
    Sync
    | StartSync
    | StartAsync
    | Stop
    | ZeroOffs
    | SetFilter
    | GetState
    | GetFsForces
    | GetFsMoments
    | Reset
    | GripperPwm
)

# -- from the board -----------------------------------------------------------------------------


class Ack(NamedTuple):
    """Acknowledgment of a request, without the name of that request."""

    state: int
    """State of the board, a `State`; other values report an error, too."""
    full_scales: tuple[int, int, int] | None = None
    """Full scales, in answers to the two queries only: x, y, z in N or 0.1 N·m."""


class Forces(NamedTuple):
    """Raw forces; ±16384 is the full scale."""

    x: int
    y: int
    z: int
    counter: int


class Moments(NamedTuple):
    """Raw moments of the sample with the same counter."""

    x: int
    y: int
    z: int
    counter: int


class Bootup(NamedTuple):
    """Report of a board that has started and read its sensor; earlier commands are void."""


BoardMessage = Ack | Forces | Moments | Bootup


class Malformed(NamedTuple):
    """Frame from a board that cannot be decoded."""

    reason: str
    """Reason, one of a few fixed phrases suitable as keys of counters."""
    opcode: int


_SAMPLE = struct.Struct("<3hH")
_SCALES = struct.Struct("<B3H")

_FROM_HOST: dict[int, tuple[type[HostMessage], struct.Struct]] = {
    int(opcode): (message, struct.Struct(f"<{letters}"))
    for opcode, message, letters in (
        (Opcode.SYNC, Sync, ""),
        (Opcode.START_SYNC, StartSync, "H"),
        (Opcode.START_ASYNC, StartAsync, "HI"),
        (Opcode.STOP, Stop, ""),
        (Opcode.ZERO_OFFS, ZeroOffs, ""),
        (Opcode.SET_FILTER, SetFilter, "H"),
        (Opcode.GET_STATE, GetState, ""),
        (Opcode.GET_FS_FORCES, GetFsForces, ""),
        (Opcode.GET_FS_MOMENTS, GetFsMoments, ""),
        (Opcode.RESET, Reset, ""),
        (Opcode.GRIPPER_PWM, GripperPwm, "f"),
    )
}
"""Message and its layout by opcode."""
_TO_BOARD = {message: (opcode, layout) for opcode, (message, layout) in _FROM_HOST.items()}

_ACK_BYTES = 1


def decode_from_board(arbitration_id: int, data: bytes) -> BoardMessage | Malformed | None:
    """Decode a frame of a board; None for a frame that boards do not send. Never raises.

    Longer payloads than those of the protocol are malformed, too.
    """
    opcode = arbitration_id & ~NODE_MASK
    size = len(data)
    if opcode == Opcode.FORCES or opcode == Opcode.MOMENTS:
        if size != _SAMPLE.size:
            return Malformed("of a wrong length", opcode)
        if opcode == Opcode.FORCES:
            return Forces(*_SAMPLE.unpack(data))
        return Moments(*_SAMPLE.unpack(data))
    if opcode == Opcode.ACK:
        if size == _ACK_BYTES:
            return Ack(data[0])
        if size == _SCALES.size:
            state, x, y, z = _SCALES.unpack(data)
            return Ack(state, (x, y, z))
        return Malformed("of a wrong length", opcode)
    if opcode == Opcode.BOOTUP:
        return Malformed("of a wrong length", opcode) if data else Bootup()
    return None


def encode_from_board(message: BoardMessage, node_id: int) -> CanFrame:
    """Encode `message` as a frame from the board `node_id`."""
    if isinstance(message, Forces):
        return CanFrame(Opcode.FORCES + node_id, _SAMPLE.pack(*message))
    if isinstance(message, Moments):
        return CanFrame(Opcode.MOMENTS + node_id, _SAMPLE.pack(*message))
    if isinstance(message, Bootup):
        return CanFrame(Opcode.BOOTUP + node_id, b"")
    if message.full_scales is None:
        return CanFrame(Opcode.ACK + node_id, bytes((message.state,)))
    return CanFrame(Opcode.ACK + node_id, _SCALES.pack(message.state, *message.full_scales))


def decode_from_host(arbitration_id: int, data: bytes) -> HostMessage | None:
    """Decode a frame of a host as a board does; None for a frame that boards ignore.

    As on the board, a field that the payload is too short for reads as 0, and bytes after the
    last field are ignored. Never raises.
    """
    opcode = arbitration_id & ~NODE_MASK
    if opcode not in _FROM_HOST or (opcode == Opcode.SYNC and arbitration_id != opcode):
        return None
    message, layout = _FROM_HOST[opcode]
    if len(data) >= layout.size:
        return message(*layout.unpack_from(data))
    values: list[Any] = []
    at = 0
    for letter in layout.format.removeprefix("<"):
        size = struct.calcsize(f"<{letter}")
        piece = data[at : at + size]
        values += struct.unpack(f"<{letter}", piece if len(piece) == size else bytes(size))
        at += size
    return message(*values)


def encode_from_host(message: HostMessage, node_id: int) -> CanFrame:
    """Encode a request to the board `node_id`. Raises ValueError for a value that does not fit."""
    opcode, layout = _TO_BOARD[type(message)]
    try:
        data = layout.pack(*message)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{message}: {error}") from None
    return CanFrame(opcode if opcode == Opcode.SYNC else opcode + node_id, data)


def centihertz(cutoff_hz: float) -> int:
    """Convert a cut-off, Hz, to the wire's 0.01 Hz. Raises ValueError outside 0 to
    `MAX_CUTOFF_HZ`."""
    if not (math.isfinite(cutoff_hz) and 0.0 <= cutoff_hz <= MAX_CUTOFF_HZ):
        raise ValueError(f"a cut-off of {cutoff_hz!r} Hz; allowed: 0 to {MAX_CUTOFF_HZ}")
    return round(cutoff_hz * 100.0)
