"""The control tick in virtual time: without a live device and re-arming the arm does not move."""

import math

import pytest

from cardan.gateway.arm.commanded_arm import TaskSpaceArm
from cardan.gateway.arm.states import Inhibit, MotionState
from cardan.gateway.arm.status import Phase
from cardan.gateway.arm.supervision import LONGEST_STEP_PERIODS, TRUST_AFTER_S, Watchdogs
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.filters import TwistFilter
from cardan.gateway.operator.mapping import GripperOptions, MappingOptions
from cardan.spatial import norm, subtract
from cardan.types import (
    IDENTITY,
    NEVER_S,
    ZERO_TWIST,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    HoldCommand,
    Pose,
    PoseCommand,
    RobotLink,
    RobotState,
    Twist,
    Vector3,
)
from tests.controllers import controller_for_device

DT_S = 0.004
START = Pose(Vector3(0.5, 0.0, 0.8), IDENTITY)
FORWARD = (1.0, 0, 0, 0, 0, 0)
REST = (0.0,) * 6


class Bench:
    """A controller, a device whose state the test sets, and an ideal robot that is at its
    command."""

    def __init__(self, deadman=("left",), gripper=None, limits=None, filters=(), watchdogs=None):
        self.core = controller_for_device(
            MappingOptions(deadman=deadman),
            limits or ReferenceLimits(),
            watchdogs,
            filters,
            gripper=gripper,
        )
        self.now_s = 100.0
        self.session = None
        self.robot = RobotState(
            stamp_s=self.now_s,
            link=RobotLink.LIVE,
            session=1,
            sequence=0,
            period_s=DT_S,
            joints=(0.0,) * 6,
            external_axes=(),
            pose=START,
            hold_reason="",
        )
        self.device = DeviceState(self.now_s, DeviceLink.LIVE, REST, frozenset())
        self.fresh = True
        self.command = None
        self.speeds = []

    def hand(self, axes=REST, *buttons, link=DeviceLink.LIVE, reason=""):
        self.device = self.device._replace(
            axes=axes, buttons=frozenset(buttons), link=link, reason=reason
        )

    def run(self, seconds=DT_S, events=(), **robot):
        for _ in range(max(1, round(seconds / DT_S))):
            self.now_s += DT_S
            self.robot = self.robot._replace(
                stamp_s=self.now_s, sequence=self.robot.sequence + 1, **robot
            )
            if self.fresh:
                self.device = self.device._replace(stamp_s=self.now_s)
            before = self.status.twist.linear
            session, self.session = self.session, self.robot.session
            self.command = self.core.tick(self.robot, self.device, events)
            events = ()
            after = self.status.twist.linear
            self.speeds.append(norm(after))
            if isinstance(self.command, PoseCommand):
                # a new session begins at rest: no speed to continue
                before = before if session == self.robot.session else Vector3(0, 0, 0)
                step = norm(subtract(after, before))
                assert step <= ReferenceLimits().linear_acceleration_m_s2 * DT_S * (1 + 1e-9)
                self.robot = self.robot._replace(pose=self.command.pose)
        return self

    def arm(self):
        self.hand()
        self.run()
        self.hand(REST, "left")
        return self.run()

    def drive(self, seconds=0.5):
        self.arm()
        self.hand(FORWARD, "left")
        self.run(seconds)
        assert self.core.phase is Phase.MOVING
        return self

    @property
    def status(self):
        return self.core.status()

    def braked_within(self, speed, acceleration=1.0):
        """Run until rest; check that the ramp has no step and takes no longer than necessary."""
        first = self.speeds[-1]
        assert first > 0
        self.run(speed / acceleration + 2 * DT_S)
        assert self.core.at_rest
        return self


def test_first_command_is_the_measured_pose_at_rest():
    bench = Bench().run()
    assert bench.command == PoseCommand(START, ZERO_TWIST)


def test_moves_only_while_the_deadman_is_held():
    bench = Bench().arm()
    bench.hand(FORWARD)
    bench.run(0.2)
    assert bench.core.at_rest
    bench.hand(FORWARD, "left")
    bench.run(0.5)
    assert bench.core.phase is Phase.MOVING
    assert bench.core.reference.linear == pytest.approx((0.1, 0, 0))
    bench.hand(FORWARD)
    bench.run()
    assert bench.core.phase is Phase.BRAKING
    bench.braked_within(0.1)
    assert bench.core.phase is Phase.HOLDING


