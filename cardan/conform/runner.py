"""Scenarios of a conformance test, and the runner that feeds them times and events.

Sans-I/O. A live shell and a simulated peer in virtual time run the same scenarios.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from cardan.conform.timeline import Event, Kind, Timeline


class Act(NamedTuple):
    """Action that a scenario requests now."""

    kind: Kind
    channel: str = ""
    data: bytes = b""
    note: str = ""


class Wait(NamedTuple):
    """Pause until `until` is true, but no longer than `seconds`."""

    seconds: float
    until: Callable[[], bool] | None = None


def send(data: bytes, channel: str = "") -> Act:
    """Send `data`."""
    return Act(Kind.DATA, channel, data)


def open_(channel: str) -> Act:
    """Open the wire named `channel`."""
    return Act(Kind.OPENED, channel)


def close(channel: str) -> Act:
    """Close the wire named `channel`."""
    return Act(Kind.CLOSED, channel)


def mark(phase: str) -> Act:
    """Begin a phase."""
    return Act(Kind.MARK, note=phase)


def ask(what: str, instruction: str) -> Act:
    """Ask the operator to do `what` by hand, as `instruction` says."""
    return Act(Kind.ASKED, what, note=instruction)


Script = Iterator["Act | Wait"]

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
        """Yield its acts and waits, from the start to the end."""

    def answer(self, event: Event) -> Iterable[Act]:
        """Return the immediate reactions to `event`, which came from the judged side."""
        return ()


class Exchange:
    """Runs a scenario, and records the timeline. Times are seconds since the start."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.timeline = Timeline()
        self.over = False
        self._script = scenario.script()
        self._wait: Wait | None = None
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
    ) -> list[Act]:
        """Record an event of the judged side, read `late_s` after it came; return the reactions."""
        self.scenario.now_s = now_s
        self.timeline.was_late(late_s)
        event = Event(now_s - late_s, kind, False, channel, data, note)
        self.timeline.add(event)
        acts = [] if self.over else list(self.scenario.answer(event))
        self._keep(now_s, acts)
        return acts + self.due(now_s)

    def due(self, now_s: float) -> list[Act]:
        """Return the script's actions due by `now_s`."""
        self.scenario.now_s = now_s
        acts: list[Act] = []
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
            elif isinstance(step, Wait):
                self._wait, self._until_s = step, now_s + step.seconds
            else:
                self._keep(now_s, [step])
                acts.append(step)
                if step.kind is Kind.OPENED:
                    # The result of opening is an event; the script continues after it.
                    break
        return acts

    def _keep(self, now_s: float, acts: Iterable[Act]) -> None:
        for act in acts:
            if act.kind is not Kind.OPENED:
                event = Event(now_s, act.kind, True, act.channel, act.data, act.note)
                self.timeline.add(event)
