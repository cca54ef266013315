"""scapy layers of the reports of the Wii Remote, its extensions' data and calibration blocks.

Written from descriptions of the protocol, independent of Cardan's codec, for cross-checks. Values
are raw: accelerometer counts (+X left, +Y tail, +Z up), camera pixels, gyroscope counts.

`WiimoteInput(report)` (from the remote) and `WiimoteOutput(report)` (to it) dissect to the layer of
the report, whose id is the first byte, to UnknownReport for another id, or to BrokenReport when
bytes are missing; they never raise. The byte of the Bluetooth transport before the id (a1, a2, 52)
is not part of a report. Bytes after a report are padding.

An extension's data bytes are in the report's `extension`; their layout depends on the extension:
`MotionPlusData`, `NunchukData`, `PassThroughNunchukData`. Blocks of the memory are
`AccelerometerCalibration`, `CameraCalibration`, `NunchukCalibration`, `MotionPlusCalibration`.
Missing checksums are computed when a block is built.
"""

from __future__ import annotations

import zlib
from typing import Any, NamedTuple

from cardan_dissect._scapy import (
    BitEnumField,
    BitField,
    ByteEnumField,
    ByteField,
    Packet,
    PacketListField,
    ShortField,
    StrFixedLenField,
    X3BytesField,
    XByteEnumField,
    XByteField,
    XShortField,
)
from cardan_dissect.layers import (
    Block,
    BrokenReport as BrokenReport,
    Report,
    UnknownReport as UnknownReport,
    choose_report,
)

BUTTONS = ("left", "right", "down", "up", "plus", "two", "one", "b", "a", "minus", "home")
LEDS = ("led_1", "led_2", "led_3", "led_4")
ERRORS = {
    0: "ok",
    3: "generic error",
    4: "busy",
    5: "unknown error",
    6: "invalid address space",
    7: "no answer from the device",
    8: "invalid address",
}
EEPROM, REGISTERS, REGISTERS_TOO, NO_SPACE = range(4)
SPACES = {
    EEPROM: "EEPROM",
    REGISTERS: "registers",
    REGISTERS_TOO: "registers",
    NO_SPACE: "no address space",
}
OUTPUTS = {
    0x10: "rumble",
    0x11: "LEDs",
    0x12: "data mode",
    0x13: "IR enable 1",
    0x14: "speaker enable",
    0x15: "status request",
    0x16: "write memory",
    0x17: "read memory",
    0x18: "speaker data",
    0x19: "speaker mute",
    0x1A: "IR enable 2",
}
DATA_MODES = (*range(0x30, 0x38), 0x3D, 0x3E, 0x3F)
DATA_BYTES = 16
"""Data bytes of a memory report, used or not."""
MISSING = 0x3FF
"""Both coordinates if the camera sees nothing."""
CHECKSUM_START = 0x55


class Spot(NamedTuple):
    """An object of the camera, in pixels of 1024 x 768; `size` 0 to 15, the box on a 128 x 96 grid
    (x_min, y_min, x_max, y_max) and the intensity only in the formats that have them."""

    x: int
    y: int
    size: int | None = None
    box: tuple[int, int, int, int] | None = None
    intensity: int | None = None


def _buttons(
    low_0: tuple[Any, ...] = (("unused_0", 2),), low_1: tuple[Any, ...] = (("unused_1", 2),)
) -> list[Any]:
    """Return the two bytes of core buttons, most significant bit first; bits 6 and 5 of each belong
    to the accelerometer."""
    return [
        BitField("unused", 0, 1),
        *(BitField(name, 0, bits) for name, bits in low_0),
        *(BitField(name, 0, 1) for name in ("plus", "up", "down", "right", "left")),
        BitField("home", 0, 1),
        *(BitField(name, 0, bits) for name, bits in low_1),
        *(BitField(name, 0, 1) for name in ("minus", "a", "b", "one", "two")),
    ]


