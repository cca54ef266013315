"""Extensions of the remote: ids, start-up, and the Nunchuk.

Source: WiiBrew (Wiimote/Extension_Controllers), Dolphin, hid-wiimote.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from cardan_wiimote.protocol.accelerometer import CHECKSUM_SEED, checksum, encode_points, points
from cardan_wiimote.protocol.inputs import Triple
from cardan_wiimote.protocol.outputs import ReadMemory, WriteMemory

EXTENSION_ADDRESS = 0xA40000
"""Registers of the extension port, or of an active MotionPlus."""
CALIBRATION_OFFSET = 0x20
ID_OFFSET = 0xFA
ID_BYTES = 6

EXTENSION_START = (
    WriteMemory(EXTENSION_ADDRESS + 0xF0, b"\x55"),
    WriteMemory(EXTENSION_ADDRESS + 0xFB, b"\x00"),
)
"""Starts an extension without encryption; also deactivates a MotionPlus. Send one at a time."""
READ_EXTENSION_ID = ReadMemory(EXTENSION_ADDRESS + ID_OFFSET, ID_BYTES)
READ_NUNCHUK_CALIBRATION = ReadMemory(EXTENSION_ADDRESS + CALIBRATION_OFFSET, 16)


class Extension(enum.Enum):
    """Kinds of extensions and their states, by id."""

    NUNCHUK = "nunchuk"
    CLASSIC = "classic"
    CLASSIC_PRO = "classic-pro"
    BALANCE_BOARD = "balance-board"
    MOTION_PLUS = "motion-plus"
    """Active, alone."""
    MOTION_PLUS_NUNCHUK = "motion-plus-nunchuk"
    """Active, passes a Nunchuk through."""
    MOTION_PLUS_CLASSIC = "motion-plus-classic"
    MOTION_PLUS_INACTIVE = "motion-plus-inactive"
    UNINITIALIZED = "uninitialized"
    """An extension is plugged in and needs its start-up."""
    UNKNOWN = "unknown"


EXTENSION_IDS: Mapping[Extension, bytes] = MappingProxyType(
    {
        Extension.NUNCHUK: bytes.fromhex("0000a4200000"),
        Extension.CLASSIC: bytes.fromhex("0000a4200101"),
        Extension.CLASSIC_PRO: bytes.fromhex("0100a4200101"),
        Extension.BALANCE_BOARD: bytes.fromhex("0000a4200402"),
        Extension.MOTION_PLUS: bytes.fromhex("0000a4200405"),
        Extension.MOTION_PLUS_NUNCHUK: bytes.fromhex("0000a4200505"),
        Extension.MOTION_PLUS_CLASSIC: bytes.fromhex("0000a4200705"),
        Extension.MOTION_PLUS_INACTIVE: bytes.fromhex("0000a6200005"),
    }
)
"""The six bytes at 0xA400FA (inactive MotionPlus: 0xA600FA)."""

_BY_KIND = {
    value[4:]: key for key, value in EXTENSION_IDS.items() if key is not Extension.CLASSIC_PRO
}


def extension_of(identity: bytes) -> Extension:
    """Return the extension with these six bytes at 0xA400FA or 0xA600FA. Never raises."""
    if len(identity) != ID_BYTES:
        return Extension.UNKNOWN
    if identity[4:] == b"\xff\xff":
        return Extension.UNINITIALIZED
    if identity[3] != 0x20 or identity[2] not in (0xA4, 0xA6):
        return Extension.UNKNOWN
    if identity[2] == 0xA6 and identity[5] == 0x05:
        # A MotionPlus that was active shows its last mode, although it is inactive.
        return Extension.MOTION_PLUS_INACTIVE
    kind = _BY_KIND.get(identity[4:], Extension.UNKNOWN)
    if kind is Extension.CLASSIC and identity[0] == 1:
        return Extension.CLASSIC_PRO
    return kind


# ---------------------------------------------------------------------------------------------
# Nunchuk


class NunchukData(NamedTuple):
    """Measurement of a Nunchuk."""

    stick_x: int
    """0..255, right is more; about 35 to 228 with the center near 128."""
    stick_y: int
    """0..255, forward is more."""
    accelerometer: Triple
    """Counts 0..1023; axes as those of the remote."""
    c: bool
    z: bool


class NunchukCalibration(NamedTuple):
    """The Nunchuk's factory calibration."""

    zero: Triple
    one_g: Triple
    stick_x: Triple
    """Lowest, center, highest."""
    stick_y: Triple


