"""The control tick in virtual time: nothing moves unless a fresh, deliberate hand says so."""

import math

import pytest

from cardan.gateway.arm.commanded_arm import TaskSpaceArm
from cardan.gateway.arm.states import Inhibit
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


class Rig:
    """An engine, a device set by hand and an ideal robot that is where it is told."""

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
                # a new session starts at rest: there is no speed to take over
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
        """Runs until rest and checks that the ramp was neither a jump nor longer than needed."""
        first = self.speeds[-1]
        assert first > 0
        self.run(speed / acceleration + 2 * DT_S)
        assert self.core.at_rest
        return self


def test_first_command_is_the_measured_pose_at_rest():
    rig = Rig().run()
    assert rig.command == PoseCommand(START, ZERO_TWIST)


def test_moves_only_while_the_deadman_is_held():
    rig = Rig().arm()
    rig.hand(FORWARD)
    rig.run(0.2)
    assert rig.core.at_rest
    rig.hand(FORWARD, "left")
    rig.run(0.5)
    assert rig.core.phase is Phase.MOVING
    assert rig.core.reference.linear == pytest.approx((0.1, 0, 0))
    rig.hand(FORWARD)
    rig.run()
    assert rig.core.phase is Phase.BRAKING
    rig.braked_within(0.1)
    assert rig.core.phase is Phase.HOLDING


def test_regripping_needs_no_ceremony_and_makes_no_step():
    rig = Rig().drive()
    rig.hand(FORWARD)
    rig.run(0.5)
    where = rig.core.reference.pose
    rig.hand(FORWARD, "left")
    rig.run()
    assert norm(subtract(rig.core.reference.pose.position, where.position)) < 1e-4
    rig.run(0.3)
    assert rig.core.phase is Phase.MOVING


@pytest.mark.parametrize("link", [DeviceLink.LOST, DeviceLink.STALE, DeviceLink.CLOSED])
def test_a_lost_device_brakes_and_needs_rearming(link):
    rig = Rig().drive()
    rig.hand(REST, link=link, reason="the SpaceMouse was unplugged")
    rig.run()
    assert rig.core.phase is Phase.BRAKING
    rig.braked_within(0.1)
    assert rig.core.phase is Phase.DISARMED
    assert "unplugged" in rig.status.message
    assert rig.status.trips == 1
    # back again, still deflected and with the button held: not enough
    rig.hand(FORWARD, "left")
    rig.run(0.2)
    assert rig.core.at_rest
    rig.hand()
    rig.run()
    rig.hand(FORWARD, "left")
    rig.run(0.2)
    assert rig.core.phase is Phase.MOVING
    assert rig.status.message == ""


def test_silence_while_deflected_trips_even_if_the_driver_does_not_say_so():
    rig = Rig().drive()
    rig.fresh = False
    rig.run(0.096)
    assert rig.core.phase is Phase.MOVING
    rig.run(0.008)
    assert rig.core.phase is Phase.BRAKING
    assert "silent" in rig.status.message


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_numbers_never_reach_the_reference(bad):
    rig = Rig().drive()
    rig.hand((bad, 0, 0, 0, 0, 0), "left")
    rig.run().braked_within(0.1)
    assert rig.core.phase is Phase.DISARMED
    assert all(map(math.isfinite, rig.core.reference.pose.position))
    rig.hand((bad, 0, 0, 0, 0, 0))
    rig.run()
    rig.hand(FORWARD, "left")
    rig.run()
    assert rig.core.at_rest


def test_a_robot_that_stops_acting_is_braked_and_then_followed_not_dragged():
    rig = Rig().drive()
    moved = Pose(Vector3(0.4, 0.1, 0.7), IDENTITY)
    rig.run(hold_reason="motors are off", pose=moved)
    # As long as it is heard it may still obey: the command ramps down, it does not break off.
    assert isinstance(rig.command, PoseCommand)
    assert rig.core.phase is Phase.BRAKING
    assert rig.status.message == "motors are off"
    for _ in range(50):
        rig.run(hold_reason="motors are off", pose=moved)
    assert rig.command == HoldCommand()
    assert rig.core.phase is Phase.NO_ROBOT
    assert rig.status.message == "motors are off"
    rig.run(hold_reason="", pose=moved)
    assert rig.command.pose == moved
    assert rig.core.phase is Phase.DISARMED
    rig.run(0.2)
    assert rig.command.pose == moved


