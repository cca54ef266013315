"""Paths from rest to rest: a line of the TCP, or a motion of all joints, on one path variable."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cardan.gateway.kinematics.base import FloatArray
from cardan.spatial import (
    add,
    from_rotation_vector,
    multiply,
    norm,
    normalized,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import ZERO3, Frame, Pose, Twist


class TimeLaw:
    """How a share goes from 0 to 1: a trapezoid of speed, its corners rounded where jerk counts.

    Rounding averages the trapezoid over the time that the acceleration takes to build up. That
    keeps speed and acceleration, bounds the jerk by acceleration / that time, ends exactly, and
    costs that time once.
    """

    def __init__(
        self,
        speed: float,
        acceleration: float,
        jerk: float = math.inf,
        duration_s: float = 0.0,
    ) -> None:
        """Limits per s, s² and s³ (infinite: none). A longer `duration_s` stretches the whole in
        time; a shorter one is not kept."""
        if math.isinf(acceleration):
            self._peak, self._ramp_s, flat_s = speed, 0.0, 1.0 / speed
        elif speed * speed <= acceleration:
            self._peak, self._ramp_s = speed, speed / acceleration
            flat_s = 1.0 / speed + speed / acceleration
        else:
            self._peak = math.sqrt(acceleration)
            self._ramp_s = 1.0 / self._peak
            flat_s = 2.0 / self._peak
        self._acceleration = acceleration
        self._flat_s = flat_s
        self._round_s = 0.0 if math.isinf(jerk) or self._ramp_s == 0.0 else acceleration / jerk
        shortest_s = flat_s + self._round_s
        self.duration_s = max(shortest_s, duration_s)
        self._pace = shortest_s / self.duration_s

    def at(self, t_s: float) -> tuple[float, float]:
        """Share (0..1) and its rate, 1/s, at `t_s` from the start."""
        t = self._pace * t_s
        if t <= 0.0:
            return 0.0, 0.0
        if t_s >= self.duration_s:
            return 1.0, 0.0
        if self._round_s == 0.0:
            share, rate = self._trapezoid(t)
        else:
            before = t - self._round_s
            share = (self._area(t) - self._area(before)) / self._round_s
            rate = (self._trapezoid(t)[0] - self._trapezoid(before)[0]) / self._round_s
        return min(1.0, share), self._pace * rate

    def _trapezoid(self, t: float) -> tuple[float, float]:
        """Share and rate of the trapezoid."""
        if t <= 0.0:
            return 0.0, 0.0
        left = self._flat_s - t
        if left <= 0.0:
            return 1.0, 0.0
        ramp = self._ramp_s
        if t < ramp:
            return 0.5 * self._acceleration * t * t, self._acceleration * t
        if left < ramp:
            return 1.0 - 0.5 * self._acceleration * left * left, self._acceleration * left
        return self._peak * (t - 0.5 * ramp), self._peak

    def _area(self, t: float) -> float:
        """Integral of the trapezoid's share from 0 to `t`."""
        if t <= 0.0:
            return 0.0
        left = self._flat_s - t
        # The share is odd about the middle, so the whole integral is half of the time.
        whole = 0.5 * self._flat_s
        if left <= 0.0:
            return whole - left
        ramp = self._ramp_s
        if t < ramp:
            return self._acceleration * t**3 / 6.0
        if left < ramp:
            return whole - left + self._acceleration * left**3 / 6.0
        cruised = t - ramp
        return (
            self._acceleration * ramp**3 / 6.0
            + 0.5 * self._peak * ramp * cruised
            + 0.5 * self._peak * cruised * cruised
        )


class LineLimits(NamedTuple):
    """Of the translation (m) and the rotation (rad) of a line; infinite: none."""

    speed_m_s: float
    acceleration_m_s2: float
    speed_rad_s: float
    acceleration_rad_s2: float
    jerk_m_s3: float = math.inf
    jerk_rad_s3: float = math.inf


class LinePath:
    """A straight line, turning about one fixed axis the short way, both on one path variable.

    The stricter of the limits of translation and rotation counts. At exactly half a turn the axis
    is the one that `cardan.spatial.rotation_between` gives.
    """

    def __init__(
        self, start: Pose, goal: Pose, limits: LineLimits, duration_s: float = 0.0
    ) -> None:
        """A longer `duration_s` than needed is kept, a shorter one is not.

        Raises ValueError for a goal that is the start.
        """
        self._start = start
        self._goal = Pose(goal.position, normalized(goal.orientation), Frame.BASE)
        self._way = subtract(goal.position, start.position)
        self._turn = rotation_between(start.orientation, goal.orientation)
        self.length_m, self.angle_rad = norm(self._way), norm(self._turn)
        if self.length_m == 0.0 and self.angle_rad == 0.0:
            raise ValueError("a line needs two different poses")

        def strictest(linear: float, angular: float) -> float:
            return min(
                linear / self.length_m if self.length_m > 0.0 else math.inf,
                angular / self.angle_rad if self.angle_rad > 0.0 else math.inf,
            )

        self._law = TimeLaw(
            strictest(limits.speed_m_s, limits.speed_rad_s),
            strictest(limits.acceleration_m_s2, limits.acceleration_rad_s2),
            strictest(limits.jerk_m_s3, limits.jerk_rad_s3),
            duration_s,
        )
        self.duration_s = self._law.duration_s

    def at(self, t: float) -> tuple[Pose, Twist]:
        """Pose and twist (base axes) at time `t` from the start, s."""
        share, rate = self._law.at(t)
        if share >= 1.0:
            return self._goal, Twist(ZERO3, ZERO3, Frame.BASE)
        turned = multiply(from_rotation_vector(scale(self._turn, share)), self._start.orientation)
        pose = Pose(
            add(self._start.position, scale(self._way, share)), normalized(turned), Frame.BASE
        )
        return pose, Twist(scale(self._way, rate), scale(self._turn, rate), Frame.BASE)


class JointPath:
    """All joints from `start` to `goal`, arriving together."""

    def __init__(
        self,
        start: FloatArray,
        goal: FloatArray,
        speeds: FloatArray,
        accelerations: FloatArray,
    ) -> None:
        """Limits of each joint, rad/s and rad/s²; infinite accelerations: T = max |Δq| / speed.

        Raises ValueError for a goal that is the start.
        """
        self._start, self._goal = np.array(start), np.array(goal)
        self._way = self._goal - self._start
        moving = self._way != 0.0
        if not moving.any():
            raise ValueError("a joint motion needs two different configurations")
        size = np.abs(self._way[moving])
        self._law = TimeLaw(
            float((speeds[moving] / size).min()), float((accelerations[moving] / size).min())
        )
        self.duration_s = self._law.duration_s

    def at(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Joint positions and velocities at time `t` from the start, s."""
        share, rate = self._law.at(t)
        if share >= 1.0:
            return self._goal, np.zeros(len(self._goal))
        return self._start + share * self._way, rate * self._way
