"""Motion profile of a vector over time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from cardan.sim_peers.motion_profile import SinePeriods, VectorMotion, VectorRamp

values = st.floats(-10.0, 10.0)
pairs = st.tuples(values, values)
durations = st.floats(0.01, 5.0)
ramps = st.builds(VectorRamp, pairs, st.just(0.0) | durations, st.booleans())
swings = st.builds(
    SinePeriods, pairs, durations, st.integers(1, 4), st.sampled_from((0.0, math.pi / 2, -1.0))
)


def test_a_ramp_is_linear_and_stays_at_its_goal():
    motion = VectorMotion((1.0, 0.0))
    motion.start(2.0, VectorRamp((3.0, -1.0), 4.0))
    assert motion.at(2.0) == (1.0, 0.0)
    assert motion.at(3.0) == (1.5, -0.25)
    assert motion.at(6.0) == motion.at(60.0) == (3.0, -1.0)


def test_a_ramp_without_a_time_is_there_at_once():
    motion = VectorMotion((1.0,))
    motion.start(2.0, VectorRamp((3.0,)))
    assert motion.at(2.0) == (3.0,)


def test_a_gentle_ramp_starts_and_ends_without_speed():
    motion = VectorMotion((0.0,), gentle=True)
    motion.start(0.0, VectorRamp((2.0,), 1.0))
    assert motion.at(0.5) == pytest.approx((1.0,))
    assert motion.at(0.01)[0] == pytest.approx(0.0, abs=1e-3)
    assert motion.at(0.99)[0] == pytest.approx(2.0, abs=1e-3)


def test_a_component_without_a_goal_goes_on_to_where_it_was_going():
    motion = VectorMotion((0.0, 0.0))
    motion.start(0.0, VectorRamp((1.0, None), 1.0))
    motion.start(0.5, VectorRamp((None, 4.0), 1.0))
    assert motion.at(0.5) == (0.5, 0.0)
    assert motion.at(1.0) == (0.75, 2.0)
    assert motion.at(1.5) == (1.0, 4.0)


def test_swings_add_up_on_top_of_a_ramp_and_end_after_whole_periods():
    motion = VectorMotion((0.0,))
    motion.start(0.0, VectorRamp((1.0,), 1.0))
    motion.start(0.0, SinePeriods((0.5,), 4.0))
    motion.start(0.0, SinePeriods((0.25,), 4.0, times=2, phase_rad=math.pi))
    assert motion.at(1.0) == pytest.approx((1.25,))
    assert motion.without_swings(1.0) == (1.0,)
    assert motion.at(5.0) == pytest.approx((0.75,))
    assert motion.at(8.0) == (1.0,)


def test_the_next_sample_is_a_period_on_or_the_end_of_a_stroke():
    motion = VectorMotion((0.0,), 0.3)
    assert motion.next_due_s == math.inf
    motion.start(0.0, VectorRamp((1.0,), 0.5))
    motion.start(0.0, SinePeriods((0.5,), 0.7))
    due = []
    while motion.next_due_s < math.inf:
        due.append(motion.next_due_s)
        motion.advance(due[-1])
    assert due == pytest.approx([0.3, 0.5, 0.7])


@given(pairs, st.lists(ramps | swings, max_size=4), ramps, durations)
def test_a_ramp_begins_where_the_vector_is(rest, before, ramp, at_s):
    motion = VectorMotion(rest)
    for stroke in before:
        motion.start(0.0, stroke)
    here = motion.at(at_s) if ramp.ends_swings else motion.without_swings(at_s)
    motion.start(at_s, ramp._replace(over_s=1.0))
    assert motion.without_swings(at_s) == pytest.approx(here)
    if ramp.ends_swings:
        assert motion.advance(at_s + 1.0) == ramp.goal
        assert motion.next_due_s == math.inf


@given(st.booleans(), pairs, st.lists(ramps | swings, max_size=4), durations)
def test_rates_are_the_derivative(gentle, rest, strokes, at_s):
    motion = VectorMotion(rest, gentle=gentle)
    for stroke in strokes:
        motion.start(0.0, stroke)
    step_s = 1e-7
    ends_s = [s.duration_s if isinstance(s, SinePeriods) else s.over_s for s in strokes]
    if any(abs(at_s - end_s) < 2 * step_s for end_s in ends_s):
        return
    before, after = motion.at(at_s - step_s), motion.at(at_s + step_s)
    slopes = [(b - a) / (2 * step_s) for a, b in zip(before, after, strict=True)]
    assert motion.rates_at(at_s) == pytest.approx(slopes, rel=1e-4, abs=1e-3)