def test_a_silent_robot_disarms():
    rig = Rig().drive()
    rig.run(link=RobotLink.LOST, hold_reason="no datagram for 0.1 s")
    assert rig.command == HoldCommand()
    rig.run(0.1, link=RobotLink.LIVE, hold_reason="")
    assert rig.core.phase is Phase.DISARMED
    assert "silent" in rig.status.message


def test_a_restarted_controller_voids_the_reference():
    rig = Rig().drive()
    elsewhere = Pose(Vector3(0.3, 0.3, 0.6), IDENTITY)
    rig.run(session=2, pose=elsewhere)
    assert rig.command == PoseCommand(elsewhere, ZERO_TWIST)
    assert rig.core.phase is Phase.DISARMED
    assert "new session" in rig.status.message


def test_a_late_tick_does_not_make_the_reference_jump():
    rig = Rig().drive()
    before = rig.core.reference.pose.position
    rig.now_s += 0.06
    rig.run(period_s=0.06)
    moved = norm(subtract(rig.core.reference.pose.position, before))
    assert moved <= 0.1 * LONGEST_STEP_PERIODS * DT_S + 1e-9
    assert rig.core.phase is Phase.MOVING


def test_after_a_stall_the_reference_is_where_the_robot_is():
    rig = Rig().drive()
    elsewhere = Pose(subtract(rig.robot.pose.position, Vector3(0.006, 0, 0)), IDENTITY)
    rig.now_s += 0.6
    state = rig.robot._replace(stamp_s=rig.now_s, pose=elsewhere, period_s=0.6)
    device = rig.device._replace(stamp_s=rig.now_s)
    assert rig.core.tick(state, device) == PoseCommand(elsewhere, ZERO_TWIST)
    assert rig.core.phase is Phase.DISARMED
    assert "stood still for 0.6 s" in rig.status.message


def test_gravity_sag_does_not_creep_into_the_reference():
    rig = Rig().arm()
    where = rig.core.reference.pose
    for _ in range(100):
        # the robot hangs 2 mm below its command, and the operator grips again and again
        sagged = Pose(subtract(where.position, Vector3(0, 0, 0.002)), IDENTITY)
        rig.hand(REST)
        rig.run(pose=sagged)
        rig.hand(REST, "left")
        rig.run(pose=sagged)
    assert rig.core.reference.pose == where


def pushed_away(rig, way_m=0.2):
    """Push the arm sideways at 1 m/s; return the pose where it stays."""
    here = rig.robot.pose
    for step in range(1, round(way_m / DT_S) + 1):
        away = Pose(subtract(here.position, Vector3(0.0, step * DT_S, 0.0)), IDENTITY)
        rig.run(pose=away)
    return away


def stays(rig, seconds, pose):
    """The robot is held at `pose`; returns the fastest that was commanded meanwhile, m/s."""
    fastest = 0.0
    for _ in range(round(seconds / DT_S)):
        rig.run(pose=pose)
        fastest = max(fastest, rig.speeds[-1])
    return fastest


def test_a_robot_held_by_something_else_gets_its_reference_back_gently():
    rig = Rig().drive()
    away = pushed_away(rig, 0.12)
    assert "something else holds it" in rig.status.message
    stays(rig, 0.1, away)
    assert rig.core.phase is Phase.RECOVERING
    before = rig.core.commanded.pose.position
    assert stays(rig, 4.0, away) <= 0.05 * (1 + 1e-9)
    went = norm(subtract(rig.core.commanded.pose.position, before))
    assert went <= ReferenceLimits().max_lead_m
    assert rig.core.phase is Phase.DISARMED
    assert rig.status.trips == 1


