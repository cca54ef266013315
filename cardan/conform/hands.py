"""Scenario base class for operator devices that a person moves on request."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_
from cardan.conform.timeline import Kind, WireEvent

HAND_S = 30.0
"""Time for the operator to follow an instruction."""
QUIET_S = 0.25
"""Silence after which a device is at rest."""
LET_GO_S = 2.0

Steps = tuple[tuple[str, str], ...]
"""Names of phases, and the instruction to the operator in each."""

PUSHES: Steps = (
    ("push", "Push the cap to the right, half way, and hold it."),
    ("twist", "Twist the cap clockwise to its stop, and hold it."),
)
KEYS: Steps = (("press", "Press a button."), ("release", "Release the button."))


class HandScenario(Scenario):
    """Scenario in which each motion has the phases NAME, NAME-held, NAME-over and NAME-rest."""

    def __init__(self, level: Level, seconds: float) -> None:
        self._level = level
        self._hold_s = seconds
        self._hand_s = min(HAND_S, 4.0 * seconds)
        self._heard_s = 0.0
        self._moved = self._pressed = self._gone = False
        self._key = ""
        """Current phase of `KEYS`: the button action now expected."""

    @abstractmethod
    def _note(self, event: WireEvent) -> None:
        """Set `_moved` and `_pressed` if the data of `event` show it."""

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind in (Kind.CLOSED, Kind.REFUSED):
            self._gone = True
        elif event.kind is Kind.DATA:
            self._heard_s = self.now_s
            self._note(event)
        return iter(())

    def _quiet(self) -> bool:
        return self._gone or self.now_s - self._heard_s > QUIET_S

    def _begin(self, rest_s: float) -> Script:
        yield open_("")
        yield mark("rest")
        yield ask("rest", "Do not touch the device.")
        yield Pause(rest_s)

    def _motions(self, rest_s: float, steps: Steps = PUSHES) -> Script:
        for name, how in steps:
            yield mark(name)
            self._moved = False
            yield ask(name, how)
            yield Pause(self._hand_s, lambda: self._moved or self._gone)
            yield mark(f"{name}-held")
            yield Pause(self._hold_s, lambda: self._gone)
            yield mark(f"{name}-over")
            yield ask("let-go", "Let go.")
            yield Pause(LET_GO_S, self._quiet)
            yield mark(f"{name}-rest")
            yield Pause(rest_s)

    def _keys(self) -> Script:
        for name, how in KEYS:
            yield mark(name)
            self._pressed, self._key = False, name
            yield ask(name, how)
            yield Pause(self._hand_s, lambda: self._pressed or self._gone)
        yield Pause(QUIET_S)

    def _again(self) -> Script:
        yield mark("push-again")
        yield ask("push", "Push the cap once more.")
        yield Pause(self._hold_s, lambda: self._gone)
        yield ask("let-go", "Let go.")
        yield Pause(LET_GO_S, self._quiet)

    def _unplugged(self) -> Script:
        yield mark("unplug")
        yield ask("unplug", "Hold the cap deflected, and unplug the device.")
        yield Pause(self._hand_s, lambda: self._gone)
        yield Pause(QUIET_S)
