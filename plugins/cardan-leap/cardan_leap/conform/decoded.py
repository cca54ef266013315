"""Decoded messages of a tracking service for its checks."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, TimelinePhase, WireTimeline
from cardan_leap.protocol import ServiceMessage, TrackingFrame, decode_service


class Said(NamedTuple):
    """Message of the service."""

    number: int
    time_s: float
    value: ServiceMessage


class Frame(NamedTuple):
    """Frame of the service."""

    number: int
    time_s: float
    value: TrackingFrame


class LeapTraffic:
    """Messages of a timeline."""

    def __init__(self, timeline: WireTimeline) -> None:
        self.phases = timeline.phases()
        self.said: list[Said] = []
        self.ended: list[tuple[int, str]] = []
        """Text of a connection that the service closed or refused."""
        for number, event in enumerate(timeline):
            if event.kind in (Kind.CLOSED, Kind.REFUSED) and not event.sent:
                self.ended.append((number, event.note or event.kind.value))
            elif event.kind is Kind.DATA and not event.sent:
                self.said.append(Said(number, event.time_s, decode_service(event.data)))

    def phase(self, name: str) -> TimelinePhase | None:
        """Phase of that name, if the scenario reached it."""
        return self.phases.get(name)

    def during(self, *names: str) -> list[Said]:
        """Messages of these phases; of none: all."""
        found = [self.phases[name] for name in names if name in self.phases]
        return [
            s for s in self.said if not names or any(p.first <= s.number < p.end for p in found)
        ]

    def frames(self, *names: str) -> list[Frame]:
        """Frames of these phases; of none: all."""
        return [
            Frame(s.number, s.time_s, s.value)
            for s in self.during(*names)
            if isinstance(s.value, TrackingFrame)
        ]
