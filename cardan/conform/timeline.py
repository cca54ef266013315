"""Timeline of wire events, with their times."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator
from typing import NamedTuple, Protocol, TypeVar

from cardan.conform.requirements import Requirement, V, Verdict


class Kind(enum.Enum):
    """Kind of a wire event."""

    DATA = "data"
    OPENED = "opened"
    CLOSED = "closed"
    """By the other side, or by us where it was `sent`."""
    REFUSED = "refused"
    """A wire could not be opened."""
    MARK = "mark"
    """A phase of the scenario begins; `note` is its name."""
    ASKED = "asked"
    """The operator was asked to do `note` by hand."""


class WireEvent(NamedTuple):
    """Event on a wire, or of the scenario."""

    time_s: float
    """Since the start."""
    kind: Kind
    sent: bool = False
    """By us, not by the tested side."""
    channel: str = ""
    """Name of the wire: a port's name, a pipe."""
    data: bytes = b""
    note: str = ""
    """For data, the source address if it can change; for an opened wire, words if its beginning is
    not known; for others, words."""


class TimelinePhase(NamedTuple):
    """Events from one mark to the next."""

    name: str
    first: int
    end: int
    """Number of the event after its last one."""
    start_s: float
    end_s: float

    @property
    def number(self) -> int:
        """Number of the event that begins it."""
        return self.first


class UnaskedError(Exception):
    """A check needs the answer to a request that the timeline lacks, as captures of others may."""


class WireTimeline:
    """Events in their order. Numbers of events count from 0."""

    start_ns: int | None = None
    """The wall time of its zero, ns since the epoch, if it comes from a capture."""
    strays: tuple[str, ...] = ()
    """Traffic in a capture that is not of the tested side: words for each."""

    def __init__(self) -> None:
        self.events: list[WireEvent] = []
        self.late_s = 0.0
        """Largest delay of the recording computer: from arrival to reading, or from an action's due
        time to the action."""

    def __iter__(self) -> Iterator[WireEvent]:
        return iter(self.events)

    def __len__(self) -> int:
        return len(self.events)

    def add(self, event: WireEvent) -> None:
        """Append the next event."""
        self.events.append(event)

    def record_lateness(self, seconds: float) -> None:
        """Record that a read or an action was late by `seconds`."""
        self.late_s = max(self.late_s, seconds)

    def verdict(self, requirement: Requirement[V], decoded: V) -> Verdict:
        """Return the verdict on `decoded`, a suite's decoded traffic of this timeline."""
        return requirement.verdict(decoded, self.late_s)

    @property
    def end_s(self) -> float:
        """Time of the last event; 0 if there is none."""
        return self.events[-1].time_s if self.events else 0.0

    def phases(self) -> dict[str, TimelinePhase]:
        """Return the phases by name; of two of one name the later."""
        marks = [(n, each) for n, each in enumerate(self.events) if each.kind is Kind.MARK]
        found = {}
        for index, (first, event) in enumerate(marks):
            if index + 1 < len(marks):
                end, end_s = marks[index + 1][0], marks[index + 1][1].time_s
            else:
                end, end_s = len(self.events), self.end_s
            found[event.note] = TimelinePhase(event.note, first, end, event.time_s, end_s)
        return found


class NumberedItem(Protocol):
    """Item received or sent by an event of a timeline."""

    @property
    def number(self) -> int:
        """Number of its event."""


N = TypeVar("N", bound=NumberedItem)


class Traffic:
    """Phases and lost wires of a timeline, for the checks of any protocol. Base class of the
    decoded traffic of each protocol."""

    def __init__(self, timeline: WireTimeline) -> None:
        self.events = timeline.events
        self.phases = timeline.phases()
        self.end_s = timeline.end_s
        self.gone = [
            (number, each)
            for number, each in enumerate(timeline)
            if each.kind in (Kind.CLOSED, Kind.REFUSED) and not each.sent
        ]
        """Wires that the tested side closed or refused, with the numbers of the events."""
        self.unread: list[tuple[int, str]] = []
        """Numbers of events with undecodable data of the tested side, and the reasons."""

    @property
    def lost(self) -> list[int]:
        """Numbers of events by which wires were closed."""
        return [number for number, each in self.gone if each.kind is Kind.CLOSED]

    @property
    def refused(self) -> list[int]:
        """Numbers of events by which wires were refused."""
        return [number for number, each in self.gone if each.kind is Kind.REFUSED]

    def phase(self, name: str) -> TimelinePhase | None:
        """Return the phase of that name, if the scenario reached it."""
        return self.phases.get(name)

    def inside(self, number: int, *names: str) -> bool:
        """True if an event belongs to one of these phases."""
        found = (self.phases[name] for name in names if name in self.phases)
        return any(phase.first <= number < phase.end for phase in found)

    def within(self, found: Iterable[N], *names: str) -> list[N]:
        """Return the items of `found` that were received or sent in these phases."""
        inside = [self.phases[name] for name in names if name in self.phases]
        return [each for each in found if any(p.first <= each.number < p.end for p in inside)]