def test_no_recovery_goes_farther_than_the_maximum_lead_without_rearming():
    rig = Rig().drive()
    away = pushed_away(rig)
    max_lead_m = ReferenceLimits().max_lead_m
    stays(rig, 5.0, away)
    assert rig.core.phase is Phase.DISARMED
    assert "not resynchronized with the robot" in rig.status.message
    start = rig.core.commanded.pose.position
    assert stays(rig, 5.0, away) == 0.0  # Not by itself, however long it takes.
    for _ in range(4):
        rig.hand()
        rig.run(pose=away)
        rig.hand(REST, "left")
        before = rig.core.commanded.pose.position
        assert stays(rig, 5.0, away) <= 0.05 * (1 + 1e-9)
        assert norm(subtract(rig.core.commanded.pose.position, before)) <= 1.1 * max_lead_m
    assert norm(subtract(rig.core.commanded.pose.position, start)) > 2.0 * max_lead_m
    assert norm(subtract(rig.core.commanded.pose.position, away.position)) < 0.2 * max_lead_m
    rig.hand()
    rig.run(pose=away)
    rig.hand(REST, "left")
    rig.run(pose=away)
    assert rig.core.phase is Phase.HOLDING


def test_any_button_ends_a_recovery():
    rig = Rig().drive()
    away = pushed_away(rig, 0.12)
    stays(rig, 0.1, away)
    assert rig.core.phase is Phase.RECOVERING
    rig.run(events=[ButtonEvent(rig.now_s, "right", True)], pose=away)
    stays(rig, 0.1, away)
    assert rig.core.phase is Phase.DISARMED
    assert "ended by a button" in rig.status.message
    assert stays(rig, 1.0, away) == 0.0


def test_any_button_ends_the_easing_of_an_armed_arm_too():
    rig = Rig().drive(0.3)
    stuck = rig.robot.pose
    for _ in range(200):
        rig.run(pose=stuck)
    rig.hand(FORWARD)
    for _ in range(60):
        rig.run(pose=stuck)
    assert rig.core.phase is Phase.RECOVERING
    assert "any button ends it" in rig.status.message
    rig.run(events=[ButtonEvent(rig.now_s, "right", True)], pose=stuck)
    stays(rig, 0.1, stuck)
    assert stays(rig, 1.0, stuck) == 0.0
    assert rig.core.phase is Phase.HOLDING
    assert rig.status.trips == 0


def test_a_recovery_can_be_switched_off():
    rig = Rig(watchdogs=Watchdogs(recovery=False)).drive()
    away = pushed_away(rig, 0.12)
    stays(rig, 0.2, away)
    assert stays(rig, 1.0, away) == 0.0
    assert "recovery is switched off" in rig.status.message


@pytest.mark.parametrize("jump_m", [0.2, 1e9])
@pytest.mark.parametrize("driven", [False, True])
def test_a_pose_that_jumps_is_not_believed_and_moves_nothing(jump_m, driven):
    rig = Rig().arm()
    if driven:
        rig.hand(FORWARD, "left")
        rig.run(0.5)
    else:
        rig.hand()
        rig.run(0.1)
    here = rig.robot.pose
    there = Pose(subtract(here.position, Vector3(0.0, jump_m, 0.0)), IDENTITY)
    trips = rig.status.trips
    stays(rig, 0.15, there)
    rested = rig.core.commanded.pose
    assert norm(subtract(rested.position, here.position)) < 0.006  # A braking way, if any.
    assert stays(rig, 5.0, there) == 0.0
    assert rig.core.commanded.pose == rested
    assert rig.core.phase in (Phase.DISARMED, Phase.NO_ROBOT)
    assert ("jumped by" if jump_m < 1.0 else "farther than any") in rig.status.message
    assert rig.status.trips == trips + 1
    # A dead-man held through it does not re-arm; and the reading comes back.
    stays(rig, TRUST_AFTER_S + 0.1, rested)
    rig.hand()
    rig.run(pose=rested)
    rig.hand(REST, "left")
    rig.run(pose=rested)
    rig.hand()
    rig.run(pose=rested)
    rig.hand(REST, "left")
    rig.run(pose=rested)
    assert rig.core.phase is Phase.HOLDING


def test_an_arm_that_lags_stops_when_the_hand_lets_go():
    rig = Rig().drive(0.3)
    stuck = rig.robot.pose
    for _ in range(200):
        rig.run(pose=stuck)
    assert rig.status.lead_used > 0.9
    rig.hand(FORWARD)
    for _ in range(300):
        rig.run(pose=stuck)
    assert rig.core.at_rest
    assert rig.status.lead_used < 0.15
    assert rig.status.trips == 0


