"""Output reports of the remote (host to remote): bytes to values and back.

Every report sets the rumble motor: without its bit the motor stops.

Source: WiiBrew (Wiimote/Protocol), Dolphin, libcwiid.
"""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.hid import BAD_VALUE, EMPTY, TOO_SHORT, UNKNOWN_ID, MalformedReport
from cardan_wiimote.protocol.identity import (
    DATA_MODE_ID,
    IR_ENABLE_1_ID,
    IR_ENABLE_2_ID,
    LEDS_ID,
    OUTPUT_SIZES,
    READ_MEMORY_ID,
    RUMBLE_ID,
    SPEAKER_DATA_ID,
    SPEAKER_ENABLE_ID,
    SPEAKER_MUTE_ID,
    STATUS_REQUEST_ID,
    WRITE_MEMORY_ID,
)
from cardan_wiimote.protocol.inputs import DATA_MODES

SWITCH_IDS: frozenset[int] = frozenset(
    {IR_ENABLE_1_ID, SPEAKER_ENABLE_ID, SPEAKER_MUTE_ID, IR_ENABLE_2_ID}
)

EEPROM = 0
"""Address space of the remote's own memory."""
REGISTERS = 1
"""Address space of the bus with extension, MotionPlus, camera and speaker."""
WRITE_BYTES = 16
"""Most bytes in one write."""

_RUMBLE, _ACK, _ON = 0x01, 0x02, 0x04


class Rumble(NamedTuple):
    """Report 0x10: the motor alone."""

    rumble: bool = False


class Leds(NamedTuple):
    """Report 0x11."""

    leds: int
    """Bit 0 is LED 1."""
    ack: bool = False
    rumble: bool = False


class DataMode(NamedTuple):
    """Report 0x12: selects the data report, and whether it is also sent without changes."""

    mode: int
    continuous: bool = True
    ack: bool = False
    rumble: bool = False


class Switch(NamedTuple):
    """Reports 0x13 and 0x1A (camera), 0x14 (speaker), 0x19 (mute)."""

    report_id: int
    on: bool
    ack: bool = False
    rumble: bool = False


class StatusRequest(NamedTuple):
    """Report 0x15: answered by a Status."""

    rumble: bool = False


class WriteMemory(NamedTuple):
    """Report 0x16: answered by an Ack."""

    address: int
    """24 bits; in register space the byte on top is the bus address, twice."""
    data: bytes
    """1 to 16 bytes."""
    space: int = REGISTERS
    rumble: bool = False


class ReadMemory(NamedTuple):
    """Report 0x17: answered by ReadData, a piece of up to 16 bytes each."""

    address: int
    size: int
    space: int = REGISTERS
    rumble: bool = False


class SpeakerData(NamedTuple):
    """Report 0x18."""

    data: bytes
    """1 to 20 bytes."""
    rumble: bool = False


OutputReport = (
    Rumble
    | Leds
    | DataMode
    | Switch
    | StatusRequest
    | WriteMemory
    | ReadMemory
    | SpeakerData
    | MalformedReport
)


def rumble_of(report: bytes) -> bool | None:
    """Return the motor's bit of any output report, even malformed; None if it has no such byte."""
    if len(report) < 2 or report[0] not in OUTPUT_SIZES:
        return None
    return bool(report[1] & _RUMBLE)


def with_rumble(report: bytes, on: bool) -> bytes:
    """Return the encoded output report with the motor's bit set to `on`."""
    return bytes((report[0], (report[1] & ~_RUMBLE) | on)) + report[2:]


