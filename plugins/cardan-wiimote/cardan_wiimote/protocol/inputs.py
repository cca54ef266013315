"""Input reports of the remote (remote to host): bytes to values and back.

Reports are given with their id first and without the header byte of L2CAP.

Source: WiiBrew (Wiimote/Protocol), Dolphin, the Linux kernel's hid-wiimote, libcwiid.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from cardan.protocols.hid import EMPTY, TOO_SHORT, UNKNOWN_ID, MalformedReport
from cardan_wiimote.protocol.identity import (
    ACK_ID,
    FIRST_HALF_ID,
    INPUT_SIZES,
    READ_DATA_ID,
    SECOND_HALF_ID,
    STATUS_ID,
)
from cardan_wiimote.protocol.values import BUTTON_MASK

READ_PIECE_BYTES = 16
"""Most bytes in one reply to a read."""
BATTERY_LOW = 0x20
"""Battery value below which the remote's battery flag is set."""
BATTERY_FULL = 0xC8
"""Battery value of new alkaline cells."""

Triple = tuple[int, int, int]


class IrFormat(enum.IntEnum):
    """Formats of the camera's dots; the values are those of its mode register."""

    BASIC = 1
    EXTENDED = 3
    FULL = 5


class DataLayout(NamedTuple):
    """Layout of a data report; offsets count from the byte after the id."""

    size: int
    buttons: bool
    accelerometer: bool
    ir_at: int
    ir_bytes: int
    ir_format: IrFormat | None
    extension_at: int
    extension_bytes: int


def _layout(
    *,
    buttons: bool = True,
    accelerometer: bool = False,
    ir: int = 0,
    ir_format: IrFormat | None = None,
    extension: int = 0,
) -> DataLayout:
    ir_at = 2 * buttons + 3 * accelerometer
    extension_at = ir_at + ir
    return DataLayout(
        extension_at + extension, buttons, accelerometer,
        ir_at, ir, ir_format, extension_at, extension,
    )  # fmt: skip


DATA_LAYOUTS: Mapping[int, DataLayout] = MappingProxyType(
    {
        0x30: _layout(),
        0x31: _layout(accelerometer=True),
        0x32: _layout(extension=8),
        0x33: _layout(accelerometer=True, ir=12, ir_format=IrFormat.EXTENDED),
        0x34: _layout(extension=19),
        0x35: _layout(accelerometer=True, extension=16),
        0x36: _layout(ir=10, ir_format=IrFormat.BASIC, extension=9),
        0x37: _layout(accelerometer=True, ir=10, ir_format=IrFormat.BASIC, extension=6),
        0x3D: _layout(buttons=False, extension=21),
    }
)
"""Data reports that are sent whole; 0x3E and 0x3F alternate instead (`Interleaved`)."""

DATA_MODES: frozenset[int] = frozenset({*DATA_LAYOUTS, FIRST_HALF_ID, SECOND_HALF_ID})
"""Data modes that a remote accepts; 0x3E and 0x3F mean the same."""


class Status(NamedTuple):
    """Report 0x20: on request, and unsolicited when the extension port changes."""

    buttons: int
    battery_low: bool
    extension: bool
    """True if an extension is plugged in, or the MotionPlus is active."""
    speaker: bool
    ir: bool
    leds: int
    """Bit 0 is LED 1."""
    battery: int
    """0..255; new cells show about 0xC8."""


class ReadData(NamedTuple):
    """Report 0x21: piece of memory."""

    buttons: int
    error: int
    """An `ErrorCode`."""
    address: int
    """Low 16 bits of the piece's address."""
    data: bytes
    """1 to 16 bytes; none after an error."""


class Ack(NamedTuple):
    """Report 0x22: result of an output report."""

    buttons: int
    report_id: int
    error: int
    """An `ErrorCode`."""


class Data(NamedTuple):
    """Reports 0x30 to 0x37 and 0x3D, and two interleaved halves joined."""

    mode: int
    """The report's id."""
    buttons: int | None
    """None: the report carries none (0x3D)."""
    accelerometer: Triple | None
    """Counts 0..1023 along x left, y towards the tail, z up; y and z have 9 significant bits."""
    ir: bytes
    """Undecoded, in the format of the mode's layout; empty without."""
    extension: bytes
    """Undecoded; empty without. The first six bytes are the extension's own."""