def test_regripping_needs_no_ceremony_and_makes_no_step():
    bench = Bench().drive()
    bench.hand(FORWARD)
    bench.run(0.5)
    where = bench.core.reference.pose
    bench.hand(FORWARD, "left")
    bench.run()
    assert norm(subtract(bench.core.reference.pose.position, where.position)) < 1e-4
    bench.run(0.3)
    assert bench.core.phase is Phase.MOVING


@pytest.mark.parametrize("link", [DeviceLink.LOST, DeviceLink.STALE, DeviceLink.CLOSED])
def test_a_lost_device_brakes_and_needs_rearming(link):
    bench = Bench().drive()
    bench.hand(REST, link=link, reason="the SpaceMouse was unplugged")
    bench.run()
    assert bench.core.phase is Phase.BRAKING
    bench.braked_within(0.1)
    assert bench.core.phase is Phase.DISARMED
    assert "unplugged" in bench.status.message
    assert bench.status.trips == 1
    # Connected again, deflected and with the button pressed: not enough for re-arming.
    bench.hand(FORWARD, "left")
    bench.run(0.2)
    assert bench.core.at_rest
    bench.hand()
    bench.run()
    bench.hand(FORWARD, "left")
    bench.run(0.2)
    assert bench.core.phase is Phase.MOVING
    assert bench.status.message == ""


def test_silence_while_deflected_trips_even_if_the_driver_does_not_say_so():
    bench = Bench().drive()
    bench.fresh = False
    bench.run(0.096)
    assert bench.core.phase is Phase.MOVING
    bench.run(0.008)
    assert bench.core.phase is Phase.BRAKING
    assert "silent" in bench.status.message


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_numbers_never_reach_the_reference(bad):
    bench = Bench().drive()
    bench.hand((bad, 0, 0, 0, 0, 0), "left")
    bench.run().braked_within(0.1)
    assert bench.core.phase is Phase.DISARMED
    assert all(map(math.isfinite, bench.core.reference.pose.position))
    bench.hand((bad, 0, 0, 0, 0, 0))
    bench.run()
    bench.hand(FORWARD, "left")
    bench.run()
    assert bench.core.at_rest


def test_a_robot_that_stops_acting_is_braked_and_then_followed_not_dragged():
    bench = Bench().drive()
    moved = Pose(Vector3(0.4, 0.1, 0.7), IDENTITY)
    bench.run(hold_reason="motors are off", pose=moved)
    # A robot that is heard may still follow: the command brakes in a ramp, without a step.
    assert isinstance(bench.command, PoseCommand)
    assert bench.core.phase is Phase.BRAKING
    assert bench.status.message == "motors are off"
    for _ in range(50):
        bench.run(hold_reason="motors are off", pose=moved)
    assert bench.command == HoldCommand()
    assert bench.core.phase is Phase.NO_ROBOT
    assert bench.status.message == "motors are off"
    bench.run(hold_reason="", pose=moved)
    assert bench.command.pose == moved
    assert bench.core.phase is Phase.DISARMED
    bench.run(0.2)
    assert bench.command.pose == moved


def test_a_silent_robot_disarms():
    bench = Bench().drive()
    bench.run(link=RobotLink.LOST, hold_reason="no datagram for 0.1 s")
    assert bench.command == HoldCommand()
    bench.run(0.1, link=RobotLink.LIVE, hold_reason="")
    assert bench.core.phase is Phase.DISARMED
    assert "silent" in bench.status.message


def test_a_restarted_controller_voids_the_reference():
    bench = Bench().drive()
    elsewhere = Pose(Vector3(0.3, 0.3, 0.6), IDENTITY)
    bench.run(session=2, pose=elsewhere)
    assert bench.command == PoseCommand(elsewhere, ZERO_TWIST)
    assert bench.core.phase is Phase.DISARMED
    assert "new session" in bench.status.message


def test_a_late_tick_does_not_make_the_reference_jump():
    bench = Bench().drive()
    before = bench.core.reference.pose.position
    bench.now_s += 0.06
    commanded, steps_s = bench.core.commanded, []
    commanded.longest_step_s, follow = 0.5 * DT_S, commanded.follow
    commanded.follow = lambda reference, dt_s, *more: (
        steps_s.append(dt_s) or follow(reference, dt_s, *more)
    )
    bench.run(period_s=0.06)
    assert len(steps_s) > 2
    assert max(steps_s) <= commanded.longest_step_s * (1.0 + 1e-9)
    moved = norm(subtract(bench.core.reference.pose.position, before))
    assert moved <= 0.1 * LONGEST_STEP_PERIODS * DT_S + 1e-9
    assert bench.core.phase is Phase.MOVING


