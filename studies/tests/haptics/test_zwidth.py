"""The stiffest wall rendered by the tick itself, under an unheld stylus."""

from __future__ import annotations

import dataclasses
import functools

import pytest

from studies.haptics import theory, zwidth
from studies.haptics.loop import TICK_S
from studies.haptics.stability import CONTROLLER_OFF, OURS, PLAIN, UNHELD, judge, local

pytestmark = pytest.mark.matrix


QUICK_AND_OFF = dataclasses.replace(CONTROLLER_OFF, slew_rise_n_s=PLAIN.slew_rise_n_s)


@functools.cache
def stiffest(limits, frictionless, damping_n_s_m):
    hand = zwidth.FRICTIONLESS if frictionless else UNHELD
    return zwidth.stiffest(limits, hand, damping_n_s_m)


def test_without_friction_the_plain_wall_ends_where_theory_says():
    late = theory.stable_stiffness_rule(zwidth.VISCOUS_N_S_M, TICK_S, zwidth.LATE_S)
    passive = theory.passive_stiffness(zwidth.VISCOUS_N_S_M, 0.0, TICK_S)
    assert late < passive
    assert stiffest(PLAIN, True, 0.0) == pytest.approx(late, rel=0.3)


def test_without_friction_ours_is_stiffer():
    assert stiffest(OURS, True, 0.0) > 3.0 * stiffest(PLAIN, True, 0.0)


def test_without_friction_the_controller_alone_renders_walls_twice_as_stiff():
    assert stiffest(OURS, True, 0.0) > 1.7 * stiffest(CONTROLLER_OFF, True, 0.0)
    assert stiffest(CONTROLLER_OFF, True, 0.0) > 3.0 * stiffest(PLAIN, True, 0.0)


def test_with_friction_the_controller_alone_changes_little():
    assert stiffest(OURS, False, 0.0) == pytest.approx(
        stiffest(CONTROLLER_OFF, False, 0.0), rel=0.4
    )


def test_with_friction_ours_is_softer_than_plain_for_its_slow_rise():
    off = stiffest(CONTROLLER_OFF, False, 0.0)
    assert stiffest(PLAIN, False, 0.0) > 3.0 * off
    assert stiffest(QUICK_AND_OFF, False, 0.0) > 4.0 * off


def test_what_the_controller_bounds_is_the_energy():
    wall = stiffest(CONTROLLER_OFF, False, 0.0)
    off, ours = (
        judge(local(limits, UNHELD, wall, 0.0, zwidth.SECONDS), limits)
        for limits in (CONTROLLER_OFF, OURS)
    )
    assert off.given_j > 10.0 * OURS.energy_budget_j
    assert ours.passive


def test_with_the_friction_of_the_device_ours_renders_what_the_device_is_said_to():
    assert stiffest(OURS, False, 0.0) >= 500.0  # HD_NOMINAL_MAX_STIFFNESS of an Omni