def _acceleration() -> list[Any]:
    low_bits = _buttons((("x_low", 2),), (("z_low", 1), ("y_low", 1)))
    return [*low_bits, *(ByteField(f"{axis}_high", 0) for axis in "xyz")]


class ButtonsReport(Report):
    """A report that begins with the core buttons."""

    @property
    def buttons(self) -> tuple[str, ...]:
        """Names of the pressed buttons."""
        return tuple(name for name in BUTTONS if self.getfieldval(name))


class AccelerationReport(ButtonsReport):
    """A report with an accelerometer sample."""

    @property
    def acceleration(self) -> tuple[int, int, int]:
        """X, Y and Z counts of 10 bits; the lowest of Y and Z is always 0."""
        return (
            self.x_high << 2 | self.x_low,
            self.y_high << 2 | self.y_low << 1,
            self.z_high << 2 | self.z_low << 1,
        )


# The camera


class IrBasicPair(Block):
    """Two objects in five bytes."""

    fields_desc = [
        ByteField("x1_low", 0xFF),
        ByteField("y1_low", 0xFF),
        *(BitField(f"{name}_high", 3, 2) for name in ("y1", "x1", "y2", "x2")),
        ByteField("x2_low", 0xFF),
        ByteField("y2_low", 0xFF),
    ]

    @property
    def spots(self) -> tuple[Spot | None, ...]:
        """Both objects; None if absent."""
        return (
            _spot(self.x1_high << 8 | self.x1_low, self.y1_high << 8 | self.y1_low),
            _spot(self.x2_high << 8 | self.x2_low, self.y2_high << 8 | self.y2_low),
        )


_IR_EXTENDED = (
    ByteField("x_low", 0xFF),
    ByteField("y_low", 0xFF),
    BitField("y_high", 3, 2),
    BitField("x_high", 3, 2),
    BitField("size", 15, 4),
)


class IrExtended(Block):
    """Object in three bytes."""

    fields_desc = list(_IR_EXTENDED)

    @property
    def spots(self) -> tuple[Spot | None, ...]:
        """Object; None if absent."""
        return (_spot(self.x_high << 8 | self.x_low, self.y_high << 8 | self.y_low, self.size),)


class IrFull(Block):
    """Object in nine bytes."""

    fields_desc = [
        *_IR_EXTENDED,
        *(ByteField(name, 0xFF) for name in ("x_min", "y_min", "x_max", "y_max")),
        ByteField("zero", 0xFF),
        ByteField("intensity", 0xFF),
    ]

    @property
    def spots(self) -> tuple[Spot | None, ...]:
        """Object; None if absent."""
        box = tuple(v & 0x7F for v in (self.x_min, self.y_min, self.x_max, self.y_max))
        x, y = self.x_high << 8 | self.x_low, self.y_high << 8 | self.y_low
        return (_spot(x, y, self.size, box, self.intensity),)


def _spot(x: int, y: int, *rest: Any) -> Spot | None:
    return None if x == y == MISSING else Spot(x, y, *rest)


def _camera(block: type[Block], count: int) -> Any:
    return PacketListField("ir", [block() for _ in range(count)], block, count_from=lambda _: count)


class CameraReport(ButtonsReport):
    """A report with objects of the camera."""

    @property
    def spots(self) -> tuple[Spot | None, ...]:
        """Objects of this report; None if absent."""
        return tuple(spot for block in self.ir for spot in block.spots)


def _extension(size: int) -> Any:
    return StrFixedLenField("extension", bytes(size), size)


# From the remote


class StatusReport(ButtonsReport):
    """Status: requested, or sent when an extension is plugged in or out."""

    fields_desc = [
        XByteField("id", 0x20),
        *_buttons(),
        *(BitField(name, 0, 1) for name in reversed(LEDS)),
        BitField("camera", 0, 1),
        BitField("speaker", 0, 1),
        BitField("extension_connected", 0, 1),
        BitField("battery_low", 0, 1),
        StrFixedLenField("zeros", bytes(2), 2),
        ByteField("battery", 0),
    ]

    @property
    def leds(self) -> tuple[int, ...]:
        """LEDs that are on, 1 to 4."""
        return _leds(self)


