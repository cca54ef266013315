"""The infrared camera: start-up, and its dots in the three formats.

Frame: 1024 x 768, up to four dots. Source: WiiBrew, libcwiid, Dolphin.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cardan_wiimote.protocol.identity import IR_ENABLE_1_ID, IR_ENABLE_2_ID
from cardan_wiimote.protocol.inputs import IrFormat
from cardan_wiimote.protocol.outputs import OutputReport, Switch, WriteMemory

WIDTH, HEIGHT = 1024, 768
DOTS = 4
CAMERA_ADDRESS = 0xB00000

SENSITIVITY_LEVEL_3 = (bytes.fromhex("02 00 00 71 01 00 aa 00 64"), bytes.fromhex("63 03"))
"""The Wii's middle setting."""
SENSITIVITY_MAXIMUM = (bytes.fromhex("00 00 00 00 00 00 90 00 41"), bytes.fromhex("40 00"))

IR_BYTES: dict[IrFormat, int] = {IrFormat.BASIC: 10, IrFormat.EXTENDED: 12, IrFormat.FULL: 36}
"""Bytes of four dots."""


class IrDot(NamedTuple):
    """A bright dot."""

    x: int
    """0..1023."""
    y: int
    """0..767."""
    size: int | None = None
    """0..15; not in the basic format."""
    box: tuple[int, int, int, int] | None = None
    """x min, y min, x max, y max on a grid of 128 x 96; in the full format only."""
    intensity: int | None = None
    """In the full format only."""


Dots = tuple[IrDot | None, ...]
"""Four dots; None for those that the camera does not see."""


def camera_start(
    ir_format: IrFormat, sensitivity: tuple[bytes, bytes] = SENSITIVITY_LEVEL_3
) -> tuple[OutputReport, ...]:
    """Return the reports that switch the camera on. Wait for the acknowledgment of each before the
    next, else the camera ends in a random state. The data mode must be set afterwards."""
    first, second = sensitivity
    return (
        Switch(IR_ENABLE_1_ID, True, ack=True),
        Switch(IR_ENABLE_2_ID, True, ack=True),
        WriteMemory(CAMERA_ADDRESS + 0x30, b"\x01"),
        WriteMemory(CAMERA_ADDRESS, first),
        WriteMemory(CAMERA_ADDRESS + 0x1A, second),
        WriteMemory(CAMERA_ADDRESS + 0x33, bytes((ir_format,))),
        WriteMemory(CAMERA_ADDRESS + 0x30, b"\x08"),
    )


def camera_stop() -> tuple[OutputReport, ...]:
    """Return the reports that switch the camera off."""
    return (
        Switch(IR_ENABLE_1_ID, False, ack=True),
        Switch(IR_ENABLE_2_ID, False, ack=True),
    )


def decode_dots(data: bytes, ir_format: IrFormat) -> Dots:
    """Decode four dots. Never raises: missing bytes give None."""
    data = data.ljust(IR_BYTES[ir_format], b"\xff")
    dots: list[IrDot | None] = []
    if ir_format is IrFormat.BASIC:
        for at in (0, 5):
            x1, y1, m, x2, y2 = data[at : at + 5]
            dots.append(_dot(x1 | (m & 0x30) << 4, y1 | (m & 0xC0) << 2))
            dots.append(_dot(x2 | (m & 0x03) << 8, y2 | (m & 0x0C) << 6))
        return tuple(dots)
    stride = 3 if ir_format is IrFormat.EXTENDED else 9
    for at in range(0, DOTS * stride, stride):
        x, y, m = data[at : at + 3]
        dot = _dot(x | (m & 0x30) << 4, y | (m & 0xC0) << 2)
        if dot is not None:
            dot = dot._replace(size=m & 15)
            if stride == 9:
                left, low, right, high = data[at + 3 : at + 7]
                dot = dot._replace(
                    box=(left & 127, low & 127, right & 127, high & 127), intensity=data[at + 8]
                )
        dots.append(dot)
    return tuple(dots)


def encode_dots(dots: Sequence[IrDot | None], ir_format: IrFormat) -> bytes:
    """Encode up to four dots; missing values of a dot are sent as 0. Raises ValueError."""
    if len(dots) > DOTS:
        raise ValueError(f"{len(dots)} dots are more than {DOTS}")
    four = [*dots, *(None,) * (DOTS - len(dots))]
    for dot in four:
        if dot is not None and not (0 <= dot.x < WIDTH and 0 <= dot.y < HEIGHT):
            raise ValueError(f"dot ({dot.x}, {dot.y}) is not in {WIDTH} x {HEIGHT}")
    if ir_format is IrFormat.BASIC:
        body = b""
        for a, b in ((four[0], four[1]), (four[2], four[3])):
            x1, y1 = (1023, 1023) if a is None else a[:2]
            x2, y2 = (1023, 1023) if b is None else b[:2]
            m = y1 >> 8 << 6 | x1 >> 8 << 4 | y2 >> 8 << 2 | x2 >> 8
            body += bytes((x1 & 255, y1 & 255, m, x2 & 255, y2 & 255))
        return body
    stride = 3 if ir_format is IrFormat.EXTENDED else 9
    return b"".join(_encode_dot(dot, stride) for dot in four)


def _encode_dot(dot: IrDot | None, stride: int) -> bytes:
    if dot is None:
        return b"\xff" * stride
    size = dot.size or 0
    if not 0 <= size <= 15:
        raise ValueError(f"size {size} is not in 0..15")
    body = bytes((dot.x & 255, dot.y & 255, dot.y >> 8 << 6 | dot.x >> 8 << 4 | size))
    if stride == 9:
        box = dot.box or (0, 0, 0, 0)
        if not all(0 <= edge <= 127 for edge in box):
            raise ValueError(f"box {box} is not in 0..127")
        body += bytes((*box, 0, (dot.intensity or 0) & 255))
    return body


def _dot(x: int, y: int) -> IrDot | None:
    return IrDot(x, y) if y < HEIGHT else None
