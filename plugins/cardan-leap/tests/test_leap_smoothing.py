"""Low-pass filter of a hand's pose."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from cardan.spatial import from_rotation_vector, norm, rotation_between, subtract
from cardan.types import IDENTITY, IDENTITY_POSE, Pose, Vector3
from cardan_leap.driver.smoothing import MAX_TURN_RAD_S, PoseFilter

vectors = st.builds(Vector3, *[st.floats(-1.0, 1.0)] * 3)
poses = st.builds(
    Pose,
    vectors,
    st.builds(Vector3, *[st.floats(-2.0, 2.0)] * 3).map(from_rotation_vector),
)


def ahead(x_m: float, roll_rad: float = 0.0) -> Pose:
    return Pose(Vector3(x_m, 0.0, 0.0), from_rotation_vector(Vector3(roll_rad, 0.0, 0.0)))


def test_the_first_pose_passes_and_a_reset_forgets():
    smooth = PoseFilter(4.0, 20.0, 1.5)
    assert smooth(ahead(0.3), 0.01) == ahead(0.3)
    smooth.reset()
    assert smooth(ahead(-0.3), 0.01) == ahead(-0.3)


def test_without_time_nothing_moves():
    smooth = PoseFilter(4.0, 20.0, 1.5)
    smooth(IDENTITY_POSE, 0.01)
    assert smooth(ahead(0.3), 0.0) == IDENTITY_POSE


def test_without_a_cut_off_only_the_speed_is_limited():
    smooth = PoseFilter(0.0, 0.0, 1.0)
    smooth(IDENTITY_POSE, 0.01)
    assert smooth(ahead(0.005, 0.05), 0.01).position.x == pytest.approx(0.005)
    assert smooth(ahead(0.5, 0.05), 0.01).position.x == pytest.approx(0.015)


@pytest.mark.parametrize("steps", [1, 4, 40])
def test_a_step_decays_by_time_and_not_by_number(steps):
    smooth = PoseFilter(3.0, 0.0, 1e3)
    smooth(IDENTITY_POSE, 0.1)
    for _ in range(steps):
        pose = smooth(ahead(0.1, 0.2), 0.1 / steps)
    left = math.exp(-math.tau * 3.0 * 0.1)
    assert pose.position.x == pytest.approx(0.1 * (1.0 - left), rel=1e-6)
    turned = norm(rotation_between(IDENTITY, pose.orientation))
    assert turned == pytest.approx(0.2 * (1.0 - left), rel=1e-6)


def test_a_fast_hand_lags_less():
    lags = []
    for rise in (0.0, 20.0):
        smooth = PoseFilter(2.0, rise, 10.0)
        for step in range(100):
            pose = smooth(ahead(0.005 * step), 0.01)
        lags.append(0.495 - pose.position.x)
    assert lags[1] < 0.3 * lags[0]


@given(st.lists(st.tuples(poses, st.floats(0.0, 0.1)), min_size=2, max_size=20))
def test_it_never_moves_or_turns_faster_than_allowed(story):
    smooth = PoseFilter(4.0, 20.0, 1.5)
    last = smooth(*story[0])
    for raw, dt_s in story[1:]:
        pose = smooth(raw, dt_s)
        assert norm(subtract(pose.position, last.position)) <= 1.5 * dt_s + 1e-9
        turn = norm(rotation_between(last.orientation, pose.orientation))
        assert turn <= MAX_TURN_RAD_S * dt_s + 1e-6
        assert math.hypot(*pose.orientation) == pytest.approx(1.0)
        last = pose