class ReadReport(ButtonsReport):
    """A piece of memory, at most 16 bytes; `address` is the low half of the piece's own."""

    fields_desc = [
        XByteField("id", 0x21),
        *_buttons(),
        BitField("length_less_1", 0, 4),
        BitEnumField("error", 0, 4, ERRORS),
        XShortField("address", 0),
        StrFixedLenField("data", bytes(DATA_BYTES), DATA_BYTES),
    ]

    @property
    def content(self) -> bytes:
        """The bytes read; none after an error."""
        return b"" if self.error else bytes(self.data[: self.length_less_1 + 1])


class AcknowledgeReport(ButtonsReport):
    """The result of an output report."""

    fields_desc = [
        XByteField("id", 0x22),
        *_buttons(),
        XByteEnumField("of", 0, OUTPUTS),
        ByteEnumField("error", 0, ERRORS),
    ]


class CoreReport(ButtonsReport):
    fields_desc = [XByteField("id", 0x30), *_buttons()]


class CoreAccelerationReport(AccelerationReport):
    fields_desc = [XByteField("id", 0x31), *_acceleration()]


class CoreExtension8Report(ButtonsReport):
    fields_desc = [XByteField("id", 0x32), *_buttons(), _extension(8)]


class CoreAccelerationIr12Report(AccelerationReport, CameraReport):
    fields_desc = [XByteField("id", 0x33), *_acceleration(), _camera(IrExtended, 4)]


class CoreExtension19Report(ButtonsReport):
    fields_desc = [XByteField("id", 0x34), *_buttons(), _extension(19)]


class CoreAccelerationExtension16Report(AccelerationReport):
    fields_desc = [XByteField("id", 0x35), *_acceleration(), _extension(16)]


class CoreIr10Extension9Report(CameraReport):
    fields_desc = [XByteField("id", 0x36), *_buttons(), _camera(IrBasicPair, 2), _extension(9)]


class CoreAccelerationIr10Extension6Report(AccelerationReport, CameraReport):
    fields_desc = [
        XByteField("id", 0x37),
        *_acceleration(),
        _camera(IrBasicPair, 2),
        _extension(6),
    ]


class Extension21Report(Report):
    """Only report without buttons."""

    fields_desc = [XByteField("id", 0x3D), _extension(21)]


class InterleavedReport(CameraReport):
    """Half a sample: two of four objects, and parts of an accelerometer value of 8 bits."""


class InterleavedFirstReport(InterleavedReport):
    """X, the upper half of Z, objects 1 and 2."""

    fields_desc = [
        XByteField("id", 0x3E),
        *_buttons((("z_5_4", 2),), (("z_7_6", 2),)),
        ByteField("x_high", 0),
        _camera(IrFull, 2),
    ]


class InterleavedSecondReport(InterleavedReport):
    """Y, the lower half of Z, objects 3 and 4."""

    fields_desc = [
        XByteField("id", 0x3F),
        *_buttons((("z_1_0", 2),), (("z_3_2", 2),)),
        ByteField("y_high", 0),
        _camera(IrFull, 2),
    ]


def interleaved_acceleration(
    first: InterleavedFirstReport, second: InterleavedSecondReport
) -> tuple[int, int, int]:
    """Return X, Y and Z of 8 bits (a 10-bit count without its two lowest bits) from a pair of
    reports."""
    z = first.z_7_6 << 6 | first.z_5_4 << 4 | second.z_3_2 << 2 | second.z_1_0
    return first.x_high, second.y_high, z


# To the remote


def _first_byte(*names: str) -> list[Any]:
    """Return payload byte 0 with flags down to bit 0, the rumble motor, which every report sets."""
    flags = (*names, "rumble")
    rest = [BitField("unused", 0, 8 - len(flags))] if len(flags) < 8 else []
    return [*rest, *(BitField(name, 0, 1) for name in flags)]


