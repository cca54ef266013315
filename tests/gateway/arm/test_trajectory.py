"""Joint trajectories from other programs, followed through the controller, in simulated time."""

import numpy as np
import pytest

from cardan.errors import CollisionError, JointLimitError, MotionRefusedError
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.vocab import State
from cardan.gateway.kinematics.collision import HalfSpace, Obstacle
from cardan.gateway.motion.joint_trajectory import LARGEST, JointTrajectory
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.types import RobotLink, Vector3
from tests.gateway.arm.arms import DT_S, World, streams


def to(world, *steps, duration_s=2.0, first=True, **more):
    """A trajectory from the arm's joints over points that are offset by `steps`."""
    q = world.q
    rows = [q + np.array(step) for step in steps]
    times = [duration_s * (number + 1) / len(rows) for number in range(len(rows))]
    if first:
        rows, times = [q, *rows], [0.0, *times]
    given = {
        name: np.full(len(q), value) for name, value in more.items() if name.endswith("tolerance")
    }
    return JointTrajectory(np.array(times), np.array(rows), **(more | given))


STEP = np.array([0.3, -0.2, 0.1, 0.0, 0.2, -0.4])


def test_it_goes_through_the_points_at_their_times():
    world = World()
    begin = world.q.copy()
    motion = world.verbs.trajectory(to(world, 0.5 * STEP, STEP))
    assert motion.outcome is Outcome.RUNNING
    assert world.verbs.state is State.MOVJ
    assert motion.duration_s == pytest.approx(2.0)
    assert motion.note == ""
    world.tick(int(1.0 / DT_S))
    np.testing.assert_allclose(world.q, begin + 0.5 * STEP, atol=5e-3)
    desired = np.array(world.verbs.desired()[0])
    np.testing.assert_allclose(desired, begin + 0.5 * STEP, atol=5e-3)
    world.run(motion)
    assert motion.outcome is Outcome.DONE
    np.testing.assert_allclose(world.q, begin + STEP, atol=1e-4)
    assert world.verbs.desired() is None
    assert world.verbs.at_rest


def test_a_faster_one_is_slowed_and_says_so():
    world = World()
    begin = world.q.copy()
    motion = world.run(world.verbs.trajectory(to(world, 5.0 * STEP[:6], duration_s=0.3)))
    assert "slowed to" in motion.note
    assert motion.duration_s > 0.3
    assert motion.outcome is Outcome.DONE
    np.testing.assert_allclose(world.q, begin + 5.0 * STEP, atol=1e-4)


def test_the_tcps_speed_limit_holds():
    limits = ReferenceLimits(linear_speed_m_s=0.1)
    world = World(options=ControllerOptions(limits=limits))
    motion = world.verbs.trajectory(to(world, STEP, duration_s=1.0))
    assert "slowed to" in motion.note
    fastest, before = 0.0, world.tcp[0]
    while not motion.over:
        world.tick()
        now = world.tcp[0]
        fastest, before = max(fastest, np.linalg.norm(now - before) / DT_S), now
    assert fastest < 0.1 * 1.02


def test_what_takes_longer_than_it_may_is_refused():
    world = World()
    with pytest.raises(MotionRefusedError, match=r"planned for 0.30 s, and may take 0.1 s"):
        world.verbs.trajectory(to(world, 5.0 * STEP, duration_s=0.3, goal_time_s=0.1))
    assert world.verbs.at_rest


def test_it_has_to_begin_where_the_arm_is():
    world = World()
    wanted = to(world, STEP)
    wanted.positions[0] += 0.1
    with pytest.raises(MotionRefusedError, match="plan it from where the arm is"):
        world.verbs.trajectory(wanted)
    wanted.positions[0] -= 0.08
    assert world.run(world.verbs.trajectory(wanted)).outcome is Outcome.DONE


def test_the_first_point_may_come_later():
    world = World()
    begin = world.q.copy()
    motion = world.run(world.verbs.trajectory(to(world, STEP, first=False)))
    assert motion.outcome is Outcome.DONE
    np.testing.assert_allclose(world.q, begin + STEP, atol=1e-4)


WRAPPED = pytest.mark.parametrize("turns", [-2, -1, 1, 3])


