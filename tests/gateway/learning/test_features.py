"""Rotation vectors are written without jumps, and names are those that LeRobot knows."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.errors import OptionError
from cardan.gateway.learning.features import (
    ActionKind,
    Continuous,
    action_kind,
    action_names,
    observation_names,
    pose_of,
    six_of,
)
from cardan.spatial import norm, rotation_between

ANGLES = st.floats(-3.0, 3.0)


def same(a, b):
    return norm(rotation_between(pose_of(a).orientation, pose_of(b).orientation)) < 1e-6


def test_a_tool_that_points_down_does_not_jump():
    written = Continuous()
    before = None
    for step in range(-100, 101):
        turn = math.pi + 0.002 * step
        six = six_of(pose_of((0.4, 0.0, 0.3, turn, 0.05 * math.sin(step), 0.0)))
        now = written.of(six)
        assert same(now, six)
        assert now[3] > 0.0
        if before is not None:
            assert math.dist(before, now) < 0.2
        before = now


@given(st.lists(st.tuples(ANGLES, ANGLES, ANGLES), min_size=1, max_size=8))
def test_what_is_written_is_the_same_orientation(turns):
    written = Continuous()
    for turn in turns:
        six = six_of(pose_of((0.1, 0.2, 0.3, *turn)))
        assert same(written.of(six), six)


def test_two_sessions_that_begin_alike_write_alike():
    down = 3.1
    for sign in (1.0, -1.0):
        first = six_of(pose_of((0.0, 0.0, 0.0, sign * (math.pi + sign * 0.01), 0.02, 0.0)))
        written = Continuous()
        written.of(first)
        assert written.of((0.0, 0.0, 0.0, down, 0.0, 0.0))[3] == pytest.approx(down)


def test_names():
    assert action_names(ActionKind.DELTA, True) == (
        *("delta_x", "delta_y", "delta_z", "delta_wx", "delta_wy", "delta_wz"),
        "gripper",
    )
    assert action_names(ActionKind.TARGET, True)[0] == "enabled"
    assert action_names(ActionKind.TARGET, True)[-1] == "gripper_vel"
    assert action_names(ActionKind.POSE, False) == (
        *("ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz"),
    )
    assert observation_names(("a", "b"), True) == (
        *("a.pos", "b.pos", "ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz"),
        "gripper.pos",
    )
    with pytest.raises(OptionError, match="'joints' is not allowed; it must be one of delta, pose"):
        action_kind("joints", (ActionKind.DELTA, ActionKind.POSE))
