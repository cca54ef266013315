"""Shared parts of motion scripts: words of a step, and steps as timed actions."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar

from cardan.errors import ScriptError
from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.motion_profile import SinePeriods, V, VectorMotion, VectorRamp

A = TypeVar("A")
D = TypeVar("D")
Action = Callable[[D, float], None]
"""Action of a script's step on a device at its time, s."""
D_contra = TypeVar("D_contra", contravariant=True)


class HeldDevice(Protocol):
    """A simulated device that a script moves; times are s from the script's start."""

    @property
    def plugged(self) -> bool:
        """True if programs can find it."""

    @property
    def next_due_s(self) -> float:
        """Time of the next work of `reports`; inf while at rest."""

    def reports(self, now_s: float) -> list[Any]:
        """Return the reports sent from the last call until `now_s`."""

    def skip_to(self, now_s: float) -> None:
        """Skip the time before `now_s`, except for reports that must not be lost."""


class DeviceMotion(Protocol[D_contra]):
    """Motion source of a simulated device."""

    @property
    def next_due_s(self) -> float:
        """Time of the next work of `advance`, s; inf when nothing is planned."""

    def advance(self, now_s: float, device: D_contra) -> None:
        """Apply the actions on `device` that are due until `now_s`."""


H = TypeVar("H", bound=HeldDevice)


def pieces(device: H, motion: DeviceMotion[H], until_s: float) -> Iterator[list[Any]]:
    """Move `device` by `motion` until `until_s`, each at its due times. Yields the reports, in
    pieces that end when it is plugged in or out."""
    sent: list[Any] = []
    plugged = device.plugged
    while (due_s := min(device.next_due_s, motion.next_due_s)) <= until_s:
        device.skip_to(due_s)
        motion.advance(due_s, device)
        sent += device.reports(due_s)
        if device.plugged != plugged:
            yield sent
            sent, plugged = [], device.plugged
    yield sent


def play(device: H, motion: DeviceMotion[H], until_s: float) -> list[Any]:
    """Return all reports of `pieces` in one list."""
    return [each for piece in pieces(device, motion, until_s) for each in piece]


def calling(method: str, *arguments: Any) -> Action[Any]:
    """Return a step that calls a method of the device."""
    return lambda device, _: getattr(device, method)(*arguments)


def setting(attribute: str, value: Any) -> Action[Any]:
    """Return a step that sets an attribute of the device."""
    return lambda device, _: setattr(device, attribute, value)


def moving(motion: VectorMotion[V], stroke: VectorRamp | SinePeriods) -> Action[Any]:
    """Return a step that begins a stroke."""
    return lambda _, at_s: motion.start(at_s, stroke)


class StepWords:
    """Parser of the words after a step's verb.

    All methods raise ScriptError, which names the step and, if it helps, its usage (from `verbs`).
    """

    def __init__(self, step: ScriptStep, verbs: Mapping[str, str]) -> None:
        self.time_s = step.time_s
        self.verb = step.verb
        self.usage = verbs[step.verb]
        self.left = list(step.args)
        """Words that were not taken yet."""

    def error(self, what: str) -> ScriptError:
        """Return the error to raise for this step; `what` is the problem."""
        return ScriptError(f"{self.time_s:g} s {self.verb}: {what}")

    def word(self, name: str) -> str:
        """Take the next word; `name` is its name in the usage."""
        if not self.left:
            raise self.error(f"{name} is missing; usage: {self.usage}")
        return self.left.pop(0)

    def number(self, name: str, lowest: float = -math.inf, highest: float = math.inf) -> float:
        """Take the next word as a finite number in `lowest` to `highest`."""
        text = self.word(name)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not lowest <= value <= highest or math.isinf(value):
            limits = "" if math.isinf(lowest) else f" from {lowest:g}"
            limits += "" if math.isinf(highest) else f" to {highest:g}"
            raise self.error(f"{name} is {text!r}, must be a number{limits}")
        return value

    def numbers(self, names: Iterable[str], lowest: float, highest: float) -> tuple[float, ...]:
        """Take a number for each of `names`."""
        return tuple([self.number(name, lowest, highest) for name in names])

    def keyword(self, name: str) -> bool:
        """Take the next word if it is `name`; return True if it was."""
        found = self.left[:1] == [name]
        del self.left[: int(found)]
        return found

    def needs(self, name: str) -> None:
        """Take the next word, which must be `name`."""
        if not self.keyword(name):
            raise self.error(f"{name!r} is missing; usage: {self.usage}")

    def over(self) -> float:
        """Take ``[over SECONDS]``; return 0 without it."""
        return self.number("SECONDS", 0.0) if self.keyword("over") else 0.0

    def swing(
        self, amplitude: tuple[float, ...], shortest_s: float, *, phased: bool = True
    ) -> SinePeriods:
        """Take ``over SECONDS [times N] [phase DEGREES]``, the last only if `phased`."""
        self.needs("over")
        period_s = self.number("SECONDS", shortest_s)
        times = int(self.number("N", 1.0)) if self.keyword("times") else 1
        phase_deg = 0.0
        if phased and self.keyword("phase"):
            phase_deg = self.number("DEGREES", -360.0, 360.0)
        return SinePeriods(amplitude, period_s, times, math.radians(phase_deg))

    def end(self) -> None:
        """Check that there are no more words."""
        if self.left:
            raise self.error(f"{' '.join(self.left)!r} is too much; usage: {self.usage}")


