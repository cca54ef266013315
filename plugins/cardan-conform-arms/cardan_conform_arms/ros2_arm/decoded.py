"""Decoded messages of a ROS 2 arm for its checks."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, Traffic, WireTimeline
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan_conform_arms.ros2_arm.names import COMMANDS, DESCRIPTION, STATES, TOPICS, joints_of


class State(NamedTuple):
    """Joint state."""

    number: int
    time_s: float
    publisher: str
    sequence: int | None
    """Publisher's count; None if the transport has none."""
    stamp_s: float
    positions: dict[str, float]
    whole: bool
    """True with as many positions as names."""


class RosArmTraffic(Traffic):
    """Messages of a timeline."""

    def __init__(self, timeline: WireTimeline) -> None:
        super().__init__(timeline)
        self.states: list[State] = []
        self.commands: list[tuple[int, float]] = []
        self.described: dict[str, str] | None = None
        """Moving joints, as returned by `joints_of`."""
        codec = codec_of(TOPICS[STATES].type)
        text = codec_of(TOPICS[DESCRIPTION].type)
        for number, event in enumerate(timeline):
            if event.kind is not Kind.DATA:
                continue
            if event.channel == COMMANDS:
                self.commands.append((number, event.time_s))
            elif event.channel == DESCRIPTION:
                said = text.decode(event.data)
                if not isinstance(said, MalformedCdr):
                    self.described = joints_of(said["data"])
            elif event.channel == STATES:
                message = codec.decode(event.data)
                if isinstance(message, MalformedCdr):
                    self.unread.append((number, message.reason))
                    continue
                publisher, _, digits = event.note.partition(":")
                stamp = message["header"]["stamp"]
                names, positions = list(message["name"]), list(message["position"])
                self.states.append(
                    State(
                        number,
                        event.time_s,
                        publisher,
                        int(digits) if digits.isdigit() else None,
                        stamp["sec"] + 1e-9 * stamp["nanosec"],
                        dict(zip(names, positions, strict=False)),
                        len(names) == len(positions) == len(set(names)),
                    )
                )

    def during(self, *names: str) -> list[State]:
        """Return the states of these phases."""
        return self.within(self.states, *names)

    def publishers(self) -> dict[str, list[State]]:
        """Return the states of each publisher."""
        found: dict[str, list[State]] = {}
        for each in self.states:
            found.setdefault(each.publisher, []).append(each)
        return found
