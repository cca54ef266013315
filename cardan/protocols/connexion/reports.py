"""HID reports of 3Dconnexion's six-axis devices: bytes to values and back.

Raw frame: right-handed, +X right, +Y towards the operator, +Z down; rotations right-handed about
these axes. Integers are little-endian.

Source: spacenavd, libspnavdev, PySpaceMouse and published captures of the devices.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from cardan.protocols.hid import BAD_VALUE, EMPTY, TOO_SHORT, UNKNOWN_ID, MalformedReport

TRANSLATION_ID = 0x01
"""Translation (7 bytes), or all six axes (13 bytes)."""
ROTATION_ID = 0x02
BUTTONS_ID = 0x03
LED_ID = 0x04
LONG_PRESS_BITS_ID = 0x16
BATTERY_ID = 0x17
KEYS_DOWN_ID = 0x1C
LONG_PRESS_ID = 0x1D

HALF_BYTES = 7
MOTION_BYTES = 13
LONGEST_BUTTONS_BYTES = 7
KEY_ARRAY_BYTES = 13
KEY_SLOTS = 6

COUNT_MIN, COUNT_MAX = -32768, 32767

_HALF = struct.Struct("<B3h")
_MOTION = struct.Struct("<B6h")
_KEYS = struct.Struct("<B6H")
_THREE = struct.Struct("<3h").unpack_from
_SIX = struct.Struct("<6h").unpack_from
_CODES = struct.Struct("<6H").unpack_from


class Translation(NamedTuple):
    """Report 1 of a SPLIT device: counts in the raw frame."""

    x: int
    y: int
    z: int


class Rotation(NamedTuple):
    """Report 2 of a SPLIT device: counts in the raw frame."""

    rx: int
    ry: int
    rz: int


class MotionReport(NamedTuple):
    """Report 1 of a ONE device: counts in the raw frame."""

    x: int
    y: int
    z: int
    rx: int
    ry: int
    rz: int


class ButtonBits(NamedTuple):
    """Report 3: pressed buttons, one bit each."""

    mask: int


class KeysDown(NamedTuple):
    """Report 0x1C: V3DK codes of the pressed keys."""

    codes: tuple[int, ...]


class LongPress(NamedTuple):
    """Report 0x1D: V3DK codes of the keys held long."""

    codes: tuple[int, ...]


class LongPressBits(NamedTuple):
    """Report 0x16: keys held long, bit n for V3DK code n + 1."""

    mask: int


class Battery(NamedTuple):
    """Report 0x17."""

    percent: int
    external_power: bool


class LedOutput(NamedTuple):
    """Output report 4."""

    on: bool


InputReport = (
    Translation
    | Rotation
    | MotionReport
    | ButtonBits
    | KeysDown
    | LongPress
    | LongPressBits
    | Battery
    | MalformedReport
)


def decode_input(report: bytes) -> InputReport:
    """Decode one input report of its true length, id first. Never raises.

    Report 1 means all six axes from 13 bytes on; trailing bytes of any report are ignored. The
    bytes missing from a short report 3 count as zero.
    """
    size = len(report)
    if size == 0:
        return MalformedReport(EMPTY, -1)
    report_id = report[0]
    if report_id == TRANSLATION_ID:
        if size >= MOTION_BYTES:
            return MotionReport._make(_SIX(report, 1))
        # A length between the two is a truncated whole report: read as a half, it would leave the
        # rotation unchanged.
        if size == HALF_BYTES:
            return Translation._make(_THREE(report, 1))
    elif report_id == ROTATION_ID:
        if size >= HALF_BYTES:
            return Rotation._make(_THREE(report, 1))
    elif report_id == BUTTONS_ID:
        if size >= 2:
            return ButtonBits(int.from_bytes(report[1:LONGEST_BUTTONS_BYTES], "little"))
    elif report_id == KEYS_DOWN_ID:
        if size >= KEY_ARRAY_BYTES:
            return KeysDown(tuple(filter(None, _CODES(report, 1))))
    elif report_id == LONG_PRESS_ID:
        if size >= KEY_ARRAY_BYTES:
            return LongPress(tuple(filter(None, _CODES(report, 1))))
    elif report_id == LONG_PRESS_BITS_ID:
        if size >= 5:
            return LongPressBits(int.from_bytes(report[1:5], "little") & 0x7FFFFFFF)
    elif report_id == BATTERY_ID:
        if size >= 3:
            if report[1] > 100:
                return MalformedReport(BAD_VALUE, report_id)
            return Battery(report[1], bool(report[2] & 1))
    else:
        return MalformedReport(UNKNOWN_ID, report_id)
    return MalformedReport(TOO_SHORT, report_id)


def decode_output(report: bytes) -> LedOutput | MalformedReport:
    """Decode one output report, id first. Never raises."""
    if len(report) == 0:
        return MalformedReport(EMPTY, -1)
    if report[0] != LED_ID:
        return MalformedReport(UNKNOWN_ID, report[0])
    if len(report) < 2:
        return MalformedReport(TOO_SHORT, report[0])
    return LedOutput(bool(report[1] & 1))


def encode_translation(x: int, y: int, z: int) -> bytes:
    """Encode report 1 of a SPLIT device. Like all here, raises ValueError for counts beyond 16
    bits."""
    return _pack(_HALF, TRANSLATION_ID, x, y, z)


def encode_rotation(rx: int, ry: int, rz: int) -> bytes:
    """Encode report 2 of a SPLIT device."""
    return _pack(_HALF, ROTATION_ID, rx, ry, rz)


def encode_motion(x: int, y: int, z: int, rx: int, ry: int, rz: int) -> bytes:
    """Encode report 1 of a ONE device."""
    return _pack(_MOTION, TRANSLATION_ID, x, y, z, rx, ry, rz)


def encode_buttons(mask: int, length: int) -> bytes:
    """Encode report 3 of `length` bytes, its id included."""
    try:
        return bytes((BUTTONS_ID,)) + mask.to_bytes(length - 1, "little")
    except OverflowError:
        raise ValueError(f"button mask {mask:#x} does not fit {length - 1} bytes") from None


def encode_keys_down(codes: Iterable[int]) -> bytes:
    """Encode report 0x1C with at most six V3DK codes."""
    return _encode_keys(KEYS_DOWN_ID, codes)


def encode_long_press(codes: Iterable[int]) -> bytes:
    """Encode report 0x1D with at most six V3DK codes."""
    return _encode_keys(LONG_PRESS_ID, codes)


def encode_battery(percent: int, external_power: bool) -> bytes:
    """Encode report 0x17."""
    if not 0 <= percent <= 100:
        raise ValueError(f"battery charge {percent} is not in 0..100 percent")
    return bytes((BATTERY_ID, percent, external_power))


def encode_led(on: bool) -> bytes:
    """Encode output report 4."""
    return bytes((LED_ID, on))


def _encode_keys(report_id: int, codes: Iterable[int]) -> bytes:
    slots = [*codes]
    if len(slots) > KEY_SLOTS:
        raise ValueError(f"{len(slots)} keys do not fit the {KEY_SLOTS} slots of the report")
    return _pack(_KEYS, report_id, *slots, *(0,) * (KEY_SLOTS - len(slots)))


def _pack(layout: struct.Struct, *values: int) -> bytes:
    try:
        return layout.pack(*values)
    except struct.error as error:
        raise ValueError(f"cannot encode {values[1:]}: {error}") from None


# ---------------------------------------------------------------------------------------------
# Frames


def to_robot_axes(
    raw: Sequence[int], full_scale: float
) -> tuple[float, float, float, float, float, float]:
    """Convert six raw counts to deflections in -1..1 (clamped): x forward, y left, z up,
    right-handed."""
    counts: Sequence[float] = raw
    if max(raw) > full_scale or min(raw) < -full_scale:
        counts = [min(full_scale, max(-full_scale, count)) for count in raw]
    x, y, z, rx, ry, rz = counts
    # Subtracting from 0.0 instead of negating keeps rest free of negative zeros.
    return (
        0.0 - y / full_scale,
        0.0 - x / full_scale,
        0.0 - z / full_scale,
        0.0 - ry / full_scale,
        0.0 - rx / full_scale,
        0.0 - rz / full_scale,
    )


def from_robot_axes(
    axes: Sequence[float], full_scale: float
) -> tuple[int, int, int, int, int, int]:
    """Convert deflections in -1..1 to the nearest raw counts: the inverse of `to_robot_axes`."""
    vx, vy, vz, wx, wy, wz = (round(-_clamp(value) * full_scale) for value in axes)
    return (vy, vx, vz, wy, wx, wz)


def from_serial_axes(raw: Sequence[int]) -> tuple[int, int, int, int, int, int]:
    """Convert counts of a `Model.serial_axes` device (right, up, away) to the usual raw frame."""
    x, y, z, rx, ry, rz = raw
    return (x, -z, -y, rx, -rz, -ry)


def _clamp(value: float) -> float:
    return -1.0 if value < -1.0 else 1.0 if value > 1.0 else value
