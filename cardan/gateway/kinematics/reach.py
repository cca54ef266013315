"""Range of an arm's TCP along the axes of its base."""

from __future__ import annotations

import math

from cardan.common.arm_libraries import np
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import FloatArray

STARTS = 4
"""Ascents for each end of an axis: some end at a local maximum."""

ANGLES = 17
"""Positions of a joint that an ascent compares, the ends of its range among them."""

ROUNDS = 6
"""Rounds of an ascent through all joints; the search range halves with each."""


def tcp_range_m(kinematics: ArmKinematics) -> list[tuple[float, float]]:
    """Return lowest and highest x, y and z of the TCP within the joints' limits, to some mm. Joint
    by joint, from the same random postures each time; collisions are ignored."""
    lower = np.where(np.isfinite(kinematics.lower), kinematics.lower, -math.pi)
    upper = np.where(np.isfinite(kinematics.upper), kinematics.upper, math.pi)
    random = np.random.default_rng(0)
    starts = random.uniform(lower, upper, (STARTS, kinematics.joints))
    ends = np.empty((3, 2))
    for axis in range(3):
        for side, sign in enumerate((-1.0, 1.0)):
            ends[axis, side] = sign * max(
                _farthest(kinematics, lower, upper, q, axis, sign) for q in starts
            )
    return [(float(low), float(high)) for low, high in ends]


def _farthest(
    kinematics: ArmKinematics,
    lower: FloatArray,
    upper: FloatArray,
    start: FloatArray,
    axis: int,
    sign: float,
) -> float:
    """Return the highest coordinate, times `sign`, found by turning one joint after the other."""
    q = start.copy()
    span = upper - lower
    best = sign * float(kinematics.forward(q).translation[axis])
    for turn in range(ROUNDS):
        for joint in range(kinematics.joints):
            half = 0.5 * span[joint] / 2.0**turn
            low = max(lower[joint], q[joint] - half)
            high = min(upper[joint], q[joint] + half)
            if turn == 0:
                low, high = lower[joint], upper[joint]
            held_rad = q[joint]
            for each in np.linspace(low, high, ANGLES):
                q[joint] = each
                found = sign * float(kinematics.forward(q).translation[axis])
                if found > best:
                    best, held_rad = found, each
            q[joint] = held_rad
    return best
