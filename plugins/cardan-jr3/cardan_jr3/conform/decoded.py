"""Decoded messages of a JR3 board for its checks."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, TimelinePhase, WireTimeline
from cardan_jr3.conform.frames import unpack
from cardan_jr3.protocol import (
    NODE_MASK,
    Ack,
    BoardMessage,
    CanFrame,
    Forces,
    FullScales,
    HostMessage,
    Malformed,
    Moments,
    decode_from_board,
    decode_from_host,
)


class Said(NamedTuple):
    """A message of the board."""

    number: int
    time_s: float
    value: BoardMessage
    frame: CanFrame


class Asked(NamedTuple):
    """Request of the host, and the next acknowledgment."""

    number: int
    time_s: float
    value: HostMessage
    ack: Said | None


class Jr3Traffic:
    """Frames of one node."""

    def __init__(self, timeline: WireTimeline, node_id: int) -> None:
        self.phases = timeline.phases()
        self.node_id = node_id
        self.said: list[Said] = []
        self.malformed: list[tuple[int, str]] = []
        self.frames: dict[int, CanFrame] = {}
        """Frames of the board, including malformed ones."""
        asked: list[tuple[int, float, HostMessage]] = []
        for number, event in enumerate(timeline):
            frame = unpack(event.data) if event.kind is Kind.DATA else None
            if frame is None:
                continue
            if event.sent:
                message = decode_from_host(*frame)
                if message is not None:
                    asked.append((number, event.time_s, message))
                continue
            if frame.arbitration_id & NODE_MASK != node_id:
                continue
            value = decode_from_board(*frame)
            if value is None:
                continue
            self.frames[number] = frame
            if isinstance(value, Malformed):
                self.malformed.append((number, f"{value.opcode:#x} {value.reason}"))
            else:
                self.said.append(Said(number, event.time_s, value, frame))
        acks = [each for each in self.said if isinstance(each.value, Ack)]
        self.asked = []
        for index, (number, time_s, message) in enumerate(asked):
            end = asked[index + 1][0] if index + 1 < len(asked) else float("inf")
            ack = next((each for each in acks if number < each.number < end), None)
            self.asked.append(Asked(number, time_s, message, ack))

    def phase(self, name: str) -> TimelinePhase | None:
        """Phase of that name, if the scenario reached it."""
        return self.phases.get(name)

    def during(self, *names: str) -> list[Said]:
        """Messages of these phases."""
        found = [self.phases[name] for name in names if name in self.phases]
        return [s for s in self.said if any(p.first <= s.number < p.end for p in found)]

    def samples(self, *names: str) -> list[Said]:
        """Forces and moments of these phases, in order."""
        return [s for s in self.during(*names) if isinstance(s.value, (Forces, Moments))]

    def scales(self) -> FullScales | None:
        """Full scales that the board reported."""
        found = [
            each.ack.value.full_scales
            for each in self.asked
            if each.ack is not None
            and isinstance(each.ack.value, Ack)
            and each.ack.value.full_scales is not None
        ]
        return FullScales(found[0], found[1]) if len(found) > 1 else None
