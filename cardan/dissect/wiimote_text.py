"""One readable line of a Wii Remote's report, in raw counts."""

from __future__ import annotations

from collections.abc import Iterator

from cardan.dissect._scapy import Packet
from cardan.dissect.text import listed
from cardan.dissect.wiimote import (
    DATA_BYTES,
    DATA_MODES,
    EEPROM,
    ERRORS,
    OUTPUTS,
    SPACES,
    AccelerationReport,
    AccelerometerCalibration,
    AcknowledgeReport,
    BrokenReport,
    ButtonsReport,
    CameraCalibration,
    CameraReport,
    DataModeReport,
    EnableReport,
    InterleavedFirstReport,
    InterleavedSecondReport,
    LedsReport,
    MotionPlusCalibration,
    MotionPlusData,
    NunchukCalibration,
    NunchukData,
    OutputReport,
    PassThroughNunchukData,
    ReadReport,
    ReadRequestReport,
    SpeakerDataReport,
    Spot,
    StatusReport,
    UnknownReport,
    WriteReport,
)

NUNCHUK, MOTION_PLUS = "Nunchuk", "MotionPlus"
MOTION_PLUS_NUNCHUK, MOTION_PLUS_CLASSIC = "MotionPlus with Nunchuk", "MotionPlus with Classic"
MOTION_PLUS_INACTIVE = "MotionPlus, not active"
IDENTITIES = {
    0xA420_0000: NUNCHUK,
    0xA420_0101: "Classic Controller",
    0xA420_0402: "Balance Board",
    0xA420_0405: MOTION_PLUS,
    0xA420_0505: MOTION_PLUS_NUNCHUK,
    0xA420_0705: MOTION_PLUS_CLASSIC,
    0xA420_0005: MOTION_PLUS_INACTIVE,  # as some that are built in say
    0xA620_0005: MOTION_PLUS_INACTIVE,
    0xA620_0405: MOTION_PLUS_INACTIVE,
}
"""By the last four of the six bytes at 0xfa."""
WRITES = {
    (0xA4, 0xF0, b"\x55"): "extension: initialise",
    (0xA4, 0xFB, b"\x00"): "extension: unencrypted",
    (0xA4, 0xFE, b"\x00"): "MotionPlus: deactivate",
    (0xA6, 0xF0, b"\x55"): "MotionPlus: initialise",
    (0xA6, 0xFE, b"\x04"): "MotionPlus: activate",
    (0xA6, 0xFE, b"\x05"): "MotionPlus: activate, Nunchuk passed through",
    (0xA6, 0xFE, b"\x07"): "MotionPlus: activate, Classic passed through",
    (0xB0, 0x33, b"\x01"): "camera: basic format",
    (0xB0, 0x33, b"\x03"): "camera: extended format",
    (0xB0, 0x33, b"\x05"): "camera: full format",
}


def describe(report: Packet, extension: str | None = None) -> str:
    """The named values of a report. `extension` is what is plugged in: one of IDENTITIES' names,
    None when it is not known; then the data bytes are shown as they are."""
    if isinstance(report, BrokenReport):
        return f"MALFORMED {report.reason}: {report.data.hex(' ')}"
    if isinstance(report, UnknownReport):
        return f"unknown report 0x{report.id:02x}: {report.data.hex(' ')}"
    if isinstance(report, OutputReport):
        return " ".join(_output(report))
    return " | ".join(_input(report, extension))


def _output(report: OutputReport) -> Iterator[str]:
    yield OUTPUTS[report.id]
    if isinstance(report, LedsReport):
        yield listed(map(str, report.leds))
    elif isinstance(report, DataModeReport):
        yield f"0x{report.mode:02x}"
        yield "continuous" if report.continuous else "on change"
        if report.mode not in DATA_MODES:
            yield "NO SUCH MODE"
    elif isinstance(report, EnableReport):
        yield "on" if report.on else "off"
    elif isinstance(report, ReadRequestReport):
        yield f"{report.size} bytes at {place(report)}"
    elif isinstance(report, WriteReport):
        yield f"{report.size} bytes at {place(report)}: {report.content.hex(' ')}"
        known = None
        if report.space != EEPROM:
            device, register = report.address >> 16 & 0xFE, report.address & 0xFF
            known = WRITES.get((device, register, report.content))
        if known:
            yield f"({known})"
        if not 1 <= report.size <= DATA_BYTES:
            yield "NO SUCH SIZE"
    elif isinstance(report, SpeakerDataReport):
        yield f"{report.length} bytes: {report.content.hex(' ')}"
    if getattr(report, "acknowledge", 0):
        yield "(acknowledge)"
    yield f"motor {'on' if report.rumble else 'off'}"


def place(report: Packet) -> str:
    """Address and address space of a memory request."""
    return f"0x{report.address:06x} of {SPACES[report.space]}"