class OutputReport(Report):
    """A report to the remote; `rumble` is the motor's new state."""


class RumbleReport(OutputReport):
    fields_desc = [XByteField("id", 0x10), *_first_byte()]


class LedsReport(OutputReport):
    fields_desc = [
        XByteField("id", 0x11),
        *(BitField(name, 0, 1) for name in reversed(LEDS)),
        BitField("unused", 0, 2),
        BitField("acknowledge", 0, 1),
        BitField("rumble", 0, 1),
    ]

    @property
    def leds(self) -> tuple[int, ...]:
        """LEDs to switch on, 1 to 4."""
        return _leds(self)


class DataModeReport(OutputReport):
    """Selects the data report, and whether it is also sent without changes."""

    fields_desc = [
        XByteField("id", 0x12),
        *_first_byte("continuous", "acknowledge"),
        XByteField("mode", 0x30),
    ]


class EnableReport(OutputReport):
    """A switch."""


class CameraEnable1Report(EnableReport):
    fields_desc = [XByteField("id", 0x13), *_first_byte("on", "acknowledge")]


class SpeakerEnableReport(EnableReport):
    fields_desc = [XByteField("id", 0x14), *_first_byte("on", "acknowledge")]


class SpeakerMuteReport(EnableReport):
    fields_desc = [XByteField("id", 0x19), *_first_byte("on", "acknowledge")]


class CameraEnable2Report(EnableReport):
    fields_desc = [XByteField("id", 0x1A), *_first_byte("on", "acknowledge")]


class StatusRequestReport(OutputReport):
    fields_desc = [XByteField("id", 0x15), *_first_byte()]


def _memory() -> list[Any]:
    return [
        BitField("unused", 0, 4),
        BitEnumField("space", EEPROM, 2, SPACES),
        BitField("acknowledge", 0, 1),
        BitField("rumble", 0, 1),
        X3BytesField("address", 0),
    ]


class WriteReport(OutputReport):
    """Writes 1 to 16 bytes; the remote ignores another `size`."""

    fields_desc = [
        XByteField("id", 0x16),
        *_memory(),
        ByteField("size", 1),
        StrFixedLenField("data", bytes(DATA_BYTES), DATA_BYTES),
    ]

    @property
    def content(self) -> bytes:
        """Bytes to write; the rest is ignored."""
        return bytes(self.data[: self.size])


class ReadRequestReport(OutputReport):
    fields_desc = [XByteField("id", 0x17), *_memory(), ShortField("size", 1)]


class SpeakerDataReport(OutputReport):
    fields_desc = [
        XByteField("id", 0x18),
        BitField("length", 0, 5),
        BitField("unused", 0, 2),
        BitField("rumble", 0, 1),
        StrFixedLenField("data", bytes(20), 20),
    ]

    @property
    def content(self) -> bytes:
        """The samples."""
        return bytes(self.data[: self.length])


def _by_id(*reports: type[Report]) -> dict[int, type[Report]]:
    """Return the classes by id; the default report has the minimum length of its kind."""
    for report in reports:
        report.least_bytes = len(bytes(report()))
    return {int(report().id): report for report in reports}


INPUT_LAYERS = _by_id(
    StatusReport,
    ReadReport,
    AcknowledgeReport,
    CoreReport,
    CoreAccelerationReport,
    CoreExtension8Report,
    CoreAccelerationIr12Report,
    CoreExtension19Report,
    CoreAccelerationExtension16Report,
    CoreIr10Extension9Report,
    CoreAccelerationIr10Extension6Report,
    Extension21Report,
    InterleavedFirstReport,
    InterleavedSecondReport,
)
OUTPUT_LAYERS = _by_id(
    RumbleReport,
    LedsReport,
    DataModeReport,
    CameraEnable1Report,
    SpeakerEnableReport,
    StatusRequestReport,
    WriteReport,
    ReadRequestReport,
    SpeakerDataReport,
    SpeakerMuteReport,
    CameraEnable2Report,
)


