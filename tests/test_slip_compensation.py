"""Time lost between two commands raises neither speed nor acceleration of a robot above the
request.

The core here is the simplest one that advances by a nominal period in each tick: a constant speed,
reached by a ramp. Drivers are the real ones, controllers are simulated, in virtual time.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st

from cardan.types import (
    CommandKind,
    Frame,
    HoldCommand,
    JointCommand,
    Pose,
    PoseCommand,
    Twist,
    Vector3,
)
from tests.fault_benches import (
    BENCHES,
    MARGIN,
    EgmBench,
    EgmJointBench,
    JointStreamBench,
    MotorosBench,
    MotorosStreamBench,
    Ros2Bench,
    UrBench,
)

pytestmark = pytest.mark.matrix

SPEED_M_S = 0.1
ACCELERATION_M_S2 = 1.0
HARDEST_M_S2 = 1.3
"""The requested ramp, plus overshoot of the servos and of two ramps in one window."""

SHORTEST_S = 0.005
LONGEST_S = {
    EgmBench: 0.09,
    EgmJointBench: 0.09,
    JointStreamBench: 0.09,
    MotorosBench: 0.09,
    MotorosStreamBench: 0.008,
    Ros2Bench: 0.011,
    UrBench: 0.09,
}
"""Longest gap in which no controller or driver stops on its own.

After 0.1 s they brake by themselves, as hard as they may. A stream of points stops dead once its
three stored increments of 4 ms are used up. A forward_command_controller stops dead at its last
position: its driver bridges 15 ms, including a period of 4 ms; tests/drivers/test_ros2_arm.py
covers longer gaps.
"""


class Steady:
    """Constant speed along the bench's direction, or about its first axis, advanced by one nominal
    period per tick."""

    def __init__(self, bench):
        self.bench = bench
        self.period_s = bench.capabilities.period_s
        self.by_pose = CommandKind.POSE in bench.capabilities.commands
        self.wanted_m_s = self.speed_m_s = 0.0
        self.place = self.session = None

    def tick(self, state):
        if not state.ready or state.session != self.session:
            self.session, self.place, self.speed_m_s = state.session, None, 0.0
            return HoldCommand()
        if self.place is None:
            self.place = state.pose.position if self.by_pose else state.joints
            self.turn = state.pose.orientation if self.by_pose else None
            radius = self.bench.kinematics.forward(np.array(state.joints)).translation
            self.radius_m = math.hypot(radius[0], radius[1])
        step = ACCELERATION_M_S2 * self.period_s
        before = self.speed_m_s
        self.speed_m_s += min(max(self.wanted_m_s - before, -step), step)
        way = 0.5 * (before + self.speed_m_s) * self.period_s
        if self.by_pose:
            along = self.bench.direction
            self.place = Vector3(*(a + way * b for a, b in zip(self.place, along, strict=True)))
            linear = Vector3(*(self.speed_m_s * part for part in along))
            twist = Twist(linear, Vector3(0.0, 0.0, 0.0), Frame.BASE)
            return PoseCommand(Pose(self.place, self.turn), twist)
        first, *others = self.place
        self.place = (first + way / self.radius_m, *others)
        return JointCommand(self.place, (self.speed_m_s / self.radius_m, 0.0, 0.0, 0.0, 0.0, 0.0))


def moving(bench):
    core = Steady(bench)
    bench.answer = core.tick
    bench.ready().run(0.05)
    core.wanted_m_s = SPEED_M_S
    bench.run(0.3)
    return core


def stall_in_tick(bench, core, seconds):
    """Stop the process between receiving a state and answering it."""

    def answer(state):
        bench.answer = core.tick
        command = core.tick(state)
        bench.stall(seconds)
        return command

    bench.answer = answer


SHARES = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 0.3), st.booleans()), min_size=1, max_size=6
)
"""Share of the longest gap, time until the next one, and whether the gap is inside a tick."""

PATTERNS = settings(max_examples=20, suppress_health_check=list(HealthCheck), derandomize=True)
ROBOTS = pytest.mark.parametrize("kind", BENCHES, ids=lambda kind: kind.name)


def through_gaps(bench, core, pattern, longest_s):
    """Return the motion of the arm while time was lost repeatedly."""
    since_s = bench.now_s
    for share, rest_s, in_tick in pattern:
        gap_s = SHORTEST_S + share * (longest_s - SHORTEST_S)
        if in_tick and not isinstance(bench, MotorosBench):
            stall_in_tick(bench, core, gap_s)
        else:
            bench.stall(gap_s)
        bench.run(0.05 + rest_s)
    bench.run(0.2)
    return bench.motion(since_s)


@ROBOTS
@PATTERNS
@given(pattern=SHARES)
@example(pattern=[(0.5, 0.3, False)] * 4)
@example(pattern=[(0.5, 0.1, True)] * 4)
@example(pattern=[(1.0, 0.2, False)] * 3)
def test_a_gap_is_not_made_up_for(kind, pattern):
    with kind() as bench:
        core = moving(bench)
        motion = through_gaps(bench, core, pattern, LONGEST_S[kind])
        assert motion.peak_m_s <= SPEED_M_S * (1.0 + MARGIN)
        assert motion.peak_m_s2 <= HARDEST_M_S2
        assert motion.back_m <= 1e-4
        assert bench.states[-1].ready
        core.wanted_m_s = 0.0
        stopping_s = bench.now_s
        bench.run(0.5)
        assert bench.motion(stopping_s).peak_m_s2 <= HARDEST_M_S2


@ROBOTS
def test_at_rest_the_arm_is_where_its_core_is(kind):
    """The remaining difference is compensated slowly, but not for long."""
    with kind() as bench:
        core = moving(bench)
        bench.stall(min(0.06, LONGEST_S[kind]))
        bench.run(0.1)
        core.wanted_m_s = 0.0
        stopping_s = bench.now_s
        bench.run(0.45)
        resting_s = bench.now_s
        bench.run(5.0)
        place = core.place
        if not core.by_pose:
            place = bench.kinematics.forward(np.array(place)).translation
        _, path = bench.path()
        assert float(np.linalg.norm(path[-1] - np.array(place))) <= 3e-4
        assert bench.motion(stopping_s + 0.2).peak_m_s <= 0.5 * SPEED_M_S
        assert bench.motion(resting_s).peak_m_s <= 0.005 * SPEED_M_S


@ROBOTS
@PATTERNS
@given(pattern=SHARES)
@example(pattern=[(1.0, 0.3, False)] * 2)
@example(pattern=[(0.25, 0.3, True)])
@example(pattern=[(0.25, 0.0, False)])
def test_no_gap_makes_an_arm_faster(kind, pattern):
    """Includes gaps in which its controller stops by itself: motion then resumes from rest."""
    with kind() as bench:
        motion = through_gaps(bench, moving(bench), pattern, 0.5)
        assert motion.peak_m_s <= SPEED_M_S * (1.0 + MARGIN)
        assert motion.back_m <= 1e-4
