"""Trajectories of all joints end together and exactly, keep every limit, and pass through their
points."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from cardan.errors import ConfigurationError, MotionRefusedError
from cardan.gateway.motion.joint_trajectory import MAX_POINTS, JointTrajectory
from cardan.gateway.motion.trajectories import (
    LineLimits,
    LineTrajectory,
    PointToPointTrajectory,
    SplineTrajectory,
    samples,
)
from cardan.spatial import (
    compose,
    from_rotation_vector,
    norm,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import IDENTITY, IDENTITY_POSE, ZERO3, Frame, Pose, Vector3

coordinates = st.floats(-2.0, 2.0)
vectors = st.builds(Vector3, coordinates, coordinates, coordinates)
poses = st.builds(Pose, vectors, vectors.map(from_rotation_vector), st.just(Frame.BASE))
profiles = st.sampled_from(["trapezoid", "jerk"])
LIMITS = LineLimits()
GROUP = LineLimits(
    linear_acceleration_m_s2=0.02, angular_speed_rad_s=0.05, angular_acceleration_rad_s2=0.02
)


def pose_difference(a, b):
    """Distance (m) and angle (rad) between two poses."""
    turned = rotation_between(a.orientation, b.orientation)
    return norm(subtract(a.position, b.position)), norm(turned)


@given(poses, poses, profiles)
def test_a_line_is_straight_within_limits_and_exact_at_both_ends(start, goal, profile):
    path = LineTrajectory(start, goal, LIMITS, profile=profile)
    assert pose_difference(path.at(0.0)[0], start) == pytest.approx((0, 0), abs=1e-9)
    end, twist = path.at(path.duration_s)
    assert end.position == goal.position
    assert pose_difference(end, goal)[1] == pytest.approx(0, abs=1e-7)
    assert norm(twist.linear) == norm(twist.angular) == 0.0
    distance, angle = pose_difference(start, goal)
    assume(path.duration_s > 0.0)
    step = path.duration_s / 1000
    for i in range(10):
        t = path.duration_s * (i + 0.5) / 10
        (pose, twist), (later, _) = path.at(t), path.at(t + step)
        done, turned = pose_difference(start, pose)
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
    assert LineTrajectory(IDENTITY_POSE, goal, GROUP).duration_s == pytest.approx(
        duration_s, abs=1e-4
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [(0, 0, 1), (0, -1, 0), (-0.6, 0.0, 0.8)])
def test_half_a_turn_takes_the_same_axis_however_it_is_written(axis, sign):
    goal = Pose(ZERO3, from_rotation_vector(scale(Vector3(*axis), sign * math.pi)))
    path = LineTrajectory(IDENTITY_POSE, goal, LIMITS)
    half, twist = path.at(0.5 * path.duration_s)
    leading = next(c for c in twist.angular if abs(c) > 1e-9)
    assert leading > 0.0
    assert pose_difference(half, IDENTITY_POSE)[1] == pytest.approx(math.pi / 2)
    assert pose_difference(half, goal)[1] == pytest.approx(math.pi / 2)
    before_end = path.at(path.duration_s * (1 - 1e-9))[0]
    assert pose_difference(before_end, goal)[1] < 1e-6


def test_a_goal_in_the_tool_frame_is_taken_from_the_start():
    start = Pose(Vector3(0.4, 0, 0.5), from_rotation_vector(Vector3(0, math.pi / 2, 0)))
    path = LineTrajectory(start, Pose(Vector3(0, 0, 0.1), IDENTITY, Frame.TOOL), LIMITS)
    assert path.goal.position == pytest.approx((0.5, 0, 0.5))
    assert path.goal.frame is Frame.BASE
    assert pose_difference(path.goal, compose(start, Pose(Vector3(0, 0, 0.1), IDENTITY)))[1] < 1e-9


def test_a_line_without_length_is_over_at_once():
    path = LineTrajectory(IDENTITY_POSE, IDENTITY_POSE, LIMITS)
    assert path.duration_s == 0.0
    assert path.at(0.0)[0] == IDENTITY_POSE


def test_a_shorter_duration_is_refused_and_a_longer_one_kept():
    goal = Pose(Vector3(0.3, 0, 0), IDENTITY)
    assert LineTrajectory(IDENTITY_POSE, goal, GROUP, duration_s=20.0).duration_s == pytest.approx(
        20.0
    )
    with pytest.raises(ValueError, match=r"5 s .* 8\.5 s"):
        LineTrajectory(IDENTITY_POSE, goal, GROUP, duration_s=5.0)


def test_senseless_limits_and_profiles_are_refused_by_name():
    with pytest.raises(ConfigurationError, match="linear_jerk_m_s3: 0"):
        LineLimits(linear_jerk_m_s3=0)
    with pytest.raises(ValueError, match="'cubic'"):
        LineTrajectory(IDENTITY_POSE, IDENTITY_POSE, LIMITS, profile="cubic")
    with pytest.raises(ValueError, match="base frame"):
        LineTrajectory(IDENTITY_POSE._replace(frame=Frame.TOOL), IDENTITY_POSE, LIMITS)


# ---------------------------------------------------------------------------------------------


def test_isochronous_times_and_speeds():
    way = np.radians([5, -2, 0, 20, 0, 10])
    path = PointToPointTrajectory([0.0] * 6, way, np.radians([10.0] * 6), [math.inf] * 6)
    assert path.duration_s == pytest.approx(2.0)
    assert np.degrees(path.at(1.0)[1]) == pytest.approx([2.5, -1, 0, 10, 0, 5])


angles = st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6)


@given(angles, angles)
def test_joints_keep_their_limits_and_arrive_together(start, goal):
    speeds, accelerations = np.linspace(1.0, 3.0, 6), np.linspace(2.0, 12.0, 6)
    path = PointToPointTrajectory(start, goal, speeds, accelerations)
    step = max(path.duration_s, 1e-9) / 100
    last = np.zeros(6)
    for i in range(101):
        q, v = path.at(i * step)
        assert (np.abs(v) <= speeds * (1 + 1e-9)).all()
        assert (np.abs(v - last) <= accelerations * step * (1 + 1e-6) + 1e-9).all()
        last = v.copy()
    q, v = path.at(path.duration_s)
    assert (q == path.goal).all()
    assert (q == goal).all()
    assert (v == 0.0).all()


def test_joint_paths_refuse_what_does_not_fit():
    with pytest.raises(ValueError, match="speeds has 1 values for 2 joints"):
        PointToPointTrajectory([0.0, 0.0], [1.0, 1.0], [1.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="finite"):
        PointToPointTrajectory([0.0], [math.nan], [1.0], [1.0])
    with pytest.raises(ValueError, match="accelerations"):
        PointToPointTrajectory([0.0], [1.0], [1.0], [0.0])


# ---------------------------------------------------------------------------------------------

START = np.array([0.1, -0.2])


def trajectory(times, positions, velocities=None, accelerations=None, **more):
    rows = [None if each is None else np.array(each, float) for each in (velocities, accelerations)]
    return JointTrajectory(np.array(times, float), np.array(positions, float), *rows, **more)


def slopes(path, times, by=1e-6):
    return [(path.at(t + by)[0] - path.at(t - by)[0]) / (2 * by) for t in times]


def test_the_curve_goes_through_the_points_with_their_velocities():
    times = [1.0, 2.0, 4.0]
    positions = [[0.5, 0.0], [0.8, 0.5], [1.0, 0.6]]
    velocities = [[0.2, 0.3], [0.1, -0.1], [0.0, 0.0]]
    path = SplineTrajectory(trajectory(times, positions, velocities), START)
    np.testing.assert_allclose(path.at(0.0)[0], START)
    np.testing.assert_allclose(path.at(0.0)[1], 0.0)
    for t, q, v in zip(times, positions, velocities, strict=True):
        np.testing.assert_allclose(path.at(t)[0], q, atol=1e-12)
        np.testing.assert_allclose(path.at(t)[1], v, atol=1e-12)
    assert path.duration_s == 4.0


def test_given_accelerations_are_those_at_the_points():
    accelerations = [[0.5, 0.1], [-0.3, 0.0], [0.0, 0.0]]
    times, positions = [1.0, 1.5, 4.0], [[0.5, 0.0], [0.8, 0.5], [1.0, 0.6]]
    velocities = [[0.2, 0.3], [0.1, -0.1], [0.0, 0.0]]
    path = SplineTrajectory(trajectory(times, positions, velocities, accelerations), START)
    for t, q, v, a in zip(times, positions, velocities, accelerations, strict=True):
        np.testing.assert_allclose(path.acceleration(t - 1e-9), a, atol=1e-6)
        for found, expected in zip(path.at(t - 1e-9), (q, v), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-7)
    np.testing.assert_allclose(path.acceleration(0.0), 0.0)


def test_velocities_are_those_of_the_curve():
    path = SplineTrajectory(trajectory([0.5, 1.5, 2.0], [[1, 0], [0, 1], [0.5, 0.5]]), START)
    path.slow(0.5)
    times = np.linspace(0.1, 3.9, 20)
    np.testing.assert_allclose([path.at(t)[1] for t in times], slopes(path, times), atol=1e-6)
    assert path.duration_s == 4.0
    before = [path.at(t - 1e-6)[1] for t in times]
    after = [path.at(t + 1e-6)[1] for t in times]
    found = (np.array(after) - before) / 2e-6
    np.testing.assert_allclose([path.acceleration(t) for t in times], found, atol=1e-3)


@given(st.lists(st.lists(st.floats(-3, 3), min_size=2, max_size=2), min_size=2, max_size=8))
def test_without_velocities_no_joint_swings_beyond_its_points(rows):
    times = np.arange(1, len(rows) + 1) * 0.7
    path = SplineTrajectory(trajectory(times, rows), START)
    knots = np.vstack((START, rows))
    slopes = np.diff(knots, axis=0) / 0.7
    going_on = (np.abs(slopes).min(axis=0) > 1e-3) & (slopes[0] * slopes[1] > 0.0)
    assert (path.at(0.7)[1] != 0.0)[going_on].all()
    for index in range(len(knots) - 1):
        low = np.minimum(knots[index], knots[index + 1]) - 1e-9
        high = np.maximum(knots[index], knots[index + 1]) + 1e-9
        for t in np.linspace(0.7 * index, 0.7 * (index + 1), 9):
            q = path.at(t)[0]
            assert np.all((low <= q) & (q <= high))


def test_it_rests_before_and_after():
    path = SplineTrajectory(trajectory([1.0], [[1.0, 1.0]]), START)
    np.testing.assert_allclose(path.at(-1.0)[0], START)
    np.testing.assert_allclose(path.at(9.0)[0], [1.0, 1.0])
    np.testing.assert_allclose(path.at(9.0)[1], 0.0, atol=1e-12)


def test_a_point_at_the_start_is_where_the_arm_is():
    path = SplineTrajectory(trajectory([0.0, 1.0], [START + 0.01, [1.0, 1.0]]), START)
    np.testing.assert_allclose(path.at(0.0)[0], START)
    np.testing.assert_allclose(path.at(1.0)[0], [1.0, 1.0])
    alone = SplineTrajectory(trajectory([0.0], [START]), START)
    assert alone.duration_s == 0.0
    np.testing.assert_allclose(alone.at(0.0)[0], START)


def test_samples_are_as_near_as_asked_and_bounded():
    path = SplineTrajectory(trajectory([1.0, 2.0], [[1.0, 0.0], [1.0, 0.5]]), START)
    times = samples(path, 0.05, 200)
    rows = np.array([path.at(t)[0] for t in times])
    assert times[0] == 0.0
    assert times[-1] == 2.0
    assert np.abs(np.diff(rows, axis=0)).max() < 0.1
    with pytest.raises(MotionRefusedError, match="too long to be checked"):
        samples(path, 1e-4, 2000)


@pytest.mark.parametrize(
    ("times", "positions", "more", "words"),
    [
        ([], np.zeros((0, 2)), {}, "0 points"),
        (range(1, MAX_POINTS + 2), np.zeros((MAX_POINTS + 1, 2)), {}, f"{MAX_POINTS + 1} points"),
        ([1.0, 1.0], np.zeros((2, 2)), {}, "point 1 comes 0 s after"),
        ([2.0, 1.0], np.zeros((2, 2)), {}, "point 1 comes -1 s after"),
        ([-1.0, 1.0], np.zeros((2, 2)), {}, "not all from 0 to"),
        ([1.0, 1e9], np.zeros((2, 2)), {}, "not all from 0 to"),
        ([1.0, np.nan], np.zeros((2, 2)), {}, "not all from 0 to"),
        ([1.0, 2.0], [[0, 0], [np.nan, 0]], {}, "positions have numbers that are not finite"),
        ([1.0, 2.0], [[0, 0], [1e300, 0]], {}, "positions have numbers"),
        ([1.0, 2.0], [[0, 0]], {}, "1 positions for 2 times"),
        ([1.0], [[0, 0]], {"velocities": [[0]]}, "velocities are not given for all"),
        ([1.0], [[0, 0]], {"velocities": [[0, np.inf]]}, "velocities have numbers"),
        ([1.0], [[0, 0]], {"velocities": [[0, 0.1]]}, "does not end at rest"),
    ],
)
def test_what_is_no_trajectory_is_refused(times, positions, more, words):
    with pytest.raises(MotionRefusedError, match=words):
        trajectory(times, positions, **more)
