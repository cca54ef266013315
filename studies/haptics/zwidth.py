"""Z-width: the stiffest wall that a loop can render at each damping of the wall.

A wall counts as rendered if it holds a stylus pressed onto it by a weight of 0.8 N, and the stylus
comes to rest there or its speed halves within 3.5 s. Energy is no criterion: theory includes the
dissipation by the mechanism's damping, and the energy given to the stylus does not.
"""

from __future__ import annotations

from typing import NamedTuple

from cardan.common.arm_libraries import np
from cardan_omni.driver.limits import TickLimits
from studies.haptics import theory
from studies.haptics.loop import TICK_S
from studies.haptics.stability import (
    CONTROLLER_OFF,
    DROOP_N,
    OURS,
    PLAIN,
    UNHELD,
    Hand,
    judge,
    local,
)
from studies.side_by_side import side_by_side

VISCOUS_N_S_M = 0.1
"""Viscous damping of the simulated device."""
LATE_S = TICK_S
"""Age of a position on its way into the tick."""
WEIGHT_N = DROOP_N - UNHELD.push_n
"""Weight of the stylus and the mass hung on it."""
HOLDS_WITHIN_M = 0.001
SECONDS = 5.0
LOWEST_N_M, HIGHEST_N_M, FACTOR = 25.0, 20000.0, 1.3
FRICTIONLESS = UNHELD._replace(friction_n=0.0)
DAMPINGS_N_S_M = (0.0, 0.1, 0.5, 1.0, 2.0)


def rendered(limits: TickLimits, hand: Hand, stiffness_n_m: float, damping_n_s_m: float) -> bool:
    """Return True if the stylus comes to rest at that wall, or nearly so, and the wall holds it."""
    trace = local(limits, hand, stiffness_n_m, damping_n_s_m, SECONDS)
    verdict = judge(trace, limits)
    if not verdict.settled:
        early = (trace.times_s > 1.0) & (trace.times_s < 1.5)
        speed = np.linalg.norm(trace.velocity_m_s[early], axis=1)
        return verdict.restless_m_s < 0.5 * float(np.sqrt((speed**2).mean()))
    last = trace.times_s > trace.times_s[-1] - 0.5
    deepest_m = -float(trace.position_m[last, 2].min())
    return deepest_m <= (hand.friction_n + WEIGHT_N) / stiffness_n_m + HOLDS_WITHIN_M


def stiffest(limits: TickLimits, hand: Hand, damping_n_s_m: float) -> float:
    """Return the stiffest wall before the first that is not rendered, N/m, within 2 %; 0: none."""
    good, bad = 0.0, LOWEST_N_M
    while bad <= HIGHEST_N_M and rendered(limits, hand, bad, damping_n_s_m):
        good, bad = bad, bad * FACTOR
    if good == 0.0 or bad > HIGHEST_N_M:
        return good
    while bad > 1.02 * good:
        middle = (good * bad) ** 0.5
        if rendered(limits, hand, middle, damping_n_s_m):
            good = middle
        else:
            bad = middle
    return good


class Width(NamedTuple):
    """Stiffest walls at one damping, N/m."""

    damping_n_s_m: float
    passive_by_theory: float
    """Limit by Colgate and Schenkel: without friction and delay."""
    stable_by_theory: float
    """Limit by the rule of thumb, with the delay of sensing."""
    plain_frictionless: float
    off_frictionless: float
    """Our loop with its passivity controller off."""
    ours_frictionless: float
    plain: float
    """Plain loop with the device's friction, as for the next two."""
    off: float
    ours: float
    plain_given_j: float
    """Largest energy given at the stiffest plain wall, with friction, as for the next one."""
    off_given_j: float


def _given_j(limits: TickLimits, stiffness_n_m: float, damping_n_s_m: float) -> float:
    return judge(local(limits, UNHELD, stiffness_n_m, damping_n_s_m, SECONDS), limits).given_j


def _width(damping_n_s_m: float) -> Width:
    plain = stiffest(PLAIN, UNHELD, damping_n_s_m)
    off = stiffest(CONTROLLER_OFF, UNHELD, damping_n_s_m)
    return Width(
        damping_n_s_m,
        theory.passive_stiffness(VISCOUS_N_S_M, damping_n_s_m, TICK_S),
        theory.stable_stiffness_rule(VISCOUS_N_S_M, TICK_S, LATE_S, damping_n_s_m),
        stiffest(PLAIN, FRICTIONLESS, damping_n_s_m),
        stiffest(CONTROLLER_OFF, FRICTIONLESS, damping_n_s_m),
        stiffest(OURS, FRICTIONLESS, damping_n_s_m),
        plain,
        off,
        stiffest(OURS, UNHELD, damping_n_s_m),
        _given_j(PLAIN, plain, damping_n_s_m),
        _given_j(CONTROLLER_OFF, off, damping_n_s_m),
    )


def measure(dampings: tuple[float, ...] = DAMPINGS_N_S_M) -> list[Width]:
    """Measure the width for each damping."""
    return side_by_side(_width, [(damping,) for damping in dampings])


def table(found: list[Width]) -> str:
    """Return the Markdown table."""
    lines = [
        "| damping of the wall | passive by theory | stable by rule | plain, no friction "
        "| ours, controller off, no friction | ours, no friction | plain | ours, controller off "
        "| ours | energy from this plain wall | energy with controller off |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for one in found:
        cells = " | ".join(f"{value:.0f}" for value in one[1:-2])
        lines.append(
            f"| {one.damping_n_s_m:g} N·s/m | {cells} | {1e3 * one.plain_given_j:.1f} mJ "
            f"| {1e3 * one.off_given_j:.1f} mJ |"
        )
    return "\n".join(lines)
