"""Asks what is judged: a scenario, run by whatever gives it times and events.

Sans-I/O. A live shell and a simulated peer in virtual time run the same scenarios.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from cardan.conform.timeline import Event, Kind, Timeline


class Act(NamedTuple):
    """What a scenario wants done now."""

    kind: Kind
    channel: str = ""
    data: bytes = b""
    note: str = ""


class Wait(NamedTuple):
    """Until `until` is true, but no longer than `seconds`."""

    seconds: float
    until: Callable[[], bool] | None = None


def send(data: bytes, channel: str = "") -> Act:
    """Send `data`."""
    return Act(Kind.DATA, channel, data)


def open_(channel: str) -> Act:
    """Open the wire of that name."""
    return Act(Kind.OPENED, channel)


def close(channel: str) -> Act:
    """Close the wire of that name."""
    return Act(Kind.CLOSED, channel)


def mark(phase: str) -> Act:
    """A phase begins."""
    return Act(Kind.MARK, note=phase)


def ask(what: str, instruction: str) -> Act:
    """Somebody is to do `what` by hand, as `instruction` says."""
    return Act(Kind.ASKED, what, note=instruction)


Script = Iterator["Act | Wait"]

END = "end"
"""The phase after the script, which is empty: its mark says how long the last one was."""

LOOK_S = 0.02
"""How often a script looks at what it waits for, where nothing comes."""


class Scenario(ABC):
    """One who asks. `script` is what it does by itself, `answer` what it does on an event."""

    now_s = 0.0
    """Kept current by the exchange."""

    @abstractmethod
    def script(self) -> Script:
        """Its acts and waits, from the start to the end."""

    def answer(self, event: Event) -> Iterable[Act]:
        """What to do at once about `event`, which came from what is judged."""
        return ()


class Exchange:
    """Runs a scenario, and keeps the timeline. Times are seconds since the start."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.timeline = Timeline()
        self.over = False
        self._script = scenario.script()
        self._wait: Wait | None = None
        self._until_s = 0.0

    @property
    def next_s(self) -> float:
        """When `due` should be called next, at the latest."""
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
        """Something came from what is judged, `late_s` before it was read; what to do about it."""
        self.scenario.now_s = now_s
        self.timeline.was_late(late_s)
        event = Event(now_s - late_s, kind, False, channel, data, note)
        self.timeline.add(event)
        acts = [] if self.over else list(self.scenario.answer(event))
        self._keep(now_s, acts)
        return acts + self.due(now_s)

    def due(self, now_s: float) -> list[Act]:
        """What the script wants done by `now_s`."""
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
                    # What comes of it is an event; the script goes on after it.
                    break
        return acts

    def _keep(self, now_s: float, acts: Iterable[Act]) -> None:
        for act in acts:
            if act.kind is not Kind.OPENED:
                event = Event(now_s, act.kind, True, act.channel, act.data, act.note)
                self.timeline.add(event)