def test_after_a_stall_the_reference_is_where_the_robot_is():
    bench = Bench().drive()
    elsewhere = Pose(subtract(bench.robot.pose.position, Vector3(0.006, 0, 0)), IDENTITY)
    bench.now_s += 0.6
    state = bench.robot._replace(stamp_s=bench.now_s, pose=elsewhere, period_s=0.6)
    device = bench.device._replace(stamp_s=bench.now_s)
    assert bench.core.tick(state, device) == PoseCommand(elsewhere, ZERO_TWIST)
    assert bench.core.phase is Phase.DISARMED
    assert "stalled for 0.6 s" in bench.status.message


def test_gravity_sag_does_not_creep_into_the_reference():
    bench = Bench().arm()
    where = bench.core.reference.pose
    for _ in range(100):
        # The robot sags 2 mm below its command, and the operator grips repeatedly.
        sagged = Pose(subtract(where.position, Vector3(0, 0, 0.002)), IDENTITY)
        bench.hand(REST)
        bench.run(pose=sagged)
        bench.hand(REST, "left")
        bench.run(pose=sagged)
    assert bench.core.reference.pose == where


def pushed_away(bench, way_m=0.2):
    """Push the arm sideways at 1 m/s; return the pose at which it stays."""
    here = bench.robot.pose
    for step in range(1, round(way_m / DT_S) + 1):
        away = Pose(subtract(here.position, Vector3(0.0, step * DT_S, 0.0)), IDENTITY)
        bench.run(pose=away)
    return away


def stays(bench, seconds, pose):
    """Hold the robot at `pose`; return the highest commanded speed meanwhile, m/s."""
    fastest = 0.0
    for _ in range(round(seconds / DT_S)):
        bench.run(pose=pose)
        fastest = max(fastest, bench.speeds[-1])
    return fastest


def test_a_robot_held_by_something_else_gets_its_reference_back_gently():
    bench = Bench().drive()
    away = pushed_away(bench, 0.12)
    assert "something else holds it" in bench.status.message
    stays(bench, 0.1, away)
    assert bench.core.phase is Phase.RECOVERING
    before = bench.core.commanded.pose.position
    assert stays(bench, 4.0, away) <= 0.05 * (1 + 1e-9)
    went = norm(subtract(bench.core.commanded.pose.position, before))
    assert went <= ReferenceLimits().max_lead_m
    assert bench.core.phase is Phase.DISARMED
    assert bench.status.trips == 1


def test_no_recovery_goes_farther_than_the_maximum_lead_without_rearming():
    bench = Bench().drive()
    away = pushed_away(bench)
    max_lead_m = ReferenceLimits().max_lead_m
    stays(bench, 5.0, away)
    assert bench.core.phase is Phase.DISARMED
    assert "not resynchronized with the robot" in bench.status.message
    start = bench.core.commanded.pose.position
    assert stays(bench, 5.0, away) == 0.0  # not by itself, after any time
    for _ in range(4):
        bench.hand()
        bench.run(pose=away)
        bench.hand(REST, "left")
        before = bench.core.commanded.pose.position
        assert stays(bench, 5.0, away) <= 0.05 * (1 + 1e-9)
        assert norm(subtract(bench.core.commanded.pose.position, before)) <= 1.1 * max_lead_m
    assert norm(subtract(bench.core.commanded.pose.position, start)) > 2.0 * max_lead_m
    assert norm(subtract(bench.core.commanded.pose.position, away.position)) < 0.2 * max_lead_m
    bench.hand()
    bench.run(pose=away)
    bench.hand(REST, "left")
    bench.run(pose=away)
    assert bench.core.phase is Phase.HOLDING


def test_any_button_ends_a_recovery():
    bench = Bench().drive()
    away = pushed_away(bench, 0.12)
    stays(bench, 0.1, away)
    assert bench.core.phase is Phase.RECOVERING
    bench.run(events=[ButtonEvent(bench.now_s, "right", True)], pose=away)
    stays(bench, 0.1, away)
    assert bench.core.phase is Phase.DISARMED
    assert "ended by a button" in bench.status.message
    assert stays(bench, 1.0, away) == 0.0