def pr2(turns):
    """A PR2 whose continuous joints, forearm roll (4) and wrist roll (6), start some turns away."""
    world = World("pr2_right_arm")
    start = world.q.copy()
    start[[4, 6]] += 2.0 * np.pi * turns
    return World("pr2_right_arm", start=start), world.q


@WRAPPED
@pytest.mark.parametrize("first", [True, False])
def test_a_plan_without_whole_turns_begins_where_a_continuous_joint_is(first, turns):
    world, home = pr2(turns)
    begin = world.q.copy()
    step = np.array([0.1, 0.0, 0.0, 0.0, 0.3, 0.0, -0.4])
    rows = [home, home + 0.5 * step, home + step] if first else [home + step]
    times = [0.0, 1.0, 2.0] if first else [2.0]
    motion = world.verbs.trajectory(JointTrajectory(times, rows, path_tolerance=[0.05] * 7))
    farthest = np.zeros(7)
    while not motion.over:
        world.tick()
        farthest = np.maximum(farthest, np.abs(world.q - begin))
    assert motion.outcome is Outcome.DONE, motion.reason
    np.testing.assert_allclose(world.q, begin + step, atol=1e-4)
    assert (farthest <= np.abs(step) + 1e-3).all()


def test_the_rest_of_a_plan_keeps_its_own_turns():
    world, home = pr2(1)
    begin = world.q.copy()
    far = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 7.0])
    rows = [home, home + 0.5 * far, home + far]
    motion = world.run(world.verbs.trajectory(JointTrajectory([0.0, 6.0, 12.0], rows)))
    assert motion.outcome is Outcome.DONE, motion.reason
    np.testing.assert_allclose(world.q, begin + far, atol=1e-4)


@WRAPPED
def test_a_joint_with_ends_keeps_its_turns(turns):
    world = World("pr2_right_arm")
    away = np.zeros(7)
    away[0] = 2.0 * np.pi * turns
    with pytest.raises(MotionRefusedError):
        world.verbs.trajectory(JointTrajectory([0.0, 2.0], [world.q + away] * 2))
    assert world.verbs.at_rest


def test_where_the_arm_is_already_nothing_starts():
    world = World()
    motion = world.verbs.trajectory(to(world, 0.0 * STEP))
    assert motion.outcome is Outcome.DONE
    assert world.verbs.at_rest


def test_joint_limits_are_found_before_the_arm_moves():
    world = World()
    with pytest.raises(JointLimitError, match=r"wrist_3_joint .*after \d\d?% of the way"):
        world.verbs.trajectory(to(world, np.array([0, 0, 0, 0, 0, 9.0]), duration_s=20.0))
    assert world.verbs.at_rest


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_of_all_joints_the_one_beyond_its_limit_is_named(joint, end):
    world = World("gp8")
    planner = world.verbs.planner
    beyond = world.q.copy()
    limit = getattr(planner.kinematics, end)[joint]
    beyond[joint] = limit + (0.01 if end == "upper" else -0.01)
    with pytest.raises(JointLimitError, match="after 100% of the way") as error:
        planner.check_joint_samples("movj", np.array([world.q, beyond]))
    assert (error.value.joint, error.value.limit) == (planner.names[joint], limit)


def test_numbers_go_up_to_the_largest():
    assert JointTrajectory([1.0], [[LARGEST, -LARGEST]]).positions
    with pytest.raises(MotionRefusedError, match="above 1e"):
        JointTrajectory([1.0], [[LARGEST * 1.001, 0.0]])


def test_collisions_are_found_before_the_arm_moves():
    height = float(World().six()[2])
    wall = Obstacle("table", HalfSpace(Vector3(0.0, 0.0, 1.0), height - 0.1))
    world = World(obstacles=[wall])
    with pytest.raises(CollisionError, match=r": \w+_link would come too near to table") as error:
        world.verbs.trajectory(to(world, np.array([0, 1.0, 0, 0, 0, 0]), duration_s=20.0))
    assert "where that is now" not in str(error.value)
    assert world.verbs.at_rest


