"""A motion is done when the measured arm has arrived, not its command; in simulated time."""

import re

import numpy as np
import pytest

from cardan.gateway.arm.arrival import Arrival, ArrivalOptions
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.vocab import State
from cardan.gateway.motion.joint_trajectory import GOAL_TOLERANCE, JointTrajectory
from cardan.gateway.session.assembly import make_verb_options
from cardan.gateway.session.config import parse_config
from cardan.types import CommandKind
from tests.gateway.arm.arms import DT_S, QUICK, World

ALLOWED = ArrivalOptions()
STEP = np.array([0.3, -0.2, 0.1, 0.0, 0.2, -0.4])
KINDS = [CommandKind.JOINT, CommandKind.JOINT_VELOCITY]


def gp8(plant, kind=CommandKind.JOINT, **more):
    world = World("gp8", commands=frozenset({kind}), plant=plant, **more)
    world.verbs.set_parameters(QUICK)
    return world


def begun(world, verb, length_m=-0.15):
    if verb == "trajectory":
        rows = np.array([world.q, world.q + STEP])
        return world.verbs.trajectory(JointTrajectory([0.0, 2.0], rows))
    return getattr(world.verbs, verb)(world.moved(0.0, 0.1, length_m))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("verb", ["movl", "movj", "trajectory"])
def test_a_motion_is_over_when_the_arm_that_lags_is_there(verb, kind):
    world = gp8("paper", kind)
    motion = world.run(begun(world, verb))
    assert motion.outcome is Outcome.DONE, motion
    servo = world.verbs.servo
    measured, commanded = servo.pose_at(world.q.tolist()), servo.pose
    assert np.linalg.norm(np.subtract(measured.position, commanded.position)) < 0.003
    assert np.abs(world.q - servo.q).max() < 0.01
    assert np.abs(world.v).max() < 0.03
    world.tick(200)
    assert np.abs(world.q - servo.q).max() < 1e-4


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("verb", ["movl", "movj", "trajectory"])
def test_an_ideal_arm_waits_for_a_few_cycles_only(verb, kind):
    world = gp8("ideal", kind)
    motion = begun(world, verb)
    resting = 0
    while not motion.over:
        world.tick()
        resting = 0 if world.verbs.servo.moving else resting + 1
    assert motion.outcome is Outcome.DONE
    assert resting <= 6


@pytest.mark.parametrize(
    ("verb", "reason"),
    [
        ("movj", r"has not arrived 2 s after its command: joint_2_l is 0.0300 from its goal"),
        ("movl", r"has not arrived 2 s after its command: the TCP is \d+\.\d mm and 0\.03"),
        ("trajectory", r"goal tolerance: joint_2_l is 0.0300 off its trajectory"),
    ],
)
def test_an_arm_that_stays_off_its_goal_is_not_waited_for_for_ever(verb, reason):
    world = gp8("ideal")
    motion = begun(world, verb)
    world.tick(20)
    world.sag[1] = 0.03
    world.run(motion, motion.duration_s + ALLOWED.arrival_timeout_s)
    assert motion.outcome is Outcome.ABORTED
    assert re.search(reason, motion.reason), motion.reason
    assert world.verbs.at_rest


@pytest.mark.parametrize("joint", [1, 5])
def test_before_a_lagging_arm_may_have_begun_wide_tolerances_do_not_count(joint):
    wide = ArrivalOptions(arrival_m=0.1, arrival_rad=0.1, arrival_joint=0.1)
    world = gp8("paper", options=ControllerOptions(arrival=wide))
    motion = begun(world, "movl")
    waited = 0
    while not motion.over:
        world.sag[joint] = 0.03
        world.tick()
        waited = 0 if world.verbs.servo.moving else waited + 1
    assert motion.outcome is Outcome.DONE
    assert waited * DT_S >= 0.4


@pytest.mark.parametrize("verb", ["movl", "movj", "trajectory"])
def test_how_near_and_how_long_are_options(verb):
    wide = ArrivalOptions(arrival_m=0.1, arrival_rad=0.1, arrival_joint=0.1)
    short = ArrivalOptions(arrival_timeout_s=0.5)
    for arrival, outcome in ((wide, Outcome.DONE), (short, Outcome.ABORTED)):
        world = gp8("ideal", options=ControllerOptions(arrival=arrival))
        motion = begun(world, verb)
        world.tick(20)
        world.sag[1] = 0.03
        world.run(motion, motion.duration_s + 0.7)
        assert motion.outcome is outcome


