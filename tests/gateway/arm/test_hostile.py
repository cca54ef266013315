"""Hostile requests, bad sensors and bad timing must not cause a motion."""

import numpy as np
import pytest

from cardan.errors import MotionRefusedError
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.states import AuthorityOptions, AuthorityPolicy, Inhibit
from cardan.gateway.arm.status import Phase
from cardan.gateway.arm.supervision import TRUST_AFTER_S
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import MappingOptions
from cardan.spatial import add, norm, subtract
from cardan.types import (
    IDENTITY,
    ButtonEvent,
    CommandKind,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    RobotLink,
    TorqueCommand,
    Vector3,
)
from tests.controllers import controller_for_device
from tests.gateway.arm.arms import DT_S, HandWorld, World
from tests.gateway.arm.random_walk import Walk
from tests.gateway.arm.test_controller_device import (
    FORWARD,
    REST,
    Bench,
    Rule,
    pushed_away,
    raises,
    stays,
)

GOFA = "gofa_crb15000_5"
QUICK = {"cpts": 0.25, "cpta": 1.0, "cprs": 1.0, "cpra": 4.0, "cpjs": 0.5}
LEFT = frozenset({"left"})


def planned_meanwhile(world, what):
    """Call `what` while the next line is planned, as another thread may."""
    plans = world.verbs.plans
    line = plans.line

    def slow(*arguments):
        plan = line(*arguments)
        what()
        return plan

    plans.line = slow


# -- timing and readings ---------------------------------------------------------------------


def test_one_state_of_no_numbers_brakes_in_a_ramp():
    bench = Bench().drive()
    good = bench.robot.pose
    bench.run(pose=good._replace(position=Vector3(float("nan"), 0.0, 0.0)))
    bench.run(pose=add_x(good, 2 * 0.1 * DT_S))
    assert bench.speeds[-1] > 0.08
    bench.braked_within(0.1)


def add_x(pose, way_m):
    return pose._replace(position=add(pose.position, Vector3(way_m, 0.0, 0.0)))


def test_a_stall_while_readings_are_not_believed_places_nothing_there():
    bench = Bench().drive()
    here = bench.core.commanded.pose.position
    there = Pose(add(bench.robot.pose.position, Vector3(0.0, 0.2, 0.0)), IDENTITY)
    bench.run(pose=there)
    assert bench.core.supervision.implausible
    bench.now_s += 0.2
    for _ in range(100):
        bench.run(pose=there)
        assert norm(subtract(bench.core.commanded.pose.position, here)) < 0.02
        if isinstance(bench.command, PoseCommand):
            assert norm(subtract(bench.command.pose.position, here)) < 0.02


def test_a_jump_is_forgotten_with_the_session_it_was_in():
    bench = Bench().arm()
    here = bench.robot.pose
    bench.run(0.02, link=RobotLink.LOST)
    away = Pose(add(here.position, Vector3(0.0, 0.5, 0.0)), IDENTITY)
    bench.run(link=RobotLink.LIVE, pose=away)
    assert bench.core.supervision.implausible
    bench.run(0.1, session=2)
    bench.drive()
    there = Pose(add(bench.robot.pose.position, Vector3(0.0, 0.2, 0.0)), IDENTITY)
    bench.hand()
    stays(bench, TRUST_AFTER_S + 0.3, there)
    rested = bench.core.commanded.pose
    bench.core.acknowledge()
    bench.run(pose=there)
    assert norm(subtract(bench.core.commanded.pose.position, rested.position)) < 1e-4


def test_readings_that_jump_are_not_caught_by_torques():
    world = World(GOFA)
    world.verbs.gcmp()
    world.tick(5)
    before = world.q.copy()
    world.q = world.q + 0.3
    world.v = np.full(6, 0.5)
    world.jammed = True
    for _ in range(50):
        world.tick()
        world.v[:] = 0.5
        if isinstance(world.command, JointCommand):
            assert np.abs(np.array(world.command.positions) - before).max() < 0.05


