"""scapy layers of the CAN frames of a JR3 force-torque sensor's board.

An identifier of 11 bits is an opcode and the board's node id, 1 to 127; SYNC has none. All values
are little-endian: forces and moments are raw, +-16384 at full scale, cut-off frequencies 0.01 Hz.
Written from a description of the board's firmware, independent of Cardan's codec, so that each can
be checked against the other.

`dissect(identifier, data)` chooses the layer of a frame's payload: UnknownFrame for an unknown
opcode, BrokenFrame if bytes are missing or a board sends too many; it never raises.
"""

from __future__ import annotations

from typing import Any, ClassVar

from cardan_dissect._scapy import (
    ByteEnumField,
    LEIntField,
    LEShortField,
    LESignedShortField,
    StrField,
)
from cardan_dissect.capture import Direction
from cardan_dissect.layers import Block, LEFloatField

FROM_BOARD = Direction.FROM_DEVICE
OPCODE_MASK, NODE_MASK = 0x780, 0x07F
SYNC_IDENTIFIER = 0x080
STATES = {0: "ready", 1: "not initialized"}
SAMPLE_PERIOD_S = 128.5e-6
"""Sample period of the sensor; the counter counts its samples."""


class Jr3Frame(Block):
    """Base layer of a frame's payload."""

    opcode: ClassVar[int] = 0
    title: ClassVar[str] = ""
    way: ClassVar[Direction] = Direction.TO_DEVICE
    """Layer that records if the frame is from the board or to it."""
    least_bytes: ClassVar[int] = 0


class SyncFrame(Jr3Frame):
    """To all boards: send one sample. Its identifier has no node id."""

    opcode, title = SYNC_IDENTIFIER, "SYNC"


class AckFrame(Jr3Frame):
    """Acknowledgment of a command, without the name of that command."""

    opcode, title, way, least_bytes = 0x100, "ACK", FROM_BOARD, 1
    fields_desc = [ByteEnumField("state", 0, STATES)]


class FullScalesAckFrame(Jr3Frame):
    """Answer to a query of full scales: X, Y, Z in N, or in 0.1 N·m."""

    opcode, title, way, least_bytes = 0x100, "ACK", FROM_BOARD, 7
    fields_desc = [
        ByteEnumField("state", 0, STATES),
        *(LEShortField(axis, 0) for axis in "xyz"),
    ]


class StartSyncFrame(Jr3Frame):
    """Send a sample for each SYNC; cut-off 0 is unfiltered."""

    opcode, title, least_bytes = 0x180, "START_SYNC", 2
    fields_desc = [LEShortField("cutoff_centihertz", 0)]


class StartAsyncFrame(Jr3Frame):
    """Send a sample each period."""

    opcode, title, least_bytes = 0x200, "START_ASYNC", 6
    fields_desc = [LEShortField("cutoff_centihertz", 0), LEIntField("period_us", 0)]


class StopFrame(Jr3Frame):
    opcode, title = 0x280, "STOP"


class ZeroOffsetsFrame(Jr3Frame):
    """Take the present filtered value as zero."""

    opcode, title = 0x300, "ZERO_OFFS"


class SetFilterFrame(Jr3Frame):
    opcode, title, least_bytes = 0x380, "SET_FILTER", 2
    fields_desc = [LEShortField("cutoff_centihertz", 0)]


class GetStateFrame(Jr3Frame):
    opcode, title = 0x400, "GET_STATE"


class GetForceScalesFrame(Jr3Frame):
    opcode, title = 0x480, "GET_FS_FORCES"


class GetMomentScalesFrame(Jr3Frame):
    opcode, title = 0x500, "GET_FS_MOMENTS"


class ResetFrame(Jr3Frame):
    """Read the calibration of the sensor again."""

    opcode, title = 0x580, "RESET"


def _sample() -> list[Any]:
    return [*(LESignedShortField(axis, 0) for axis in "xyz"), LEShortField("counter", 0)]


class ForcesFrame(Jr3Frame):
    """First half of a sample."""

    opcode, title, way, least_bytes = 0x600, "FORCES", FROM_BOARD, 8
    fields_desc = _sample()


class MomentsFrame(Jr3Frame):
    """Second half of a sample, with the same counter."""

    opcode, title, way, least_bytes = 0x680, "MOMENTS", FROM_BOARD, 8
    fields_desc = _sample()


class BootupFrame(Jr3Frame):
    """Report of a board that is ready, with a sensor."""

    opcode, title, way = 0x700, "BOOTUP", FROM_BOARD


class GripperPwmFrame(Jr3Frame):
    """Duty of a gripper on the same board, percent: -100 to 100."""

    opcode, title, least_bytes = 0x780, "GRIPPER_PWM", 4
    fields_desc = [LEFloatField("pwm_percent", 0.0)]


class UnknownFrame(Jr3Frame):
    """Frame with an opcode that the board ignores."""

    title = "unknown opcode"
    fields_desc = [StrField("data", b"")]


class BrokenFrame(Jr3Frame):
    """Frame whose length is not its opcode's; the board reads a command's missing bytes as 0."""

    fields_desc = [StrField("data", b"")]
    title = "broken"


ACKNOWLEDGED = (
    StartSyncFrame,
    StartAsyncFrame,
    StopFrame,
    ZeroOffsetsFrame,
    SetFilterFrame,
    GetStateFrame,
    GetForceScalesFrame,
    GetMomentScalesFrame,
    ResetFrame,
)
"""Opcodes of commands that the board answers."""
LAYERS: dict[int, type[Jr3Frame]] = {
    layer.opcode: layer
    for layer in (
        AckFrame,
        *ACKNOWLEDGED,
        ForcesFrame,
        MomentsFrame,
        BootupFrame,
        GripperPwmFrame,
    )
}
"""Layers by opcode, of frames with a node id."""


def split(identifier: int) -> tuple[int, int]:
    """Return opcode and node id of an identifier."""
    return identifier & OPCODE_MASK, identifier & NODE_MASK


def dissect(identifier: int, data: bytes) -> Jr3Frame:
    """Return the layer of a frame's payload."""
    opcode, node = split(identifier)
    layer = LAYERS.get(opcode, UnknownFrame) if node else UnknownFrame
    if identifier == SYNC_IDENTIFIER:
        layer = SyncFrame
    elif layer is AckFrame and len(data) == FullScalesAckFrame.least_bytes:
        layer = FullScalesAckFrame
    excess = len(data) - layer.least_bytes
    if excess < 0 or (excess and layer.way is FROM_BOARD):
        return BrokenFrame(data=data)
    # scapy makes a packet with default values of no bytes; only layers without fields get there.
    return layer(data) if data else layer()


def malformed(identifier: int, data: bytes) -> str | None:
    """Return why a payload does not fit its opcode, None if it does."""
    layer = LAYERS.get(identifier & OPCODE_MASK)
    if layer is None or not isinstance(dissect(identifier, data), BrokenFrame):
        return None
    return f"{layer.title} of {len(data)} bytes"