def test_stopping_brakes_and_stays():
    rig = Rig().drive()
    rig.core.inhibit("stopped by SIGTERM", Inhibit.FOR_GOOD)
    rig.run().braked_within(0.1)
    rig.hand()
    rig.run()
    rig.hand(FORWARD, "left")
    rig.run(0.2)
    assert rig.core.at_rest
    assert rig.status.message == "stopped by SIGTERM"


def test_gripper_needs_an_armed_hand():
    rig = Rig(gripper=GripperOptions(toggle="right"))
    press = [ButtonEvent(0.0, "right", True)]
    rig.run(events=press)
    assert not rig.status.gripper_closed
    rig.arm()
    rig.run(events=press)
    assert rig.status.gripper_closed


def test_a_device_never_heard_keeps_everything_still():
    rig = Rig()
    rig.fresh = False
    rig.device = DeviceState(
        NEVER_S, DeviceLink.NEEDS_NEUTRAL, REST, frozenset(), reason="touch the cap once"
    )
    rig.run(0.5)
    assert rig.command == PoseCommand(START, ZERO_TWIST)
    assert rig.status.message == "touch the cap once"


class Rule(TwistFilter):
    """A filter made of a function of the twist; records its inputs."""

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
    rig = Rig(filters=(first, second)).drive()
    assert rig.core.reference.linear == pytest.approx((0, 0.05, 0))
    assert second.given[-1].linear == pytest.approx((0, 0.1, 0))
    assert rig.status.target.linear == pytest.approx((0, 0.05, 0))
    assert rig.status.filters == ()
    second.words = "half speed"
    assert rig.status.filters == ("half speed",)


def test_a_filter_is_called_once_a_tick_whatever_happens():
    rule = Rule(halved)
    rig = Rig(filters=(rule,)).drive(0.1)
    rig.run(0.1, link=RobotLink.LOST, hold_reason="silent", pose=None)
    assert len(rule.given) == rig.robot.sequence
    assert rule.given[-1] == ZERO_TWIST


def test_every_limit_holds_after_a_filter():
    rig = Rig(filters=(Rule(faster),)).drive()
    assert max(rig.speeds) == pytest.approx(ReferenceLimits().linear_speed_m_s)


def test_a_filter_that_stops_brakes_in_a_ramp_and_lets_go_on():
    rule = Rule(lambda twist: twist)
    rig = Rig(filters=(rule,)).drive()
    rule.rule = lambda twist: ZERO_TWIST
    rig.run()
    assert rig.core.phase is Phase.BRAKING
    rig.braked_within(0.1)
    assert rig.core.phase is Phase.HOLDING
    assert rig.status.trips == 0
    rule.rule = lambda twist: twist
    rig.run(0.5)
    assert rig.core.phase is Phase.MOVING


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
    rig = Rig(filters=(good, bad, last)).drive()
    bad.rule = rule
    rig.run()
    assert rig.core.phase is Phase.BRAKING
    assert last.given[-1] == ZERO_TWIST
    rig.braked_within(0.05)
    assert rig.core.phase is Phase.DISARMED
    assert rig.status.message.startswith("the filter mine ")
    assert words in rig.status.message
    rig.arm().run(0.1)
    assert rig.core.phase is Phase.DISARMED
    assert rig.status.trips == 1
    bad.rule = lambda t: t
    rig.run(0.1)
    assert rig.core.phase is Phase.DISARMED
    rig.drive()


def test_without_a_deadman_a_failing_filter_trips_once():
    rule = Rule(halved)
    rig = Rig(deadman=(), filters=(rule,)).run()
    rule.rule = raises
    rig.run(0.5)
    assert rig.status.trips == 1
    rule.rule = halved
    rig.run()
    assert rig.core.phase is Phase.DISARMED
    rig.run()
    assert rig.core.phase is Phase.HOLDING


class Model(TaskSpaceArm):
    """An arm's model that is at START whatever the robot reports."""

    def obstacle(self, state, new):
        return ""

    def measured(self, state):
        return START


def test_filters_see_the_pose_of_the_arms_model_where_there_is_one():
    seen = []
    rule = Rule(halved)
    rule.apply = lambda twist, robot: seen.append(robot.pose) or twist
    rig = Rig(filters=(rule,))
    rig.core.commanded = Model(ReferenceLimits())
    rig.run(pose=None)
    assert seen == [START]
