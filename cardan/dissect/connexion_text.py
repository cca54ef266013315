"""One readable line of a 3Dconnexion report, in raw counts."""

from __future__ import annotations

from cardan.dissect._scapy import Packet
from cardan.dissect.connexion import (
    V3DK,
    BatteryReport,
    BrokenReport,
    ButtonReport,
    CalibrateReport,
    KeysReport,
    LedReport,
    LongPressBitsReport,
    LongPressReport,
    MotionReport,
    RotationReport,
    TranslationReport,
)
from cardan.dissect.text import listed


def describe(report: Packet) -> str:
    """The named values of a report."""
    if isinstance(report, TranslationReport):
        return f"translation {report.x} {report.y} {report.z}"
    if isinstance(report, RotationReport):
        return f"rotation {report.rx} {report.ry} {report.rz}"
    if isinstance(report, MotionReport):
        axes = f"{report.x} {report.y} {report.z}"
        return f"motion {axes} rotation {report.rx} {report.ry} {report.rz}"
    if isinstance(report, ButtonReport):
        return f"buttons {_bits(report.mask)}"
    if isinstance(report, LongPressBitsReport):
        return f"long press {_bits(report.mask)}"
    if isinstance(report, KeysReport):
        kind = "long press keys" if isinstance(report, LongPressReport) else "keys down"
        return f"{kind} {listed(f'{code} {V3DK.get(code, code)}' for code in report.codes)}"
    if isinstance(report, BatteryReport):
        power = "external power" if report.external_power else "on battery"
        return f"battery {report.percent} % {power}"
    if isinstance(report, LedReport):
        return f"LED {'on' if report.on else 'off'}"
    if isinstance(report, CalibrateReport):
        return f"calibrate {report.value}"
    if isinstance(report, BrokenReport):
        return f"MALFORMED {report.reason}: {report.data.hex(' ')}"
    return f"unknown report 0x{report.id:02x}: {report.data.hex(' ')}"


def _bits(mask: int) -> str:
    return listed(str(n) for n in range(mask.bit_length()) if mask >> n & 1)
