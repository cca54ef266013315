"""Shaped velocities and poses stay within their bounds for all targets, arrive, and do not
overshoot."""

import math

import pytest
import ruckig
from hypothesis import assume, example, given, settings, strategies as st

from cardan.errors import ConfigurationError
from cardan.gateway.motion.profiles import Profile
from cardan.gateway.motion.shaping import (
    JerkLimitedVector,
    PoseShaper,
    PoseShaperLimits,
    _stop_sample,
    _stop_way,
    damping_time_s,
)
from cardan.spatial import add, from_rotation_vector, norm, rotation_between, scale, subtract
from cardan.types import IDENTITY, IDENTITY_POSE, ZERO3, ZERO_TWIST, Frame, Pose, Twist, Vector3
from tests.examples import examples

DT_S = 0.004
LIMITS = PoseShaperLimits()
components = st.floats(-2.0, 2.0)
vectors = st.builds(Vector3, components, components, components)
periods = st.floats(1e-3, 2e-2)
small = st.floats(-0.3, 0.3)
poses = st.builds(
    Pose,
    st.builds(Vector3, small, small, small),
    vectors.map(from_rotation_vector),
    st.just(Frame.BASE),
)


@pytest.mark.parametrize(
    ("acceleration", "jerk", "delay_s"),
    [(20, 4000, 0.015), (15, 1000, 0.024), (10, 500, 0.035), (5, 100, 0.075), (2, 20, 0.175)],
)
def test_equivalent_ramp_delays(acceleration, jerk, delay_s):
    shaper = JerkLimitedVector(1, 3.0, acceleration, jerk)
    lost, v = 0.0, 0.0
    for _ in range(500):
        (after,) = shaper.advance((0.5,), 0.002)
        lost += (0.5 - 0.5 * (v + after)) * 0.002
        v = after
    assert v == 0.5
    assert lost / 0.5 == pytest.approx(delay_s, rel=0.05)


TURNS = [
    (Vector3(*target), [0.02] * 8)
    for target in ((0.3, 0.17, 0.94), (-0.54, 0.74, -0.41), (0.0, 0.81, 0.59), (0.3, 0.92, -0.23))
]
"""Changes of direction at full speed, at which the desired acceleration is not available."""


@pytest.mark.parametrize("jerk", [60.0, 20.0])
@example(TURNS)
@given(st.lists(st.tuples(vectors, st.lists(periods, min_size=1, max_size=30)), max_size=6))
def test_velocity_bounds_hold_with_any_targets_and_periods(jerk, plan):
    shaper = JerkLimitedVector(3, 1.0, 4.0, jerk)
    a = ZERO3
    for target, times in plan:
        for dt_s in times:
            before = Vector3(*shaper.velocity)
            v = shaper.advance(target, dt_s)
            after = Vector3(*shaper.acceleration_now)
            assert norm(v) <= 1.0 + 1e-8
            assert norm(after) <= 4.0 + 1e-9
            assert norm(subtract(after, a)) <= jerk * dt_s * (1 + 1e-9)
            assert norm(subtract(v, before)) <= 4.0 * dt_s * (1 + 1e-9)
            if after != ZERO3:
                gained = scale(add(a, after), 0.5 * dt_s)
                assert v == pytest.approx(add(before, gained), abs=1e-9)
            a = after
    target = plan[-1][0] if plan else ZERO3
    for _ in range(1000):
        v = shaper.advance(target, DT_S)
    assert v == pytest.approx(scale(target, min(1.0, 1.0 / max(norm(target), 1e-9))), abs=1e-12)
    assert shaper.acceleration_now == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("ticks", "ahead"), [(1, 0.0), (1, 0.5), (2, 0.0), (2, 0.5)])
def test_a_target_at_the_present_speed_or_where_the_acceleration_leads_to_is_reached(ticks, ahead):
    dt_s = 1.0 / 64.0
    shaper = JerkLimitedVector(1, 4.0, 8.0, 64.0)
    for _ in range(ticks):
        shaper.advance((4.0,), dt_s)
    target = (shaper.velocity[0] + ahead * dt_s * shaper.acceleration_now[0],)
    for _ in range(100):
        shaper.advance(target, dt_s)
    assert shaper.velocity == target


