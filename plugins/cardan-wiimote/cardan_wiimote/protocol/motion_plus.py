"""MotionPlus: three gyroscopes with a fine and a coarse range, their frames and calibration.

Rates are in the remote's axes (+x left, +y towards the tail, +z up), right-handed.

Source: WiiBrew (Wii_Motion_Plus), Dolphin, hid-wiimote; the calibration from two real blocks.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

from cardan_wiimote.protocol.extensions import (
    CALIBRATION_OFFSET,
    EXTENSION_ADDRESS,
    ID_BYTES,
    ID_OFFSET,
)
from cardan_wiimote.protocol.inputs import Triple
from cardan_wiimote.protocol.outputs import ReadMemory, WriteMemory

MOTION_PLUS_ADDRESS = 0xA60000
"""Registers of an inactive MotionPlus; an active one is at the extension port."""
PASS_NONE, PASS_NUNCHUK, PASS_CLASSIC = 0x04, 0x05, 0x07
"""Values that activate it: alone, or passing an extension through."""

READ_MOTION_PLUS_ID = ReadMemory(MOTION_PLUS_ADDRESS + ID_OFFSET, ID_BYTES)
MOTION_PLUS_START = WriteMemory(MOTION_PLUS_ADDRESS + 0xF0, b"\x55")
"""Initialize; comes before `motion_plus_activate`."""
MOTION_PLUS_STOP = WriteMemory(EXTENSION_ADDRESS + 0xF0, b"\x55")
READ_MOTION_PLUS_CALIBRATION = ReadMemory(MOTION_PLUS_ADDRESS + CALIBRATION_OFFSET, 32)
"""Possible while it is inactive."""

RAW_MAX = 16383
RAW_REST = 8192
_CALIBRATION_STEPS = 4
"""A calibration's readings have 16 bits, a frame's 14."""
_BLOCK = struct.Struct(">6HBBH")

Vector = tuple[float, float, float]


class MotionPlusData(NamedTuple):
    """A frame: 14-bit readings, about 8192 at rest, each in its fine or coarse range."""

    yaw: int
    roll: int
    pitch: int
    yaw_slow: bool
    """True: the fine range."""
    roll_slow: bool
    pitch_slow: bool
    extension: bool
    """True if an extension is plugged into the MotionPlus."""


class MotionPlusRange(NamedTuple):
    """Calibration of one range, in the order yaw, roll, pitch."""

    zero: Triple
    """16-bit readings at rest."""
    scale: Triple
    """16-bit readings at `degrees_s`."""
    degrees_s: int
    """Degrees per second; a multiple of 6."""


class MotionPlusCalibration(NamedTuple):
    """Factory calibration."""

    fast: MotionPlusRange
    slow: MotionPlusRange
    unique_id: tuple[int, int] = (0, 0)


DEFAULT_MOTION_PLUS = MotionPlusCalibration(
    MotionPlusRange((32768, 32768, 32768), (13107, 52429, 13107), 1200),
    MotionPlusRange((32768, 32768, 32768), (12660, 52876, 12660), 270),
)
"""8192/2000 and 8192/440 counts per degree per second; real units differ by up to 30 percent."""


def motion_plus_activate(passing: int = PASS_NONE) -> WriteMemory:
    """Move the MotionPlus to the extension port, which is dead for some 20 ms and then reports it
    by status reports. `passing` is one of PASS_NONE, PASS_NUNCHUK, PASS_CLASSIC."""
    return WriteMemory(MOTION_PLUS_ADDRESS + 0xFE, bytes((passing,)))


def is_motion_plus_frame(data: bytes) -> bool:
    """Return True if the extension's six bytes are the MotionPlus's own and not passed through."""
    return len(data) >= 6 and data[5] & 3 == 2


def decode_motion_plus(data: bytes) -> MotionPlusData | None:
    """Decode a frame of the MotionPlus; None: not its own, invalid or short."""
    if not is_motion_plus_frame(data):
        return None
    yaw, roll, pitch, b3, b4, b5 = data[:6]
    return MotionPlusData(
        yaw | (b3 & 0xFC) << 6, roll | (b4 & 0xFC) << 6, pitch | (b5 & 0xFC) << 6,
        bool(b3 & 2), bool(b4 & 2), bool(b3 & 1), bool(b4 & 1),
    )  # fmt: skip


def encode_motion_plus(value: MotionPlusData) -> bytes:
    """Encode six bytes. Raises ValueError for readings beyond 14 bits."""
    if not all(0 <= reading <= RAW_MAX for reading in value[:3]):
        raise ValueError(f"readings {value[:3]} are not in 0..{RAW_MAX}")
    return bytes(
        (
            value.yaw & 255,
            value.roll & 255,
            value.pitch & 255,
            value.yaw >> 8 << 2 | value.yaw_slow << 1 | value.pitch_slow,
            value.roll >> 8 << 2 | value.roll_slow << 1 | value.extension,
            value.pitch >> 8 << 2 | 2,
        )
    )


def decode_motion_plus_calibration(block: bytes) -> MotionPlusCalibration | None:
    """Decode the 32 bytes at offset 0x20; None if short, with a wrong CRC or without any span."""
    if len(block) < 32:
        return None
    fast_raw, slow_raw = _BLOCK.unpack_from(block, 0), _BLOCK.unpack_from(block, 16)
    if zlib.crc32(block[:14] + block[16:30]) != fast_raw[8] << 16 | slow_raw[8]:
        return None
    ranges = []
    for raw in (fast_raw, slow_raw):
        zero, scale = (raw[0], raw[1], raw[2]), (raw[3], raw[4], raw[5])
        if raw[6] == 0 or any(a == b for a, b in zip(zero, scale, strict=True)):
            return None
        ranges.append(MotionPlusRange(zero, scale, raw[6] * 6))
    return MotionPlusCalibration(ranges[0], ranges[1], (fast_raw[7], slow_raw[7]))


def encode_motion_plus_calibration(value: MotionPlusCalibration) -> bytes:
    """Encode the block of 32 bytes. Raises ValueError for values that do not fit."""
    bodies = []
    for part, unique_id in zip((value.fast, value.slow), value.unique_id, strict=True):
        if part.degrees_s % 6:
            raise ValueError(f"{part.degrees_s} deg/s is not a multiple of 6")
        try:
            packed = _BLOCK.pack(*part.zero, *part.scale, part.degrees_s // 6, unique_id, 0)
        except struct.error as error:
            raise ValueError(f"cannot encode {part}: {error}") from None
        bodies.append(packed[:14])
    crc = zlib.crc32(bodies[0] + bodies[1]).to_bytes(4, "big")
    return bodies[0] + crc[:2] + bodies[1] + crc[2:]


def to_rad_s(
    data: MotionPlusData, calibration: MotionPlusCalibration = DEFAULT_MOTION_PLUS
) -> Vector:
    """Return the angular velocity about the remote's axes, rad/s."""
    yaw = _rate(data.yaw, calibration.slow if data.yaw_slow else calibration.fast, 0)
    roll = _rate(data.roll, calibration.slow if data.roll_slow else calibration.fast, 1)
    pitch = _rate(data.pitch, calibration.slow if data.pitch_slow else calibration.fast, 2)
    return (0.0 - pitch, roll, 0.0 - yaw)


