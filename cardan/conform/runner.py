"""Scenarios of a conformance test, and the runner that feeds them times and events.

Sans-I/O. A live shell and a simulated peer in virtual time run the same scenarios.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from cardan.conform.timeline import Kind, WireEvent, WireTimeline


class Step(NamedTuple):
    """Action that a scenario requests now."""

    kind: Kind
    channel: str = ""
    data: bytes = b""
    note: str = ""


class Pause(NamedTuple):
    """Pause until `until` is true, but no longer than `seconds`."""

    seconds: float
    until: Callable[[], bool] | None = None


def send(data: bytes, channel: str = "") -> Step:
    """Send `data`."""
    return Step(Kind.DATA, channel, data)


def open_(channel: str) -> Step:
    """Open the wire named `channel`."""
    return Step(Kind.OPENED, channel)


def close(channel: str) -> Step:
    """Close the wire named `channel`."""
    return Step(Kind.CLOSED, channel)


def mark(phase: str) -> Step:
    """Begin a phase."""
    return Step(Kind.MARK, note=phase)


def ask(what: str, instruction: str) -> Step:
    """Ask the operator to do `what` by hand, with the given instruction."""
    return Step(Kind.ASKED, what, note=instruction)


Script = Iterator["Step | Pause"]

END = "end"
"""The empty phase after the script: its mark ends the last phase."""

LOOK_S = 0.02
"""Polling period of a script's wait condition while nothing arrives."""


class Scenario(ABC):
    """Test scenario. `script` has its own actions, `answer` its reactions to events."""

    now_s = 0.0
    """Kept current by the exchange."""

    @abstractmethod
    def script(self) -> Script:
        """Yield its steps and pauses, from the start to the end."""

    def answer(self, event: WireEvent) -> Iterable[Step]:
        """Return the immediate reactions to `event`, which came from the tested side."""
        return ()


class Exchange:
    """Runs a scenario, and records the timeline. Times are seconds since the start."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.timeline = WireTimeline()
        self.over = False
        self._script = scenario.script()
        self._wait: Pause | None = None
        self._until_s = 0.0

    @property
    def next_s(self) -> float:
        """Latest time at which `due` should be called next."""
        if self.over:
            return math.inf
        wait = self._wait
        if wait is None:
            return 0.0
        if wait.until is None:
            return self._until_s
        return min(self._until_s, self.scenario.now_s + LOOK_S)

    def heard(
        self,
        now_s: float,
        channel: str,
        data: bytes = b"",
        *,
        kind: Kind = Kind.DATA,
        note: str = "",
        late_s: float = 0.0,
    ) -> list[Step]:
        """Record an event of the tested side, read `late_s` after it came; return the reactions."""
        self.scenario.now_s = now_s
        self.timeline.record_lateness(late_s)
        event = WireEvent(now_s - late_s, kind, False, channel, data, note)
        self.timeline.add(event)
        steps = [] if self.over else list(self.scenario.answer(event))
        self._keep(now_s, steps)
        return steps + self.due(now_s)

    def due(self, now_s: float) -> list[Step]:
        """Return the script's actions due by `now_s`."""
        self.scenario.now_s = now_s
        steps: list[Step] = []
        while not self.over:
            wait = self._wait
            if wait is not None:
                if now_s < self._until_s and not (wait.until is not None and wait.until()):
                    break
                self._wait = None
            step = next(self._script, None)
            if step is None:
                self.over = True
                self._keep(now_s, [mark(END)])
            elif isinstance(step, Pause):
                self._wait, self._until_s = step, now_s + step.seconds
            else:
                self._keep(now_s, [step])
                steps.append(step)
                if step.kind is Kind.OPENED:
                    # The result of opening is an event; the script continues after it.
                    break
        return steps

    def _keep(self, now_s: float, steps: Iterable[Step]) -> None:
        for step in steps:
            if step.kind is not Kind.OPENED:
                event = WireEvent(now_s, step.kind, True, step.channel, step.data, step.note)
                self.timeline.add(event)
