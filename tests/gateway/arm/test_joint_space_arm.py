"""A commanded arm in joint space."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from cardan.drivers.robot_core import JUMP_NOISE_RAD, JUMP_SHARE
from cardan.gateway.arm.commanded_arm import (
    APPROACH_SPEED_M_S,
    APPROACH_SPEED_RAD_S,
    APPROACH_TIME_S,
    FASTEST_TCP_M_S,
    FASTEST_TCP_RAD_S,
    equal_steps,
)
from cardan.gateway.arm.joint_space_arm import (
    APPROACH_SHARE,
    CORRECTION_SHARE,
    JOINT_TCP_TOLERANCE_M,
    POSE_TCP_TOLERANCE_M,
    JointSpaceArm,
)
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.servo.servo import LONGEST_SERVO_STEP_S, Servo
from cardan.robots import load_arm
from cardan.spatial import add, from_rotation_vector, multiply
from cardan.types import (
    CommandKind,
    JointCommand,
    JointVelocityCommand,
    RobotCapabilities,
    RobotLink,
    RobotState,
    Vector3,
)
from tests.examples import examples

DT_S = 0.004
MODEL = load_arm("ur5")
KINEMATICS = ArmKinematics(MODEL)
HOME = np.array(MODEL.home)
STATE = RobotState(1.0, RobotLink.LIVE, 1, 0, DT_S, tuple(MODEL.home), (), None, "")


def robot(joints=HOME, pose=None):
    return STATE._replace(joints=tuple(np.asarray(joints).tolist()), pose=pose)


def arm(*kinds, kinematics=KINEMATICS, **more):
    return JointSpaceArm(Servo(kinematics), frozenset(kinds or (CommandKind.JOINT,)), **more)


def moving(v, *kinds):
    """An arm whose joints are commanded to move at `v`."""
    commanded = arm(*kinds)
    commanded.place(robot())
    commanded.servo.v[:] = v
    return commanded


# -- valid commands --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kinds", "chosen"),
    [
        ((CommandKind.POSE, CommandKind.JOINT_VELOCITY, CommandKind.JOINT), CommandKind.JOINT),
        ((CommandKind.POSE, CommandKind.JOINT_VELOCITY), CommandKind.JOINT_VELOCITY),
        ((CommandKind.POSE, CommandKind.TORQUE), CommandKind.POSE),
        ((CommandKind.TORQUE,), None),
    ],
)
def test_the_best_of_the_commands_that_the_robot_takes_is_sent(kinds, chosen):
    assert arm(*kinds).kind is chosen


def test_a_usual_period_is_one_step_and_a_long_one_several():
    longest_s = arm().longest_step_s
    assert [equal_steps(dt_s, longest_s) for dt_s in (0.0, 0.001, LONGEST_SERVO_STEP_S)] == [
        [],
        [0.001],
        [LONGEST_SERVO_STEP_S],
    ]
    assert equal_steps(0.02, longest_s) == pytest.approx([0.005] * 4)


def test_the_last_gate_knows_the_joints_limits_and_the_robots_own():
    capabilities = RobotCapabilities(frozenset(), DT_S, 6, None, 0, 0)
    limits = arm().output_limits(capabilities)
    assert limits.joint_lower == tuple(KINEMATICS.lower)
    assert limits.joint_upper == tuple(KINEMATICS.upper)
    assert limits.joint_speed == tuple(KINEMATICS.velocity)
    assert limits.joint_acceleration == tuple(KINEMATICS.acceleration)
    assert limits.linear_speed_m_s == FASTEST_TCP_M_S
    assert limits.angular_speed_rad_s == FASTEST_TCP_RAD_S
    slow = capabilities._replace(linear_speed_m_s=0.25, angular_speed_rad_s=0.5)
    limits = arm().output_limits(slow)
    assert limits.linear_speed_m_s == 0.25
    assert limits.angular_speed_rad_s == 0.5


# -- agreement of robot and model ----------------------------------------------------------------


def reported(shift_m=0.0, turn_rad=0.0):
    """The TCP pose of the model, shifted and turned by this much."""
    pose = to_pose(KINEMATICS.forward(HOME))
    turn = from_rotation_vector(Vector3(0.0, 0.0, turn_rad))
    return pose._replace(
        position=add(pose.position, Vector3(shift_m, 0.0, 0.0)),
        orientation=multiply(turn, pose.orientation),
    )


@pytest.mark.parametrize(
    ("kind", "tolerance_m", "minds_turns"),
    [
        (CommandKind.POSE, POSE_TCP_TOLERANCE_M, True),
        (CommandKind.JOINT, JOINT_TCP_TOLERANCE_M, False),
        (CommandKind.JOINT_VELOCITY, JOINT_TCP_TOLERANCE_M, False),
    ],
)
def test_a_tcp_that_contradicts_the_joints_is_a_misfit(kind, tolerance_m, minds_turns):
    commanded = arm(kind)
    assert commanded.obstacle(robot(pose=reported(0.9 * tolerance_m)), True) == ""
    words = commanded.obstacle(robot(pose=reported(1.1 * tolerance_m)), True)
    assert f"{1.1e3 * tolerance_m:.1f} mm away from the arm model's" in words
    words = commanded.obstacle(robot(pose=reported(turn_rad=0.1)), True)
    assert ("0.100 rad" in words) is minds_turns


def test_tool_and_model_are_compared_only_where_the_robot_is_new_and_tells_its_pose():
    commanded = arm(CommandKind.POSE)
    assert commanded.obstacle(robot(pose=reported(0.5)), False) == ""
    assert commanded.obstacle(robot(), True) == ""
    assert arm(CommandKind.TORQUE).obstacle(robot(pose=reported(0.5)), True) == ""
    assert arm(tcp_tolerance_m=0.6).obstacle(robot(pose=reported(0.5)), True) == ""


@pytest.mark.parametrize(
    ("joints", "words"),
    [((0.0,) * 5, "reports 5 joints, the arm's model has 6"), ((math.inf,) * 6, "not numbers")],
)
def test_joints_that_are_none_of_this_arm_are_an_obstacle(joints, words):
    assert words in arm().obstacle(robot(joints), False)


# -- jumps ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", range(6))
def test_no_joint_goes_farther_than_twice_its_speed_allows(joint):
    commanded, away = arm(), np.zeros(6)
    most = JUMP_NOISE_RAD + JUMP_SHARE * KINEMATICS.velocity[joint] * 0.02
    away[joint] = 0.99 * most
    assert commanded.jump(robot(), robot(HOME + away), 0.02) == ""
    away[joint] = 1.01 * most
    words = commanded.jump(robot(), robot(HOME - away), 0.02)
    assert KINEMATICS.names[joint] in words
    assert "in 20 ms" in words


def test_the_worst_joint_is_named_and_whole_turns_are_no_jump():
    away = np.array((0.3, 0.0, 0.0, -0.9, 0.0, 0.0))
    assert KINEMATICS.names[3] in arm().jump(robot(), robot(HOME + away), DT_S)
    pr2 = load_arm("pr2_right_arm")
    kinematics, home = ArmKinematics(pr2), np.array(pr2.home)
    commanded, turn = arm(kinematics=kinematics), np.zeros(7)
    turn[6] = 2.0 * math.pi
    assert kinematics.continuous[6]
    assert commanded.jump(robot(home), robot(home + turn), DT_S) == ""


# -- placing -------------------------------------------------------------------------------------


def test_it_begins_at_rest_where_the_robot_is():
    commanded = moving(np.full(6, 0.1))
    commanded.place(robot(HOME + 0.2))
    assert commanded.placed
    assert not commanded.moving
    np.testing.assert_allclose(commanded.servo.q, HOME + 0.2)
    assert commanded.twist.linear == (0.0, 0.0, 0.0)


def test_it_goes_on_at_the_speeds_that_the_joints_really_have():
    commanded = moving(np.array((0.4, -0.4, 0.4, 0.0, 0.4, -0.4)))
    way = DT_S * np.array((0.2, -0.2, 0.8, 0.3, -0.2, 0.0))
    commanded.place(robot(HOME + way), robot(), DT_S)
    # In order: as commanded, faster than commanded, not commanded, against the command, at rest.
    np.testing.assert_allclose(commanded.servo.v, (0.2, -0.2, 0.4, 0.0, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(commanded.servo.q, HOME + way)
    twist = (
        KINEMATICS.placement.rotation @ (KINEMATICS.jacobian @ commanded.servo.v).reshape(2, 3).T
    )
    assert commanded.twist.linear == pytest.approx(tuple(twist.T[0]), abs=1e-9)
    assert commanded.twist.angular == pytest.approx(tuple(twist.T[1]), abs=1e-9)


@pytest.mark.parametrize(
    ("way_rad", "before", "time_s"),
    [
        (0.001, None, DT_S),
        (0.001, robot()._replace(joints=()), DT_S),
        (0.001, robot(), 0.0),
        (0.9, robot(), DT_S),
    ],
    ids=["no state before", "no joints before", "no time", "a jump"],
)
def test_speeds_that_are_not_known_are_none(way_rad, before, time_s):
    commanded = moving(np.full(6, 0.3))
    commanded.place(robot(HOME + way_rad), before, time_s)
    assert not commanded.moving


joint_values = st.tuples(*[st.floats(-0.05, 0.05)] * 6).map(np.array)
joint_speeds = st.tuples(*[st.floats(-3.0, 3.0)] * 6).map(np.array)


@settings(max_examples=examples(50), suppress_health_check=list(HealthCheck))
@given(joint_speeds, joint_values, st.floats(0.0, 0.5))
def test_no_joint_is_placed_faster_than_commanded_or_the_other_way(v, way, time_s):
    commanded = moving(v)
    commanded.place(robot(HOME + way), robot(), time_s)
    after = commanded.servo.v
    assert (np.abs(after) <= np.abs(v) + 1e-12).all()
    assert (after * v >= 0.0).all()


def test_an_arm_of_velocities_that_is_placed_while_it_moves_is_sent_no_step():
    v = np.full(6, 0.3)
    commanded = moving(v, CommandKind.JOINT_VELOCITY)
    commanded.place(robot(HOME + v * DT_S), robot(), DT_S)
    sent = np.array(commanded.command(robot(HOME + v * DT_S), DT_S).velocities)
    assert (np.abs(sent - v) <= KINEMATICS.acceleration * DT_S + 1e-9).all()


# -- return to the robot -------------------------------------------------------------------------


@settings(max_examples=10, suppress_health_check=list(HealthCheck))
@given(st.tuples(*[st.floats(-0.3, 0.3)] * 6).map(np.array))
def test_a_command_comes_back_to_its_arm_slowly_and_arrives(away):
    commanded, there = arm(), robot(HOME + away)
    commanded.place(robot())
    for tick in range(1500):
        before = commanded.servo.v.copy()
        commanded.approach(there, DT_S)
        v = commanded.servo.v
        assert (np.abs(v) <= APPROACH_SHARE * KINEMATICS.velocity + 1e-4).all()
        assert (np.abs(v - before) <= KINEMATICS.acceleration * DT_S + 1e-6).all()
        if tick % 50 == 0:
            KINEMATICS.update(commanded.servo.q)
            twist = KINEMATICS.jacobian @ v
            assert np.linalg.norm(twist[:3]) <= 1.1 * APPROACH_SPEED_M_S
            assert np.linalg.norm(twist[3:]) <= 1.1 * APPROACH_SPEED_RAD_S
    left = np.abs(commanded.servo.q - HOME - away).max()
    assert left < max(1e-3, 0.7 * np.abs(away).max())


def test_what_is_sent_while_it_comes_back_does_not_go_along():
    commanded, there = arm(), robot(HOME + 0.2)
    commanded.place(robot())
    for _ in range(20):
        commanded.approach(there, DT_S)
    command = commanded.command(there, DT_S, approaching=True)
    assert isinstance(command, JointCommand)
    assert command.velocities == (0.0,) * 6
    assert commanded.command(there, DT_S).velocities != (0.0,) * 6


def test_a_small_error_is_taken_back_with_its_time_constant():
    commanded = arm()
    commanded.place(robot())
    commanded.approach(robot(HOME + 1e-4), DT_S)
    np.testing.assert_allclose(commanded.servo.v, 1e-4 / APPROACH_TIME_S, rtol=1e-3)


def test_an_arm_of_velocities_that_was_pushed_away_returns_slowly_and_blind_not_at_all():
    commanded = arm(CommandKind.JOINT_VELOCITY)
    commanded.place(robot())
    pushed = robot(HOME + 0.5)
    command = commanded.command(pushed, DT_S, blind=True)
    assert command == JointVelocityCommand((0.0,) * 6)
    v = np.array(commanded.command(pushed, 10.0).velocities)
    np.testing.assert_allclose(v, -CORRECTION_SHARE * KINEMATICS.velocity)
    # The return to the robot is slower when no operator steers it.
    v = np.array(commanded.command(pushed, 10.0, approaching=True).velocities)
    KINEMATICS.update(commanded.servo.q)
    assert np.linalg.norm(KINEMATICS.jacobian[:3] @ v) == pytest.approx(APPROACH_SPEED_M_S)
    v = np.array(commanded.command(robot(HOME + 1e-4), 10.0, approaching=True).velocities)
    np.testing.assert_allclose(v, -1e-4 * commanded.velocity_gain_1_s)


# -- messages ------------------------------------------------------------------------------------


def test_what_holds_the_arm_is_said():
    commanded = arm()
    commanded.place(robot())
    assert commanded.held_by() == ""
    q = HOME.copy()
    q[5] = KINEMATICS.upper[5] - 0.001
    commanded.place(robot(q))
    assert commanded.held_by() == f"{KINEMATICS.names[5]} is at its limit, {q[5]:.4f} rad"


def test_the_worst_joint_of_a_following_error_is_named():
    commanded, away = arm(), np.array((0.01, -0.03, 0.0, 0.02, 0.0, 0.0))
    commanded.place(robot())
    error = commanded.following_error(robot(HOME + away), None)
    assert error.joint == KINEMATICS.names[1]
    assert error.joint_error == pytest.approx(0.03)
    assert error.linear_m == error.angular_rad == 0.0