def from_rad_s(
    rates_rad_s: Sequence[float],
    calibration: MotionPlusCalibration = DEFAULT_MOTION_PLUS,
    extension: bool = False,
) -> MotionPlusData:
    """Return the nearest frame: each axis in the fine range if it fits, else coarse, clipped."""
    x, y, z = rates_rad_s
    readings, slow = [], []
    for axis, rate in enumerate((-z, y, -x)):
        raw = _reading(rate, calibration.slow, axis)
        fits = 0 <= raw <= RAW_MAX
        if not fits:
            raw = min(RAW_MAX, max(0, _reading(rate, calibration.fast, axis)))
        readings.append(raw)
        slow.append(fits)
    return MotionPlusData(
        readings[0], readings[1], readings[2], slow[0], slow[1], slow[2], extension
    )


def _rate(raw: int, part: MotionPlusRange, axis: int) -> float:
    zero = part.zero[axis]
    share = (raw * _CALIBRATION_STEPS - zero) / (part.scale[axis] - zero)
    return share * math.radians(part.degrees_s)


def _reading(rate_rad_s: float, part: MotionPlusRange, axis: int) -> int:
    zero = part.zero[axis]
    share = rate_rad_s / math.radians(part.degrees_s)
    return round((zero + share * (part.scale[axis] - zero)) / _CALIBRATION_STEPS)