def test_the_workspace_is_kept():
    x = float(World().six()[0])
    world = World(options=streams(workspace_x_m=(x - 0.02, x + 0.02)))
    with pytest.raises(MotionRefusedError, match="outside of the workspace"):
        world.verbs.trajectory(to(world, np.array([1.5, 0, 0, 0, 0, 0]), duration_s=20.0))


def test_another_number_of_joints_is_refused():
    world = World()
    wanted = JointTrajectory(np.array([1.0]), np.zeros((1, 5)))
    with pytest.raises(MotionRefusedError, match="5 joints, the arm has 6"):
        world.verbs.trajectory(wanted)


def test_a_stop_brakes_along_the_way():
    world = World()
    begin = world.q.copy()
    motion = world.verbs.trajectory(to(world, STEP))
    world.tick(int(0.9 / DT_S))
    world.verbs.stop()
    world.rest()
    assert motion.outcome is Outcome.ABORTED
    assert motion.reason == "stopped"
    share = (world.q - begin)[0] / STEP[0]
    assert 0.2 < share < 0.9
    np.testing.assert_allclose(world.q - begin, share * STEP, atol=5e-3)


def test_another_motion_takes_over_through_rest():
    world = World()
    first = world.verbs.trajectory(to(world, STEP))
    world.tick(int(0.9 / DT_S))
    second = world.verbs.movj(world.moved(0.0, 0.0, 0.02))
    assert first.outcome is Outcome.ABORTED
    assert world.run(second).outcome is Outcome.DONE


def test_a_trajectory_that_was_planned_from_an_arm_in_motion_is_refused_when_that_rests():
    world = World()
    world.verbs.set_parameter("cpjs", 1.0)
    world.verbs.movj(world.moved(0.2, 0.2, 0.0))
    world.tick(int(0.5 / DT_S))
    motion = world.run(world.verbs.trajectory(to(world, STEP)))
    assert motion.outcome is Outcome.REFUSED
    assert "plan it from where the arm is" in motion.reason
    assert world.verbs.at_rest


@pytest.mark.parametrize("tolerance", [0.02, 0.2])
def test_an_arm_that_lags_behind_leaves_its_path_tolerance(tolerance):
    world = World()
    motion = world.verbs.trajectory(to(world, STEP, path_tolerance=tolerance))
    world.tick(int(0.6 / DT_S))
    world.sag[0] = -0.05  # less than the supervision's limit
    world.tick(int(0.9 / DT_S))
    world.sag[0] = 0.0
    world.run(motion)
    if tolerance < 0.05:
        assert motion.outcome is Outcome.ABORTED
        assert motion.reason.startswith("path tolerance: shoulder_pan_joint is 0.05")
    else:
        assert motion.outcome is Outcome.DONE
    assert world.verbs.at_rest


@pytest.mark.parametrize("tolerance", [0.01, 0.1, 0.0])
def test_an_arm_that_ends_beside_its_goal_leaves_its_goal_tolerance(tolerance):
    world = World()
    motion = world.verbs.trajectory(
        to(world, STEP, goal_tolerance=tolerance, goal_time_s=0.5, duration_s=3.0)
    )
    world.tick(int(2.0 / DT_S))
    world.sag[1] = 0.03
    world.run(motion)
    if tolerance == 0.01:
        assert motion.reason.startswith("goal tolerance: shoulder_lift_joint is 0.03")
        assert motion.outcome is Outcome.ABORTED
    else:
        assert motion.outcome is Outcome.DONE


def test_a_goal_that_is_reached_late_but_in_time_is_reached():
    world = World()
    motion = world.verbs.trajectory(to(world, STEP, goal_tolerance=0.01, goal_time_s=0.5))
    world.tick(int(1.8 / DT_S))
    world.sag[1] = 0.03
    world.tick(int(0.4 / DT_S))
    assert not motion.over
    world.sag[1] = 0.0
    assert world.run(motion).outcome is Outcome.DONE


def test_a_robot_that_is_lost_ends_it():
    world = World()
    motion = world.verbs.trajectory(to(world, STEP))
    world.tick(int(0.9 / DT_S))
    world.link = RobotLink.LOST
    world.tick(5)
    assert motion.outcome is Outcome.ABORTED