class WiimoteInput(Packet):
    """A report from the remote."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        return choose_report(INPUT_LAYERS, _pkt)


class WiimoteOutput(Packet):
    """A report to the remote."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        return choose_report(OUTPUT_LAYERS, _pkt)


def _leds(report: Packet) -> tuple[int, ...]:
    return tuple(n for n, name in enumerate(LEDS, start=1) if report.getfieldval(name))


# Data of extensions


class MotionPlusData(Block):
    """Six bytes of an active MotionPlus, rates of 14 bits; `slow` is the fine range."""

    fields_desc = [
        ByteField("yaw_low", 0),
        ByteField("roll_low", 0),
        ByteField("pitch_low", 0),
        BitField("yaw_high", 0, 6),
        BitField("yaw_slow", 0, 1),
        BitField("pitch_slow", 0, 1),
        BitField("roll_high", 0, 6),
        BitField("roll_slow", 0, 1),
        BitField("extension_connected", 0, 1),
        BitField("pitch_high", 0, 6),
        BitField("motion_plus", 1, 1),
        BitField("invalid", 0, 1),
    ]

    @property
    def rates(self) -> tuple[int, int, int]:
        """Yaw, roll and pitch, in counts."""
        return (
            self.yaw_high << 8 | self.yaw_low,
            self.roll_high << 8 | self.roll_low,
            self.pitch_high << 8 | self.pitch_low,
        )

    @property
    def slow(self) -> tuple[bool, bool, bool]:
        """True for each of yaw, roll and pitch in the fine range."""
        return bool(self.yaw_slow), bool(self.roll_slow), bool(self.pitch_slow)


class NunchukData(Block):
    """Six bytes of a Nunchuk; its buttons are 0 when down."""

    fields_desc = [
        *(ByteField(name, 0x80) for name in ("stick_x", "stick_y")),
        *(ByteField(f"{axis}_high", 0) for axis in "xyz"),
        *(BitField(f"{axis}_low", 0, 2) for axis in "zyx"),
        BitField("c_up", 1, 1),
        BitField("z_up", 1, 1),
    ]

    @property
    def acceleration(self) -> tuple[int, int, int]:
        """X, Y and Z counts of 10 bits."""
        return (
            self.x_high << 2 | self.x_low,
            self.y_high << 2 | self.y_low,
            self.z_high << 2 | self.z_low,
        )


class PassThroughNunchukData(Block):
    """Six bytes of a Nunchuk behind a MotionPlus, without the lowest accelerometer bits."""

    fields_desc = [
        *(ByteField(name, 0x80) for name in ("stick_x", "stick_y", "x_high", "y_high")),
        BitField("z_high", 0, 7),
        BitField("extension_connected", 1, 1),
        BitField("z_low", 0, 2),
        BitField("y_low", 0, 1),
        BitField("x_low", 0, 1),
        BitField("c_up", 1, 1),
        BitField("z_up", 1, 1),
        BitField("motion_plus", 0, 1),
        BitField("zero", 0, 1),
    ]

    @property
    def acceleration(self) -> tuple[int, int, int]:
        """X, Y and Z counts of 10 bits, bit 0 always 0."""
        return (
            self.x_high << 2 | self.x_low << 1,
            self.y_high << 2 | self.y_low << 1,
            self.z_high << 3 | self.z_low << 1,
        )


# Blocks of the memory


def _point(name: str) -> list[Any]:
    """Return a point of the accelerometer: upper eight bits of each axis, then the lower ones of
    all."""
    return [
        *(ByteField(f"{name}_{axis}_high", 0) for axis in "xyz"),
        BitField(f"{name}_unused", 0, 2),
        *(BitField(f"{name}_{axis}_low", 0, 2) for axis in "xyz"),
    ]