class Interleaved(NamedTuple):
    """Report 0x3E (first) or 0x3F (second): half of the remote's measurement."""

    mode: int
    buttons: int
    axis: int
    """The upper eight bits of accelerometer x (0x3E) or y (0x3F)."""
    z_bits: int
    """The upper (0x3E) or lower (0x3F) four of the upper eight bits of accelerometer z."""
    ir: bytes
    """18 bytes: dots 1 and 2, or 3 and 4, in the full format."""


InputReport = Status | ReadData | Ack | Data | Interleaved | MalformedReport


def decode_input(report: bytes) -> InputReport:
    """Decode one input report, id first. Never raises; bytes after its end are ignored."""
    size = len(report)
    if size == 0:
        return MalformedReport(EMPTY, -1)
    report_id = report[0]
    needed = INPUT_SIZES.get(report_id)
    if needed is None:
        return MalformedReport(UNKNOWN_ID, report_id)
    if size <= needed:
        return MalformedReport(TOO_SHORT, report_id)
    layout = DATA_LAYOUTS.get(report_id)
    if layout is not None:
        return _decode_data(report_id, layout, report)
    b0, b1 = report[1], report[2]
    buttons = (b1 << 8 | b0) & BUTTON_MASK
    if report_id == STATUS_ID:
        flags = report[3]
        return Status(
            buttons, bool(flags & 1), bool(flags & 2), bool(flags & 4), bool(flags & 8),
            flags >> 4, report[6],
        )  # fmt: skip
    if report_id == READ_DATA_ID:
        error = report[3] & 0x0F
        length = 0 if error else (report[3] >> 4) + 1
        address = report[4] << 8 | report[5]
        return ReadData(buttons, error, address, bytes(report[6 : 6 + length]))
    if report_id == ACK_ID:
        return Ack(buttons, report[3], report[4])
    low, high = b0 >> 5 & 3, b1 >> 5 & 3
    z_bits = high << 2 | low
    return Interleaved(report_id, buttons, report[3], z_bits, bytes(report[4:22]))


def _decode_data(report_id: int, layout: DataLayout, report: bytes) -> Data:
    buttons: int | None = None
    accelerometer: Triple | None = None
    if layout.buttons:
        b0, b1 = report[1], report[2]
        buttons = (b1 << 8 | b0) & BUTTON_MASK
        if layout.accelerometer:
            accelerometer = (
                report[3] << 2 | (b0 >> 5 & 3),
                report[4] << 2 | (b1 >> 4 & 2),
                report[5] << 2 | (b1 >> 5 & 2),
            )
    at = 1 + layout.ir_at
    end = at + layout.ir_bytes
    return Data(
        report_id, buttons, accelerometer,
        bytes(report[at:end]), bytes(report[end : end + layout.extension_bytes]),
    )  # fmt: skip


def join_halves(first: Interleaved, second: Interleaved) -> Data:
    """Join a 0x3E and the 0x3F after it: 36 bytes of camera, accelerometer of 8 bits times 4.

    Buttons are those of `second`. Raises ValueError for any other pair.
    """
    if first.mode != FIRST_HALF_ID or second.mode != SECOND_HALF_ID:
        raise ValueError(f"reports {first.mode:#x} and {second.mode:#x} are not 0x3e and 0x3f")
    z = first.z_bits << 4 | second.z_bits
    return Data(
        FIRST_HALF_ID, second.buttons, (first.axis << 2, second.axis << 2, z << 2),
        first.ir + second.ir, b"",
    )  # fmt: skip


def encode_status(status: Status) -> bytes:
    """Encode report 0x20. Raises ValueError for values that do not fit, like all encoders here."""
    leds = _in_range("leds", status.leds, 15)
    flags = (
        status.battery_low | status.extension << 1 | status.speaker << 2 | status.ir << 3
        | leds << 4
    )  # fmt: skip
    battery = _in_range("battery", status.battery, 255)
    return bytes((STATUS_ID, *_buttons(status.buttons), flags, 0, 0, battery))


