"""Control law of the velocity mode, for arbitrary commands."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st

from cardan.sim_peers.motoros_controller.velocity import VelocityLaw
from tests.examples import examples

IPC_S = 0.004
SPEED = (4.0, 6.0, 9.0)
ACCELERATION = (20.0, 12.0, 45.0)
LOWER, UPPER = (-1.0, -0.5, -3.0), (1.0, 0.7, 3.0)
PER_RAD = (65_190.0, 52_152.3, 40_000.0)
TINY = 1e-9


def law(start=(0.0, 0.0, 0.0)):
    it = VelocityLaw(SPEED, ACCELERATION, LOWER, UPPER, PER_RAD, IPC_S)
    it.place([int(q * each) for q, each in zip(start, PER_RAD, strict=True)])
    return it


def run(it, target, ticks, accelerations=ACCELERATION):
    total = [0, 0, 0]
    for _ in range(ticks):
        total = [a + b for a, b in zip(total, it.step(target, accelerations), strict=True)]
    return total


speeds = st.tuples(*[st.floats(-30.0, 30.0)] * 3)
commands = st.lists(
    st.tuples(
        st.none() | speeds,
        st.integers(1, 120),
        st.tuples(*[st.floats(0.01, 1.0)] * 3),
    ),
    min_size=1,
    max_size=8,
)


@settings(max_examples=examples(150))
@given(commands)
def test_no_command_leaves_the_limits(way):
    it = law()
    position = [0, 0, 0]
    for target, ticks, shares in way:
        given_accelerations = [a * s for a, s in zip(ACCELERATION, shares, strict=True)]
        for _ in range(ticks):
            before = list(it.velocity)
            increments = it.step(target, given_accelerations)
            for axis in range(3):
                position[axis] += increments[axis]
                v, own = it.velocity[axis], ACCELERATION[axis]
                assert abs(v) <= SPEED[axis] + TINY
                assert abs(v - before[axis]) <= own * IPC_S + TINY
                joint = position[axis] / PER_RAD[axis]
                assert LOWER[axis] - TINY <= joint <= UPPER[axis] + TINY


@settings(max_examples=examples(100))
@given(commands)
def test_an_axis_can_stop_inside_its_range_at_any_time(way):
    it = law()
    position = [0, 0, 0]

    def step(target, accelerations):
        for axis, pulses in enumerate(it.step(target, accelerations)):
            position[axis] += pulses

    for target, ticks, shares in way:
        for _ in range(ticks):
            step(target, [a * s for a, s in zip(ACCELERATION, shares, strict=True)])
    for _ in range(2000):
        step(None, ACCELERATION)
    assert it.still
    for axis in range(3):
        assert LOWER[axis] <= position[axis] / PER_RAD[axis] <= UPPER[axis]


@settings(max_examples=examples(100))
@given(speeds, st.integers(1, 60))
def test_the_direction_is_kept_from_rest(target, ticks):
    it = law()
    for _ in range(ticks):
        it.step(target, ACCELERATION)
        if it.position_mask:
            return
        v = it.velocity
        for a in range(3):
            for b in range(a):
                assert v[a] * target[b] == pytest.approx(v[b] * target[a], abs=1e-7)


@settings(max_examples=examples(100))
@given(speeds, st.floats(0.0, 1.0), st.lists(speeds, min_size=1, max_size=4))
def test_a_speed_limit_slows_all_axes_alike(before, share, targets):
    it = law()
    run(it, before, 40)
    for target in [*targets, None]:
        for _ in range(20):
            increments = it.step(target, ACCELERATION, share)
            for axis in range(3):
                most = share * SPEED[axis]
                assert abs(it.velocity[axis]) <= most + TINY
                # Up to one pulse more, from the carried fraction.
                assert abs(increments[axis]) <= most * IPC_S * PER_RAD[axis] + 1.0 + TINY


@settings(max_examples=examples(60))
@given(speeds, st.floats(0.01, 0.2), st.integers(50, 200))
def test_a_speed_limit_keeps_the_direction_without_drift(target, share, ticks):
    it = law()
    run(it, (0.0, 0.0, 0.0), 1)
    total = [0, 0, 0]
    for _ in range(ticks):
        increments = it.step(target, ACCELERATION, share)
        total = [a + b for a, b in zip(total, increments, strict=True)]
        if it.position_mask:
            return
    way = [pulses / each for pulses, each in zip(total, PER_RAD, strict=True)]
    for a in range(3):
        for b in range(a):
            assert way[a] * target[b] == pytest.approx(way[b] * target[a], abs=3e-3)


@settings(max_examples=examples(60))
@given(st.tuples(*[st.floats(-0.05, 0.05)] * 3), st.integers(100, 1000))
def test_there_is_no_dead_band_and_no_drift(target, ticks):
    it = law()
    ticks_up = 50
    run(it, target, ticks_up)
    assert it.velocity == pytest.approx(target, abs=1e-12)
    total = run(it, target, ticks)
    for axis in range(3):
        way = target[axis] * ticks * IPC_S * PER_RAD[axis]
        assert abs(total[axis] - way) <= 1.0 + 1e-6


def test_the_slowest_speeds_move_the_arm():
    it = law()
    (total, *_) = run(it, (1e-5, 0.0, 0.0), 2500)
    assert total == pytest.approx(1e-5 * 10 * PER_RAD[0], abs=1.01)


def test_at_rest_nothing_moves():
    it = law((0.3, -0.2, 1.234567))
    assert run(it, (0.0, 0.0, 0.0), 100) == [0, 0, 0]
    assert it.still


def test_a_stop_brakes_each_axis_by_itself():
    it = law()
    run(it, (2.0, 1.0, -4.0), 200)
    it.place([0, 0, 0])
    run(it, (1.0, 0.5, -2.0), 50)
    expected = [v / a for v, a in zip((1.0, 0.5, 2.0), ACCELERATION, strict=True)]
    assert it.stopping_time_s == pytest.approx(max(expected))
    ticks = 0
    while not it.still:
        before = [abs(v) for v in it.velocity]
        it.step(None, ACCELERATION)
        for axis in range(3):
            left = max(0.0, before[axis] - ACCELERATION[axis] * IPC_S)
            assert abs(it.velocity[axis]) == pytest.approx(left)
        ticks += 1
    assert ticks * IPC_S == pytest.approx(max(expected), abs=IPC_S)


def test_it_comes_right_up_to_a_limit():
    it = law()
    total = run(it, (4.0, 0.0, 0.0), 1000)
    assert 0.999 < total[0] / PER_RAD[0] <= 1.0
    assert it.position_mask == 0b001
    assert run(it, (-1.0, 0.0, 0.0), 50)[0] < 0


def test_masks_name_what_limited_which_axis():
    it = law()
    it.step((0.05, 0.0, 13.0), ACCELERATION)
    assert (it.speed_mask, it.acceleration_mask, it.position_mask) == (0b100, 0b100, 0)
    it.clear_masks()
    run(it, (0.01, 0.0, 0.0), 500)
    it.clear_masks()
    it.step((0.01, 0.0, 0.0), ACCELERATION)
    assert (it.speed_mask, it.acceleration_mask, it.position_mask) == (0, 0, 0)


def test_what_was_not_executed_is_not_caught_up():
    it = law()
    run(it, (1.0, 0.0, 0.0), 50)
    it.discard([100, 0, 0])
    increments = it.step((1.0, 0.0, 0.0), ACCELERATION)
    assert increments[0] == pytest.approx(1.0 * IPC_S * PER_RAD[0], abs=1)
