"""The verbs of the Cartesian interface, in simulated time."""

import math
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import cardan.gateway.arm
from cardan.errors import (
    CollisionError,
    CommandError,
    ConfigurationError,
    JointLimitError,
    MotionRefusedError,
    OutOfReachError,
)
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.vocab import Action, PolicyCode, State
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.kinematics.collision import HalfSpace, Obstacle, box_obstacle
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.spatial import from_rotation_vector, multiply, rotate, to_rotation_vector
from cardan.types import (
    IDENTITY_POSE,
    ZERO_TWIST,
    CommandKind,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    Quaternion,
    RobotLink,
    Vector3,
)
from tests.examples import examples
from tests.gateway.arm.arms import DT_S, GOFA, World, quick, streams, turned


def same_rotation(a, b, atol=1e-5):
    a, b = (from_rotation_vector(Vector3(*v)) for v in (a, b))
    return abs(abs(np.dot(a, b)) - 1.0) < atol**2 + 1e-12


# -- reported state ------------------------------------------------------------------------------


def test_stat_is_measured_in_the_base_whatever_the_frame():
    world = World()
    before = world.verbs.stat()
    assert (before.state, before.stamp_s) == (State.NOT_CONTROLLING, world.now_s)
    world.verbs.set_parameter("cpf", "cpft")
    assert world.verbs.stat().pose == before.pose


def test_inv_gives_joints_in_rad_in_both_frames():
    world = World()
    target = world.moved(0.05, 0.0, 0.02)
    joints = np.array(world.verbs.inv(target))
    placement = world.verbs.planner.forward(joints)
    np.testing.assert_allclose(placement.translation, target[:3], atol=1e-5)
    world.verbs.set_parameter("cpf", "cpft")
    np.testing.assert_allclose(world.verbs.inv([0.0] * 6), world.q, atol=1e-5)


def test_nothing_is_commanded_before_a_verb():
    world = World()
    world.tick(10)
    assert world.command == HoldCommand()
    unheard = ArmVerbs.alone(world.model, world.capabilities)
    with pytest.raises(MotionRefusedError, match="no state of the robot was received yet"):
        unheard.movj(world.six())


def test_the_first_command_is_where_the_robot_is():
    world = quick()
    world.sag[:] = 0.01
    world.tick()
    measured = world.q + world.sag
    world.verbs.movl(world.moved(0.05, 0.0, 0.0))
    world.tick()
    assert isinstance(world.command, JointCommand)
    np.testing.assert_allclose(world.command.positions, measured, atol=1e-4)


# -- movj, relj, movl, movv ----------------------------------------------------------------------


@pytest.mark.parametrize("arm", [GOFA, "ur5", "pr2_left_arm", "asibot"])
@pytest.mark.parametrize("verb", ["movj", "movl"])
def test_the_goal_is_reached(arm, verb):
    world = quick(arm)
    target = world.moved(-0.05, 0.0, -0.05) if arm != "asibot" else world.moved(-0.05, 0.0, 0.0)
    motion = world.run(getattr(world.verbs, verb)(target))
    assert motion.outcome is Outcome.DONE, motion
    np.testing.assert_allclose(world.six()[:3], target[:3], atol=2e-5)
    assert same_rotation(world.six()[3:], target[3:], 1e-3)
    assert world.verbs.state is State.NOT_CONTROLLING


def test_a_line_of_five_joints_keeps_the_position_and_the_orientation_as_far_as_it_can():
    world = quick("asibot", start=np.radians([40.0, -30.0, 90.0, 30.0, 20.0]))
    target = world.moved(0.0, 0.08, 0.0)
    motion = world.run(world.verbs.movl(target))
    assert motion.outcome is Outcome.DONE, motion
    np.testing.assert_allclose(world.six()[:3], target[:3], atol=1e-3)
    assert not same_rotation(world.six()[3:], target[3:], 1e-2)


def test_joints_arrive_together_at_reference_speed():
    world = quick()
    goal = world.q + np.array([0.3, 0.1, 0.0, 0.0, 0.2, 0.0])
    target = world.verbs.planner.forward(goal)
    rotation = to_rotation_vector(to_pose(target).orientation)
    world.verbs.set_parameter("cpja", 1.0)
    motion = world.verbs.movj([*target.translation, *rotation])
    assert world.verbs.state is State.MOVJ
    speeds = 0.5 * world.verbs.servo.kinematics.velocity
    assert motion.duration_s > (np.abs(goal - world.q) / speeds).max()
    start = world.q.copy()
    shares = []
    while not motion.over:
        world.tick()
        shares.append((world.q - start)[[0, 1, 4]] / [0.3, 0.1, 0.2])
    assert np.abs(np.ptp(np.array(shares), axis=1)).max() < 1e-3
    np.testing.assert_allclose(world.q, goal, atol=1e-4)