def test_velocities_are_not_corrected_by_readings_that_are_not_believed():
    world = HandWorld(commands=frozenset({CommandKind.JOINT_VELOCITY}))
    world.arm_hand()
    world.hand(FORWARD, "left").tick(100)
    moving = np.abs(world.command.velocities).max()
    world.sag = np.full(6, 0.3)
    for _ in range(100):
        world.tick()
        if isinstance(world.command, JointVelocityCommand):
            assert np.abs(world.command.velocities).max() <= moving + 1e-3


@pytest.mark.parametrize("joints", [(), (0.0,) * 7])
@pytest.mark.parametrize("doing", ["torque", "recovery", "stream", "operator"])
def test_states_of_another_arm_never_raise(joints, doing):
    world = HandWorld()
    if doing == "torque":
        world.verbs.gcmp()
        world.tick(5)
        world.v = np.full(6, 0.5)
        world.verbs.stop()
        world.tick()
    elif doing == "recovery":
        world.arm_hand()
        world.hand(FORWARD, "left").tick(100)
        world.jammed = True
        world.tick(200)
        world.hand().tick(100)
        assert world.verbs.controller.phase is Phase.RECOVERING
    elif doing == "stream":
        world.verbs.set_parameter("cpsc", "twst")
        world.verbs.stream("twist", [0.1, 0, 0, 0, 0, 0])
        world.tick(10)
    else:
        world.arm_hand()
        world.hand(FORWARD, "left").tick(100)
    assert world.verbs.servo.moving
    good = world.state
    world.state = lambda: good()._replace(joints=joints, velocities=())
    world.jammed = True
    world.tick(300)
    assert world.command == HoldCommand()


@pytest.mark.parametrize("period_s", [0.0, -0.004, float("nan"), float("inf")])
def test_a_robot_whose_clock_stands_still_is_braked(period_s):
    world = HandWorld(commands=frozenset({CommandKind.JOINT_VELOCITY}))
    world.arm_hand()
    world.hand(FORWARD, "left").tick(100)
    assert world.verbs.servo.moving
    good = world.state
    world.state = lambda: good()._replace(period_s=period_s)
    world.hand()
    world.tick(60)
    assert not world.verbs.servo.moving
    assert np.abs(world.command.velocities).max() < 1e-3


# -- motion without a request ----------------------------------------------------------------


def test_a_stop_while_it_still_brakes_keeps_a_recovery_from_beginning():
    bench = Bench().drive()
    away = None
    here = bench.robot.pose
    for step in range(1, 100):
        away = Pose(subtract(here.position, Vector3(0.0, step * DT_S, 0.0)), IDENTITY)
        bench.run(pose=away)
        if bench.core.recovering:
            break
    assert bench.core.phase is Phase.BRAKING
    bench.core.stop("stopped")
    stays(bench, 0.3, away)
    assert stays(bench, 2.0, away) == 0.0
    assert bench.status.message


def nobody_may_drive(bench, how):
    if how == "stop":
        bench.core.inhibit("enough", Inhibit.FOR_GOOD)
    elif how == "silence":
        bench.core.inhibit("the supervisor is silent", Inhibit.WHILE_SAID)
    else:
        bench.robot = bench.robot._replace(alarm="the port is flooded")


@pytest.mark.parametrize("how", ["stop", "silence", "alarm"])
def test_nothing_is_brought_back_while_nobody_may_drive(how):
    bench = Bench().drive()
    away = pushed_away(bench, 0.12)
    stays(bench, 0.1, away)
    assert bench.core.phase is Phase.RECOVERING
    nobody_may_drive(bench, how)
    stays(bench, 0.1, away)
    assert stays(bench, 2.0, away) == 0.0
    assert bench.core.phase is Phase.DISARMED
    bench.core.inhibit("", Inhibit.WHILE_SAID)
    bench.robot = bench.robot._replace(alarm="")
    assert stays(bench, 2.0, away) == 0.0


