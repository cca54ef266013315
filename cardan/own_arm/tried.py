"""Trial of an arm: inverse kinematics, reach, and postures free of collisions."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

from cardan.common.arm_libraries import np
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import FloatArray
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.kinematics.reach import tcp_range_m
from cardan.robots import ArmModel

POSES = 1_000
"""Number of reachable poses to solve the inverse kinematics for."""

LONGEST_S = 20.0
"""Longest duration of the trial, s; an idle computer takes a second or two."""

POSTURE_TRIES = 1_000
"""Number of random postures to search for some without collisions."""


class Tried(NamedTuple):
    """Numbers of reachable poses tried, and of those with an inverse."""

    wanted: int
    """Number of poses to try if the time suffices."""
    tried: int
    found: int
    outside: int
    """Solutions with a joint out of its range or the TCP elsewhere; 0 for a correct solver."""

    def words(self) -> str:
        """The result as one line."""
        share = 100.0 * self.found / self.tried if self.tried else 0.0
        words = f"found for {self.found} of {self.tried} reachable poses, {share:.1f} %"
        if self.outside:
            words += f", {self.outside} WRONG"
        if self.tried < self.wanted:
            words += f" ({self.wanted} took too long)"
        return words


class Reach(NamedTuple):
    """Reach of the TCP in the base frame, m."""

    ranges: tuple[tuple[float, float], ...]
    """Lowest and highest x, y, z."""

    def words(self) -> str:
        """The result as one line."""
        return ", ".join(
            f"{axis} {low:.2f} to {high:.2f} m"
            for axis, (low, high) in zip("xyz", self.ranges, strict=True)
        )


def _bounds(kinematics: ArmKinematics) -> tuple[FloatArray, FloatArray]:
    lower = np.where(np.isfinite(kinematics.lower), kinematics.lower, -math.pi)
    return lower, np.where(np.isfinite(kinematics.upper), kinematics.upper, math.pi)


def try_inverse(
    arm: ArmModel,
    say: Callable[[int], None] = lambda _done: None,
    poses: int = POSES,
    longest_s: float = LONGEST_S,
) -> Tried:
    """Solve the inverse kinematics of random postures' poses, each from the home posture. `say`
    receives the number of tries done, now and then."""
    kinematics = ArmKinematics(arm)
    lower, upper = _bounds(kinematics)
    home, end_s = np.array(arm.home), time.monotonic() + longest_s
    tried = found = outside = 0
    for q in np.random.default_rng(0).uniform(lower, upper, (poses, kinematics.joints)):
        if time.monotonic() > end_s:
            break
        goal = kinematics.forward(q)
        solution = kinematics.inverse(goal, home)
        tried += 1
        if solution is not None:
            found += 1
            there = kinematics.forward(solution)
            if not (kinematics.within_limits(solution, 1e-6) and there.isApprox(goal, 1e-4)):
                outside += 1
        if tried % 50 == 0:
            say(tried)
    return Tried(poses, tried, found, outside)


def reach_of(arm: ArmModel) -> Reach:
    """Sample the reach within the joint limits, ignoring collisions."""
    return Reach(tuple(tcp_range_m(ArmKinematics(arm))))


def postures(arm: ArmModel, number: int = 3) -> list[tuple[float, ...]]:
    """Pick random postures without collisions that differ most from home and from each other.
    Returns fewer if hardly any are free."""
    kinematics = ArmKinematics(arm)
    bodies = CollisionModel(kinematics)
    lower, upper = _bounds(kinematics)
    free: list[FloatArray] = []
    for q in np.random.default_rng(1).uniform(lower, upper, (POSTURE_TRIES, kinematics.joints)):
        if min(bodies.at(q), default=1.0) > 0.0:
            free.append(q)
        if len(free) == 50 * number:
            break
    chosen = [np.array(arm.home)]
    for _ in range(min(number, len(free))):
        chosen.append(
            max(free, key=lambda q: min(float(np.linalg.norm(q - each)) for each in chosen))
        )
    return [tuple(q.tolist()) for q in chosen[1:]]


def pairs_watched(arm: ArmModel) -> int:
    """Number of body pairs whose distance is checked in each cycle."""
    return len(CollisionModel(ArmKinematics(arm)).pairs)
