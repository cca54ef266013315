"""What judges of a Magellan look at: its packets, decoded once."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, Phase, Timeline
from cardan.protocols.connexion_serial import (
    MagellanKeys,
    MagellanMotion,
    MagellanPacket,
    MagellanReader,
)


class Packet(NamedTuple):
    """A packet of the device."""

    number: int
    """Of the event that completed it."""
    time_s: float
    value: MagellanPacket

    @property
    def counts(self) -> tuple[int, ...]:
        """Of a motion."""
        return tuple(self.value) if isinstance(self.value, MagellanMotion) else ()


class Asked(NamedTuple):
    """A command of ours, and the first packet after it that begins with its letter."""

    number: int
    time_s: float
    command: bytes
    answer: Packet | None


class MagellanSeen:
    """The packets of a timeline."""

    def __init__(self, timeline: Timeline) -> None:
        self.phases = timeline.phases()
        self.packets: list[Packet] = []
        self.lines: list[tuple[int, bytes]] = []
        """What stood before each CR, with the event that brought it."""
        self.lost: list[int] = []
        self.refused: list[int] = []
        self.asked: list[Asked] = []
        reader = MagellanReader()
        commands: list[tuple[int, float, bytes]] = []
        pending = b""
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
                values = reader.feed(event.data)
                self.packets += [Packet(index, event.time_s, value) for value in values]
                *lines, pending = (pending + event.data).split(b"\r")
                self.lines += [(index, line) for line in lines if line]
        for index, time_s, command in commands:
            if command:
                answer = next(
                    (
                        each
                        for each in self.packets
                        if each.number > index and _letter(each.value) == command[:1]
                    ),
                    None,
                )
                self.asked.append(Asked(index, time_s, command, answer))

    def phase(self, name: str) -> Phase | None:
        """The phase of that name, if the pilot came to it."""
        return self.phases.get(name)

    def during(self, *names: str) -> list[Packet]:
        """The packets of these phases."""
        found = [self.phases[name] for name in names if name in self.phases]
        return [r for r in self.packets if any(p.first <= r.number < p.end for p in found)]

    def motions(self, *names: str) -> list[Packet]:
        """Those with axes."""
        return [each for each in self.during(*names) if each.counts]

    def keys(self, *names: str) -> list[int]:
        """The masks that were told in these phases."""
        found = [each.value for each in self.during(*names)]
        return [each.mask for each in found if isinstance(each, MagellanKeys)]


def _letter(value: MagellanPacket) -> bytes:
    letters = {"MagellanVersion": b"v", "MagellanKeys": b"k", "MagellanError": b"e"}
    name = type(value).__name__
    command: bytes = getattr(value, "command", b"")
    return letters.get(name, command[:1])