@given(vectors, st.lists(periods, min_size=5, max_size=20), st.floats(1.0, 30.0))
def test_a_straight_change_does_not_overshoot_and_is_time_optimal(target, times, acceleration):
    shaper = JerkLimitedVector(3, 4.0, acceleration, 100.0)
    wanted, t = norm(target), 0.0
    assume(wanted == 0.0 or wanted > 1e-12)
    for i in range(4000):
        v = shaper.advance(target, times[i % len(times)])
        t += times[i % len(times)]
        assert norm(v) <= wanted * (1 + 1e-9)
        assert norm(subtract(scale(target, norm(v) / max(wanted, 1e-300)), v)) <= 1e-9
        if v == target:
            break
    assert v == target
    if wanted * 100.0 >= acceleration**2:
        best = wanted / acceleration + acceleration / 100.0
    else:
        best = 2.0 * math.sqrt(wanted / 100.0)
    assert t <= best * 1.05 + 4.0 * max(times)


@pytest.mark.parametrize("speed", [0.25, 0.1, 0.02, -0.25])
@pytest.mark.parametrize("acceleration", [0.0, 0.9, -0.9])
def test_the_way_of_a_stop_is_what_its_ticks_add_up_to(speed, acceleration):
    way, v, a = 0.0, speed, acceleration
    for _ in range(500):
        mean = 0.5 * v
        step, v, a = _stop_sample(v, a, 1.0, 10.0, 0.001)
        assert step == pytest.approx((mean + 0.5 * v) * 0.001, abs=1e-8)
        way += step
    assert (v, a) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert _stop_way(speed, acceleration, 1.0, 10.0) == pytest.approx(way, abs=1e-9)


@given(st.floats(0.05, 2.0), st.floats(-2.0, 2.0))
@settings(max_examples=examples(30))
def test_velocity_against_ruckig(target, start):
    shaper = JerkLimitedVector(1, 4.0, 5.0, 100.0)
    shaper.reset((start,))
    given_ = ruckig.InputParameter(1)
    given_.control_interface = ruckig.ControlInterface.Velocity
    given_.current_velocity, given_.target_velocity = [start], [target]
    given_.max_acceleration, given_.max_jerk = [5.0], [100.0]
    trajectory = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(given_, trajectory)
    ticks = 0
    while shaper.velocity != (target,):
        shaper.advance((target,), 0.001)
        ticks += 1
        assert ticks < 5000
    assert ticks * 0.001 <= trajectory.duration * 1.02 + 0.004
    assert ticks * 0.001 >= trajectory.duration - 0.001


def test_two_dimensions_and_senseless_arguments():
    shaper = JerkLimitedVector(2, 1.0, 10.0, 1e3)
    for _ in range(100):
        v = shaper.advance((0.3, -0.4), DT_S)
    assert v == (0.3, -0.4)
    before = shaper.velocity
    for target, dt_s in (((1.0,), DT_S), ((math.nan, 0.0), DT_S), ((0.0, 0.0), -1.0)):
        with pytest.raises(ValueError, match="target"):
            shaper.advance(target, dt_s)
    assert shaper.velocity == before
    with pytest.raises(ValueError, match="4 dimensions"):
        JerkLimitedVector(4, 1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="jerk"):
        JerkLimitedVector(3, 1.0, 1.0, math.inf)
    with pytest.raises(ValueError, match="above the speed"):
        shaper.reset((1.0, 1.0))


# ---------------------------------------------------------------------------------------------


def placed(pose=IDENTITY_POSE, **options):
    shaper = PoseShaper(LIMITS, **options)
    shaper.place(pose)
    return shaper


def pose_difference(shaper, goal):
    turned = rotation_between(shaper.pose.orientation, goal.orientation)
    return norm(subtract(goal.position, shaper.pose.position)), norm(turned)


