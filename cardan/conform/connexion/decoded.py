"""Decoded reports of a 3Dconnexion device, for its checks."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, Traffic, WireTimeline
from cardan.protocols.connexion import devices, reports

MOTIONS = (reports.Translation, reports.Rotation, reports.MotionReport)
"""Reports with axes."""


class DeviceReport(NamedTuple):
    """An input report."""

    number: int
    time_s: float
    raw: bytes
    value: reports.InputReport

    @property
    def is_motion(self) -> bool:
        """True if it has axes."""
        return isinstance(self.value, MOTIONS)

    @property
    def counts(self) -> tuple[int, ...]:
        """Axis counts of a motion."""
        return tuple(self.value) if isinstance(self.value, MOTIONS) else ()


class ConnexionTraffic(Traffic):
    """The reports of a timeline."""

    def __init__(self, timeline: WireTimeline) -> None:
        super().__init__(timeline)
        self.reports: list[DeviceReport] = []
        self.model: devices.Model | None = None
        """Model by its vendor and product id; None if they are not known."""
        for index, event in enumerate(timeline):
            if event.kind is Kind.OPENED and ":" in event.note:
                vendor, _, product = event.note.partition(":")
                self.model = devices.find_model(int(vendor, 16), int(product, 16))
            elif event.kind is Kind.DATA and not event.sent:
                value = reports.decode_input(event.data)
                self.reports.append(DeviceReport(index, event.time_s, event.data, value))

    @property
    def motions(self) -> list[DeviceReport]:
        """Reports with axes."""
        return [each for each in self.reports if each.is_motion]

    @property
    def family(self) -> devices.Family | None:
        """Family by the reports it sends; None before any motion."""
        motions = self.motions
        if not motions:
            return None
        whole = isinstance(motions[0].value, reports.MotionReport)
        return devices.Family.ONE if whole else devices.Family.SPLIT

    def during(self, *names: str) -> list[DeviceReport]:
        """Return the reports of these phases."""
        return self.within(self.reports, *names)
