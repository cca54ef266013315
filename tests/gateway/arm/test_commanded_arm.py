"""An arm in task space is placed, braked and brought back inside its limits."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.arm.commanded_arm import (
    APPROACH_SPEED_M_S,
    APPROACH_SPEED_RAD_S,
    FASTEST_TCP_M_S,
    FASTEST_TCP_RAD_S,
    READING_NOISE_M,
    READING_NOISE_RAD,
    FollowingError,
    TaskSpaceArm,
    equal_steps,
)
from cardan.gateway.arm.motions.base import Deceleration
from cardan.gateway.arm.motions.pose_stream import RESTING_M_S, FollowPoseStream
from cardan.gateway.motion.shaping import PoseShaper, PoseShaperLimits
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.spatial import (
    dot,
    from_rotation_vector,
    norm,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import (
    IDENTITY,
    ZERO3,
    ZERO_TWIST,
    Pose,
    PoseCommand,
    Quaternion,
    RobotLink,
    RobotState,
    Twist,
    Vector3,
)

DT_S = 0.004
LIMITS = ReferenceLimits()


def robot(pose):
    return RobotState(10.0, RobotLink.LIVE, 1, 0, DT_S, (), (), pose, "")


def at(x=0.0, y=0.0, z=0.0, turn=ZERO3):
    return robot(Pose(Vector3(x, y, z), from_rotation_vector(turn)))


def moving(linear=ZERO3, angular=ZERO3):
    """An arm that is commanded to move with this twist."""
    commanded = TaskSpaceArm(LIMITS)
    commanded.place(at())
    reference = Reference(LIMITS)
    reference.place(commanded.pose)
    reference.linear, reference.angular = linear, angular
    commanded.follow(reference, DT_S)
    return commanded


# -- following errors ----------------------------------------------------------------------------


def test_a_following_error_is_too_large_when_one_of_its_parts_is():
    limit = FollowingError(0.1, 0.6, 0.2)
    assert not limit.exceeds(limit)
    for part in ("linear_m", "angular_rad", "joint_error"):
        error = FollowingError(0.0, 0.0)._replace(**{part: 1.01 * getattr(limit, part)})
        assert error.exceeds(limit)
        assert not error.exceeds(limit, 2.0)
    assert FollowingError(0.06, 0.0).exceeds(limit, 0.5)


def test_a_following_error_is_said_in_words():
    words = FollowingError(0.012, 0.1, 0.1, "joint_2").in_words("behind")
    assert words == "the robot is 12 mm and 0.10 rad behind its reference (joint_2 by 0.10)"
    words = FollowingError(0.0, 0.0, 0.25, "joint_3").in_words("away from")
    assert words == "joint_3 is 0.250 rad away from where it was commanded to be"


def test_the_reference_knows_how_far_a_free_pose_is_from_its_robot():
    commanded, reference = TaskSpaceArm(LIMITS), Reference(LIMITS)
    commanded.place(at())
    assert commanded.following_error(at(0.1), None) == FollowingError(0.0, 0.0)
    reference.place(commanded.pose)
    reference.observe(at(0.03, turn=Vector3(0.0, 0.2, 0.0)).pose)
    error = commanded.following_error(at(0.03), reference)
    assert error == pytest.approx((0.03, 0.2, 0.0, ""))


# -- measured states -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (None, "no pose"),
        (Pose(Vector3(math.nan, 0.0, 0.0), IDENTITY), "not numbers"),
        (Pose(ZERO3, Quaternion(math.inf, 0.0, 0.0, 0.0)), "not numbers"),
        (Pose(Vector3(200.0, 0.0, 0.0), IDENTITY), "200 m away"),
        (Pose(ZERO3, IDENTITY), ""),
    ],
)
def test_a_robot_without_a_usable_pose_is_an_obstacle(pose, words):
    found = TaskSpaceArm(LIMITS).obstacle(robot(pose), True)
    assert words in found if words else found == ""


def test_no_tcp_goes_farther_than_any_arm_can():
    commanded = TaskSpaceArm(LIMITS)
    most_m = READING_NOISE_M + FASTEST_TCP_M_S * 0.02
    assert commanded.jump(at(), at(0.99 * most_m), 0.02) == ""
    assert "jumped by 112 mm" in commanded.jump(at(), at(1.02 * most_m), 0.02)
    most_rad = READING_NOISE_RAD + FASTEST_TCP_RAD_S * 0.02
    turned = at(turn=Vector3(0.99 * most_rad, 0.0, 0.0))
    assert commanded.jump(at(), turned, 0.02) == ""
    assert "0.36 rad" in commanded.jump(at(), at(turn=Vector3(1.02 * most_rad, 0.0, 0.0)), 0.02)
    assert commanded.jump(robot(None), at(), 0.02) == commanded.jump(at(), robot(None), 0.02) == ""


# -- placing -------------------------------------------------------------------------------------


def test_it_begins_at_rest_where_the_robot_is():
    commanded = TaskSpaceArm(LIMITS)
    assert not commanded.placed
    commanded.place(at(0.5, 0.1, 0.2))
    assert commanded.placed
    assert not commanded.moving
    assert commanded.command(at(), DT_S) == PoseCommand(at(0.5, 0.1, 0.2).pose, ZERO_TWIST)


def test_it_goes_on_at_the_speed_that_the_robot_really_has():
    commanded = moving(Vector3(0.2, 0.0, 0.0), Vector3(0.0, 0.0, 0.4))
    turned = at(0.0102, turn=Vector3(0.0, 0.0, 0.0004))
    commanded.place(turned, at(0.01), 0.002)  # half of the commanded speed
    assert commanded.twist.linear == pytest.approx((0.1, 0.0, 0.0))
    assert commanded.twist.angular == pytest.approx((0.0, 0.0, 0.2))
    assert commanded.pose.position == pytest.approx((0.0102, 0.0, 0.0))


@pytest.mark.parametrize(
    ("state", "before", "time_s"),
    [
        (at(0.01), None, 0.004),
        (at(0.01), robot(None), 0.004),
        (at(0.01), at(), 0.0),
        (at(0.5), at(), 0.004),
        (at(-0.001), at(), 0.004),
    ],
    ids=["no state before", "no pose before", "no time", "a jump", "backwards"],
)
def test_a_speed_that_is_not_known_or_not_commanded_is_none(state, before, time_s):
    commanded = moving(Vector3(0.2, 0.0, 0.0))
    commanded.place(state, before, time_s)
    assert commanded.twist == ZERO_TWIST


small = st.floats(-0.02, 0.02)
speeds = st.floats(-1.0, 1.0)
offsets = st.builds(Vector3, small, small, small)
velocities = st.builds(Vector3, speeds, speeds, speeds)


@given(velocities, velocities, offsets, offsets, st.floats(0.0, 0.6))
def test_it_is_never_placed_faster_than_commanded_or_in_another_direction(
    linear, angular, way, turn, time_s
):
    commanded = moving(linear, angular)
    commanded.place(robot(Pose(way, from_rotation_vector(turn))), at(), time_s)
    twist = commanded.twist
    for after, before in ((twist.linear, linear), (twist.angular, angular)):
        assert norm(after) <= norm(before) * (1.0 + 1e-9)
        assert dot(after, before) >= 0.0
        across = subtract(scale(after, norm(before)), scale(before, norm(after)))
        assert norm(across) <= 1e-9


# -- motion --------------------------------------------------------------------------------------


def step(commanded, move):
    """Move for one period; check that the pose moves by the twist, and that the twist changes
    within the acceleration."""
    before, twist = commanded.pose, commanded.twist
    move()
    way = subtract(commanded.pose.position, before.position)
    turn = rotation_between(before.orientation, commanded.pose.orientation)
    assert way == pytest.approx(scale(commanded.twist.linear, DT_S), abs=1e-9)
    assert turn == pytest.approx(scale(commanded.twist.angular, DT_S), abs=1e-8)
    change = norm(subtract(commanded.twist.linear, twist.linear))
    assert change <= LIMITS.linear_acceleration_m_s2 * DT_S * (1.0 + 1e-9)
    change = norm(subtract(commanded.twist.angular, twist.angular))
    assert change <= LIMITS.angular_acceleration_rad_s2 * DT_S * (1.0 + 1e-9)


def test_it_brakes_to_rest_in_a_ramp_and_no_longer_than_needed():
    commanded = moving(Vector3(0.0, 0.2, 0.0), Vector3(0.4, 0.0, 0.0))
    for _ in range(math.ceil(0.2 / LIMITS.linear_acceleration_m_s2 / DT_S) + 1):
        step(commanded, lambda: commanded.brake(DT_S))
    assert not commanded.moving


def test_halting_is_at_once():
    commanded = moving(Vector3(0.2, 0.0, 0.0))
    where = commanded.pose
    commanded.halt()
    assert not commanded.moving
    assert commanded.pose == where


def test_it_comes_back_to_its_robot_slowly_and_without_overshoot():
    commanded, away = moving(), at(0.06, 0.0, -0.06, Vector3(0.0, 0.3, 0.0))
    left_m = norm(subtract(away.pose.position, commanded.pose.position))
    for _ in range(1000):
        step(commanded, lambda: commanded.approach(away, DT_S))
        assert norm(commanded.twist.linear) <= APPROACH_SPEED_M_S * (1.0 + 1e-9)
        assert norm(commanded.twist.angular) <= APPROACH_SPEED_RAD_S * (1.0 + 1e-9)
        now_m = norm(subtract(away.pose.position, commanded.pose.position))
        assert now_m <= left_m + 1e-9
        left_m = now_m
    assert left_m < 1e-4


def test_it_follows_its_reference_exactly():
    commanded, reference = moving(), Reference(LIMITS)
    reference.place(commanded.pose)
    reference.shape(Twist(Vector3(0.1, 0.0, 0.0), ZERO3), DT_S)
    assert commanded.follow(reference, DT_S) == 1.0
    assert commanded.pose == reference.pose
    assert commanded.twist == reference.twist


def test_a_period_is_one_step_and_no_time_is_none():
    commanded = TaskSpaceArm(LIMITS)
    assert equal_steps(0.02, commanded.longest_step_s) == [0.02]
    assert equal_steps(0.0, commanded.longest_step_s) == []
    assert commanded.status() is None
    assert commanded.held_by() == ""
    assert commanded.settled


@pytest.mark.parametrize(
    ("shift_m", "turn_rad", "speed_m_s", "speed_rad_s", "driven"),
    [
        (0.0, 0.0, 0.0, 0.0, False),
        (0.9e-6, 0.9e-5, 0.9 * RESTING_M_S, 0.9 * RESTING_M_S, False),
        (1.1e-6, 0.0, 0.0, 0.0, True),
        (0.0, 1.1e-5, 0.0, 0.0, True),
        (0.0, 0.0, 1.1 * RESTING_M_S, 0.0, True),
        (0.0, 0.0, 0.0, 1.1 * RESTING_M_S, True),
    ],
)
def test_a_streamed_pose_drives_its_arm_until_it_rests_there(
    shift_m, turn_rad, speed_m_s, speed_rad_s, driven
):
    commanded, reference = TaskSpaceArm(LIMITS), Reference(LIMITS)
    commanded.place(at())
    shaper = PoseShaper(PoseShaperLimits())
    motion = FollowPoseStream(commanded, reference, Deceleration(1.0, 1.0, 1.0), shaper)
    assert not motion.driven
    motion.aim(at(y=shift_m, turn=Vector3(0.0, 0.0, turn_rad)).pose, 1.0)
    reference.linear, reference.angular = Vector3(speed_m_s, 0, 0), Vector3(0, speed_rad_s, 0)
    assert motion.driven is driven
    motion.brake()
    assert not motion.driven
