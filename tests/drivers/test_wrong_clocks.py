"""Wrong clocks of controllers make no arm faster: those of the fault table that every change tries,
in virtual time."""

import pytest

from tests.fault_benches import EgmBench, JointStreamBench, MotorosStreamBench, Ros2Bench, UrBench
from tests.fault_table import FAULTS, HIGHEST_M_S, measured

SLOW = "clock 0.5 times as fast"
JUMP = "clock jumps ahead by 0.14 s"
CHECKED = (EgmBench, JointStreamBench, Ros2Bench, UrBench)
"""Benches whose drivers compare clocks. A slow clock is certain only after 1 to 1.5 s."""


@pytest.mark.parametrize("kind", CHECKED, ids=lambda kind: kind.name)
def test_no_clock_makes_an_arm_faster(kind):
    jump, slow = measured("twist", [FAULTS[JUMP], FAULTS[SLOW]], kind)
    assert max(jump.peak_m_s, slow.peak_m_s) <= HIGHEST_M_S
    assert jump.stop_s <= 0.6
    assert slow.stop_s <= 1.7


def test_a_clock_that_is_not_used_stops_no_arm():
    (jump,) = measured("twist", [FAULTS[JUMP]], MotorosStreamBench)
    assert jump.peak_m_s <= HIGHEST_M_S
    assert jump.stop_s == float("inf")
