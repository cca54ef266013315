"""Whether a force loop can be stable, by the rule of Gil, Hulin and others: K < (b + B)/(T/2 + t).

K is the stiffness rendered to the hand, b the damping of hand and device, B the damping that the
device renders, T the period at which the force is computed, t the delay from the hand's motion to
its force. A rule of thumb for a linear loop: it finds unstable settings, but does not prove
stability.
"""

from __future__ import annotations

import math

HAND_DAMPING_N_S_M = 5.0
"""Damping of a hand that holds the stylus loosely, with the stylus: 2 to 8 in the literature. A
stylus that is not held has 0.1, too little for any stiffness."""

FIXTURE_STIFFNESS_N_M = 500.0
"""Largest stiffness that a held Omni's mechanism and encoders render cleanly in its own loop."""


def stable_stiffness_n_m(damping_n_s_m: float, period_s: float, delay_s: float) -> float:
    """The largest rendered stiffness, N/m, by the rule."""
    return damping_n_s_m / (0.5 * period_s + delay_s)


def loop_warning(
    *,
    motion_scale: float,
    force_scale: float,
    environment_stiffness_n_m: float,
    device_damping_n_s_m: float,
    period_s: float,
    delay_s: float,
    cutoff_hz: float,
) -> str:
    """Return the warning about a loop over a measured force, with its numbers; empty: none. The
    delay of the low-pass filter, 1/(2π·cutoff), and one period are added to `delay_s`."""
    rendered = motion_scale * force_scale * environment_stiffness_n_m
    delay_s += period_s + 0.5 / (math.pi * cutoff_hz)
    damping = HAND_DAMPING_N_S_M + device_damping_n_s_m
    most = stable_stiffness_n_m(damping, period_s, delay_s)
    if rendered <= most:
        return ""
    return (
        f"the force loop may become unstable: the rendered stiffness is {rendered:.3g} N/m "
        f"(motion scale {motion_scale:g} x force.scale {force_scale:g} x environment "
        f"{environment_stiffness_n_m:g} N/m), and with {damping:g} N·s/m, a period of "
        f"{period_s * 1e3:.3g} ms and {delay_s * 1e3:.3g} ms of delay {most:.3g} N/m are stable: "
        f"set force.scale to {force_scale * most / rendered:.2g} or less"
    )


def fixture_warning(index: int, motion_scale: float, stiffness_n_m: float) -> str:
    """Return the warning about a fixture's stiffness; empty: none."""
    rendered = motion_scale * stiffness_n_m
    if rendered <= FIXTURE_STIFFNESS_N_M:
        return ""
    return (
        f"fixtures.{index} has a rendered stiffness of {rendered:.3g} N/m (motion scale "
        f"{motion_scale:g} x {stiffness_n_m:g} N/m): a held Omni renders at most "
        f"{FIXTURE_STIFFNESS_N_M:g} N/m cleanly"
    )