@given(st.floats(1e-6, 2.0), st.lists(periods, min_size=1, max_size=7))
@settings(max_examples=examples(40))
def test_a_resting_target_is_reached_straight_in_time_and_not_passed(distance, times):
    direction = Vector3(0.48, -0.6, 0.64)
    goal = Pose(scale(direction, distance), IDENTITY)
    shaper, t, highest = placed(), 0.0, 0.0
    for i in range(20000):
        dt_s, before, v = times[i % len(times)], shaper.pose.position, shaper.twist.linear
        pose = shaper.advance(goal, dt_s)
        t += dt_s
        along = norm(pose.position)
        ended = add(before, scale(add(v, shaper.twist.linear), 0.5 * dt_s))
        assert norm(subtract(pose.position, ended)) <= 10.0 * dt_s**3 / 12.0 + 1e-12
        highest = max(highest, along)
        assert norm(subtract(scale(direction, along), pose.position)) <= 1e-9 * distance
        if shaper.twist.linear == ZERO3 and distance - along <= 1e-12:
            break
    assert norm(subtract(goal.position, pose.position)) <= 1e-12
    assert highest <= distance * (1 + 1e-9)
    best = Profile(distance, 0.25, 1.0, 10.0).duration_s
    assert t <= 1.1 * best + 6 * max(times)


def assert_within(shaper, last, dt_s, slack=1e-6):
    """Check the norms of twist, acceleration and jerk; return the acceleration for the next
    call."""
    twist, now = shaper.twist, shaper.acceleration
    assert norm(twist.linear) <= LIMITS.linear_speed_m_s * (1 + slack)
    assert norm(twist.angular) <= LIMITS.angular_speed_rad_s * (1 + slack)
    assert norm(now.linear) <= LIMITS.linear_acceleration_m_s2 * (1 + slack)
    assert norm(now.angular) <= LIMITS.angular_acceleration_rad_s2 * (1 + slack)
    jerk = norm(subtract(now.linear, last.linear)) / dt_s
    assert jerk <= LIMITS.linear_jerk_m_s3 * (1 + slack)
    jerk = norm(subtract(now.angular, last.angular)) / dt_s
    assert jerk <= LIMITS.angular_jerk_rad_s3 * (1 + slack)
    return now


@given(st.lists(poses, min_size=1, max_size=25), st.sampled_from([0.002, 0.004, 0.01]))
@settings(max_examples=examples(40))
def test_bounds_hold_while_the_target_jumps_and_it_arrives_after(targets, dt_s):
    shaper = placed()
    last = shaper.acceleration
    for target in targets:
        for _ in range(round(0.02 / dt_s)):
            before, twist = shaper.pose, shaper.twist
            shaper.advance(target, dt_s)
            last = assert_within(shaper, last, dt_s)
            moved = subtract(shaper.pose.position, before.position)
            assert norm(moved) <= LIMITS.linear_speed_m_s * dt_s * (1 + 1e-3)
            # The distance equals that of the mean speed, except for the effect of jerk within a
            # tick.
            mean = scale(add(twist.linear, shaper.twist.linear), 0.5 * dt_s)
            assert norm(subtract(moved, mean)) <= LIMITS.linear_jerk_m_s3 * dt_s**3 / 12.0 + 1e-12
    for _ in range(round(12.0 / dt_s)):
        shaper.advance(targets[-1], dt_s)
        last = assert_within(shaper, last, dt_s)
        if max(pose_difference(shaper, targets[-1])) < 1e-9:
            break
    assert pose_difference(shaper, targets[-1]) == pytest.approx((0, 0), abs=1e-7)


def test_rotation_follows_the_geodesic():
    axis = Vector3(0.0, 0.6, 0.8)
    goal = Pose(ZERO3, from_rotation_vector(scale(axis, 2.0)))
    shaper = placed()
    for _ in range(1000):
        pose = shaper.advance(goal, DT_S)
        turned = rotation_between(IDENTITY, pose.orientation)
        assert norm(subtract(scale(axis, norm(turned)), turned)) < 1e-8
    assert pose_difference(shaper, goal)[1] < 1e-9


def test_a_reference_that_another_motion_moved_goes_on_at_its_twist_without_acceleration():
    shaper = placed()
    there = Pose(Vector3(0.3, 0.1, 0.0), from_rotation_vector(Vector3(0.5, 0.0, 0.2)))
    for _ in range(10):
        shaper.advance(there, DT_S)
    twist = Twist(Vector3(0.1, 0.0, 0.0), Vector3(0.0, 0.2, 0.0), Frame.BASE)
    shaper.adopt(IDENTITY_POSE, twist)
    assert (shaper.pose, shaper.twist) == (IDENTITY_POSE, twist)
    assert shaper.acceleration == ZERO_TWIST


