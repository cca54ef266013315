"""Kinematics of the arms: Jacobian against finite differences, inverse against forward
kinematics."""

import math

import numpy as np
import pinocchio as pin
import pytest

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose, to_se3
from cardan.robots import arm_names, load_arm
from cardan.spatial import from_rotation_vector, same_hemisphere
from cardan.types import IDENTITY_POSE, Pose, Vector3
from tests.examples import ARMS_LATER

POSES = 200
"""Number of poses per arm; the benchmark uses thousands."""


def arm(name, **options):
    return ArmKinematics(load_arm(name), **options)


def random_configurations(kinematics, count, seed=0):
    generator = np.random.default_rng(seed)
    low = np.where(kinematics.continuous, -math.pi, kinematics.lower)
    high = np.where(kinematics.continuous, math.pi, kinematics.upper)
    return generator.uniform(low, high, (count, kinematics.joints))


def error(a, b):
    """Distance (m) and angle (rad) between two placements."""
    difference = a.actInv(b)
    return np.linalg.norm(difference.translation), np.linalg.norm(pin.log3(difference.rotation))


@pytest.mark.parametrize("name", arm_names())
def test_the_jacobian_is_the_derivative_in_tcp_axes(name):
    kinematics = arm(name, tool=Pose(Vector3(0.02, -0.03, 0.1), from_rotation_vector((1, 2, 0.5))))
    for q in random_configurations(kinematics, 5):
        kinematics.update(q)
        start, jacobian = kinematics.placement.copy(), kinematics.jacobian.copy()
        for joint in range(kinematics.joints):
            step = np.zeros(kinematics.joints)
            step[joint] = 1e-6
            moved = start.actInv(kinematics.forward(q + step))
            twist = np.concatenate((moved.translation, pin.log3(moved.rotation))) / 1e-6
            assert twist == pytest.approx(jacobian[:, joint], abs=2e-5)


@pytest.mark.matrix(*ARMS_LATER)
@pytest.mark.parametrize("name", arm_names())
def test_the_inverse_finds_reachable_poses_inside_the_limits(name):
    kinematics = arm(name)
    goals = random_configurations(kinematics, POSES, seed=1)
    starts = random_configurations(kinematics, POSES, seed=2)
    found = 0
    for goal, start in zip(goals, starts, strict=True):
        placement = kinematics.forward(goal)
        q = kinematics.inverse(placement, start)
        if q is None:
            continue
        found += 1
        assert kinematics.within_limits(q)
        assert error(kinematics.forward(q), placement) == pytest.approx((0, 0), abs=3e-6)
    assert found >= 0.995 * POSES


@pytest.mark.parametrize("name", ["ur5", "gofa_crb15000_5", "gp8", "teo_left_arm"])
def test_the_inverse_stays_on_the_branch_it_starts_on(name):
    kinematics = arm(name)
    home = np.array(kinematics.arm.home)
    for step in random_configurations(kinematics, 50, seed=3):
        goal = np.clip(home + 0.02 * step, kinematics.lower, kinematics.upper)
        q = kinematics.inverse(kinematics.forward(goal), home)
        assert q == pytest.approx(goal, abs=1e-4)


def test_an_unreachable_pose_has_no_inverse():
    kinematics = arm("ur5")
    far = kinematics.forward(np.array(kinematics.arm.home))
    far.translation = np.array((2.0, 0.0, 0.0))
    assert kinematics.inverse(far, np.array(kinematics.arm.home), restarts=3) is None


def test_branches_are_different_ways_to_the_same_pose_nearest_first():
    kinematics = arm("ur5")
    home = np.array(kinematics.arm.home)
    placement = kinematics.forward(home)
    branches = kinematics.branches(placement, home)
    assert len(branches) >= 4
    assert branches[0] == pytest.approx(home, abs=1e-5)
    times = [float((np.abs(q - home) / kinematics.velocity).max()) for q in branches]
    assert times == sorted(times)
    for q in branches:
        assert error(kinematics.forward(q), placement) == pytest.approx((0, 0), abs=3e-6)


def test_whole_turns_are_added_to_be_near_but_never_beyond_a_limit():
    kinematics = arm("ur5")  # five joints of ±360 degrees, the elbow ±180
    near = np.radians([350.0, -350.0, 170.0, 0.0, 190.0, -10.0])
    q = np.radians([-20.0, 20.0, -170.0, 350.0, -190.0, 5.0])
    moved = np.degrees(kinematics.nearest_turns(q, near))
    assert moved == pytest.approx([340.0, -340.0, -170.0, -10.0, 170.0, 5.0])


@pytest.mark.parametrize("name", ["pr2_left_arm", "pr2_right_arm"])
def test_no_rounding_turns_a_joint_away_from_its_end(name):
    """The joint's range is more than half a turn and less than a whole one."""
    kinematics, roll = arm(name), 2
    for end, near in (("lower", "upper"), ("upper", "lower")):
        q, other = (np.array(kinematics.arm.home) for _ in range(2))
        q[roll], other[roll] = getattr(kinematics, end)[roll], getattr(kinematics, near)[roll]
        assert kinematics.nearest_turns(q, other).tolist() == q.tolist()


def test_continuous_joints_count_their_turns():
    kinematics = arm("pr2_right_arm")
    near = np.array(kinematics.arm.home)
    near[6] += 20.0 * math.pi  # ten turns of the wrist
    placement = kinematics.forward(near)
    assert kinematics.inverse(placement, near) == pytest.approx(near, abs=1e-5)


def test_a_tool_moves_the_tcp_and_comes_off_again():
    kinematics = arm("ur5")
    home = np.array(kinematics.arm.home)
    bare = kinematics.forward(home)
    tool = Pose(Vector3(0.0, 0.0, 0.15), from_rotation_vector(Vector3(0.0, 0.3, 0.0)))
    kinematics.set_tool(tool)
    assert error(kinematics.forward(home), bare * to_se3(tool)) == pytest.approx((0, 0), abs=1e-12)
    kinematics.set_tool(IDENTITY_POSE)
    assert error(kinematics.forward(home), bare) == pytest.approx((0, 0), abs=1e-12)


def test_five_joints_come_as_near_as_they_can():
    kinematics = arm("asibot")
    home = np.array(kinematics.arm.home)
    weights = np.array((1.0, 1.0, 1.0, 0.01, 0.01, 0.01))
    goal = kinematics.forward(home)
    goal.rotation = goal.rotation @ pin.exp3(np.array((0.4, 0.0, 0.0)))
    q, reached = kinematics.nearest(goal, home, weights)
    meters, radians = error(reached, goal)
    assert meters < 1e-3
    assert 0.05 < radians < 0.41
    assert kinematics.within_limits(q)
    exact = kinematics.forward(home + 0.1)
    assert error(kinematics.nearest(exact, home, weights)[1], exact) == pytest.approx(
        (0, 0), abs=1e-5
    )


def test_poses_survive_the_way_to_pinocchio_and_back():
    pose = Pose(Vector3(0.1, -0.2, 0.3), from_rotation_vector(Vector3(0.5, 1.0, -2.0)))
    back = to_pose(to_se3(pose))
    assert back.position == pytest.approx(pose.position)
    same = same_hemisphere(back.orientation, pose.orientation)
    assert tuple(same) == pytest.approx(tuple(pose.orientation))
