"""scapy layers of the HID reports of 3Dconnexion 6-DoF devices.

Counts are raw: +X right, +Y towards the user, +Z down, rotations right-handed about them, full
scale nominally 350. All values are little-endian. Written from public descriptors and captures
(SpaceNavigator 217-byte report descriptor; Wireless, Pro and Enterprise reports), independent of
Cardan's codec, for cross-checks.

`ConnexionInput(report)`, `ConnexionOutput(report)` and `ConnexionFeature(report)` dissect to the
layer of the report, to UnknownReport for another id, or to BrokenReport when bytes are missing;
they never raise. The report id is the first byte.
"""

from __future__ import annotations

from typing import Any

from cardan_dissect._scapy import (
    BitField,
    ByteField,
    FieldListField,
    LEIntField,
    LEShortField,
    LESignedShortField,
    Packet,
    StrField,
    XByteField,
)
from cardan_dissect.layers import (
    BrokenReport as BrokenReport,
    Report,
    UnknownReport as UnknownReport,
    choose_report,
)

SPLIT_BYTES, ONE_BYTES = 7, 13
KEY_SLOTS = 6

_FIRST_KEYS = """
    MENU FIT TOP LEFT RIGHT FRONT BOTTOM BACK ROLL_CW ROLL_CCW ISO1 ISO2
    1 2 3 4 5 6 7 8 9 10 ESC ALT SHIFT CTRL ROTATE PANZOOM DOMINANT PLUS MINUS
    SPIN_CW SPIN_CCW TILT_CW TILT_CCW ENTER DELETE
"""
V3DK = {
    **dict(enumerate(_FIRST_KEYS.split(), start=1)),
    **{40 + n: f"F{n}" for n in range(1, 13)},
    77: "11",
    78: "12",
    **{102 + n: f"V{n}" for n in range(1, 4)},
    **{138 + n: f"SAVE_V{n}" for n in range(1, 4)},
    175: "TAB",
    176: "SPACE",
    **{228 + n: f"NUMPAD_F{n}" for n in range(1, 5)},
}
"""The vendor's key numbers; a bit n of a button report of the newer devices is key n + 1."""


class TranslationReport(Report):
    """Report of devices that send translation and rotation separately."""

    fields_desc = [XByteField("id", 0x01), *(LESignedShortField(n, 0) for n in ("x", "y", "z"))]
    least_bytes = SPLIT_BYTES


class RotationReport(Report):
    """The other half of TranslationReport."""

    fields_desc = [XByteField("id", 0x02), *(LESignedShortField(n, 0) for n in ("rx", "ry", "rz"))]
    least_bytes = SPLIT_BYTES


class MotionReport(Report):
    """Report of devices that send all six axes together."""

    fields_desc = [
        XByteField("id", 0x01),
        *(LESignedShortField(n, 0) for n in ("x", "y", "z", "rx", "ry", "rz")),
    ]
    least_bytes = ONE_BYTES


class ButtonReport(Report):
    """All buttons, low bit first, in as many bytes as the device sends."""

    fields_desc = [XByteField("id", 0x03), StrField("bits", b"\0\0")]
    least_bytes = 2

    @property
    def mask(self) -> int:
        """Bit n is button n."""
        return int.from_bytes(self.bits, "little")


class LongPressBitsReport(Report):
    """Long presses: 31 bits and one of padding."""

    fields_desc = [XByteField("id", 0x16), LEIntField("bits", 0)]
    least_bytes = 5

    @property
    def mask(self) -> int:
        """Bit n is key n + 1."""
        return int(self.bits) & 0x7FFFFFFF


class BatteryReport(Report):
    fields_desc = [
        XByteField("id", 0x17),
        ByteField("percent", 0),
        BitField("reserved", 0, 7),
        BitField("external_power", 0, 1),
    ]
    least_bytes = 3


def _keys(report_id: int) -> list[Any]:
    free: Any = [0] * KEY_SLOTS
    slot = LEShortField("slot", 0)
    slots = FieldListField("slots", free, slot, count_from=lambda _: KEY_SLOTS)
    return [XByteField("id", report_id), slots]


class KeysReport(Report):
    """Keys by number, in slots; 0 is a free one."""

    least_bytes = ONE_BYTES

    @property
    def codes(self) -> tuple[int, ...]:
        """Key numbers in the slots that are not free."""
        return tuple(code for code in self.slots if code)


class KeysDownReport(KeysReport):
    fields_desc = _keys(0x1C)


class LongPressReport(KeysReport):
    fields_desc = _keys(0x1D)


class LedReport(Report):
    """To the device."""

    fields_desc = [XByteField("id", 0x04), ByteField("on", 0)]
    least_bytes = 2


class CalibrateReport(Report):
    """Feature report to the device: 0 sets the present deflection as the new rest position."""

    fields_desc = [XByteField("id", 0x07), ByteField("value", 0)]
    least_bytes = 2


_INPUTS: dict[int, type[Report]] = {
    0x02: RotationReport,
    0x03: ButtonReport,
    0x16: LongPressBitsReport,
    0x17: BatteryReport,
    0x1C: KeysDownReport,
    0x1D: LongPressReport,
}


class ConnexionInput(Packet):
    """Report from the device. The length identifies report 1's kind: 7 bytes or at least 13."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        if _pkt[:1] == b"\x01" and len(_pkt) == SPLIT_BYTES:
            return TranslationReport
        return choose_report({0x01: MotionReport, **_INPUTS}, _pkt)


class ConnexionOutput(Packet):
    """An output report to the device."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        return choose_report({0x04: LedReport}, _pkt)


class ConnexionFeature(Packet):
    """A feature report to the device."""

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[Packet]:
        return choose_report({0x07: CalibrateReport}, _pkt)