def test_near_half_a_turn_the_way_round_is_kept():
    shaper = placed()
    turned = []
    for i in range(150):
        angle = math.pi + (0.05 if i % 2 else -0.05)
        shaper.advance(Pose(ZERO3, from_rotation_vector(Vector3(0, 0, angle))), DT_S)
        turned.append(shaper.twist.angular.z)
    assert min(turned) >= 0.0
    assert turned[-1] > 0.5


@pytest.mark.parametrize("dt_s", [0.002, 0.004, 0.02])
@pytest.mark.parametrize(
    ("damping", "backend"), [(0.3, "builtin"), (0.6, "builtin"), (0.6, "ruckig")]
)
def test_damping_is_a_time_constant_whatever_the_tick_rate(damping, backend, dt_s):
    goal = Pose(Vector3(0.01, 0, 0), IDENTITY)
    quick = PoseShaperLimits(linear_acceleration_m_s2=20.0, linear_jerk_m_s3=5000.0)
    shaper = PoseShaper(quick, damping=damping, backend=backend)
    shaper.place(IDENTITY_POSE)
    ticks = round(2.5 / dt_s)
    distances = [0.01 - shaper.advance(goal, dt_s).position.x for _ in range(ticks)]
    assert min(distances) >= -1e-11
    tau = damping_time_s(damping)
    # Some time after the start only the exponential remains: a factor e per time constant.
    first = next(i for i, d in enumerate(distances) if d < 0.003)
    later = distances[first + round(tau / dt_s)]
    share = 1.0 if backend == "builtin" else 3.0**-0.5  # this speed is limited along each axis
    assert later / distances[first] == pytest.approx(math.exp(-share), rel=0.15)


def test_damping_times():
    assert damping_time_s(1.0) == 0.0
    assert damping_time_s(0.5) == pytest.approx(0.1 / math.log(2))
    with pytest.raises(ConfigurationError, match=r"damping: damping 0\.05"):
        placed(damping=0.05)


@given(st.floats(1e-3, 1.0))
@settings(max_examples=20)
def test_poses_against_ruckig(distance):
    given_ = ruckig.InputParameter(1)
    given_.current_position, given_.target_position = [0.0], [distance]
    given_.max_velocity, given_.max_acceleration, given_.max_jerk = [0.25], [1.0], [10.0]
    trajectory = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(given_, trajectory)
    shaper, t = placed(), 0.0
    while t == 0.0 or shaper.twist.linear != ZERO3:
        shaper.advance(Pose(Vector3(distance, 0, 0), IDENTITY), DT_S)
        t += DT_S
        assert t < 10.0
    assert trajectory.duration - DT_S <= t <= 1.05 * trajectory.duration + 3 * DT_S


@given(st.lists(poses, min_size=1, max_size=10))
@settings(max_examples=20)
def test_the_ruckig_back_end_keeps_the_same_bounds(targets):
    shaper = placed(backend="ruckig")
    for _ in range(50):
        x, y, z = shaper.advance(Pose(Vector3(0.3, 0.1, -0.2), IDENTITY), DT_S).position
        assert (y, z) == pytest.approx((x / 3.0, x / -1.5), abs=1e-9)  # Straight from rest.
    shaper.place(IDENTITY_POSE)
    last = shaper.acceleration
    for target in targets:
        for _ in range(5):
            shaper.advance(target, DT_S)
            last = assert_within(shaper, last, DT_S)
    for _ in range(3000):
        shaper.advance(targets[-1], DT_S)
    assert pose_difference(shaper, targets[-1]) == pytest.approx((0, 0), abs=1e-6)


def test_what_makes_no_sense_is_refused_and_changes_nothing():
    with pytest.raises(ConfigurationError, match="linear_speed_m_s: 0"):
        PoseShaperLimits(linear_speed_m_s=0)
    with pytest.raises(ConfigurationError, match="'reflexxes'"):
        PoseShaper(LIMITS, backend="reflexxes")
    with pytest.raises(RuntimeError, match="placed"):
        PoseShaper(LIMITS).advance(IDENTITY_POSE, DT_S)
    shaper = placed()
    with pytest.raises(ValueError, match="not finite"):
        shaper.advance(Pose(Vector3(math.nan, 0, 0), IDENTITY), DT_S)
    with pytest.raises(ValueError, match="period"):
        shaper.advance(IDENTITY_POSE, -DT_S)
    assert shaper.pose == IDENTITY_POSE
