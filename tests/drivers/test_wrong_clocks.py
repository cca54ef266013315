"""Wrong clocks of controllers make no arm faster: every driver with every fault, in virtual
time."""

import functools
import math

import pytest

from tests.fault_benches import (
    BENCHES,
    CLOCKS,
    EgmBench,
    JointStreamBench,
    MotorosBench,
    MotorosStreamBench,
    Ros2Bench,
    UrBench,
)
from tests.fault_scenarios import SPEED_M_S
from tests.fault_table import FAULTS, measured

FASTEST = 1.05
"""Highest share of the commanded speed."""
SAID_S = 0.6
"""Longest time until the arm rests. A slow clock is certain only after 1 to 1.5 s, and the driver
brakes then."""

NO_FAULT = "1.02 times as fast"
SLOW = "0.5 times as fast"


JUMP = "jumps ahead by 0.14 s"
SLOW_NOW = (EgmBench, JointStreamBench, Ros2Bench, UrBench)
"""Benches whose drivers check for a slow clock."""
JUMP_NOW = (*SLOW_NOW, MotorosStreamBench)
"""Benches whose drivers check for a jump."""


def clocks_now(kind):
    """Return the clocks that `make test` tries with a bench."""
    clocks = ((JUMP, JUMP_NOW), (SLOW, SLOW_NOW))
    return tuple(clock for clock, kinds in clocks if kind in kinds)


CASES = [
    pytest.param(
        kind,
        clock,
        marks=() if clock in clocks_now(kind) else pytest.mark.matrix,
        id=f"{kind.name}-{clock}",
    )
    for kind in BENCHES
    for clock in sorted(CLOCKS, key=lambda clock: clock not in clocks_now(kind))
]


@functools.cache
def moved(kind, clocks):
    """Measure the motion of an arm after each of these faults of its controller's clock."""
    motions = measured("twist", [FAULTS[f"clock {name}"] for name in clocks], kind)
    return dict(zip(clocks, motions, strict=True))


@pytest.mark.parametrize(("kind", "clock"), CASES)
def test_no_clock_makes_an_arm_faster(kind, clock):
    now = clocks_now(kind)
    later = tuple(each for each in CLOCKS if each not in now)
    motion = moved(kind, now if clock in now else later)[clock]
    assert motion.peak_m_s <= FASTEST * SPEED_M_S
    if issubclass(kind, MotorosBench) or clock == NO_FAULT:
        assert math.isinf(motion.stop_s), "MotoROS' clock is not used, and 2 % are no fault"
    else:
        assert motion.stop_s <= (1.7 if clock == SLOW else SAID_S)
