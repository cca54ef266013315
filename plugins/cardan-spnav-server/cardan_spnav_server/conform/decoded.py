"""Decoded records of a daemon at spacenavd's socket for its checks."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, TimelinePhase, WireTimeline
from cardan.protocols.spnav.records import (
    RECORD_BYTES,
    Button,
    MotionEvent,
    ServerRecord,
    ServerReply,
)
from cardan.protocols.spnav.streams import Handshake, ServerReader
from cardan_spnav_server.conform.scenario import STRINGS
from cardan_spnav_server.protocol import ClientRequest, decode_request


class Record(NamedTuple):
    """Record of the daemon, or its word that grants a version."""

    number: int
    """Number of the event that completed it."""
    time_s: float
    channel: str
    value: ServerRecord | Handshake

    @property
    def counts(self) -> tuple[int, ...]:
        """Counts of a motion."""
        return tuple(self.value[:6]) if isinstance(self.value, MotionEvent) else ()


class Asked(NamedTuple):
    """Request of the suite, and its replies: several if the answer is a string."""

    number: int
    time_s: float
    request: ClientRequest
    answers: tuple[Record, ...]

    @property
    def reply(self) -> ServerReply | None:
        """First reply."""
        return self.answers[0].value if self.answers else None  # type: ignore[return-value]


class SpnavTraffic:
    """The records of a timeline."""

    def __init__(self, timeline: WireTimeline) -> None:
        self.phases = timeline.phases()
        self.records: list[Record] = []
        self.streams: dict[str, bytes] = {}
        """All received bytes of each connection."""
        self.ended: list[tuple[int, str]] = []
        """Connections closed or refused by the daemon, with the reason."""
        self.taken = False
        """True if it accepted a connection."""
        self.greeted: dict[str, tuple[int, float]] = {}
        """Number and time of our handshakes, by connection."""
        self._requests: list[tuple[int, float, str, ClientRequest]] = []
        readers: dict[str, ServerReader] = {}
        for number, event in enumerate(timeline):
            if event.kind in (Kind.CLOSED, Kind.REFUSED) and not event.sent:
                self.ended.append((number, event.note or event.kind.value))
            elif event.kind is not Kind.DATA:
                self.taken = self.taken or event.kind is Kind.OPENED
            elif not event.sent:
                reader = readers.setdefault(event.channel, ServerReader())
                held = self.streams.get(event.channel, b"")
                self.streams[event.channel] = held + event.data
                for value in reader.feed(event.data):
                    self.records.append(Record(number, event.time_s, event.channel, value))
            elif len(event.data) == RECORD_BYTES:
                request = decode_request(event.data)
                assert isinstance(request, ClientRequest)
                self._requests.append((number, event.time_s, event.channel, request))
            else:
                self.greeted.setdefault(event.channel, (number, event.time_s))
        self.asked = [self._answered(at) for at in range(len(self._requests))]

    def _answered(self, at: int) -> Asked:
        """Return the request of that index, with its replies before the next request of its
        code."""
        number, time_s, channel, request = self._requests[at]
        later = (
            n
            for n, _, where, other in self._requests[at + 1 :]
            if where == channel and other.code == request.code
        )
        end = next(later, None)
        found = [
            each
            for each in self.records
            if each.channel == channel
            and isinstance(each.value, ServerReply)
            and each.value.code == request.code
            and each.number > number
            and (end is None or each.number < end)
        ]
        return Asked(
            number, time_s, request, tuple(found if request.code in STRINGS else found[:1])
        )

    def sent_request(self, code: int, phase: str = "") -> Asked | None:
        """Return the first request of that code, of a phase if one is given."""
        where = self.phases.get(phase)
        if phase and where is None:
            return None
        for each in self.asked:
            there = where is None or where.first <= each.number < where.end
            if there and each.request.code == code:
                return each
        return None

    def phase(self, name: str) -> TimelinePhase | None:
        """Return the phase of that name, if the scenario reached it."""
        return self.phases.get(name)

    def during(self, channel: str, *names: str) -> list[Record]:
        """Return the records of a connection in these phases; without phases: all."""
        found = [self.phases[name] for name in names if name in self.phases]
        return [
            r
            for r in self.records
            if r.channel == channel
            and (not names or any(p.first <= r.number < p.end for p in found))
        ]

    def motions(self, channel: str, *names: str) -> list[Record]:
        """Return the motions among them."""
        return [each for each in self.during(channel, *names) if each.counts]

    def buttons(self, channel: str, *names: str) -> list[tuple[int, Button]]:
        """Return the presses and releases among them, each with its event's number."""
        return [
            (each.number, each.value)
            for each in self.during(channel, *names)
            if isinstance(each.value, Button)
        ]
