"""Decoded reports of a remote for its checks, and the requests to it."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, TimelinePhase, WireTimeline
from cardan_wiimote.protocol import (
    InputReport,
    OutputReport,
    ReadData,
    ReadMemory,
    decode_input,
    decode_output,
)


class Report(NamedTuple):
    """An input report."""

    number: int
    time_s: float
    raw: bytes
    value: InputReport


class Asked(NamedTuple):
    """An output report of the suite."""

    number: int
    time_s: float
    value: OutputReport


class Memory(NamedTuple):
    """Read of memory, and its result."""

    asked: Asked
    pieces: tuple[Report, ...]

    @property
    def error(self) -> int:
        """Error of the last piece; 0 if none arrived."""
        last = self.pieces[-1].value if self.pieces else None
        return last.error if isinstance(last, ReadData) else 0

    @property
    def data(self) -> bytes:
        """Data read so far."""
        values = [each.value for each in self.pieces]
        return b"".join(each.data for each in values if isinstance(each, ReadData))


class WiimoteTraffic:
    """The reports of a timeline."""

    def __init__(self, timeline: WireTimeline) -> None:
        self.phases = timeline.phases()
        self.reports: list[Report] = []
        self.asked: list[Asked] = []
        self.lost: list[int] = []
        self.refused: list[int] = []
        for number, event in enumerate(timeline):
            if event.kind is Kind.CLOSED and not event.sent:
                self.lost.append(number)
            elif event.kind is Kind.REFUSED:
                self.refused.append(number)
            elif event.kind is Kind.DATA and event.sent:
                self.asked.append(Asked(number, event.time_s, decode_output(event.data)))
            elif event.kind is Kind.DATA:
                value = decode_input(event.data)
                self.reports.append(Report(number, event.time_s, event.data, value))

    def phase(self, name: str) -> TimelinePhase | None:
        """Return the phase of that name, if the scenario reached it."""
        return self.phases.get(name)

    def during(self, *names: str) -> list[Report]:
        """Return the reports of these phases."""
        found = [self.phases[name] for name in names if name in self.phases]
        return [r for r in self.reports if any(p.first <= r.number < p.end for p in found)]

    def reads(self) -> list[Memory]:
        """Return every read of memory."""
        found = []
        reads = [each for each in self.asked if isinstance(each.value, ReadMemory)]
        for index, each in enumerate(reads):
            end = reads[index + 1].number if index + 1 < len(reads) else float("inf")
            pieces = tuple(
                r
                for r in self.reports
                if each.number < r.number < end and isinstance(r.value, ReadData)
            )
            found.append(Memory(each, pieces))
        return found