def decode_output(report: bytes) -> OutputReport:
    """Decode one output report, id first. Never raises; bytes after its end are ignored."""
    if len(report) == 0:
        return MalformedReport(EMPTY, -1)
    report_id = report[0]
    size = OUTPUT_SIZES.get(report_id)
    if size is None:
        return MalformedReport(UNKNOWN_ID, report_id)
    if len(report) <= size:
        return MalformedReport(TOO_SHORT, report_id)
    flags = report[1]
    rumble, ack, on = bool(flags & _RUMBLE), bool(flags & _ACK), bool(flags & _ON)
    if report_id == RUMBLE_ID:
        return Rumble(rumble)
    if report_id == LEDS_ID:
        return Leds(flags >> 4, ack, rumble)
    if report_id == DATA_MODE_ID:
        if report[2] not in DATA_MODES:
            return MalformedReport(BAD_VALUE, report_id)
        return DataMode(report[2], on, ack, rumble)
    if report_id in SWITCH_IDS:
        return Switch(report_id, on, ack, rumble)
    if report_id == STATUS_REQUEST_ID:
        return StatusRequest(rumble)
    if report_id == SPEAKER_DATA_ID:
        length = flags >> 3
        if not 1 <= length <= 20:
            return MalformedReport(BAD_VALUE, report_id)
        return SpeakerData(bytes(report[2 : 2 + length]), rumble)
    space = flags >> 2 & 3
    address = int.from_bytes(report[2:5], "big")
    if report_id == WRITE_MEMORY_ID:
        length = report[5]
        if not 1 <= length <= WRITE_BYTES:
            return MalformedReport(BAD_VALUE, report_id)
        return WriteMemory(address, bytes(report[6 : 6 + length]), space, rumble)
    length = int.from_bytes(report[5:7], "big")
    if length == 0:
        return MalformedReport(BAD_VALUE, report_id)
    return ReadMemory(address, length, space, rumble)


def encode_output(value: OutputReport) -> bytes:
    """Encode one output report of its full length. Raises ValueError for values that do not fit."""
    if isinstance(value, Rumble):
        return bytes((RUMBLE_ID, value.rumble))
    if isinstance(value, Leds):
        if not 0 <= value.leds <= 15:
            raise ValueError(f"leds {value.leds} is not in 0..15")
        return bytes((LEDS_ID, value.leds << 4 | _flags(value.rumble, value.ack)))
    if isinstance(value, DataMode):
        if value.mode not in DATA_MODES:
            modes = ", ".join(f"{mode:#x}" for mode in sorted(DATA_MODES))
            raise ValueError(f"data mode {value.mode:#x} is not one of {modes}")
        flags = _flags(value.rumble, value.ack, value.continuous)
        return bytes((DATA_MODE_ID, flags, value.mode))
    if isinstance(value, Switch):
        if value.report_id not in SWITCH_IDS:
            ids = ", ".join(f"{report_id:#x}" for report_id in sorted(SWITCH_IDS))
            raise ValueError(f"report {value.report_id:#x} is not one of {ids}")
        return bytes((value.report_id, _flags(value.rumble, value.ack, value.on)))
    if isinstance(value, StatusRequest):
        return bytes((STATUS_REQUEST_ID, value.rumble))
    if isinstance(value, SpeakerData):
        if not 1 <= len(value.data) <= 20:
            raise ValueError(f"{len(value.data)} bytes of sound are not 1 to 20")
        head = bytes((SPEAKER_DATA_ID, len(value.data) << 3 | value.rumble))
        return (head + value.data).ljust(22, b"\0")
    if isinstance(value, WriteMemory):
        if not 1 <= len(value.data) <= WRITE_BYTES:
            raise ValueError(f"{len(value.data)} bytes to write are not 1 to {WRITE_BYTES}")
        head = _memory(WRITE_MEMORY_ID, value.space, value.address, value.rumble)
        return (head + bytes((len(value.data),)) + value.data).ljust(22, b"\0")
    if isinstance(value, ReadMemory):
        if not 1 <= value.size <= 0xFFFF:
            raise ValueError(f"{value.size} bytes to read are not 1 to 65535")
        head = _memory(READ_MEMORY_ID, value.space, value.address, value.rumble)
        return head + value.size.to_bytes(2, "big")
    raise ValueError(f"a malformed report cannot be encoded: {value}")


def _memory(report_id: int, space: int, address: int, rumble: bool) -> bytes:
    if not 0 <= space <= 3:
        raise ValueError(f"address space {space} is not in 0..3")
    if not 0 <= address <= 0xFFFFFF:
        raise ValueError(f"address {address:#x} is beyond 24 bits")
    return bytes((report_id, space << 2 | rumble)) + address.to_bytes(3, "big")


def _flags(rumble: bool, ack: bool, on: bool = False) -> int:
    return rumble | ack << 1 | on << 2
