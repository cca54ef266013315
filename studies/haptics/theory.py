"""Linear theory of a sampled, delayed wall: reference lines for the measurements.

Sources: Colgate and Schenkel 1997 (a passive sampled wall); Gil, Sánchez, Hulin, Preusche and
Hirzinger 2009 (a stable delayed one); Diolaiti, Niemeyer, Barbagli and Salisbury 2006 (friction).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cardan.common.arm_libraries import np, npt

Array = npt.NDArray[np.float64]


class Held(NamedTuple):
    """A stylus and the hand holding it, one axis, linear: m·a = −b·v − k·x + wall."""

    mass_kg: float
    damping_n_s_m: float
    stiffness_n_m: float = 0.0


def passive_stiffness(damping_n_s_m: float, wall_damping_n_s_m: float, period_s: float) -> float:
    """Stiffest sampled wall that is passive for any hand, N/m: b > K·T/2 + |B|."""
    return max(0.0, 2.0 * (damping_n_s_m - abs(wall_damping_n_s_m)) / period_s)


def stable_stiffness_rule(
    damping_n_s_m: float, period_s: float, delay_s: float, wall_damping_n_s_m: float = 0.0
) -> float:
    """Stiffest delayed wall that is stable, N/m, by rule of thumb: K < (b + B)/(T/2 + t_d)."""
    return (damping_n_s_m + wall_damping_n_s_m) / (0.5 * period_s + delay_s)


def passive_by_friction(friction_n: float, quantum_m: float) -> float:
    """Stiffest wall whose quantization is compensated by Coulomb friction, N/m: f_c > K·Δ/2."""
    return 2.0 * friction_n / quantum_m


def _exponential(matrix: Array) -> Array:
    """Matrix exponential of a small matrix, by scaling and squaring."""
    halvings = max(0, math.ceil(math.log2(max(1e-12, float(np.abs(matrix).sum())))) + 4)
    scaled = matrix / 2.0**halvings
    total, term = np.eye(len(matrix)), np.eye(len(matrix))
    for order in range(1, 12):
        term = term @ scaled / order
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


def spectral_radius(held: Held, stiffness_n_m: float, period_s: float, samples: int) -> float:
    """Spectral radius of the loop closed once per `period_s` by −K·x, `samples` periods old, with a
    zero-order hold."""
    m, b, k = held
    continuous = np.zeros((3, 3))
    continuous[0, 1] = 1.0
    continuous[1] = (-k / m, -b / m, 1.0 / m)
    discrete = _exponential(continuous * period_s)
    size = 2 + samples
    loop = np.zeros((size, size))
    loop[:2, :2] = discrete[:2, :2]
    oldest = size - 1 if samples else 0
    loop[:2, oldest] += -stiffness_n_m * discrete[:2, 2]
    if samples:
        loop[2, 0] = 1.0
        for index in range(3, size):
            loop[index, index - 1] = 1.0
    return float(np.abs(np.linalg.eigvals(loop)).max())


def stable_stiffness(
    held: Held, period_s: float, samples: int, highest_n_m: float = 1e5, parts: int = 160
) -> float:
    """Smallest stiffness at which the loop of `spectral_radius` is unstable, N/m."""
    low = 1e-2
    for high in np.geomspace(low, highest_n_m, parts)[1:]:
        if spectral_radius(held, float(high), period_s, samples) >= 1.0:
            for _ in range(30):
                middle = math.sqrt(low * high)
                if spectral_radius(held, middle, period_s, samples) >= 1.0:
                    high = middle
                else:
                    low = middle
            return low
        low = float(high)
    return highest_n_m