def test_any_button_ends_the_easing_of_an_armed_arm_too():
    bench = Bench().drive(0.3)
    stuck = bench.robot.pose
    for _ in range(200):
        bench.run(pose=stuck)
    bench.hand(FORWARD)
    for _ in range(60):
        bench.run(pose=stuck)
    assert bench.core.phase is Phase.RECOVERING
    assert "any button ends it" in bench.status.message
    bench.run(events=[ButtonEvent(bench.now_s, "right", True)], pose=stuck)
    stays(bench, 0.1, stuck)
    assert stays(bench, 1.0, stuck) == 0.0
    assert bench.core.phase is Phase.HOLDING
    assert bench.status.trips == 0


def test_a_recovery_can_be_switched_off():
    bench = Bench(watchdogs=Watchdogs(recovery=False)).drive()
    away = pushed_away(bench, 0.12)
    stays(bench, 0.2, away)
    assert stays(bench, 1.0, away) == 0.0
    assert "recovery is switched off" in bench.status.message


@pytest.mark.parametrize("jump_m", [0.2, 1e9])
@pytest.mark.parametrize("driven", [False, True])
def test_a_pose_that_jumps_is_not_believed_and_moves_nothing(jump_m, driven):
    bench = Bench().arm()
    if driven:
        bench.hand(FORWARD, "left")
        bench.run(0.5)
    else:
        bench.hand()
        bench.run(0.1)
    here = bench.robot.pose
    there = Pose(subtract(here.position, Vector3(0.0, jump_m, 0.0)), IDENTITY)
    trips = bench.status.trips
    stays(bench, 0.15, there)
    rested = bench.core.commanded.pose
    assert norm(subtract(rested.position, here.position)) < 0.006  # braking distance, if any
    assert stays(bench, 5.0, there) == 0.0
    assert bench.core.commanded.pose == rested
    assert bench.core.phase in (Phase.DISARMED, Phase.NO_ROBOT)
    assert ("jumped by" if jump_m < 1.0 else "farther than any") in bench.status.message
    assert bench.status.trips == trips + 1
    # A dead-man's switch held since before does not re-arm when the reading is plausible again.
    stays(bench, TRUST_AFTER_S + 0.1, rested)
    bench.hand()
    bench.run(pose=rested)
    bench.hand(REST, "left")
    bench.run(pose=rested)
    bench.hand()
    bench.run(pose=rested)
    bench.hand(REST, "left")
    bench.run(pose=rested)
    assert bench.core.phase is Phase.HOLDING


def test_a_stall_while_readings_are_rejected_ends_the_motion_at_once():
    bench = Bench().drive()
    there = Pose(subtract(bench.robot.pose.position, Vector3(0.0, 0.3, 0.0)), IDENTITY)
    bench.run(pose=there)
    assert bench.core.rejects
    assert not bench.core.at_rest
    bench.now_s += 0.6
    bench.run(pose=there)
    assert bench.core.rejects
    assert bench.core.state.motion is MotionState.HOLDING


def test_an_arm_that_lags_stops_when_the_hand_lets_go():
    bench = Bench().drive(0.3)
    stuck = bench.robot.pose
    for _ in range(200):
        bench.run(pose=stuck)
    assert bench.status.lead_used > 0.9
    bench.hand(FORWARD)
    for _ in range(300):
        bench.run(pose=stuck)
    assert bench.core.at_rest
    assert bench.status.lead_used < 0.15
    assert bench.status.trips == 0


def test_stopping_brakes_and_stays():
    bench = Bench().drive()
    bench.core.inhibit("stopped by SIGTERM", Inhibit.FOR_GOOD)
    bench.run().braked_within(0.1)
    bench.hand()
    bench.run()
    bench.hand(FORWARD, "left")
    bench.run(0.2)
    assert bench.core.at_rest
    assert bench.status.message == "stopped by SIGTERM"


def test_gripper_needs_an_armed_hand():
    bench = Bench(gripper=GripperOptions(toggle="right"))
    press = [ButtonEvent(0.0, "right", True)]
    bench.run(events=press)
    assert not bench.status.gripper_closed
    bench.arm()
    bench.run(events=press)
    assert bench.status.gripper_closed


def test_a_device_never_heard_keeps_everything_still():
    bench = Bench()
    bench.fresh = False
    bench.device = DeviceState(
        NEVER_S, DeviceLink.NEEDS_NEUTRAL, REST, frozenset(), reason="touch the cap once"
    )
    bench.run(0.5)
    assert bench.command == PoseCommand(START, ZERO_TWIST)
    assert bench.status.message == "touch the cap once"


