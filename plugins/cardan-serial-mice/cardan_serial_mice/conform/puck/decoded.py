"""Decoded packets of a serial six-axis device for its checks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from cardan.conform.timeline import Kind, TimelinePhase, WireTimeline
from cardan_serial_mice.protocol import Malformed

V = TypeVar("V")


class Reader(Protocol[V]):
    """Splits a device's stream into packets."""

    def feed(self, data: bytes) -> list[V]: ...


@dataclass(frozen=True)
class Packet(Generic[V]):
    """A packet of the device."""

    number: int
    """Number of the event that completed it."""
    time_s: float
    value: V
    counts: tuple[int, ...]
    """Counts of a motion; else empty."""
    mask: int | None
    """Mask of the pressed keys."""

    @property
    def is_malformed(self) -> bool:
        """True if it is not a valid packet."""
        return isinstance(self.value, Malformed)


@dataclass(frozen=True)
class Asked(Generic[V]):
    """A command of the suite, and the first packet after it that answers it."""

    number: int
    time_s: float
    command: bytes
    answer: Packet[V] | None


class PacketMeaning(ABC, Generic[V]):
    """Meaning of the packets of a protocol."""

    @abstractmethod
    def reader(self) -> Reader[V]:
        """Return a new reader of a device's stream."""

    @abstractmethod
    def counts(self, value: V) -> tuple[int, ...]:
        """Return the six counts of a motion; empty for another packet."""

    @abstractmethod
    def mask(self, value: V) -> int | None:
        """Return the mask of pressed keys, if the packet has it."""

    @abstractmethod
    def answers(self, value: V, command: bytes) -> bool:
        """Return True if it may be the answer to a command."""


class PuckTraffic(Generic[V]):
    """The packets of a timeline."""

    def __init__(self, timeline: WireTimeline, meaning: PacketMeaning[V]) -> None:
        self.phases = timeline.phases()
        self.packets: list[Packet[V]] = []
        self.stream = b""
        """All received bytes."""
        self.lost: list[int] = []
        self.refused: list[int] = []
        self._meaning = meaning
        reader = meaning.reader()
        commands: list[tuple[int, float, bytes]] = []
        for index, event in enumerate(timeline):
            if event.kind is Kind.CLOSED and not event.sent:
                self.lost.append(index)
            elif event.kind is Kind.REFUSED:
                self.refused.append(index)
            elif event.kind is not Kind.DATA:
                continue
            elif event.sent:
                commands.append((index, event.time_s, event.data.strip(b"\r")))
            else:
                self.stream += event.data
                self.packets += [
                    Packet(index, event.time_s, value, meaning.counts(value), meaning.mask(value))
                    for value in reader.feed(event.data)
                ]
        self.asked = [
            Asked(index, time_s, command, self._answer(index, command))
            for index, time_s, command in commands
            if command
        ]

    def _answer(self, index: int, command: bytes) -> Packet[V] | None:
        later = (each for each in self.packets if each.number > index)
        return next((e for e in later if self._meaning.answers(e.value, command)), None)

    def sent_command(self, command: bytes) -> Asked[V] | None:
        """Return the first command of these bytes."""
        return next((each for each in self.asked if each.command == command), None)

    def phase(self, name: str) -> TimelinePhase | None:
        """Return the phase of that name, if the scenario reached it."""
        return self.phases.get(name)

    def during(self, *names: str) -> list[Packet[V]]:
        """Return the packets of these phases."""
        found = [self.phases[name] for name in names if name in self.phases]
        return [r for r in self.packets if any(p.first <= r.number < p.end for p in found)]

    def motions(self, *names: str) -> list[Packet[V]]:
        """Return the motion packets."""
        return [each for each in self.during(*names) if each.counts]

    def keys(self, *names: str) -> list[int]:
        """Return the masks of keys in these phases."""
        return [each.mask for each in self.during(*names) if each.mask is not None]
