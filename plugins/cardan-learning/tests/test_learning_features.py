"""Rotation vectors without jumps, and feature names known to LeRobot."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cardan.errors import OptionError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.robots import arm_names, load_arm
from cardan.spatial import compose, norm, rotation_between, subtract
from cardan.types import IDENTITY_POSE, ZERO3, Pose, Quaternion
from cardan_learning.features import (
    ActionKind,
    Continuous,
    action_kind,
    action_names,
    observation_names,
    pose_of,
    reference_of,
    six_of,
)

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


def near_home(model, seed):
    """Return a pose with joints up to 2 mrad off the arm's home."""
    away = np.random.default_rng(seed).uniform(-2e-3, 2e-3, len(model.joints))
    placement = ArmKinematics(model).forward(np.array(model.home) + away)
    return six_of(to_pose(placement))


@pytest.mark.parametrize("tool", [IDENTITY_POSE, Pose(ZERO3, Quaternion(0.0, 0.0, 0.0, 1.0))])
@pytest.mark.parametrize("name", arm_names())
def test_sessions_of_an_arm_write_alike_wherever_they_begin(name, tool):
    model = load_arm(name)
    reference = reference_of(model, tool)
    written = []
    for seed in range(40):
        pose = pose_of(near_home(model, seed))
        six = six_of(compose(pose, tool))
        written.append(Continuous(reference).of(six)[3:])
        assert same((0.0, 0.0, 0.0, *written[-1]), six)
        assert math.dist(written[-1], reference) < 0.03
        # Vectors written earlier in a session make no difference.
        late = Continuous(reference)
        late.of((0.0, 0.0, 0.0, 0.1 * seed - 2.0, 0.3, -1.0))
        assert late.of(six)[3:] == written[-1]
    assert max(math.dist(written[0], each) for each in written) < 0.03


def test_the_reference_is_where_the_arms_home_is():
    for name in arm_names():
        model = load_arm(name)
        placement = to_pose(ArmKinematics(model).forward(np.array(model.home)))
        assert norm(subtract(model.home_tcp.position, placement.position)) < 1e-9
        assert same(six_of(model.home_tcp), six_of(placement))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((-2.2213, 2.2215, 0.0), (-2.2215, 2.2213, 0.0)),
        ((-1.9999, 0.0, 0.0), (-2.0001, 0.0, 0.0)),
    ],
)
def test_without_a_model_too_a_hairs_breadth_makes_no_difference(one, other):
    first = Continuous().of((0.0, 0.0, 0.0, *one))[3:]
    assert math.dist(first, Continuous().of((0.0, 0.0, 0.0, *other))[3:]) < 1e-3


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
