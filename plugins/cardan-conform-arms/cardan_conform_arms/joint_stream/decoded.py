"""Decoded traffic of the joint stream for its checks: states and commands."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, Traffic, WireTimeline
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    ArmState,
    MalformedDatagram,
    decode_command,
    decode_state,
)


class State(NamedTuple):
    """State of the arm."""

    number: int
    time_s: float
    value: ArmState


class Command(NamedTuple):
    """Command; `value` is None for bytes that are deliberately not a command."""

    number: int
    time_s: float
    value: ArmCommand | None


class JointStreamTraffic(Traffic):
    """Datagrams of a timeline in which we are the client, or with `arm_sends` the arm."""

    def __init__(self, timeline: WireTimeline, arm_sends: bool = False) -> None:
        super().__init__(timeline)
        self.states: list[State] = []
        self.commands: list[Command] = []
        self.raw: dict[int, bytes] = {}
        for number, event in enumerate(timeline):
            if event.kind is not Kind.DATA:
                continue
            if not event.sent:
                self.raw[number] = event.data
            if event.sent is arm_sends:
                state = decode_state(event.data)
                if not isinstance(state, MalformedDatagram):
                    self.states.append(State(number, event.time_s, state))
                elif not event.sent:
                    self.unread.append((number, state.reason))
                continue
            command = decode_command(event.data)
            if not isinstance(command, MalformedDatagram):
                self.commands.append(Command(number, event.time_s, command))
            elif event.sent:
                self.commands.append(Command(number, event.time_s, None))
            else:
                self.unread.append((number, command.reason))

    def during(self, *names: str) -> list[State]:
        """Return the states of these phases."""
        return self.within(self.states, *names)

    def sent_during(self, *names: str) -> list[Command]:
        """Return the commands of these phases."""
        return self.within(self.commands, *names)

    @property
    def sessions(self) -> list[list[State]]:
        """Return the states, session by session."""
        found: dict[int, list[State]] = {}
        for each in self.states:
            found.setdefault(each.value.session, []).append(each)
        return list(found.values())