DEFAULT_NUNCHUK = NunchukCalibration(
    (512, 512, 512), (716, 716, 716), (32, 128, 224), (32, 128, 224)
)
"""For clones without a calibration; the true center is the mean at rest."""


def decode_nunchuk(data: bytes) -> NunchukData | None:
    """Decode the first six bytes of the extension; None: no Nunchuk (short, all FF or all zero)."""
    if _absent(data):
        return None
    sx, sy, ax, ay, az, m = data[:6]
    return NunchukData(
        sx, sy, (ax << 2 | m >> 2 & 3, ay << 2 | m >> 4 & 3, az << 2 | m >> 6),
        not m & 2, not m & 1,
    )  # fmt: skip


def encode_nunchuk(value: NunchukData) -> bytes:
    """Encode six bytes of a Nunchuk alone."""
    ax, ay, az = value.accelerometer
    m = (az & 3) << 6 | (ay & 3) << 4 | (ax & 3) << 2 | (not value.c) << 1 | (not value.z)
    return bytes((value.stick_x, value.stick_y, ax >> 2, ay >> 2, az >> 2, m))


def decode_nunchuk_pass_through(data: bytes) -> NunchukData | None:
    """Decode six bytes of a Nunchuk behind a MotionPlus, which takes the lowest accelerometer bits.

    None: no Nunchuk, or the frame is the MotionPlus's own (bit 1 of the last byte).
    """
    if _absent(data) or data[5] & 3:
        return None
    sx, sy, ax, ay, az, m = data[:6]
    return NunchukData(
        sx, sy,
        (ax << 2 | m >> 3 & 2, ay << 2 | m >> 4 & 2, (az & 0xFE) << 2 | m >> 5 & 6),
        not m & 8, not m & 4,
    )  # fmt: skip


def encode_nunchuk_pass_through(value: NunchukData, plugged: bool = True) -> bytes:
    """Encode six bytes of a Nunchuk behind a MotionPlus."""
    ax, ay, az = value.accelerometer
    m = (
        (az >> 1 & 3) << 6 | (ay >> 1 & 1) << 5 | (ax >> 1 & 1) << 4
        | (not value.c) << 3 | (not value.z) << 2
    )  # fmt: skip
    return bytes((value.stick_x, value.stick_y, ax >> 2, ay >> 2, az >> 3 << 1 | plugged, m))


def decode_nunchuk_calibration(block: bytes) -> NunchukCalibration | None:
    """Decode the 16 bytes at 0xA40020; None if short, with a wrong checksum or implausible."""
    if len(block) < 16:
        return None
    first = checksum(block[:14])
    if block[14] != first or block[15] != (first + CHECKSUM_SEED) & 0xFF:
        return None
    zero, one_g = points(block)
    x_max, x_min, x_mid, y_max, y_min, y_mid = block[8:14]
    if not (x_min < x_mid < x_max and y_min < y_mid < y_max):
        return None
    if any(b <= a for a, b in zip(zero, one_g, strict=True)):
        return None
    return NunchukCalibration(zero, one_g, (x_min, x_mid, x_max), (y_min, y_mid, y_max))


def encode_nunchuk_calibration(value: NunchukCalibration) -> bytes:
    """Encode the block of 16 bytes. Raises ValueError for values that do not fit."""
    sticks = (
        value.stick_x[2], value.stick_x[0], value.stick_x[1],
        value.stick_y[2], value.stick_y[0], value.stick_y[1],
    )  # fmt: skip
    body = encode_points(value.zero, value.one_g) + bytes(sticks)
    first = checksum(body)
    return body + bytes((first, (first + CHECKSUM_SEED) & 0xFF))


def stick_deflection(value: int, calibration: Triple) -> float:
    """Return a stick's axis in -1..1 (clamped) by its lowest, center and highest reading."""
    low, center, high = calibration
    if value >= center:
        return min(1.0, (value - center) / (high - center))
    return max(-1.0, (value - center) / (center - low))


def _absent(data: bytes) -> bool:
    return len(data) < 6 or data[:6] == b"\xff" * 6 or not any(data[:6])
