"""The curve through the points of a joint trajectory."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cardan.errors import MotionRefusedError
from cardan.gateway.motion.joint_trajectory import MAX_POINTS, JointTrajectory
from cardan.gateway.motion.trajectory import TrajectoryPath, samples

START = np.array([0.1, -0.2])


def trajectory(times, positions, velocities=None, accelerations=None, **more):
    rows = [None if each is None else np.array(each, float) for each in (velocities, accelerations)]
    return JointTrajectory(np.array(times, float), np.array(positions, float), *rows, **more)


def speeds(path, times, by=1e-6):
    return [(path.at(t + by)[0] - path.at(t - by)[0]) / (2 * by) for t in times]


def test_the_curve_goes_through_the_points_with_their_velocities():
    times = [1.0, 2.0, 4.0]
    positions = [[0.5, 0.0], [0.8, 0.5], [1.0, 0.6]]
    velocities = [[0.2, 0.3], [0.1, -0.1], [0.0, 0.0]]
    path = TrajectoryPath(trajectory(times, positions, velocities), START)
    np.testing.assert_allclose(path.at(0.0)[0], START)
    np.testing.assert_allclose(path.at(0.0)[1], 0.0)
    for t, q, v in zip(times, positions, velocities, strict=True):
        np.testing.assert_allclose(path.at(t)[0], q, atol=1e-12)
        np.testing.assert_allclose(path.at(t)[1], v, atol=1e-12)
    assert path.duration_s == 4.0


def test_given_accelerations_are_those_at_the_points():
    accelerations = [[0.5, 0.1], [-0.3, 0.0], [0.0, 0.0]]
    path = TrajectoryPath(
        trajectory(
            [1.0, 2.0, 3.0], [[0.5, 0.0], [0.8, 0.5], [1.0, 0.6]], np.zeros((3, 2)), accelerations
        ),
        START,
    )
    for t, a in zip((1.0, 2.0, 3.0), accelerations, strict=True):
        np.testing.assert_allclose(path.acceleration(t - 1e-9), a, atol=1e-6)
    np.testing.assert_allclose(path.acceleration(0.0), 0.0)


def test_velocities_are_those_of_the_curve():
    path = TrajectoryPath(trajectory([0.5, 1.5, 2.0], [[1, 0], [0, 1], [0.5, 0.5]]), START)
    path.slow(0.5)
    times = np.linspace(0.1, 3.9, 20)
    np.testing.assert_allclose([path.at(t)[1] for t in times], speeds(path, times), atol=1e-6)
    assert path.duration_s == 4.0
    before = [path.at(t - 1e-6)[1] for t in times]
    after = [path.at(t + 1e-6)[1] for t in times]
    found = (np.array(after) - before) / 2e-6
    np.testing.assert_allclose([path.acceleration(t) for t in times], found, atol=1e-3)


@given(st.lists(st.lists(st.floats(-3, 3), min_size=2, max_size=2), min_size=2, max_size=8))
def test_without_velocities_no_joint_swings_beyond_its_points(rows):
    times = np.arange(1, len(rows) + 1) * 0.7
    path = TrajectoryPath(trajectory(times, rows), START)
    knots = np.vstack((START, rows))
    for index in range(len(knots) - 1):
        low = np.minimum(knots[index], knots[index + 1]) - 1e-9
        high = np.maximum(knots[index], knots[index + 1]) + 1e-9
        for t in np.linspace(0.7 * index, 0.7 * (index + 1), 9):
            q = path.at(t)[0]
            assert np.all((low <= q) & (q <= high))


def test_it_rests_before_and_after():
    path = TrajectoryPath(trajectory([1.0], [[1.0, 1.0]]), START)
    np.testing.assert_allclose(path.at(-1.0)[0], START)
    np.testing.assert_allclose(path.at(9.0)[0], [1.0, 1.0])
    np.testing.assert_allclose(path.at(9.0)[1], 0.0, atol=1e-12)


def test_a_point_at_the_start_is_where_the_arm_is():
    path = TrajectoryPath(trajectory([0.0, 1.0], [START + 0.01, [1.0, 1.0]]), START)
    np.testing.assert_allclose(path.at(0.0)[0], START)
    np.testing.assert_allclose(path.at(1.0)[0], [1.0, 1.0])
    alone = TrajectoryPath(trajectory([0.0], [START]), START)
    assert alone.duration_s == 0.0
    np.testing.assert_allclose(alone.at(0.0)[0], START)


def test_samples_are_as_near_as_asked_and_bounded():
    path = TrajectoryPath(trajectory([1.0, 2.0], [[1.0, 0.0], [1.0, 0.5]]), START)
    times = samples(path, 0.05, 200)
    rows = np.array([path.at(t)[0] for t in times])
    assert times[0] == 0.0
    assert times[-1] == 2.0
    assert np.abs(np.diff(rows, axis=0)).max() < 0.1
    with pytest.raises(MotionRefusedError, match="too long to be looked through"):
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
