"""Braking bounds hold in discrete time, for all periods."""

from hypothesis import given, strategies as st

from cardan.common.braking import stopping_speed

EPSILON = 1e-9
periods = st.floats(1e-3, 0.05)


@given(st.floats(1e-9, 3), st.floats(0.05, 50), st.lists(periods, min_size=1, max_size=50))
def test_always_leaves_the_braking_distance(distance, acceleration, steps):
    before = None
    for dt_s in steps:
        speed = stopping_speed(distance, acceleration, dt_s)
        distance -= speed * dt_s
        assert distance >= speed * speed / (2 * acceleration) - EPSILON
        # So that the following period can always keep to its own bound.
        assert before is None or speed >= before - acceleration * dt_s - EPSILON
        before = speed


@given(st.floats(1e-3, 2), st.floats(0.01, 20))
def test_approaches_the_continuous_bound(distance, acceleration):
    continuous = (2 * acceleration * distance) ** 0.5
    assert abs(stopping_speed(distance, acceleration, 1e-5) - continuous) <= 1e-5 * acceleration


def test_nothing_left():
    assert stopping_speed(0.0, 1.0, 0.004) == 0.0
    assert stopping_speed(-1.0, 1.0, 0.004) == 0.0
