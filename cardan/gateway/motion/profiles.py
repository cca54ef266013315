"""Motion along a length: how far, how fast, at any time, with speed and its rates of change bounded.

A profile is a chain of phases of constant jerk. The length has whatever unit its user gives it
(m, rad, the share of a path), and speed, acceleration and jerk the same unit per s, s² and s³.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class ProfileState(NamedTuple):
    """Where a profile is at one time."""

    s: float
    """Way along the path."""
    ds: float
    """Speed, per s; never negative."""
    dds: float
    """Acceleration, per s²."""


class Phase(NamedTuple):
    """A stretch of constant jerk."""

    duration_s: float
    acceleration: float
    """At its start."""
    jerk: float


def _require_positive(**values: float) -> None:
    for name, value in values.items():
        if not value > 0.0:
            raise ValueError(f"{name} {value:g} is not above 0")


def stopping_phases(
    speed: float, acceleration_now: float, acceleration: float, jerk: float
) -> tuple[Phase, ...]:
    """The quickest way from `speed` >= 0 and `acceleration_now` to rest, in up to three phases.

    Speed falls at every time at least as fast as in any other motion within `acceleration` and
    `jerk` (both may be infinite) that comes to rest without turning back; so no other covers less
    way. Where speed is too low to end the present braking within `jerk` (by rounding, that is),
    braking ends linearly.
    """
    a = acceleration_now
    if speed <= 0.0:
        return ()
    if math.isinf(jerk):
        if math.isinf(acceleration):
            return ()
        return (Phase(speed / acceleration, -acceleration, 0.0),)
    if a < 0.0 and 2.0 * jerk * speed <= a * a:
        duration = -2.0 * speed / a
        return (Phase(duration, a, -a / duration),)
    peak = math.sqrt(jerk * speed + 0.5 * a * a)
    hold = 0.0
    if peak > acceleration:
        peak = acceleration
        hold = max(0.0, (speed + 0.5 * a * a / jerk - peak * peak / jerk) / peak)
    return (
        Phase((a + peak) / jerk, a, -jerk),
        Phase(hold, -peak, 0.0),
        Phase(peak / jerk, -peak, jerk),
    )


class Profile:
    """Phases one after the other, then the last speed for ever (0 where the motion ends).

    The classes below make them; :meth:`brake` makes one from another.
    """

    def __init__(
        self,
        phases: tuple[Phase, ...],
        acceleration: float,
        jerk: float,
        start: ProfileState,
        end: tuple[float, float] | None = None,
    ) -> None:
        """`end`: way and speed after the last phase, where they are known better than by sums."""
        self.acceleration = acceleration
        """Bound of |dds| when braking."""
        self.jerk = jerk
        """Bound of |ddds|; infinite: accelerations may jump."""
        self.start = start.s
        """Way at time 0."""
        # (end time, start time, way, speed, acceleration, jerk) of each phase.
        self._phases: list[tuple[float, float, float, float, float, float]] = []
        time, s, ds = 0.0, start.s, start.ds
        for length, dds, ddds in phases:
            if length <= 0.0:
                continue
            self._phases.append((time + length, time, s, ds, dds, ddds))
            s += length * (ds + length * (0.5 * dds + length * ddds / 6.0))
            ds = max(0.0, ds + length * (dds + length * 0.5 * ddds))
            time += length
        self._settled_s = time
        self._end_s, self._end_ds = (s, ds) if end is None else end
        self.duration_s = time if self._end_ds == 0.0 else math.inf
        """Time until rest, s; infinite for a motion without end."""

    @property
    def distance(self) -> float:
        """Way covered from time 0 until rest."""
        return math.inf if self._end_ds > 0.0 else self._end_s - self.start

    def at(self, t_s: float) -> ProfileState:
        """The state at `t_s` since the start; before it the start at rest, after it the end."""
        if t_s < 0.0:
            return ProfileState(self.start, 0.0, 0.0)
        for until, since, s, ds, dds, ddds in self._phases:
            if t_s < until:
                t = t_s - since
                way = s + t * (ds + t * (0.5 * dds + t * ddds / 6.0))
                speed = ds + t * (dds + t * 0.5 * ddds)
                if self._end_ds == 0.0 and way > self._end_s:
                    way = self._end_s
                return ProfileState(way, speed if speed > 0.0 else 0.0, dds + t * ddds)
        if self._end_ds == 0.0:
            return ProfileState(self._end_s, 0.0, 0.0)
        return ProfileState(self._end_s + self._end_ds * (t_s - self._settled_s), self._end_ds, 0.0)

    def brake(
        self, t_s: float, acceleration: float | None = None, jerk: float | None = None
    ) -> Profile:
        """From the state at `t_s`, the quickest stop; its time 0 is `t_s`, its way goes on.

        The limits are the profile's own (also where it was stretched) or stronger ones: with
        weaker ones it could pass the end. Raises ValueError for these.
        """
        limits = []
        for name, given, own in (
            ("acceleration", acceleration, self.acceleration),
            ("jerk", jerk, self.jerk),
        ):
            value = own if given is None else given
            if not value >= own:
                raise ValueError(f"{name} {value:g} is weaker than the profile's own {own:g}")
            limits.append(value)
        state = self.at(t_s)
        phases = stopping_phases(state.ds, state.dds, *limits)
        stop = Profile(phases, limits[0], limits[1], state)
        end = stop._end_s if self._end_ds > 0.0 else min(stop._end_s, self._end_s)
        stop._end_s, stop._end_ds = end, 0.0
        stop.duration_s = stop._settled_s
        return stop


def _ramp(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Times of a change of speed from 0: of either jerk phase, of constant acceleration."""
    if math.isinf(jerk):
        return 0.0, speed / acceleration
    if speed * jerk >= acceleration * acceleration:
        return acceleration / jerk, speed / acceleration - acceleration / jerk
    return math.sqrt(speed / jerk), 0.0


def _peak_speed(length: float, acceleration: float, jerk: float) -> float:
    """The speed reached where `length` is too short to reach any limit of it."""
    if math.isinf(jerk):
        return math.sqrt(length * acceleration)
    if math.isfinite(acceleration) and length * jerk * jerk >= 2.0 * acceleration**3:
        knee = acceleration * acceleration / jerk
        return 0.5 * (math.sqrt(knee * knee + 4.0 * acceleration * length) - knee)
    return math.cbrt(0.25 * length * length * jerk) if _HAS_CBRT else _cbrt(length, jerk)


def _rise(
    speed: float, acceleration: float, jerk: float, jerk_s: float, constant_s: float
) -> tuple[Phase, ...]:
    """From rest to `speed`."""
    if speed <= 0.0 or jerk_s + constant_s <= 0.0:
        return ()
    if jerk_s == 0.0:
        return (Phase(constant_s, speed / constant_s, 0.0),)
    peak = speed / (jerk_s + constant_s)
    return (
        Phase(jerk_s, 0.0, peak / jerk_s),
        Phase(constant_s, peak, 0.0),
        Phase(jerk_s, peak, -peak / jerk_s),
    )