@pytest.mark.parametrize("verb", ["movj", "movl"])
def test_the_twist_of_the_tcp_is_that_of_its_motion(verb):
    world = quick()
    getattr(world.verbs, verb)(turned(world.moved(0.05, 0.0, -0.1), (0.0, 0.0, 0.2)))
    world.tick(100)
    before = world.tcp
    world.tick()
    after = world.tcp
    twist = world.verbs.controller.status().twist
    np.testing.assert_allclose(twist.linear, (after[0] - before[0]) / DT_S, atol=2e-4)
    assert np.linalg.norm(twist.linear) > 0.02
    assert twist.angular.z > 0.02
    world.rest()
    assert world.verbs.controller.status().twist == ZERO_TWIST


def test_a_line_is_straight_and_takes_its_time():
    world = World("ur5")
    start = world.six()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.125))
    assert world.verbs.state is State.MOVL
    assert motion.duration_s == pytest.approx(5.0)  # check value for the default parameters
    assert motion.note == ""
    began, off, fastest = world.now_s, 0.0, 0.0
    while not motion.over:
        before = world.tcp[0]
        world.tick()
        off = max(off, np.linalg.norm((world.tcp[0] - start[:3])[:2]))
        fastest = max(fastest, np.linalg.norm(world.tcp[0] - before) / DT_S)
    assert off < 1e-4
    assert fastest == pytest.approx(0.05, rel=0.02)
    assert world.now_s - began == pytest.approx(5.0, abs=0.2)


def test_jerk_profile_takes_longer():
    world = quick()
    plain = world.verbs.movl(world.moved(0.0, 0.0, -0.1)).duration_s
    world.verbs.stop()
    world.rest()
    world.verbs.set_parameters({"cppf": "jerk", "cptj": 5.0})
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.1))
    assert motion.duration_s > plain
    assert world.run(motion).outcome is Outcome.DONE


def test_rotation_is_on_so3_and_has_its_own_speed():
    world = quick()
    start = world.six()
    target = turned(start, (0.3, -0.2, 0.5))
    motion = world.verbs.movl(target)
    assert motion.duration_s < 2.0
    world.run(motion)
    assert motion.outcome is Outcome.DONE
    np.testing.assert_allclose(world.six()[:3], start[:3], atol=2e-5)
    assert same_rotation(world.six()[3:], target[3:], 1e-4)


def test_a_longer_duration_is_kept_and_a_shorter_one_reported():
    world = quick()
    world.verbs.set_parameter("cptd", 3.0)
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.1))
    assert motion.duration_s == 3.0
    world.verbs.stop()
    world.rest()
    world.verbs.set_parameter("cptd", 0.1)
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.1))
    assert motion.duration_s > 0.1
    assert "too short" in motion.note


@pytest.mark.parametrize("frame", ["cpfb", "cpft"])
def test_relj_composes_rotations(frame):
    world = quick()
    start = world.six()
    world.verbs.set_parameter("cpf", frame)
    step = [0.02, -0.03, -0.04, 0.1, 0.2, -0.1]
    world.run(world.verbs.relj(step))
    r0 = from_rotation_vector(Vector3(*start[3:]))
    dr = from_rotation_vector(Vector3(*step[3:]))
    if frame == "cpfb":
        position, rotation = start[:3] + step[:3], multiply(dr, r0)
    else:
        world_step = np.array(rotate(r0, Vector3(*step[:3])))
        position, rotation = start[:3] + world_step, multiply(r0, dr)
    np.testing.assert_allclose(world.six()[:3], position, atol=2e-5)
    assert same_rotation(world.six()[3:], to_rotation_vector(rotation), 1e-4)