@pytest.mark.parametrize("how", ["stop", "silence", "alarm"])
@pytest.mark.parametrize("way_m", [0.04, 0.12])
def test_nothing_begins_to_be_brought_back_while_nobody_may_drive(how, way_m):
    bench = Bench().arm()
    nobody_may_drive(bench, how)
    bench.run()
    away = pushed_away(bench, way_m)
    assert stays(bench, 2.0, away) == 0.0
    assert bench.status.message


def test_readings_that_wander_lead_no_arm_away():
    bench = Bench().arm()
    start = bench.core.commanded.pose.position
    for _ in range(10):
        for offset_m in (0.03, 0.0):
            for _ in range(120):
                here = bench.core.commanded.pose
                bench.run(pose=Pose(add(here.position, Vector3(offset_m, 0.0, 0.0)), IDENTITY))
    went = norm(subtract(bench.core.commanded.pose.position, start))
    assert went <= 1.1 * ReferenceLimits().max_lead_m


def test_a_recovery_that_was_acknowledged_while_the_robot_is_gone_places_nothing():
    world = HandWorld()
    world.tick(5)
    world.link = RobotLink.LOST
    world.tick(5)
    world.q = world.q + 1.0
    world.link = RobotLink.LIVE
    world.tick()
    assert world.verbs.controller.supervision.implausible
    world.jammed = True
    world.tick(200)
    good = world.state
    world.state = lambda: good()._replace(joints=())
    world.tick()
    world.verbs.acknowledge()
    world.tick()
    world.state = good
    world.tick(5)
    world.jammed = False
    np.testing.assert_allclose(world.verbs.servo.q, world.q)


def test_a_pose_that_waited_for_the_planner_is_not_gone_to():
    world = World(GOFA)
    world.verbs.set_parameter("cpsc", "pose")
    planner = world.verbs.planner
    inverse = planner.inverse_nearby

    def slow(*of):
        world.tick(50)
        return inverse(*of)

    planner.inverse_nearby = slow
    assert "waited for 0.20 s" in world.verbs.stream("pose", world.moved(0.0, 0.0, 0.05))
    world.tick(50)
    assert not world.verbs.servo.moving
    planner.inverse_nearby = inverse
    assert world.verbs.stream("pose", world.moved(0.0, 0.0, 0.05)) == ""
    world.tick(5)
    assert world.verbs.servo.moving


# -- owner of a motion -----------------------------------------------------------------------


def test_a_clutch_let_go_as_a_filter_fails_is_let_go():
    fails = Rule(lambda twist: twist)
    bench = Bench(deadman=(), filters=[fails])
    bench.core = controller_for_device(MappingOptions(clutch="left"), filters=[fails])
    bench.hand()
    bench.run(0.1)
    bench.hand(REST, "left")
    bench.run(events=[ButtonEvent(bench.now_s, "left", True)])
    bench.hand()
    bench.run(events=[ButtonEvent(bench.now_s, "left", False)])
    bench.hand(FORWARD)
    bench.run(0.3)
    assert bench.core.phase is Phase.MOVING
    fails.rule = raises
    bench.hand(FORWARD, "left")
    bench.run(events=[ButtonEvent(bench.now_s, "left", True)])
    fails.rule = lambda twist: twist
    bench.hand(FORWARD)
    bench.run(0.3, events=[ButtonEvent(bench.now_s, "left", False)])
    bench.run(0.3)
    assert bench.core.at_rest
    assert bench.core.phase is Phase.DISARMED


@pytest.mark.parametrize("how", ["stop", "request_stop", "operator", "lost"])
def test_what_happens_while_a_motion_is_worked_out_counts(how):
    world = HandWorld()
    controller = world.verbs.controller

    def meanwhile():
        if how == "stop":
            world.verbs.stop()
        elif how == "request_stop":
            controller.inhibit("enough", Inhibit.FOR_GOOD)
        elif how == "operator":
            world.arm_hand()
        else:
            world.link = RobotLink.LOST
            world.tick()
            world.link = RobotLink.LIVE
            world.tick()

    planned_meanwhile(world, meanwhile)
    if how == "operator":
        controller.authority.release("verbs")
    with pytest.raises(MotionRefusedError):
        world.verbs.movl(world.moved(0.0, 0.0, -0.1))
    world.tick(50)
    assert not world.verbs.servo.moving


