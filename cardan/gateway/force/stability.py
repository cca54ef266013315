"""Whether a force loop can be stable, by the rule of Gil, Hulin and others: K < (b + B)/(T/2 + t).

K is the stiffness that the hand feels, b the damping of hand and device, B that which the device
renders, T the period at which the force is computed, t the delay from the hand's motion to the
force of it. A rule of thumb for a linear loop: it says what will not do, and proves nothing.
"""

from __future__ import annotations

import math

HAND_DAMPING_N_S_M = 5.0
"""A hand that holds the stylus loosely, and the stylus itself: 2 to 8 in the literature. One that
nobody holds has 0.1, and no stiffness is safe that needs a hand."""

FIXTURE_STIFFNESS_N_M = 500.0
"""What a held Omni renders cleanly in its own loop; its mechanism and encoders allow no more."""


def stable_stiffness_n_m(damping_n_s_m: float, period_s: float, delay_s: float) -> float:
    """The largest felt stiffness, N/m, by the rule."""
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
    """What is wrong with a loop over a measured force, with its numbers; empty: nothing.

    The delay of the low-pass filter, 1/(2π·cutoff), and one period more come on top of `delay_s`.
    """
    felt = motion_scale * force_scale * environment_stiffness_n_m
    delay_s += period_s + 0.5 / (math.pi * cutoff_hz)
    damping = HAND_DAMPING_N_S_M + device_damping_n_s_m
    most = stable_stiffness_n_m(damping, period_s, delay_s)
    if felt <= most:
        return ""
    return (
        f"the force loop may become unstable: the hand will feel {felt:.3g} N/m (motion scale "
        f"{motion_scale:g} x force.scale {force_scale:g} x environment "
        f"{environment_stiffness_n_m:g} N/m), and with {damping:g} N·s/m, a period of "
        f"{period_s * 1e3:.3g} ms and {delay_s * 1e3:.3g} ms of delay {most:.3g} N/m are stable: "
        f"set force.scale to {force_scale * most / felt:.2g} or less"
    )


def fixture_warning(index: int, motion_scale: float, stiffness_n_m: float) -> str:
    """What is wrong with a fixture's stiffness; empty: nothing."""
    felt = motion_scale * stiffness_n_m
    if felt <= FIXTURE_STIFFNESS_N_M:
        return ""
    return (
        f"fixtures.{index} feels like {felt:.3g} N/m (motion scale {motion_scale:g} x "
        f"{stiffness_n_m:g} N/m): a held Omni renders at most {FIXTURE_STIFFNESS_N_M:g} N/m cleanly"
    )