def _input(report: Packet, extension: str | None) -> Iterator[str]:
    if isinstance(report, StatusReport):
        yield f"status battery {report.battery}{' LOW' if report.battery_low else ''}"
        yield f"LEDs {listed(map(str, report.leds))}"
        yield f"extension {'connected' if report.extension_connected else 'none'}"
        on = ("camera", "speaker")
        yield "on: " + listed(name for name in on if report.getfieldval(name))
    elif isinstance(report, ReadReport):
        if report.error:
            yield f"read at 0x{report.address:04x} ERROR {report.error} {_error(report.error)}"
        else:
            content = report.content
            yield f"read {len(content)} bytes at 0x{report.address:04x}: {content.hex(' ')}"
    elif isinstance(report, AcknowledgeReport):
        of = OUTPUTS.get(report.of, f"report 0x{report.of:02x}")
        result = f"ERROR {report.error} {_error(report.error)}" if report.error else "ok"
        yield f"acknowledge {of} {result}"
    else:
        yield f"data 0x{report.id:02x}"
    if isinstance(report, ButtonsReport):
        yield f"buttons {listed(report.buttons)}"
    if isinstance(report, AccelerationReport):
        yield "accel {} {} {}".format(*report.acceleration)
    elif isinstance(report, InterleavedFirstReport):
        yield f"accel x8 {report.x_high} z8 bits 7..4 {report.z_7_6 << 2 | report.z_5_4}"
    elif isinstance(report, InterleavedSecondReport):
        yield f"accel y8 {report.y_high} z8 bits 3..0 {report.z_3_2 << 2 | report.z_1_0}"
    if isinstance(report, CameraReport):
        yield "IR " + ", ".join("-" if spot is None else _spot(spot) for spot in report.spots)
    if "extension" in report.fields:
        yield describe_extension(bytes(report.extension), extension)


def _error(number: int) -> str:
    return ERRORS.get(number, "unknown")


def _spot(spot: Spot) -> str:
    text = f"({spot.x} {spot.y})"
    if spot.size is not None:
        text += f" size {spot.size}"
    if spot.box is not None:
        text += f" box {' '.join(map(str, spot.box))} intensity {spot.intensity}"
    return text


def describe_extension(data: bytes, extension: str | None) -> str:
    """The data bytes of an extension, by its name."""
    layer: type[Packet] | None = None
    if extension == NUNCHUK:
        layer = NunchukData
    elif extension in (MOTION_PLUS, MOTION_PLUS_NUNCHUK, MOTION_PLUS_CLASSIC):
        if data[5] & 2:
            layer = MotionPlusData
        elif extension == MOTION_PLUS_NUNCHUK:
            layer = PassThroughNunchukData
    if layer is None:
        return f"extension {data.hex(' ')}"
    values = layer(data)
    if isinstance(values, MotionPlusData):
        if values.invalid:
            return f"MotionPlus invalid frame {data[:6].hex(' ')}"
        named = zip(("yaw", "roll", "pitch"), values.rates, values.slow, strict=True)
        rates = " ".join(f"{name} {raw} {'slow' if slow else 'fast'}" for name, raw, slow in named)
        return f"MotionPlus {rates}"
    down = listed(name for name, up in (("c", values.c_up), ("z", values.z_up)) if not up)
    x, y, z = values.acceleration
    return f"Nunchuk stick {values.stick_x} {values.stick_y} accel {x} {y} {z} buttons {down}"


def identity(data: bytes) -> str:
    """What the six bytes at 0xfa of an extension say it is."""
    if data[4:] == b"\xff\xff":
        return "an extension that is not initialised"
    known = IDENTITIES.get(int.from_bytes(data[2:], "big"))
    return known or f"an unknown extension {data.hex(' ')}"


def describe_block(layer: Packet) -> str:
    """The values of a calibration block."""
    state = "checksum ok" if layer.checksum_ok else "CHECKSUM WRONG"
    if isinstance(layer, CameraCalibration):
        corners = ", ".join(
            "-" if spot is None else _spot(spot) for block in layer.ir for spot in block.spots
        )
        return f"camera calibration {corners}, {state}"
    if isinstance(layer, AccelerometerCalibration | NunchukCalibration):
        kind = "accelerometer" if isinstance(layer, AccelerometerCalibration) else "Nunchuk"
        zero, one = (" ".join(map(str, layer.point(name))) for name in ("zero", "one_g"))
        text = f"{kind} calibration zero {zero}, 1 g {one}"
        if isinstance(layer, NunchukCalibration):
            for axis in "xy":
                values = (layer.getfieldval(f"stick_{axis}_{n}") for n in ("min", "center", "max"))
                text += f", stick {axis} {' '.join(map(str, values))}"
        return f"{text}, {state}"
    if isinstance(layer, MotionPlusCalibration):
        text = "MotionPlus calibration"
        for name in ("fast", "slow"):
            zero, scale = (
                " ".join(
                    str(layer.getfieldval(f"{name}_{a}_{n}")) for a in ("yaw", "roll", "pitch")
                )
                for n in ("zero", "scale")
            )
            speed = 6 * layer.getfieldval(f"{name}_degrees_by_6")
            text += f" {name} zero {zero} at {speed} deg/s {scale},"
        return f"{text} {state}"
    raise TypeError(f"{type(layer).__name__} is no calibration block")
