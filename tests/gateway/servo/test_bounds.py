"""Velocity bounds: never empty, and no joint exceeds its range or its acceleration."""

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.servo.bounds import JointBounds
from cardan.robots import load_arm

pytestmark = pytest.mark.matrix

ARM = ArmKinematics(load_arm("gofa_crb15000_5"))
N = ARM.joints


def bounds(share=1.0):
    return JointBounds(ARM, share, share)


def limits(each, q, v, dt_s):
    low, high = np.zeros(N + 1), np.zeros(N + 1)
    each.fill(q.tolist(), v.tolist(), dt_s, low, high)
    return low[:N], high[:N]


@given(
    st.lists(st.floats(-8.0, 8.0), min_size=N, max_size=N),
    st.lists(st.floats(-8.0, 8.0), min_size=N, max_size=N),
    st.floats(1e-4, 0.05),
)
@example([0.0] * 5 + [-4.0], [0.0] * 5 + [1.0], 0.03125)
@example([0.0] * 5 + [4.0], [0.0] * 5 + [-1.0], 0.03125)
def test_bounds_are_never_empty_and_never_ask_more_than_the_acceleration(q, v, dt_s):
    q, v = np.array(q), np.array(v)
    low, high = limits(bounds(), q, v, dt_s)
    assert (low <= high).all()
    reach = ARM.acceleration * dt_s + 1e-9
    slower = np.abs(v) <= ARM.velocity
    assert (high[slower] <= (v + reach)[slower]).all()
    assert (low[slower] >= (v - reach)[slower]).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from((0.001, 0.002, 0.004, 0.01)))
def test_full_speed_into_every_limit_stops_at_it(seed, dt_s):
    generator = np.random.default_rng(seed)
    each, v = bounds(), np.zeros(N)
    q = generator.uniform(ARM.lower, ARM.upper)
    direction = generator.choice((-1.0, 1.0), N)
    steps = int(12.0 / dt_s)
    for _ in range(min(steps, 4000)):
        low, high = limits(each, q, v, dt_s)
        new = np.where(direction > 0, high, low)
        assert (np.abs(new - v) <= ARM.acceleration * dt_s * (1 + 1e-9)).all()
        v = new
        q = q + v * dt_s
        assert (q <= ARM.upper + 1e-9).all()
        assert (q >= ARM.lower - 1e-9).all()
    if dt_s * 4000 >= 8.0:
        ends = np.where(direction > 0, ARM.upper, ARM.lower)
        assert q == pytest.approx(ends, abs=1e-5)  # the full range is used


def test_outside_its_range_a_joint_may_only_come_back():
    q = ARM.upper + 0.1
    low, high = limits(bounds(), q, np.zeros(N), 0.002)
    assert (high == 0.0).all()
    assert (low < 0.0).all()


def test_shares_scale_speed_and_acceleration():
    low, high = limits(bounds(0.5), np.array(ARM.arm.home), np.zeros(N), 0.002)
    assert high == pytest.approx(0.5 * ARM.acceleration * 0.002)
    assert low == pytest.approx(-high)


def test_joints_at_a_bound_are_reported():
    each = bounds()
    low, high = limits(each, np.array(ARM.arm.home), np.zeros(N), 0.002)
    v = np.zeros(N)
    v[2] = high[2]
    assert each.limiting(low, high, v) == [2]
