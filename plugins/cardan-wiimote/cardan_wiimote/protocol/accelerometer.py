"""The accelerometer's factory calibration in the remote's EEPROM, and counts <-> g.

Axes of the remote, flat, buttons up, camera end away from the operator: +x left, +y towards the
tail, +z up, right-handed. The measurand is specific force: (0, 0, +1 g) flat and at rest.

Source: WiiBrew, Dolphin, xwiimote's EEPROM dumps.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import NamedTuple

from cardan_wiimote.protocol.inputs import Triple

EEPROM_BYTES = 0x1700
"""Readable bytes; a request beyond them fails completely."""
CAMERA_CALIBRATION_ADDRESSES = (0x0000, 0x000B)
CAMERA_CALIBRATION_BYTES = 11
ACCELEROMETER_CALIBRATION_ADDRESSES = (0x0016, 0x0020)
ACCELEROMETER_CALIBRATION_BYTES = 10

COUNTS_MAX = 1023
_ZERO_RANGE = (440, 600)
_SPAN_RANGE = (80, 130)
CHECKSUM_SEED = 0x55

Vector = tuple[float, float, float]


class AccelerometerCalibration(NamedTuple):
    """Counts (10 bits) at 0 g and at +1 g along each axis."""

    zero: Triple
    one_g: Triple
    volume: int = 0x40
    """Speaker volume (7 bits) and the motor's enable bit; not used by Cardan."""


DEFAULT_ACCELEROMETER = AccelerometerCalibration((512, 512, 512), (616, 616, 616))
"""For remotes without a usable calibration."""


class CalibrationSource(enum.Enum):
    """Block that a calibration comes from."""

    FIRST = "first"
    SECOND = "second"
    DEFAULT = "default"


def checksum(block: bytes) -> int:
    """Return the last byte of a calibration block, from the bytes before."""
    return (sum(block) + CHECKSUM_SEED) & 0xFF


def decode_accelerometer_calibration(block: bytes) -> AccelerometerCalibration | None:
    """Decode a block of ten bytes; None if it is short, its checksum wrong or it is implausible."""
    if len(block) < ACCELEROMETER_CALIBRATION_BYTES or checksum(block[:9]) != block[9]:
        return None
    zero, one_g = points(block)
    if not all(_ZERO_RANGE[0] <= value <= _ZERO_RANGE[1] for value in zero):
        return None
    if not all(_SPAN_RANGE[0] <= b - a <= _SPAN_RANGE[1] for a, b in zip(zero, one_g, strict=True)):
        return None
    return AccelerometerCalibration(zero, one_g, block[8])


def encode_accelerometer_calibration(value: AccelerometerCalibration) -> bytes:
    """Encode the block of ten bytes. Raises ValueError for values that do not fit."""
    body = encode_points(value.zero, value.one_g) + bytes((value.volume,))
    return body + bytes((checksum(body),))


def read_accelerometer_calibration(
    both: bytes,
) -> tuple[AccelerometerCalibration, CalibrationSource]:
    """Return the calibration from the 20 bytes at 0x0016: first block, else second, else
    defaults."""
    first = decode_accelerometer_calibration(both[:10])
    if first is not None:
        return first, CalibrationSource.FIRST
    second = decode_accelerometer_calibration(both[10:20])
    if second is not None:
        return second, CalibrationSource.SECOND
    return DEFAULT_ACCELEROMETER, CalibrationSource.DEFAULT


def points(block: bytes) -> tuple[Triple, Triple]:
    """Return zero and 1 g from the first eight bytes of a block, also of a Nunchuk's."""
    x0, y0, z0, low0, x1, y1, z1, low1 = block[:8]
    return (
        (x0 << 2 | low0 >> 4 & 3, y0 << 2 | low0 >> 2 & 3, z0 << 2 | low0 & 3),
        (x1 << 2 | low1 >> 4 & 3, y1 << 2 | low1 >> 2 & 3, z1 << 2 | low1 & 3),
    )


def encode_points(zero: Triple, one_g: Triple) -> bytes:
    """Encode the first eight bytes of a block. Raises ValueError for counts beyond 0..1023."""
    body = bytearray()
    for x, y, z in (zero, one_g):
        if not all(0 <= value <= COUNTS_MAX for value in (x, y, z)):
            raise ValueError(f"counts {(x, y, z)} are not in 0..{COUNTS_MAX}")
        body += bytes((x >> 2, y >> 2, z >> 2, (x & 3) << 4 | (y & 3) << 2 | z & 3))
    return bytes(body)


def to_g(counts: Sequence[int], zero: Triple, one_g: Triple) -> Vector:
    """Return the specific force in g along the remote's axes."""
    x, y, z = counts
    return (
        (x - zero[0]) / (one_g[0] - zero[0]),
        (y - zero[1]) / (one_g[1] - zero[1]),
        (z - zero[2]) / (one_g[2] - zero[2]),
    )


def from_g(force_g: Sequence[float], zero: Triple, one_g: Triple) -> Triple:
    """Return the nearest counts, clipped to 0..1023: the inverse of `to_g`."""
    x, y, z = (
        min(COUNTS_MAX, max(0, round(a + g * (b - a))))
        for g, a, b in zip(force_g, zero, one_g, strict=True)
    )
    return x, y, z


def roll_and_pitch_rad(force_g: Sequence[float]) -> tuple[float, float]:
    """Return roll (positive: right side down) and pitch (positive: nose up) of a remote at rest,
    rad.

    Valid while gravity is the only acceleration; roll is undefined near a pitch of 90 degrees.
    """
    gx, gy, gz = force_g
    return math.atan2(gx, gz), math.atan2(-gy, math.hypot(gx, gz))


def to_operator_axes(vector: Sequence[float]) -> Vector:
    """A vector in the remote's axes in the operator's: x forward, y left, z up.

    The same for rotation vectors.
    """
    x, y, z = vector
    return (0.0 - y, x, z)


def from_operator_axes(vector: Sequence[float]) -> Vector:
    """Inverse of `to_operator_axes`."""
    x, y, z = vector
    return (y, 0.0 - x, z)
