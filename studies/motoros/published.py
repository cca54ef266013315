"""Delays measured by Baklouti et al. 2021 (Applied Sciences 11(16), 7190, tables 1 and 2), s."""

from __future__ import annotations

from typing import NamedTuple

WORDS = {
    "standard": "two-point trajectories",
    "stream": "endless trajectory",
    "velocity": "velocity mode",
}
"""Names of the motions that each mode sends."""


class Delays(NamedTuple):
    """Delays of one phase, s."""

    device_to_goal: float
    goal_to_measured: float
    total: float


STANDARD = (
    Delays(0.207, 0.549, 0.756),
    Delays(0.235, 0.545, 0.780),
    Delays(0.210, 0.571, 0.781),
    Delays(0.230, 0.520, 0.750),
    Delays(0.270, 0.592, 0.862),
    Delays(0.240, 0.512, 0.752),
)
"""Table 1: the standard driver."""

VELOCITY = (
    Delays(0.106, 0.305, 0.411),
    Delays(0.118, 0.289, 0.407),
    Delays(0.180, 0.343, 0.523),
    Delays(0.130, 0.290, 0.420),
    Delays(0.131, 0.320, 0.451),
    Delays(0.150, 0.310, 0.460),
)
"""Table 2: their velocity mode."""

STANDARD_MEAN = Delays(0.232, 0.548, 0.780)
VELOCITY_MEAN = Delays(0.136, 0.309, 0.445)
"""Means as printed in the paper."""


def mean(phases: tuple[Delays, ...]) -> Delays:
    """Return the means, stage by stage."""
    return Delays(*(sum(column) / len(phases) for column in zip(*phases, strict=True)))