def test_authority_given_up_in_motion_passes_through_rest():
    world = World(GOFA)
    world.verbs.set_parameter("cpsc", "twst")
    for _ in range(50):
        assert world.verbs.stream("twist", [0.2, 0, 0, 0, 0, 0], owner="a") == ""
        world.tick()
    world.verbs.release("a")
    answer = world.verbs.stream("twist", [-0.2, 0, 0, 0, 0, 0], owner="b")
    world.tick()
    assert answer or world.verbs.controller.braking
    for _ in range(100):
        world.tick()
        world.verbs.stream("twist", [-0.2, 0, 0, 0, 0, 0], owner="b")
        if world.verbs.servo.twist[0, 0] < -1e-6:
            raise AssertionError("went over without a rest")
        if not world.verbs.servo.moving:
            break
    assert not world.verbs.servo.moving


def test_a_wrench_for_an_arm_that_is_being_caught_is_refused_in_words():
    world = World(GOFA)
    world.verbs.forc([0.0, 0.0, -5.0, 0.0, 0.0, 0.0])
    world.tick(5)
    world.v = np.full(6, 0.5)
    world.verbs.stop()
    try:
        motion = world.verbs.forc([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])
    except MotionRefusedError:
        pass
    else:
        assert motion.outcome is Outcome.WAITING


def test_a_wrench_needs_the_authority():
    world = HandWorld(
        options=ControllerOptions(authority=AuthorityOptions(policy=AuthorityPolicy.FIRST))
    )
    world.verbs.forc([0.0, 0.0, -5.0, 0.0, 0.0, 0.0])
    world.tick(5)
    world.verbs.hand_over("b")
    with pytest.raises(MotionRefusedError):
        world.verbs.forc([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])


def test_nobody_changes_the_tool_in_an_operators_hand():
    world = HandWorld()
    world.arm_hand()
    with pytest.raises(MotionRefusedError, match="authority"):
        world.verbs.tool([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])


def test_a_new_tool_is_no_following_error():
    world = HandWorld()
    world.tick(5)
    world.verbs.tool([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    world.tick(20)
    assert world.verbs.controller.trips == 0
    assert not world.verbs.servo.moving


# -- correct reports -------------------------------------------------------------------------


def test_torques_are_no_rest():
    world = World(GOFA)
    world.verbs.gcmp()
    world.tick(5)
    assert isinstance(world.command, TorqueCommand)
    assert not world.verbs.controller.at_rest
    world.verbs.stop()
    assert not world.verbs.controller.at_rest
    world.tick(5)
    assert world.verbs.controller.at_rest


# -- random walks ----------------------------------------------------------------------------

MAPPINGS = (
    MappingOptions(deadman=("left",)),
    MappingOptions(clutch="clutch"),
    MappingOptions(deadman=("left",), clutch="clutch"),
    MappingOptions(),
)
KINDS = (CommandKind.JOINT, CommandKind.JOINT_VELOCITY, CommandKind.POSE)


WALKS_NOW = (0, 3, 5, 10, 11)
"""Seeds that cover each arm, kind of command, rule of authority and mapping."""


@pytest.mark.matrix(*(str(seed) for seed in range(12) if seed not in WALKS_NOW))
@pytest.mark.parametrize("seed", range(12))
def test_every_promise_is_kept_on_a_walk_at_random(seed):
    walk = Walk(
        seed,
        "pr2_left_arm" if seed == 11 else ("ur5", GOFA)[seed % 2],
        KINDS[seed % 3],
        (AuthorityPolicy.OPERATOR, AuthorityPolicy.FIRST)[seed // 3 % 2],
        MAPPINGS[seed % 4],
    )
    walk.tick(3)
    for _ in range(50):
        walk.step()
    walk.lives()