@pytest.mark.parametrize("verb", ["movj", "movl"])
def test_tcp_frame_targets_are_relative_to_the_tcp(verb):
    world = quick()
    rotation = world.tcp[1]
    start = world.six()
    world.verbs.set_parameter("cpf", "cpft")
    world.run(getattr(world.verbs, verb)([0.0, 0.0, -0.05, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(world.six()[:3], start[:3] - 0.05 * rotation[:, 2], atol=2e-5)


def test_where_the_arm_is_already_nothing_starts():
    world = World()
    for verb in ("movj", "movl"):
        motion = getattr(world.verbs, verb)(world.six())
        assert (motion.outcome, world.verbs.state) == (Outcome.DONE, State.NOT_CONTROLLING)


def test_movv_goes_on_and_stops_on_command():
    world = quick()
    start = world.six()
    motion = world.verbs.movv([0.0, 0.0, -0.1, 0.0, 0.0, 0.0])
    assert world.verbs.state is State.MOVV
    world.tick(int(2.0 / DT_S))
    way = start[2] - world.six()[2]
    assert way == pytest.approx(
        0.2 - 0.5 * 0.1 * 0.1 - 0.1 * 0.025, abs=2e-3
    )  # after a path longer than refSpeed meters
    world.verbs.stop()
    assert world.verbs.state is State.NOT_CONTROLLING
    world.rest()
    assert motion.outcome is Outcome.ABORTED
    assert np.abs(world.six()[:2] - start[:2]).max() < 1e-4


def test_movv_starts_at_the_slowest_acceleration_of_the_field():
    world = World(GOFA)
    start = world.six()
    world.verbs.movv([0.0, 0.0, -0.04, 0.0, 0.0, 0.0])
    world.tick(int(4.0 / DT_S))
    assert start[2] - world.six()[2] == pytest.approx(0.04 * 4.0 - 0.04, abs=2e-3)


def test_movv_in_tcp_axes_keeps_its_direction():
    world = quick()
    rotation, start = world.tcp[1], world.six()
    world.verbs.set_parameter("cpf", "cpft")
    world.verbs.movv([0.0, 0.0, -0.1, 0.0, 0.0, 0.3])
    world.tick(200)
    step = world.six()[:3] - start[:3]
    np.testing.assert_allclose(step / -np.linalg.norm(step), rotation[:, 2], atol=1e-2)


def test_movv_slows_a_twist_that_is_too_fast_and_says_so():
    world = quick()
    motion = world.verbs.movv([0.0, 0.0, -1.0, 0.0, 0.0, 0.5])
    assert "25%" in motion.note
    with pytest.raises(MotionRefusedError, match="zero"):
        world.verbs.movv([0.0] * 6)


def test_movv_ends_at_the_workspace():
    world = quick(options=streams(workspace_z_m=(0.7, 2.0)))
    motion = world.run(world.verbs.movv([0.0, 0.0, -0.1, 0.0, 0.0, 0.0]))
    assert "workspace" in motion.reason
    assert world.six()[2] >= 0.7 - 1e-6
    assert world.six()[2] == pytest.approx(0.7, abs=2e-3)
    again = world.run(world.verbs.movv([0.0, 0.0, -0.1, 0.0, 0.0, 0.0]), 1.0)
    assert "workspace" in again.reason


def test_movv_ends_at_a_joint_limit():
    world = quick()
    motion = world.run(world.verbs.movv([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    assert motion.outcome is Outcome.ABORTED
    assert motion.reason


# -- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize("verb", ["inv", "movj", "relj", "movl", "movv", "forc", "tool"])
@pytest.mark.parametrize(
    ("values", "why"),
    [
        ([0.1] * 5, "not 5"), ([0.1] * 7, "not 7"), ([], "not 0"), (3.0, "six numbers"),
        ([0.1, math.nan, 0, 0, 0, 0], "number 2 of 6 is nan"),
        ([0, 0, 0, 0, 0, math.inf], "number 6 of 6 is inf"), (["a"] * 6, "six numbers"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_and_changes_nothing(verb, values, why):
    world = World()
    with pytest.raises(MotionRefusedError, match=why):
        getattr(world.verbs, verb)(values)
    world.tick()
    assert world.command == HoldCommand()
    assert why in world.verbs.status().last_refusal
    assert world.verbs.status().refusals == 1


def test_the_package_has_each_of_its_names():
    assert all(getattr(cardan.gateway.arm, name) for name in cardan.gateway.arm.__all__)


def test_a_quaternion_has_length_one():
    world = World()
    with pytest.raises(MotionRefusedError, match="has length 2"):
        world.verbs.movl(Pose(Vector3(0.4, 0, 0.4), Quaternion(2.0, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize("verb", ["inv", "movj", "movl"])
def test_what_is_out_of_reach_is_refused_with_how_far(verb):
    world = World(GOFA)
    target = [3.0, *world.six()[1:]]
    with pytest.raises(MotionRefusedError) as found:
        getattr(world.verbs, verb)(target)
    assert isinstance(found.value, OutOfReachError)
    assert 1.5 < found.value.distance_m < 2.5
    assert "out of reach by" in str(found.value)
    if verb == "movl":
        share = re.search(r" mm.*, from (\d+)% of the line on; choose one near", str(found.value))
        reach_m = world.six()[0] + int(share[1]) / 100 * (3.0 - world.six()[0])
        assert 0.7 < reach_m < 1.1


def test_the_workspace_is_checked_first():
    world = quick(options=streams(workspace_x_m=(0.2, 0.7), workspace_z_m=(0.6, 1.0)))
    for verb in ("inv", "movj", "movl"):
        with pytest.raises(MotionRefusedError, match=r"z = 0.5378 m .* 0.6000 to 1.0000 m"):
            getattr(world.verbs, verb)(world.moved(0.0, 0.0, -0.3))


def test_a_line_from_a_stretched_arm_is_refused_as_singular():
    world = World("ur5", start=(0.0, -1.27, 0.0, -1.0, -1.5, 0.0))
    with pytest.raises(MotionRefusedError, match=r"the arm is singular there \(0\.000\): move"):
        world.verbs.movl(world.moved(0.05, 0.0, 0.0))


def test_a_joint_limit_on_the_line_is_named():
    world = quick()
    rotation = world.tcp[1]
    axis = rotation[:, 2]
    world.run(world.verbs.movl(turned(world.six(), 2.0 * axis)))
    with pytest.raises(JointLimitError) as found:
        world.verbs.movl(turned(world.six(), 2.0 * axis))
    assert found.value.joint in world.model.joint_names
    assert abs(found.value.value) > abs(found.value.limit)
    assert f"{found.value.limit:.4f} rad" in str(found.value)
    assert "of the line" in str(found.value)


def test_a_resting_arm_at_its_limit_may_leave_it():
    start = list(World(GOFA).model.home)
    start[5] = 3.141593
    world = quick(start=start)
    axis = world.tcp[1][:, 2]
    joint = world.q[5]
    for sign in (-1.0, 1.0):
        try:
            motion = world.verbs.movl(turned(world.six(), sign * 0.3 * axis))
        except JointLimitError:
            continue
        assert world.run(motion).outcome is Outcome.DONE
        assert world.q[5] < joint
        return
    raise AssertionError("refused both ways")


def test_a_collision_is_found_before_the_arm_moves():
    six = World(GOFA).six()
    wall = box_obstacle(
        "wall", Vector3(six[0] - 0.5, -1.0, 0.1), Vector3(six[0] + 0.8, 1.0, six[2] - 0.2)
    )
    world = quick(obstacles=[wall])
    for verb in ("movj", "movl"):
        with pytest.raises(CollisionError, match=r": \w+ would come too near to wall") as found:
            getattr(world.verbs, verb)(world.moved(0.0, 0.0, -0.3))
        assert "wall" in found.value.pair
        assert 0.0 <= found.value.share < 1.0
    world.tick()
    assert world.command == HoldCommand()


@pytest.mark.parametrize(("speed", "note"), [(1.0, "for the TCP's speed"), (0.01, "")])
def test_a_joint_motion_says_that_the_tcps_speed_slowed_it(speed, note):
    world = quick(options=ControllerOptions(limits=ReferenceLimits(linear_speed_m_s=0.1)))
    world.verbs.set_parameter("cpjs", speed)
    motion = world.verbs.movj(world.moved(-0.1, 0.3, -0.2))
    assert note in motion.note
    assert bool(motion.note) is bool(note)


def test_movj_takes_another_branch_only_where_the_way_is_free():
    floor = Obstacle("floor", HalfSpace(Vector3(0.0, 0.0, 1.0), -0.2))
    world = quick(obstacles=[floor])
    motion = world.run(world.verbs.movj(world.moved(-0.1, 0.2, -0.2)))
    assert motion.outcome is Outcome.DONE


@pytest.mark.parametrize(
    ("verb", "argument"),
    [("movj", None), ("relj", [0.01] * 6), ("movl", None), ("movv", [0, 0, 0.1, 0, 0, 0])],
)
def test_a_robot_without_joint_or_pose_commands_cannot_move(verb, argument):
    world = World(commands=frozenset({CommandKind.TWIST}))
    with pytest.raises(MotionRefusedError, match="the robot takes twist"):
        getattr(world.verbs, verb)(argument or world.moved(0, 0, -0.05))


def test_torque_verbs_need_torque():
    world = World(commands=frozenset({CommandKind.JOINT}))
    for call in (world.verbs.gcmp, lambda: world.verbs.forc([0.0] * 6)):
        with pytest.raises(MotionRefusedError, match="this needs torque"):
            call()
    with pytest.raises(MotionRefusedError, match="this needs torque"):
        world.verbs.set_parameter("cpsc", "wrnc")


def test_a_robot_that_would_not_act_is_not_moved():
    world = World()
    world.hold_reason = "motors are off"
    world.tick()
    with pytest.raises(MotionRefusedError, match="motors are off"):
        world.verbs.movj(world.moved(0, 0, -0.05))
    world.hold_reason, world.v[:] = "", 1.0
    world.jammed = False
    world.verbs.controller.tick(world.state())
    with pytest.raises(MotionRefusedError, match="moves already"):
        world.verbs.movj(world.moved(0, 0, -0.05))


def test_arm_and_robot_fit_together():
    world = World()
    with pytest.raises(ConfigurationError, match="6 joints, the robot has 7"):
        type(world.verbs).alone(world.model, world.capabilities._replace(joints=7))
    with pytest.raises(ConfigurationError, match="pose: the robot takes joint"):
        World(options=ControllerOptions(drive=CommandKind.POSE))
    with pytest.raises(ConfigurationError, match=r"linear_speed_m_s: 0.0 is not allowed"):
        streams(linear_speed_m_s=0.0)
    with pytest.raises(ConfigurationError, match=r"workspace_x_m.*lower bound first"):
        streams(workspace_x_m=(1.0, 0.0))
    with pytest.raises(ConfigurationError, match=r"streams\.angular_jerk_rad_s3.*shapes"):
        streams(angular_jerk_rad_s3=None)


# -- stop, taking over, tools, gripper -----------------------------------------------------------


def test_stop_stays_on_the_line_and_holds():
    world = quick()
    start = world.six()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.3))
    world.tick(150)
    world.verbs.stop()
    assert world.verbs.state is State.NOT_CONTROLLING
    world.rest()
    assert (motion.outcome, motion.reason) == (Outcome.ABORTED, "stopped")
    assert np.abs(world.six()[:2] - start[:2]).max() < 1e-4
    held = world.q.copy()
    world.tick(50)
    np.testing.assert_array_equal(world.q, held)


def test_stop_works_without_anything():
    world = World()
    world.verbs.stop()
    world.link = RobotLink.LOST
    world.tick()
    world.verbs.stop()
    assert world.verbs.at_rest


@pytest.mark.parametrize("first", ["movj", "movl", "movv", "gcmp", "twist"])
@pytest.mark.parametrize("second", ["movj", "movl", "movv", "gcmp"])
def test_a_new_motion_takes_over_without_a_step(first, second):
    world = quick()
    there, back = world.moved(0.0, 0.0, -0.25), world.moved(0.0, 0.1, -0.05)
    call = {
        "movj": lambda target: world.verbs.movj(target),
        "movl": lambda target: world.verbs.movl(target),
        "movv": lambda _: world.verbs.movv([0.0, 0.05, -0.1, 0.0, 0.0, 0.0]),
        "gcmp": lambda _: world.verbs.gcmp(),
    }
    old = None
    if first == "twist":
        world.verbs.set_parameter("cpsc", "twst")
        assert world.verbs.stream("twist", [0.0, 0.0, -0.1, 0.0, 0.0, 0.0]) == ""
        world.tick(20)
    else:
        old = call[first](there)
        world.tick(60)
    new = call[second](back)
    assert (new.outcome, new.note) == (Outcome.WAITING, "")
    if old is not None:
        assert (old.outcome, old.reason) == (Outcome.ABORTED, f"{second} took over")
    for _ in range(500):
        world.verbs.start_pending()
        if new.outcome is not Outcome.WAITING:
            break
        world.tick()
    assert new.outcome is Outcome.RUNNING
    world.tick(50)
    if new.ends:
        assert world.run(new).outcome is Outcome.DONE
        np.testing.assert_allclose(world.six()[:3], back[:3], atol=2e-5)
        assert world.verbs.start_pending() is None


def test_a_motion_that_is_refused_leaves_the_one_under_way_alone():
    world = quick()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.2))
    world.tick(30)
    with pytest.raises(MotionRefusedError):
        world.verbs.movl([9.0, *world.six()[1:]])
    assert world.run(motion).outcome is Outcome.DONE


def test_stop_drops_what_waits():
    world = quick()
    world.verbs.movl(world.moved(0.0, 0.0, -0.2))
    world.tick(60)
    waiting = world.verbs.movj(world.moved(0.0, 0.0, 0.0))
    newer = world.verbs.movl(world.moved(0.0, 0.0, 0.0))
    assert waiting.reason == "movl took over"
    world.verbs.stop()
    world.rest()
    assert newer.outcome is Outcome.ABORTED
    assert world.verbs.start_pending() is None


def test_tools_replace_each_other_and_zeros_take_them_off():
    world = quick()
    bare, rotation = world.six(), world.tcp[1]
    for length in (0.1, 0.2):
        world.verbs.tool([0.0, 0.0, length, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(world.six()[:3], bare[:3] + length * rotation[:, 2])
    target = turned(world.six(), (0.0, 0.2, 0.0))
    world.run(world.verbs.movl(target))
    np.testing.assert_allclose(world.six()[:3], target[:3], atol=2e-5)
    world.verbs.tool([0.0] * 6)
    np.testing.assert_allclose(world.six()[:3], target[:3] - 0.2 * world.tcp[1][:, 2], atol=2e-5)
    world.verbs.tool([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    verbs = world.verbs
    again = ArmVerbs(verbs.controller, verbs.commanded, world.model, world.capabilities)
    np.testing.assert_allclose(again.planner.forward(world.q), verbs.planner.forward(world.q))


def test_tools_are_not_changed_in_motion():
    world = quick()
    world.verbs.movl(world.moved(0.0, 0.0, -0.1))
    with pytest.raises(MotionRefusedError, match="cclc"):
        world.verbs.tool([0.0] * 6)
    world.tick(60)
    world.verbs.stop()
    with pytest.raises(MotionRefusedError, match="still moving"):
        world.verbs.tool([0.0] * 6)


def test_the_gripper_gets_what_it_is_reported():
    done = []

    def gripper(action):
        if action is Action.STOP:
            raise CommandError("it cannot stop")
        done.append(action)

    world = World(gripper=gripper)
    world.verbs.act("accg")
    world.verbs.act(Action.OPEN)
    assert done == [Action.CLOSE, Action.OPEN]
    with pytest.raises(MotionRefusedError, match="cannot stop"):
        world.verbs.act("acsg")
    for bad in ("acn", 12, "nonsense"):
        with pytest.raises(MotionRefusedError, match="allowed are"):
            world.verbs.act(bad)
    with pytest.raises(MotionRefusedError, match="no gripper"):
        World().verbs.act("accg")


# -- parameters ----------------------------------------------------------------------------------


def test_a_group_is_set_whole_or_not_at_all():
    world = World()
    before = world.verbs.get_parameters()
    with pytest.raises(ConfigurationError):
        world.verbs.set_parameters({"cpts": 0.2, "cpta": -1.0})
    with pytest.raises(MotionRefusedError):
        World(commands=frozenset({CommandKind.JOINT})).verbs.set_parameters(
            {"cpts": 0.2, "cpsc": "wrnc"}
        )
    assert world.verbs.get_parameters() == before
    world.verbs.set_parameters({"cpts": 0.2, "trajectoryRefAccel": 0.5})
    assert world.verbs.get_parameter("trajectoryRefSpeed") == 0.2
    assert world.verbs.get_parameter("cpta") == 0.5


def test_no_parameter_is_set_in_motion():
    world = quick()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.1))
    with pytest.raises(MotionRefusedError, match="cclc"):
        world.verbs.set_parameter("cpts", 1.0)
    world.run(motion)
    world.verbs.set_parameter("cpts", 1.0)
    # Setting a parameter gives no source authority; it only renews the owner's lease.
    world.verbs.release()
    world.verbs.set_parameters({"cpts": 0.5}, source="one")
    assert world.verbs.status().authority.owner == ""


def test_reach_keeps_the_pace():
    world = quick()
    world.verbs.set_parameter("cppo", PolicyCode.REACH)
    assert world.verbs.servo.policy.value == "reach"
    motion = world.run(world.verbs.movl(world.moved(0.0, 0.0, -0.1)))
    assert motion.outcome is Outcome.DONE


# -- supervision ---------------------------------------------------------------------------------


@pytest.mark.parametrize("cause", ["silent", "motors", "session", "stall"])
def test_a_robot_that_is_lost_ends_the_motion(cause):
    world = quick()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.2))
    world.tick(60)
    if cause == "silent":
        world.link = RobotLink.LOST
    elif cause == "motors":
        world.hold_reason = "motors are off"
    elif cause == "session":
        world.session += 1
    else:
        world.now_s += 3.0
    commanded = np.array(world.command.velocities)
    world.tick()
    assert motion.outcome is Outcome.ABORTED
    if cause in ("silent", "stall"):
        assert world.command == HoldCommand()
    else:
        # A robot that still follows is braked in a ramp.
        speeds = np.abs(world.command.velocities)
        assert (speeds <= np.abs(commanded) + 1e-9).all()
        assert speeds.max() > 0.5 * np.abs(commanded).max()
    world.tick(100)
    assert world.command == HoldCommand()
    world.link, world.hold_reason = RobotLink.LIVE, ""
    world.tick(50)
    assert world.command == HoldCommand()
    assert world.verbs.controller.message.startswith("stopped before: ")
    again = world.verbs.movl(world.moved(0.0, 0.0, 0.05))
    world.tick()
    assert world.verbs.controller.message == ""
    np.testing.assert_allclose(world.command.positions, world.q, atol=1e-3)
    assert world.run(again).outcome is Outcome.DONE


def test_a_held_arm_trips_and_the_command_comes_back():
    world = quick()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.3))
    world.jammed = True
    for _ in range(1000):
        world.tick()
        if motion.over:
            break
    assert "away from where it was commanded to be" in motion.reason
    assert world.verbs.status().recovering
    with pytest.raises(MotionRefusedError, match="resynchronizing"):
        world.verbs.movl(world.moved(0.0, 0.0, -0.1))
    max_lead_m = ControllerOptions().streams.max_lead_m
    world.tick(50)  # until rest
    for _ in range(6):
        before = np.array(world.verbs.commanded.pose.position)
        world.tick(1000)
        # Without a request: at most the maximum lead, and again only after re-arming.
        assert np.linalg.norm(world.verbs.commanded.pose.position - before) <= max_lead_m
        assert not world.verbs.servo.moving
        if not world.verbs.controller.inhibited:
            break
        with pytest.raises(MotionRefusedError, match="not resynchronized with the robot"):
            world.verbs.movl(world.moved(0.0, 0.0, -0.1))
        world.verbs.acknowledge()
    assert np.abs(world.verbs.servo.q - world.q).max() < 0.05
    world.jammed = False
    assert world.run(world.verbs.movl(world.moved(0.0, 0.0, -0.05))).outcome is Outcome.DONE


def test_an_alarm_brakes():
    world = quick()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.3))
    world.tick(60)
    world.alarm = "the port is flooded"
    world.tick()
    assert motion.reason == "the port is flooded"
    assert world.verbs.servo.moving
    world.rest()
    with pytest.raises(MotionRefusedError, match="flooded"):
        world.verbs.movl(world.moved(0.0, 0.0, -0.1))


# -- other robots --------------------------------------------------------------------------------


def test_velocity_robots_are_kept_from_creeping():
    world = quick(commands=frozenset({CommandKind.JOINT_VELOCITY}))
    world.creep_rad_s[:] = 0.002
    motion = world.run(world.verbs.movl(world.moved(0.0, 0.0, -0.1)))
    assert motion.outcome is Outcome.DONE
    world.tick(2000)
    assert isinstance(world.command, JointVelocityCommand)
    # A gain of 0.05 per 50 ms is 1/s: a creep of 0.002 rad/s ends 0.002 rad away.
    np.testing.assert_allclose(world.verbs.servo.q - world.q, -0.002, atol=1e-4)


def test_pose_robots_are_sent_the_bare_tcp():
    world = quick(commands=frozenset({CommandKind.POSE}))
    world.verbs.tool([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.05))
    world.tick(40)
    assert isinstance(world.command, PoseCommand)
    assert world.command.twist.linear.z < -0.05
    assert world.run(motion).outcome is Outcome.DONE
    shift = np.array(world.command.pose.position) - world.six()[:3]
    assert np.linalg.norm(shift) == pytest.approx(0.1, abs=1e-4)


def test_a_pose_robot_with_another_tool_is_refused():
    world = quick(commands=frozenset({CommandKind.POSE}))
    world.pose = IDENTITY_POSE
    world.verbs.controller.tick(world.state())
    with pytest.raises(MotionRefusedError, match="the tool or the model does not fit"):
        world.verbs.movl(world.moved(0.0, 0.0, -0.05))


# -- any requests --------------------------------------------------------------------------------

steps = st.tuples(*[st.floats(-0.25, 0.25)] * 3, *[st.floats(-0.8, 0.8)] * 3)
actions = st.lists(
    st.tuples(
        st.sampled_from(
            ["movj", "relj", "movl", "movv", "stop", "twst", "pose", "gcmp", "twist", "tick",
             "frame", "tool", "lost", "sag"]
        ),
        steps,
        st.integers(1, 60),
    ),
    min_size=1,
    max_size=10,
)  # fmt: skip


@settings(max_examples=examples(25), suppress_health_check=list(HealthCheck))
@given(
    st.sampled_from([GOFA, "ur5", "pr2_left_arm", "asibot"]),
    st.sampled_from([CommandKind.JOINT, CommandKind.JOINT_VELOCITY, CommandKind.POSE]),
    actions,
)
def test_limits_hold_whatever_is_asked(arm, drive, sequence):
    """`World` checks position, speed and acceleration of every joint in every tick."""
    world = quick(arm, commands=frozenset({drive, CommandKind.TORQUE}))
    controller = world.verbs
    for name, step, ticks in sequence:
        try:
            if name in ("movj", "movl"):
                getattr(controller, name)([*(world.six() + np.array(step))])
            elif name in ("relj", "movv", "tool"):
                getattr(controller, name)(step)
            elif name == "gcmp":
                controller.gcmp()
            elif name == "stop":
                controller.stop()
            elif name in ("twst", "pose"):
                controller.set_parameter("cpsc", name)
                controller.stream("pose", [*(world.six() + 0.3 * np.array(step))])
            elif name == "twist":
                controller.stream("twist", step)
            elif name == "frame":
                controller.set_parameter("cpf", "cpft" if step[0] > 0 else "cpfb")
            elif name == "lost":
                world.link = RobotLink.LOST
                world.tick()
                world.link, world.v[:] = RobotLink.LIVE, 0.0
            elif name == "sag":
                world.sag = np.full(len(world.q), 0.05 * step[0])
        except MotionRefusedError:
            pass
        for _ in range(ticks):
            controller.start_pending()
            world.tick()
    controller.stop()
    world.rest()
    held = controller.servo.q.copy()
    world.tick(20)
    np.testing.assert_array_equal(controller.servo.q, held)


def test_a_robot_of_no_numbers_is_not_moved_by_any_verb():
    world = World()
    world.q[:] = math.nan
    world.verbs = type(world.verbs).alone(world.model, world.capabilities)
    world.tick(2)
    for verb, argument in (("movv", [0.01] * 6), ("movl", [0.4] * 6), ("movj", [0.4] * 6)):
        with pytest.raises(MotionRefusedError, match="not numbers"):
            getattr(world.verbs, verb)(argument)
    with pytest.raises(MotionRefusedError, match="not numbers"):
        world.verbs.stat()
    with pytest.raises((MotionRefusedError, ConfigurationError)):
        world.verbs.set_parameter("cpsc", "twst")


@pytest.mark.parametrize("values", [[1e308] * 6, [0.4, 0.0, 1e5, 0.0, 0.0, 0.0], [10**400] * 6])
@pytest.mark.parametrize("verb", ["inv", "movj", "movl", "movv", "relj", "tool"])
def test_numbers_of_no_arm_are_refused_in_words(verb, values):
    world = World()
    with pytest.raises(MotionRefusedError):
        getattr(world.verbs, verb)(values)


def test_a_command_that_never_meets_its_arm_is_given_up():
    world = quick("ur5")
    motion = world.verbs.movv([0.0, 0.0, -0.05, 0.0, 0.0, 0.0])
    world.tick(100)
    before = world.verbs.servo.q.copy()
    for _ in range(100):  # a joint whose measured position drifts a radian away
        world.sag[0] += 0.01
        world.tick()
    world.tick(3000)
    assert motion.over
    assert np.abs(world.verbs.servo.q - before).max() < 1.7
    assert isinstance(world.command, HoldCommand)
