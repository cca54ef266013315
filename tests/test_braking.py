"""Braking bounds hold in discrete time, for all periods."""

import math

import numpy as np
from hypothesis import given, strategies as st

from cardan.common.braking import stopping_speed
from cardan.drivers.limiters import JointLimiter
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.servo.bounds import JointBounds
from cardan.robots import load_arm

EPSILON = 1e-9
periods = st.floats(1e-3, 0.05)


@given(st.floats(1e-9, 3), st.floats(0.05, 50), st.lists(periods, min_size=1, max_size=50))
def test_always_leaves_the_braking_distance(distance, acceleration, steps):
    before = None
    for dt_s in steps:
        speed = stopping_speed(distance, acceleration, dt_s)
        distance -= speed * dt_s
        assert distance >= speed * speed / (2 * acceleration) - EPSILON
        # The following period must be able to keep to its own bound.
        assert before is None or speed >= before - acceleration * dt_s - EPSILON
        before = speed


@given(st.floats(1e-3, 2), st.floats(0.01, 20))
def test_approaches_the_continuous_bound(distance, acceleration):
    continuous = (2 * acceleration * distance) ** 0.5
    assert abs(stopping_speed(distance, acceleration, 1e-5) - continuous) <= 1e-5 * acceleration


def test_nothing_left():
    assert stopping_speed(0.0, 1.0, 0.004) == 0.0
    assert stopping_speed(-1.0, 1.0, 0.004) == 0.0


def test_a_distance_that_is_no_number_leaves_no_speed():
    assert stopping_speed(math.nan, 1.0, 0.004) == 0.0
    limiter = JointLimiter((-1.0,), (1.0,), (2.0,), (5.0,), 0.02)
    limiter.reset((math.nan,), (2.0,))
    assert not limiter.moving
    bounds = JointBounds(ArmKinematics(load_arm("ur5")), 1.0, 1.0)
    lowest, highest = np.full(6, math.nan), np.full(6, math.nan)
    bounds.fill([math.nan] * 6, [0.0] * 6, 0.004, lowest, highest)
    assert np.all(np.isfinite(lowest))
    assert np.all(np.isfinite(highest))
