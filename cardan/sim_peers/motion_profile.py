"""Motion of a vector in time for scripts: ramps, with superimposed sine periods."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Generic, NamedTuple, TypeVar, cast

V = TypeVar("V", bound=tuple[float, ...])


class VectorRamp(NamedTuple):
    """Ramp to `goal` from the present vector."""

    goal: tuple[float | None, ...]
    """None: this component keeps its own goal, reached in the same time as the others."""
    over_s: float = 0.0
    ends_swings: bool = False
    """Start from the vector with its swings, and end them; otherwise they stay superimposed."""


class SinePeriods(NamedTuple):
    """`times` whole sine periods on top of the ramps."""

    amplitude: tuple[float, ...]
    period_s: float
    times: int = 1
    phase_rad: float = 0.0

    @property
    def duration_s(self) -> float:
        """Duration of all periods."""
        return self.period_s * self.times


class VectorMotion(Generic[V]):
    """Vector that strokes move; it begins at `rest` and stays at the goal of the last ramp.

    `period_s` is the sample period during motion. Ramps are linear, or `gentle`: half a cosine,
    with zero speed at both ends. All times count from the same zero as those of `advance`, and must
    not go back.
    """

    def __init__(self, rest: V, period_s: float = math.inf, *, gentle: bool = False) -> None:
        self._period_s = period_s
        self._gentle = gentle
        self._origin = self._goal = rest
        self._begin_s = 0.0
        self._over_s = 0.0
        self._swings: list[tuple[float, SinePeriods]] = []
        self._now_s = 0.0

    @property
    def next_due_s(self) -> float:
        """Time of the next sample, s; inf at rest."""
        ends_s = [begin_s + swing.duration_s for begin_s, swing in self._swings]
        if self._now_s < self._begin_s + self._over_s:
            ends_s.append(self._begin_s + self._over_s)
        return min(self._now_s + self._period_s, *ends_s) if ends_s else math.inf

    def start(self, begin_s: float, stroke: VectorRamp | SinePeriods) -> None:
        """Begin a stroke at `begin_s`."""
        if isinstance(stroke, SinePeriods):
            self._swings.append((begin_s, stroke))
            return
        self._origin = self.at(begin_s) if stroke.ends_swings else self.without_swings(begin_s)
        if stroke.ends_swings:
            self._swings.clear()
        goals = zip(stroke.goal, self._goal, strict=True)
        self._goal = self._vector(old if new is None else new for new, old in goals)
        self._begin_s, self._over_s = begin_s, stroke.over_s

    def advance(self, now_s: float) -> V:
        """Return the vector at `now_s`, and discard swings that have ended by then."""
        self._now_s = now_s
        self._swings = [
            (begin_s, swing)
            for begin_s, swing in self._swings
            if now_s < begin_s + swing.duration_s
        ]
        return self.at(now_s)

    def without_swings(self, at_s: float) -> V:
        """Return the vector at `at_s` by the ramps alone."""
        if at_s >= self._begin_s + self._over_s:
            return self._goal
        share = (at_s - self._begin_s) / self._over_s
        if self._gentle:
            share = 0.5 - 0.5 * math.cos(math.pi * share)
        return self._vector(
            a + (b - a) * share for a, b in zip(self._origin, self._goal, strict=True)
        )

    def at(self, at_s: float) -> V:
        """Return the vector at `at_s`."""
        vector = self.without_swings(at_s)
        for begin_s, swing in self._swings:
            if begin_s <= at_s < begin_s + swing.duration_s:
                sine = math.sin(math.tau * (at_s - begin_s) / swing.period_s + swing.phase_rad)
                vector = self._vector(
                    a + b * sine for a, b in zip(vector, swing.amplitude, strict=True)
                )
        return vector

    def rates_at(self, at_s: float) -> V:
        """Return the vector's derivative at `at_s`, 1/s."""
        rates = [0.0] * len(self._goal)
        if at_s < self._begin_s + self._over_s:
            slope = 1.0 / self._over_s
            if self._gentle:
                slope *= 0.5 * math.pi * math.sin(math.pi * (at_s - self._begin_s) * slope)
            rates = [(b - a) * slope for a, b in zip(self._origin, self._goal, strict=True)]
        for begin_s, swing in self._swings:
            if begin_s <= at_s < begin_s + swing.duration_s:
                turn_rad_s = math.tau / swing.period_s
                cosine = math.cos(turn_rad_s * (at_s - begin_s) + swing.phase_rad)
                for index, amplitude in enumerate(swing.amplitude):
                    rates[index] += amplitude * turn_rad_s * cosine
        return self._vector(rates)

    @staticmethod
    def _vector(values: Iterable[float]) -> V:
        return cast(V, tuple(values))
