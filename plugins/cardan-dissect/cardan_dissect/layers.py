"""Fields and base classes for scapy layers of several protocols."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan_dissect._scapy import Field, Packet, StrField, XByteField


class Block(Packet):
    """Bytes with a known end: following bytes are not the layer's payload."""

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes | None]:
        return b"", s


class Report(Block):
    """HID report whose first byte is its id; bytes after it are padding."""

    least_bytes: ClassVar[int] = 1
    """Including the id."""


class UnknownReport(Report):
    """Report with an id that the device does not have."""

    fields_desc = [XByteField("id", 0), StrField("data", b"")]


class BrokenReport(Report):
    """Too few bytes for their id, with the `reason`."""

    fields_desc = [StrField("data", b"")]

    @property
    def reason(self) -> str:
        if not self.data:
            return "empty report"
        return f"report 0x{self.data[0]:02x} of {len(self.data)} bytes"


def choose_report(reports: Mapping[int, type[Report]], report: bytes) -> type[Report]:
    """Return the layer of a report by its id."""
    if not report:
        return BrokenReport
    layer = reports.get(report[0], UnknownReport)
    return layer if len(report) >= layer.least_bytes else BrokenReport


class LEFloatField(Field[float, float]):
    """f32, little-endian."""

    def __init__(self, name: str, default: float) -> None:
        Field.__init__(self, name, default, "<f")
