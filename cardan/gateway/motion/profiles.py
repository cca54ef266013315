"""Motion along a length in time, with speed and its rates of change bounded.

A profile is a chain of phases of constant jerk. The length may have any unit (m, rad, the share of
a path); speed, acceleration and jerk have the same unit per s, s² and s³.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class ProfileState(NamedTuple):
    """State of a profile at one time."""

    s: float
    """Distance along the path."""
    ds: float
    """Speed, per s; never negative."""
    dds: float
    """Acceleration, per s²."""


class JerkSegment(NamedTuple):
    """A stretch of constant jerk."""

    duration_s: float
    acceleration: float
    """Acceleration at its start."""
    jerk: float


def _ramp(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Return the times of a change of speed from 0: of each jerk phase, and of constant
    acceleration."""
    if math.isinf(jerk):
        return 0.0, speed / acceleration
    if speed * jerk >= acceleration * acceleration:
        return acceleration / jerk, speed / acceleration - acceleration / jerk
    return math.sqrt(speed / jerk), 0.0


def _peak_speed(length: float, acceleration: float, jerk: float) -> float:
    """Return the peak speed over a `length` too short to reach it."""
    if math.isinf(jerk):
        return math.sqrt(length * acceleration)
    if math.isfinite(acceleration) and length * jerk * jerk >= 2.0 * acceleration**3:
        knee = acceleration * acceleration / jerk
        return 0.5 * (math.sqrt(knee * knee + 4.0 * acceleration * length) - knee)
    return float((0.25 * length * length * jerk) ** (1.0 / 3.0))


def _rise(speed: float, jerk_s: float, constant_s: float) -> tuple[JerkSegment, ...]:
    """Return the phases from rest to `speed`."""
    if speed <= 0.0 or jerk_s + constant_s <= 0.0:
        return ()
    if jerk_s == 0.0:
        return (JerkSegment(constant_s, speed / constant_s, 0.0),)
    peak = speed / (jerk_s + constant_s)
    return (
        JerkSegment(jerk_s, 0.0, peak / jerk_s),
        JerkSegment(constant_s, peak, 0.0),
        JerkSegment(jerk_s, peak, -peak / jerk_s),
    )


def _rest_to_rest(
    length: float, speed: float, acceleration: float, jerk: float, duration_s: float | None
) -> tuple[JerkSegment, ...]:
    """Return the phases of the quickest symmetric motion over `length`, stretched to
    `duration_s`."""
    if not 0.0 <= length < math.inf:
        raise ValueError(f"length {length:g} is not a finite number from 0")
    for name, value in (("speed", speed), ("acceleration", acceleration), ("jerk", jerk)):
        if not value > 0.0:
            raise ValueError(f"{name} {value:g} is not above 0")
    if math.isinf(speed):
        raise ValueError("speed is infinite")
    if length == 0.0:
        if duration_s is not None and not 0.0 <= duration_s < math.inf:
            raise ValueError(f"duration {duration_s:g} s is not a finite time")
        # Standing still lasts as long as it is asked to.
        return () if duration_s is None else (JerkSegment(duration_s, 0.0, 0.0),)
    jerk_s, constant_s = _ramp(speed, acceleration, jerk)
    ramp_s = 2.0 * jerk_s + constant_s
    if speed * ramp_s > length:
        speed = _peak_speed(length, acceleration, jerk)
        jerk_s, constant_s = _ramp(speed, acceleration, jerk)
        ramp_s = 2.0 * jerk_s + constant_s
        cruise_s = 0.0
    else:
        cruise_s = length / speed - ramp_s
    quickest_s = 2.0 * ramp_s + cruise_s
    rate = 1.0
    if duration_s is not None:
        if not quickest_s * (1.0 - 1e-12) <= duration_s < math.inf:
            raise ValueError(
                f"duration {duration_s:g} s is not possible: the limits need {quickest_s:g} s"
            )
        rate = min(1.0, quickest_s / duration_s)
    rise = _rise(speed, jerk_s, constant_s)
    fall = tuple(
        JerkSegment(
            phase.duration_s, -phase.acceleration - phase.jerk * phase.duration_s, phase.jerk
        )
        for phase in reversed(rise)
    )
    return tuple(
        JerkSegment(phase.duration_s / rate, phase.acceleration * rate**2, phase.jerk * rate**3)
        for phase in (*rise, JerkSegment(cruise_s, 0.0, 0.0), *fall)
    )


class Profile:
    """Motion from rest to rest over `length` with speed, acceleration and jerk bounded: up to 7
    phases. It is the quickest such motion; if `length` is too short, it has no cruising and no
    constant acceleration. A `duration_s` above its time stretches it in time; a shorter one raises
    ValueError naming both. An infinite jerk makes a trapezoid, an infinite acceleration is no
    bound.
    """

    def __init__(
        self,
        length: float,
        speed: float,
        acceleration: float,
        jerk: float,
        duration_s: float | None = None,
    ) -> None:
        phases = _rest_to_rest(length, speed, acceleration, jerk, duration_s)
        self.length = length
        # (end time, start time, way, speed, acceleration, jerk) of each phase.
        self._phases: list[tuple[float, float, float, float, float, float]] = []
        time = s = ds = 0.0
        if math.isinf(jerk) and math.isinf(acceleration) and length > 0.0:
            ds = length / sum(phase.duration_s for phase in phases)
        for phase_s, dds, ddds in phases:
            self._phases.append((time + phase_s, time, s, ds, dds, ddds))
            s += phase_s * (ds + phase_s * (0.5 * dds + phase_s * ddds / 6.0))
            ds = max(0.0, ds + phase_s * (dds + phase_s * 0.5 * ddds))
            time += phase_s
        self.duration_s = time
        """Time until rest, s."""

    def at(self, t_s: float) -> ProfileState:
        """Return the state at `t_s` since the start; before it the start at rest, after it the
        end."""
        if t_s < 0.0:
            return ProfileState(0.0, 0.0, 0.0)
        for until, since, s, ds, dds, ddds in self._phases:
            if t_s < until:
                t = t_s - since
                way = s + t * (ds + t * (0.5 * dds + t * ddds / 6.0))
                speed = ds + t * (dds + t * 0.5 * ddds)
                if way > self.length:
                    way = self.length
                return ProfileState(way, speed if speed > 0.0 else 0.0, dds + t * ddds)
        return ProfileState(self.length, 0.0, 0.0)