def encode_read_data(value: ReadData) -> bytes:
    """Encode report 0x21; after an error the length is 16 and the data are zero, whatever `data`
    is."""
    data = b"" if value.error else value.data
    if not value.error and not 1 <= len(data) <= READ_PIECE_BYTES:
        raise ValueError(f"{len(data)} bytes are not 1 to {READ_PIECE_BYTES}")
    size = 0xF0 if value.error else len(data) - 1 << 4
    head = bytes(
        (READ_DATA_ID, *_buttons(value.buttons), size | _in_range("error", value.error, 15))
    )
    address = _in_range("address", value.address, 0xFFFF).to_bytes(2, "big")
    return head + address + data.ljust(READ_PIECE_BYTES, b"\0")


def encode_ack(value: Ack) -> bytes:
    """Encode report 0x22."""
    report_id = _in_range("report_id", value.report_id, 255)
    error = _in_range("error", value.error, 255)
    return bytes((ACK_ID, *_buttons(value.buttons), report_id, error))


def encode_data(value: Data) -> bytes:
    """Encode reports 0x30 to 0x37 and 0x3D; values that the mode does not carry must be absent.

    The lowest bits of accelerometer y and z are lost, as in the remote.
    """
    layout = DATA_LAYOUTS.get(value.mode)
    if layout is None:
        modes = ", ".join(f"{mode:#x}" for mode in DATA_LAYOUTS)
        raise ValueError(f"mode {value.mode:#x} is not one of {modes}")
    if (value.buttons is not None) != layout.buttons:
        raise ValueError(f"mode {value.mode:#x} carries {'' if layout.buttons else 'no '}buttons")
    if (value.accelerometer is not None) != layout.accelerometer:
        carries = "an" if layout.accelerometer else "no"
        raise ValueError(f"mode {value.mode:#x} carries {carries} accelerometer")
    if len(value.ir) != layout.ir_bytes or len(value.extension) != layout.extension_bytes:
        raise ValueError(
            f"mode {value.mode:#x} carries {layout.ir_bytes} bytes of the camera and "
            f"{layout.extension_bytes} of the extension, not {len(value.ir)} and "
            f"{len(value.extension)}"
        )
    head = bytes((value.mode,))
    if value.buttons is not None:
        b0, b1 = _buttons(value.buttons)
        if value.accelerometer is None:
            head += bytes((b0, b1))
        else:
            x, y, z = _counts(value.accelerometer)
            b0 |= (x & 3) << 5
            b1 |= (y & 2) << 4 | (z & 2) << 5
            head += bytes((b0, b1, x >> 2, y >> 2, z >> 2))
    return head + value.ir + value.extension


def encode_interleaved(mode: int, buttons: int, accelerometer: Sequence[int], ir: bytes) -> bytes:
    """Encode report 0x3E or 0x3F of one measurement: counts 0..1023 and that half's 18 camera
    bytes."""
    if mode not in (FIRST_HALF_ID, SECOND_HALF_ID):
        raise ValueError(f"mode {mode:#x} is neither 0x3e nor 0x3f")
    if len(ir) != 18:
        raise ValueError(f"{len(ir)} bytes of the camera are not 18")
    x, y, z = _counts(accelerometer)
    first = mode == FIRST_HALF_ID
    z_bits = z >> 6 if first else z >> 2 & 15
    b0, b1 = _buttons(buttons)
    b0 |= (z_bits & 3) << 5
    b1 |= (z_bits >> 2) << 5
    return bytes((mode, b0, b1, (x if first else y) >> 2)) + ir


def _buttons(mask: int) -> tuple[int, int]:
    if mask & ~BUTTON_MASK:
        raise ValueError(f"button mask {mask:#x} has bits beyond {BUTTON_MASK:#x}")
    return mask & 0xFF, mask >> 8


def _counts(values: Sequence[int]) -> Triple:
    x, y, z = values
    if not (0 <= x <= 1023 and 0 <= y <= 1023 and 0 <= z <= 1023):
        raise ValueError(f"accelerometer counts {(x, y, z)} are not in 0..1023")
    return x, y, z


def _in_range(name: str, value: int, highest: int) -> int:
    if not 0 <= value <= highest:
        raise ValueError(f"{name} {value} is not in 0..{highest}")
    return value
