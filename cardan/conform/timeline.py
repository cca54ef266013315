"""What went over a wire, and when."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator
from typing import NamedTuple, Protocol, TypeVar

from cardan.conform.requirements import Requirement, V, Verdict


class Kind(enum.Enum):
    """What an event is."""

    DATA = "data"
    OPENED = "opened"
    CLOSED = "closed"
    """By the other side, or by us where it was `sent`."""
    REFUSED = "refused"
    """What was to be opened could not be."""
    MARK = "mark"
    """A phase of the scenario begins; `note` is its name."""
    ASKED = "asked"
    """Somebody was asked to do `note` by hand."""


class Event(NamedTuple):
    """One thing that happened."""

    time_s: float
    """Since the start."""
    kind: Kind
    sent: bool = False
    """By us, not by what is judged."""
    channel: str = ""
    """Which of its wires: a port's name, a pipe."""
    data: bytes = b""
    note: str = ""
    """Of data, where it came from where that can change; of what was opened, words where its
    beginning is not known; of others, words."""


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
        """Of the event that begins it."""
        return self.first


class UnaskedError(Exception):
    """A judge wants what came of something that was asked for, and nobody asked for it: of a
    timeline that somebody else recorded."""


class Timeline:
    """Events in their order. Numbers of events count from 0."""

    start_ns: int | None = None
    """The wall time of its zero, ns since the epoch, where it is a capture's."""
    strays: tuple[str, ...] = ()
    """What a capture has besides that is none of what is judged: words for each."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.late_s = 0.0
        """The longest time for which something that had come was not read, or something that was
        due was not done: how late the computer was on which this was taken."""

    def __iter__(self) -> Iterator[Event]:
        return iter(self.events)

    def __len__(self) -> int:
        return len(self.events)

    def add(self, event: Event) -> None:
        """Append what happened next."""
        self.events.append(event)

    def was_late(self, seconds: float) -> None:
        """Note that something was read, or done, so long after it could have been."""
        self.late_s = max(self.late_s, seconds)

    def verdict(self, requirement: Requirement[V], seen: V) -> Verdict:
        """On `seen`, which a suite made of it."""
        return requirement.verdict(seen, self.late_s)

    @property
    def end_s(self) -> float:
        """When the last event was; 0 for an empty one."""
        return self.events[-1].time_s if self.events else 0.0

    def phases(self) -> dict[str, TimelinePhase]:
        """By name; of two of one name the later."""
        marks = [(n, each) for n, each in enumerate(self.events) if each.kind is Kind.MARK]
        found = {}
        for index, (first, event) in enumerate(marks):
            if index + 1 < len(marks):
                end, end_s = marks[index + 1][0], marks[index + 1][1].time_s
            else:
                end, end_s = len(self.events), self.end_s
            found[event.note] = TimelinePhase(event.note, first, end, event.time_s, end_s)
        return found


class Numbered(Protocol):
    """Something that came, or was sent, by an event of a timeline."""

    @property
    def number(self) -> int:
        """Of its event."""


N = TypeVar("N", bound=Numbered)


class Traffic:
    """What the judges of any protocol look at: a timeline's phases. Of a protocol it is the base
    of what has the decoded messages."""

    def __init__(self, timeline: Timeline) -> None:
        self.events = timeline.events
        self.phases = timeline.phases()
        self.end_s = timeline.end_s
        self.gone = [
            (number, each)
            for number, each in enumerate(timeline)
            if each.kind in (Kind.CLOSED, Kind.REFUSED) and not each.sent
        ]
        """Wires that what is judged closed or refused, by the numbers of events."""
        self.unread: list[tuple[int, str]] = []
        """Numbers of events with what cannot be read of what is judged, and why."""

    @property
    def lost(self) -> list[int]:
        """Numbers of events by which wires were closed."""
        return [number for number, each in self.gone if each.kind is Kind.CLOSED]

    @property
    def refused(self) -> list[int]:
        """Numbers of events by which wires were refused."""
        return [number for number, each in self.gone if each.kind is Kind.REFUSED]

    def phase(self, name: str) -> TimelinePhase | None:
        """The phase of that name, if the scenario came to it."""
        return self.phases.get(name)

    def inside(self, number: int, *names: str) -> bool:
        """Whether an event is one of these phases."""
        found = (self.phases[name] for name in names if name in self.phases)
        return any(phase.first <= number < phase.end for phase in found)

    def within(self, found: Iterable[N], *names: str) -> list[N]:
        """What of `found` came, or was sent, in these phases."""
        inside = [self.phases[name] for name in names if name in self.phases]
        return [each for each in found if any(p.first <= each.number < p.end for p in inside)]
