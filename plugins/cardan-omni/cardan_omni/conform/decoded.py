"""Decoded answers and ticks of an HDAPI library for its checks."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

from cardan.conform.timeline import Kind, TimelinePhase, WireTimeline


class Answer(NamedTuple):
    """Result of a call."""

    number: int
    call: str
    arguments: tuple[Any, ...]
    returns: Any
    values: tuple[float, ...]
    errors: tuple[int, ...]
    """Error codes, newest first."""
    devices: tuple[int, ...]
    """Device handle of each code."""


class Tick(NamedTuple):
    """Values of a frame; HDAPI's units and axes."""

    number: int
    time_s: float
    buttons: int
    inkwell: bool
    encoders: tuple[float, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    transform: tuple[float, ...]
    joints: tuple[float, ...]
    temperature: tuple[float, ...]
    force: tuple[float, ...]
    """Value at the beginning of the frame."""
    last: tuple[float, ...]
    """Value of the previous frame."""
    set_n: float
    """Upward force set in this frame, N."""
    errors: tuple[int, ...]


class HdapiTraffic:
    """Answers and ticks of a timeline."""

    def __init__(self, timeline: WireTimeline) -> None:
        self.phases = timeline.phases()
        self.functions: tuple[str, ...] | None = None
        self.answers: list[Answer] = []
        self.all_ticks: list[Tick] = []
        for number, event in enumerate(timeline):
            if event.kind is not Kind.DATA or event.sent:
                continue
            said = json.loads(event.data)
            if "functions" in said:
                self.functions = tuple(said["functions"])
            elif "tick" in said:
                self.all_ticks.append(_tick(number, said))
            else:
                self.answers.append(_answer(number, said))

    def phase(self, name: str) -> TimelinePhase | None:
        """Phase of that name, if the scenario reached it."""
        return self.phases.get(name)

    def ticks(self, *names: str) -> list[Tick]:
        """Ticks of these phases."""
        found = [self.phases[name] for name in names if name in self.phases]
        return [t for t in self.all_ticks if any(p.first <= t.number < p.end for p in found)]

    def said(self, call: str, *arguments: Any, phase: str = "") -> Answer | None:
        """First answer to a call with these first arguments, optionally within a phase."""
        where = self.phases.get(phase)
        for each in self.answers:
            there = not phase or (where is not None and where.first <= each.number < where.end)
            if there and each.call == call and each.arguments[: len(arguments)] == arguments:
                return each
        return None

    @property
    def opened(self) -> bool:
        """True if a device was initialized and answered queries."""
        return self.phase("ask") is not None


def _codes(errors: Sequence[Sequence[int]]) -> tuple[int, ...]:
    return tuple(each[0] for each in errors)


def _answer(number: int, said: dict[str, Any]) -> Answer:
    return Answer(
        number,
        said["call"],
        tuple(said["arguments"]),
        said.get("returns"),
        tuple(said.get("values", ())),
        _codes(said["errors"]),
        tuple(each[2] for each in said["errors"]),
    )


def _tick(number: int, said: dict[str, Any]) -> Tick:
    vectors = {name: tuple(said[name]) for name in _VECTORS}
    return Tick(
        number=number,
        time_s=said["tick"],
        buttons=said["buttons"][0],
        inkwell=bool(said["inkwell"][0]),
        set_n=said["set"],
        errors=_codes(said["errors"]),
        **vectors,
    )


_VECTORS = (
    "encoders", "position", "velocity", "transform", "joints", "temperature", "force", "last",
)  # fmt: skip