def test_an_arm_that_comes_through_its_goal_has_not_arrived():
    arrival = ArrivalOptions(arrival_timeout_s=0.1)
    world = gp8("ideal", options=ControllerOptions(arrival=arrival))
    motion = begun(world, "movj")
    world.tick(50)
    while world.verbs.servo.moving:
        world.sag[0] = 0.04
        world.tick()
    for sag in [0.04] * 22 + [0.004, 0.002, 0.0, -0.002, -0.004]:
        world.sag[0] = sag
        world.tick()
    assert motion.outcome is Outcome.ABORTED
    assert "it still moves" in motion.reason


def test_one_that_swings_about_its_goal_has_not_arrived():
    arrival = Arrival(ALLOWED)
    world = World()
    for tick in range(200):
        world.now_s += DT_S
        away = 0.02 * np.sin(2.0 * np.pi * 12.5 * tick * DT_S)
        world.sag[0] = away
        arrival.observe(world.state())
        assert not arrival.arrived(world.state(), abs(away) < ALLOWED.arrival_joint)


def test_a_coarse_encoder_at_rest_is_slow():
    world = gp8("ideal")
    motion = begun(world, "movj")
    while not motion.over:
        world.sag[0] = 0.0015 * (world.sequence % 3 == 0)
        world.tick()
    assert motion.outcome is Outcome.DONE


@pytest.mark.parametrize("verb", ["movl", "movj", "trajectory"])
def test_while_the_arm_is_waited_for_stop_ends_it_at_once(verb):
    world = gp8("paper")
    motion = begun(world, verb)
    world.tick(10)
    while world.verbs.servo.moving:
        world.tick()
    assert world.verbs.state is not State.NOT_CONTROLLING
    world.verbs.stop()
    world.tick(2)
    assert (motion.outcome, motion.reason) == (Outcome.ABORTED, "stopped")
    assert world.verbs.at_rest


@pytest.mark.parametrize("turns", [-1, 2])
@pytest.mark.parametrize("verb", ["movl", "movj"])
def test_whole_turns_of_a_continuous_joint_are_no_distance(verb, turns):
    world = World("pr2_right_arm")
    motion = begun(world, verb, -0.05)
    world.tick(20)
    world.sag[6] = 2.0 * np.pi * turns
    assert world.run(motion).outcome is Outcome.DONE


def test_an_arm_that_was_not_seen_before_has_not_arrived():
    assert not Arrival(ALLOWED).arrived(World().state(), True)


@pytest.mark.parametrize("verb", ["movl", "movj"])
def test_a_short_motion_is_not_over_before_an_arm_that_lags_has_begun_it(verb):
    world = gp8("paper")
    motion = world.run(getattr(world.verbs, verb)(world.moved(0.0, 0.0, -0.008)))
    assert motion.outcome is Outcome.DONE
    servo = world.verbs.servo
    measured = servo.pose_at(world.q.tolist()).position
    assert np.linalg.norm(np.subtract(measured, servo.pose.position)) < 0.002


def test_a_session_has_them_in_its_table_of_the_arm():
    arm = {"model": "ur5", "arrival_m": 0.001, "arrival_timeout_s": 5.0}
    config = parse_config({"robot": {"driver": "sim_arm"}, "arm": arm})
    arrival = make_verb_options(config).arrival
    assert (arrival.arrival_m, arrival.arrival_timeout_s) == (0.001, 5.0)
    assert arrival.arrival_joint == ALLOWED.arrival_joint


@pytest.mark.parametrize("verb", ["movl", "movj", "trajectory"])
def test_where_only_the_command_is_already_the_arm_is_waited_for(verb):
    """A request is repeated after a stop near the goal, or after a motion that did not arrive."""
    world = gp8("ideal")
    world.run(world.verbs.movj(world.moved(0.0, 0.0, -0.01)))
    world.sag[1] = 0.03
    world.tick(5)
    servo = world.verbs.servo

    def again():
        if verb == "trajectory":
            return world.verbs.trajectory(JointTrajectory([1.0], [servo.q.tolist()]))
        return getattr(world.verbs, verb)(servo.pose)

    motion = world.run(again(), 3.5)
    assert motion.outcome is Outcome.ABORTED
    assert "joint_2_l is 0.0300" in motion.reason
    assert motion.reason.startswith(GOAL_TOLERANCE) is (verb == "trajectory")
    motion = again()
    world.tick(20)
    assert motion.outcome is Outcome.RUNNING
    world.sag[1] = 0.0
    assert world.run(motion, 1.5).outcome is Outcome.DONE
    assert again().outcome is Outcome.DONE
