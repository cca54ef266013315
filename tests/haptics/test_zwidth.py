"""The stiffest wall of the tick itself, under a stylus that nobody holds."""

from __future__ import annotations

import functools

import pytest

from bench.haptics import theory, zwidth
from bench.haptics.loop import TICK_S
from bench.haptics.stability import OURS, PLAIN, UNHELD

pytestmark = pytest.mark.once


@functools.cache
def stiffest(ours, frictionless, damping_n_s_m):
    hand = zwidth.FRICTIONLESS if frictionless else UNHELD
    return zwidth.stiffest(OURS if ours else PLAIN, hand, damping_n_s_m)


def test_without_friction_the_plain_wall_ends_where_theory_says():
    late = theory.stable_stiffness_rule(zwidth.VISCOUS_N_S_M, TICK_S, zwidth.LATE_S)
    passive = theory.passive_stiffness(zwidth.VISCOUS_N_S_M, 0.0, TICK_S)
    assert late < passive
    assert stiffest(False, True, 0.0) == pytest.approx(late, rel=0.3)


def test_without_friction_ours_is_stiffer():
    assert stiffest(True, True, 0.0) > 3.0 * stiffest(False, True, 0.0)


def test_with_the_friction_of_the_device_ours_renders_what_the_device_is_said_to():
    assert stiffest(True, False, 0.0) >= 500.0  # HD_NOMINAL_MAX_STIFFNESS of an Omni
