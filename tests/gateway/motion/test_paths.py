"""Paths end together and exactly, keep every limit, and brake along themselves."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from cardan.errors import ConfigurationError
from cardan.gateway.motion.paths import (
    JointPath,
    LinePath,
    PathLimits,
    wrap_angle,
)
from cardan.spatial import (
    compose,
    dot,
    from_rotation_vector,
    norm,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import IDENTITY, IDENTITY_POSE, ZERO3, Frame, Pose, Twist, Vector3

coordinates = st.floats(-2.0, 2.0)
vectors = st.builds(Vector3, coordinates, coordinates, coordinates)
poses = st.builds(Pose, vectors, vectors.map(from_rotation_vector), st.just(Frame.BASE))
profiles = st.sampled_from(["trapezoid", "jerk"])
LIMITS = PathLimits()
GROUP = PathLimits(
    linear_acceleration_m_s2=0.02, angular_speed_rad_s=0.05, angular_acceleration_rad_s2=0.02
)


def apart(a, b):
    """Distance in m and angle in rad between two poses."""
    turned = rotation_between(a.orientation, b.orientation)
    return norm(subtract(a.position, b.position)), norm(turned)


@given(poses, poses, profiles)
def test_a_line_is_straight_within_limits_and_exact_at_both_ends(start, goal, profile):
    path = LinePath(start, goal, LIMITS, profile=profile)
    assert apart(path.at(0.0)[0], start) == pytest.approx((0, 0), abs=1e-9)
    end, twist = path.at(path.duration_s)
    assert end.position == goal.position
    assert apart(end, goal)[1] == pytest.approx(0, abs=1e-7)
    assert norm(twist.linear) == norm(twist.angular) == 0.0
    distance, angle = apart(start, goal)
    assume(path.duration_s > 0.0)
    step = path.duration_s / 1000
    for i in range(10):
        t = path.duration_s * (i + 0.5) / 10
        (pose, twist), (later, _) = path.at(t), path.at(t + step)
        done, turned = apart(start, pose)
        assert turned * distance == pytest.approx(done * angle, abs=1e-6)
        assert norm(twist.linear) <= LIMITS.linear_speed_m_s * (1 + 1e-9)
        assert norm(twist.angular) <= LIMITS.angular_speed_rad_s * (1 + 1e-9)
        speed = scale(subtract(later.position, pose.position), 1 / step)
        slack = LIMITS.linear_acceleration_m_s2 * step
        assert norm(subtract(speed, twist.linear)) <= slack + 1e-9
        turn_speed = scale(rotation_between(pose.orientation, later.orientation), 1 / step)
        slack = LIMITS.angular_acceleration_rad_s2 * step
        assert norm(subtract(turn_speed, twist.angular)) <= slack + 1e-6


@pytest.mark.parametrize(
    ("goal", "duration_s"),
    [
        (Pose(Vector3(0, 0.05, 0), IDENTITY), 3.1623),
        (Pose(Vector3(0.1, 0, 0), IDENTITY), 4.4721),
        (Pose(Vector3(0, 0, 0.125), IDENTITY), 5.0),
        (Pose(Vector3(0.3, 0, 0), from_rotation_vector(Vector3(0, 0.2, 0))), 8.5),
        (Pose(Vector3(0.3, 0, 0), from_rotation_vector(Vector3(0, math.pi / 2, 0))), 33.916),
    ],
)
def test_line_times_with_an_equivalent_radius_of_one_meter(goal, duration_s):
    assert LinePath(IDENTITY_POSE, goal, GROUP).duration_s == pytest.approx(duration_s, abs=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [(0, 0, 1), (0, -1, 0), (-0.6, 0.0, 0.8)])
def test_half_a_turn_takes_the_same_axis_however_it_is_written(axis, sign):
    goal = Pose(ZERO3, from_rotation_vector(scale(Vector3(*axis), sign * math.pi)))
    path = LinePath(IDENTITY_POSE, goal, LIMITS)
    half, twist = path.at(0.5 * path.duration_s)
    leading = next(c for c in twist.angular if abs(c) > 1e-9)
    assert leading > 0.0
    assert apart(half, IDENTITY_POSE)[1] == pytest.approx(math.pi / 2)
    assert apart(half, goal)[1] == pytest.approx(math.pi / 2)
    before_end = path.at(path.duration_s * (1 - 1e-9))[0]
    assert apart(before_end, goal)[1] < 1e-6


def test_a_goal_in_the_tool_frame_is_taken_from_the_start():
    start = Pose(Vector3(0.4, 0, 0.5), from_rotation_vector(Vector3(0, math.pi / 2, 0)))
    path = LinePath(start, Pose(Vector3(0, 0, 0.1), IDENTITY, Frame.TOOL), LIMITS)
    assert path.goal.position == pytest.approx((0.5, 0, 0.5))
    assert path.goal.frame is Frame.BASE
    assert apart(path.goal, compose(start, Pose(Vector3(0, 0, 0.1), IDENTITY)))[1] < 1e-9


def test_a_line_without_length_is_over_at_once():
    path = LinePath(IDENTITY_POSE, IDENTITY_POSE, LIMITS)
    assert path.duration_s == 0.0
    assert path.at(0.0)[0] == IDENTITY_POSE


@given(poses, poses, profiles, st.floats(0.0, 1.0))
def test_a_line_brakes_along_itself(start, goal, profile, when):
    path = LinePath(start, goal, LIMITS, profile=profile)
    t = when * path.duration_s
    stop = path.brake(t)
    assert stop.duration_s <= path.duration_s - t + 1e-6
    (pose, twist), (stopping, stopping_twist) = path.at(t), stop.at(0.0)
    assert apart(pose, stopping) == pytest.approx((0, 0), abs=1e-6)
    if when < 1.0 - 1e-6:
        assert stopping_twist.linear == pytest.approx(twist.linear, abs=1e-6)
    rest, twist = stop.at(stop.duration_s)
    assert twist == Twist(ZERO3, ZERO3)
    line, moved = subtract(goal.position, start.position), subtract(rest.position, start.position)
    assert dot(line, moved) == pytest.approx(norm(line) * norm(moved), abs=1e-9)
    assert norm(moved) <= norm(line) * (1 + 1e-9)


def test_a_shorter_duration_is_refused_and_a_longer_one_kept():
    goal = Pose(Vector3(0.3, 0, 0), IDENTITY)
    assert LinePath(IDENTITY_POSE, goal, GROUP, duration_s=20.0).duration_s == pytest.approx(20.0)
    with pytest.raises(ValueError, match=r"5 s .* 8\.5 s"):
        LinePath(IDENTITY_POSE, goal, GROUP, duration_s=5.0)


def test_senseless_limits_and_profiles_are_refused_by_name():
    with pytest.raises(ConfigurationError, match="linear_jerk_m_s3: 0"):
        PathLimits(linear_jerk_m_s3=0)
    with pytest.raises(ValueError, match="'cubic'"):
        LinePath(IDENTITY_POSE, IDENTITY_POSE, LIMITS, profile="cubic")
    with pytest.raises(ValueError, match="base frame"):
        LinePath(IDENTITY_POSE._replace(frame=Frame.TOOL), IDENTITY_POSE, LIMITS)


# ---------------------------------------------------------------------------------------------


def test_isochronous_times_and_speeds():
    way = np.radians([5, -2, 0, 20, 0, 10])
    path = JointPath([0.0] * 6, way, np.radians([10.0] * 6), [math.inf] * 6)
    assert path.duration_s == pytest.approx(2.0)
    assert np.degrees(path.at(1.0)[1]) == pytest.approx([2.5, -1, 0, 10, 0, 5])


angles = st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6)


@given(angles, angles, st.booleans(), st.lists(st.booleans(), min_size=6, max_size=6))
def test_joints_keep_their_limits_and_arrive_together(start, goal, jerk_limited, continuous):
    speeds, accelerations = np.linspace(1.0, 3.0, 6), np.linspace(2.0, 12.0, 6)
    jerks = np.linspace(20.0, 100.0, 6) if jerk_limited else None
    path = JointPath(start, goal, speeds, accelerations, jerks, continuous=continuous)
    step = max(path.duration_s, 1e-9) / 100
    last = np.zeros(6)
    for i in range(101):
        q, v = path.at(i * step)
        assert (np.abs(v) <= speeds * (1 + 1e-9)).all()
        assert (np.abs(v - last) <= accelerations * step * (1 + 1e-6) + 1e-9).all()
        last = v.copy()
    q, v = path.at(path.duration_s)
    assert (q == path.goal).all()
    assert (v == 0.0).all()
    turns = (path.goal - np.array(goal)) / (2 * math.pi)
    assert turns == pytest.approx(np.round(turns), abs=1e-9)
    assert (turns[~np.array(continuous)] == 0.0).all()
    assert (np.abs(path.goal - np.array(start))[continuous] <= math.pi + 1e-9).all()
    rest = path.brake(0.4 * path.duration_s)
    assert rest.at(rest.duration_s)[1] == pytest.approx(np.zeros(6))
    assert rest.at(0.0)[0] == pytest.approx(path.at(0.4 * path.duration_s)[0])


def test_short_way_round():
    path = JointPath([3.0, 3.0], [-3.0, -3.0], [1, 1], [1, 1], continuous=[True, False])
    assert path.goal == pytest.approx([2 * math.pi - 3.0, -3.0])
    assert wrap_angle(math.pi) == wrap_angle(-math.pi) == math.pi
    assert JointPath([0.0], [-math.pi], [1], [1], continuous=[True]).goal[0] == math.pi


def test_joint_paths_refuse_what_does_not_fit():
    with pytest.raises(ValueError, match="speeds has 1 values for 2 joints"):
        JointPath([0.0, 0.0], [1.0, 1.0], [1.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="finite"):
        JointPath([0.0], [math.nan], [1.0], [1.0])
    with pytest.raises(ValueError, match="accelerations"):
        JointPath([0.0], [1.0], [1.0], [0.0])
    with pytest.raises(ValueError, match="jerks"):
        JointPath([0.0], [1.0], [1.0], [1.0], [-1.0])
    with pytest.raises(ValueError, match=r"0\.5 s is not possible"):
        JointPath([0.0], [1.0], [1.0], [1.0], duration_s=0.5)