class Rule(TwistFilter):
    """A filter that applies a function to the twist and records its inputs."""

    def __init__(self, rule, name="rule"):
        self.rule, self.name, self.given, self.words = rule, name, [], ""

    def open(self):
        pass

    def close(self):
        pass

    def apply(self, twist, robot):
        self.given.append(twist)
        return self.rule(twist)

    def status(self):
        return self.words


def faster(twist):
    return Twist(Vector3(99.0, 0, 0), twist.angular, twist.frame)


def sideways(twist):
    return Twist(Vector3(0, twist.linear.x, 0), twist.angular, twist.frame)


def halved(twist):
    return twist._replace(linear=Vector3(*(0.5 * v for v in twist.linear)))


def test_filters_are_applied_in_their_order_and_shown():
    first, second = Rule(sideways), Rule(halved)
    bench = Bench(filters=(first, second)).drive()
    assert bench.core.reference.linear == pytest.approx((0, 0.05, 0))
    assert second.given[-1].linear == pytest.approx((0, 0.1, 0))
    assert bench.status.target.linear == pytest.approx((0, 0.05, 0))
    assert bench.status.filters == ()
    second.words = "half speed"
    assert bench.status.filters == ("half speed",)


def test_a_filter_is_called_once_a_tick_whatever_happens():
    rule = Rule(halved)
    bench = Bench(filters=(rule,)).drive(0.1)
    bench.run(0.1, link=RobotLink.LOST, hold_reason="silent", pose=None)
    assert len(rule.given) == bench.robot.sequence
    assert rule.given[-1] == ZERO_TWIST


def test_every_limit_holds_after_a_filter():
    bench = Bench(filters=(Rule(faster),)).drive()
    assert max(bench.speeds) == pytest.approx(ReferenceLimits().linear_speed_m_s)


def test_a_filter_that_stops_brakes_in_a_ramp_and_lets_go_on():
    rule = Rule(lambda twist: twist)
    bench = Bench(filters=(rule,)).drive()
    rule.rule = lambda twist: ZERO_TWIST
    bench.run()
    assert bench.core.phase is Phase.BRAKING
    bench.braked_within(0.1)
    assert bench.core.phase is Phase.HOLDING
    assert bench.status.trips == 0
    rule.rule = lambda twist: twist
    bench.run(0.5)
    assert bench.core.phase is Phase.MOVING


def raises(_twist):
    raise ZeroDivisionError("0 targets")


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (lambda t: t._replace(linear=Vector3(math.nan, 0, 0)), "not numbers"),
        (lambda t: t._replace(angular=Vector3(0, math.inf, 0)), "not numbers"),
        (raises, "0 targets"),
        (lambda t: None, "failed"),
    ],
)
def test_a_filter_that_fails_takes_the_hand_off_the_robot(rule, words):
    good, bad, last = Rule(halved), Rule(lambda t: t, "mine"), Rule(halved)
    bench = Bench(filters=(good, bad, last)).drive()
    bad.rule = rule
    bench.run()
    assert bench.core.phase is Phase.BRAKING
    assert last.given[-1] == ZERO_TWIST
    bench.braked_within(0.05)
    assert bench.core.phase is Phase.DISARMED
    assert bench.status.message.startswith("the filter mine ")
    assert words in bench.status.message
    bench.arm().run(0.1)
    assert bench.core.phase is Phase.DISARMED
    assert bench.status.trips == 1
    bad.rule = lambda t: t
    bench.run(0.1)
    assert bench.core.phase is Phase.DISARMED
    bench.drive()


def test_without_a_deadman_a_failing_filter_trips_once():
    rule = Rule(halved)
    bench = Bench(deadman=(), filters=(rule,)).run()
    rule.rule = raises
    bench.run(0.5)
    assert bench.status.trips == 1
    rule.rule = halved
    bench.run()
    assert bench.core.phase is Phase.DISARMED
    bench.run()
    assert bench.core.phase is Phase.HOLDING


class Model(TaskSpaceArm):
    """An arm's model that computes START, whatever the robot reports."""

    def obstacle(self, state, new):
        return ""

    def measured(self, state):
        return START


def test_filters_see_the_pose_of_the_arms_model_where_there_is_one():
    seen = []
    rule = Rule(halved)
    rule.apply = lambda twist, robot: seen.append(robot.pose) or twist
    bench = Bench(filters=(rule,))
    bench.core.commanded = Model(ReferenceLimits())
    bench.run(pose=None)
    assert seen == [START]