class Checked(Block):
    """Block whose last byte is the sum of the others and 0x55."""

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        if self.checksum is None:
            pkt = pkt[:-1] + bytes([checksum(pkt[:-1])])
        return pkt + pay

    @property
    def checksum_ok(self) -> bool:
        """True if the checksum is right."""
        data = self.post_build(self.self_build(), b"")
        return data[-1] == checksum(data[:-1])


class AccelerometerBlock(Block):
    """Block with readings of an accelerometer at rest in each axis."""

    def point(self, name: str) -> tuple[int, int, int]:
        """Return X, Y and Z of "zero" or "one_g", counts of 10 bits."""
        x, y, z = (
            self.getfieldval(f"{name}_{axis}_high") << 2 | self.getfieldval(f"{name}_{axis}_low")
            for axis in "xyz"
        )
        return x, y, z


class AccelerometerCalibration(Checked, AccelerometerBlock):
    """Ten bytes at 0x0016 and 0x0020 of the EEPROM."""

    fields_desc = [
        *_point("zero"),
        *_point("one_g"),
        BitField("motor", 0, 1),
        BitField("volume", 0, 7),
        XByteField("checksum", None),
    ]


class CameraCalibration(Checked):
    """Eleven bytes at 0x0000 and 0x000b of the EEPROM: the corners of a rectangle."""

    fields_desc = [_camera(IrBasicPair, 2), XByteField("checksum", None)]


class NunchukCalibration(AccelerometerBlock):
    """Sixteen bytes at 0x20 of a Nunchuk's registers."""

    fields_desc = [
        *_point("zero"),
        *_point("one_g"),
        *(ByteField(f"stick_{a}_{n}", 0) for a in "xy" for n in ("max", "min", "center")),
        XByteField("checksum", None),
        XByteField("checksum_2", None),
    ]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        first = checksum(pkt[:14]) if self.checksum is None else self.checksum
        second = (first + CHECKSUM_START) % 256 if self.checksum_2 is None else self.checksum_2
        return pkt[:14] + bytes([first, second]) + pay

    @property
    def checksum_ok(self) -> bool:
        """True if both checksums are right."""
        data = self.post_build(self.self_build(), b"")
        first = checksum(data[:14])
        return data[14:16] == bytes([first, (first + CHECKSUM_START) % 256])


def _range(name: str) -> list[Any]:
    return [
        *(ShortField(f"{name}_{axis}_zero", 0) for axis in ("yaw", "roll", "pitch")),
        *(ShortField(f"{name}_{axis}_scale", 0) for axis in ("yaw", "roll", "pitch")),
        ByteField(f"{name}_degrees_by_6", 0),
        ByteField(f"{name}_uid", 0),
    ]


class MotionPlusCalibration(Block):
    """32 bytes at 0x20 of a MotionPlus. Each range has the reading at rest and the one at 6 *
    `degrees_by_6` deg/s, both of 16 bits (four times a report's value)."""

    fields_desc = [
        *_range("fast"),
        XShortField("crc_high", None),
        *_range("slow"),
        XShortField("crc_low", None),
    ]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        crc = zlib.crc32(pkt[:14] + pkt[16:30])
        high = crc >> 16 if self.crc_high is None else self.crc_high
        low = crc & 0xFFFF if self.crc_low is None else self.crc_low
        return b"".join(
            (pkt[:14], high.to_bytes(2, "big"), pkt[16:30], low.to_bytes(2, "big"), pay)
        )

    @property
    def checksum_ok(self) -> bool:
        """True if the CRC-32 is right."""
        data = self.post_build(self.self_build(), b"")
        crc = zlib.crc32(data[:14] + data[16:30]).to_bytes(4, "big")
        return data[14:16] + data[30:32] == crc


def checksum(data: bytes) -> int:
    """Return the sum of the bytes and 0x55."""
    return (sum(data) + CHECKSUM_START) % 256
