"""Braking bounds hold in discrete time, to the last step."""

from hypothesis import given
from hypothesis import strategies as st

from cardan.braking import stopping_speed


@given(st.floats(0, 2), st.floats(0.01, 20), st.floats(1e-3, 0.05))
def test_stops_in_time_without_braking_harder(distance, acceleration, dt_s):
    speed = stopping_speed(distance, acceleration, dt_s)
    left = distance
    for _ in range(3000):
        left -= speed * dt_s
        assert left >= -1e-9
        following = stopping_speed(left, acceleration, dt_s)
        assert following >= speed - acceleration * dt_s * (1 + 1e-6) - 1e-9
        speed = min(following, speed)


@given(st.floats(1e-3, 2), st.floats(0.01, 20))
def test_approaches_the_continuous_bound(distance, acceleration):
    continuous = (2 * acceleration * distance) ** 0.5
    assert abs(stopping_speed(distance, acceleration, 1e-5) - continuous) <= 1e-5 * acceleration


def test_nothing_left():
    assert stopping_speed(0.0, 1.0, 0.004) == 0.0
    assert stopping_speed(-1.0, 1.0, 0.004) == 0.0


def test_one_period_is_enough_for_a_short_way():
    assert stopping_speed(1e-6, 1.0, 0.004) == 1e-6 / 0.004