class ScriptTimeline(Generic[A]):
    """Actions of a script in the order of time, repeated from ``loop``.

    `read` turns a step's words into actions and their times, s; actions after the loop happen at
    the loop. `start_s`: start of the script; inf: at the call of `start`. Raises ScriptError for a
    ``loop`` that is not the last step, and any error of `read`.
    """

    def __init__(
        self,
        steps: Sequence[ScriptStep],
        verbs: Mapping[str, str],
        read: Callable[[StepWords], Iterable[tuple[float, A]]],
        start_s: float = 0.0,
    ) -> None:
        actions: list[tuple[float, A]] = []
        self._loop_s = math.inf
        for index, step in enumerate(steps):
            words = StepWords(step, verbs)
            if step.verb != "loop":
                actions += read(words)
                continue
            words.end()
            if step.time_s <= 0.0 or index + 1 < len(steps):
                raise words.error("must be the last step, after 0 s")
            self._loop_s = step.time_s
        self._actions = sorted(
            ((min(time_s, self._loop_s), action) for time_s, action in actions),
            key=lambda timed: timed[0],
        )
        self._start_s = start_s
        self._next = 0

    @property
    def next_due_s(self) -> float:
        """Time of the next action or loop, s; inf before the start and after the end."""
        if self._next < len(self._actions):
            return self._start_s + self._actions[self._next][0]
        return self._start_s + self._loop_s

    def start(self, now_s: float) -> None:
        """Begin at `now_s`, unless the script has begun."""
        if self._start_s == math.inf:
            self._start_s = now_s

    def due(self, now_s: float) -> Iterator[tuple[float, A]]:
        """Yield each new action that is due until `now_s`, with its time."""
        while (due_s := self.next_due_s) <= now_s:
            if self._next < len(self._actions):
                self._next += 1
                yield due_s, self._actions[self._next - 1][1]
            else:
                self._start_s, self._next = due_s, 0


class MotionScript(ABC, Generic[D]):
    """Plays the steps of a script on a device of type D, which keeps its last state.

    `motions` move parts of the device in time. `start_s`: start of the script; inf: at the call of
    `start`. Raises ScriptError, naming the step, for arguments that its verb does not take.
    """

    def __init__(
        self,
        steps: Sequence[ScriptStep],
        verbs: Mapping[str, str],
        motions: Sequence[VectorMotion[Any]] = (),
        start_s: float = 0.0,
    ) -> None:
        self._motions = motions
        self._timeline = ScriptTimeline(steps, verbs, self._timed, start_s)

    @abstractmethod
    def _read(self, words: StepWords) -> Action[D]:
        """Turn the words of a step into its action."""

    def _timed(self, words: StepWords) -> list[tuple[float, Action[D]]]:
        """Actions of one step, each with its time, s."""
        actions = [(words.time_s, self._read(words))]
        words.end()
        return actions

    @abstractmethod
    def _hold(self, device: D, now_s: float) -> None:
        """Set `device` to the state of the motions at `now_s`."""

    def start(self, now_s: float) -> None:
        """Begin the script at `now_s`, unless it has begun."""
        self._timeline.start(now_s)

    @property
    def next_due_s(self) -> float:
        """Time of the next work of `advance`, s; inf before the start and after the end."""
        return min(
            self._timeline.next_due_s, *(motion.next_due_s for motion in self._motions), math.inf
        )

    def advance(self, now_s: float, device: D) -> None:
        """Apply every step that is due until `now_s`, then set `device` to its state at `now_s`."""
        for due_s, action in self._timeline.due(now_s):
            action(device, due_s)
        self._hold(device, now_s)
