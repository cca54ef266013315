"""The control tick in virtual time: nothing moves unless a fresh, deliberate hand says so."""

import math

import pytest

from cardan.gateway.arm.engine import Phase, TeleopEngine, Watchdogs
from cardan.gateway.hand.filters import TwistFilter
from cardan.gateway.hand.mapping import GripperAction, MappingOptions, TwistMapping
from cardan.gateway.motion.reference import Reference, ReferenceLimits
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

DT_S = 0.004
START = Pose(Vector3(0.5, 0.0, 0.8), IDENTITY)
FORWARD = (1.0, 0, 0, 0, 0, 0)
REST = (0.0,) * 6


class Rig:
    """An engine, a device set by hand and an ideal robot that is where it is told."""

    def __init__(self, deadman=("left",), gripper=(), limits=None, filters=()):
        self.engine = TeleopEngine(
            TwistMapping(MappingOptions(deadman=deadman, gripper=gripper)),
            Reference(limits or ReferenceLimits()),
            Watchdogs(),
            filters,
        )
        self.now_s = 100.0
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
            before = self.engine.reference.linear
            session = self.engine._session
            self.command = self.engine.tick(self.robot, self.device, events)
            events = ()
            after = self.engine.reference.linear
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
        assert self.engine.phase is Phase.MOVING
        return self

    @property
    def status(self):
        return self.engine.status()

    def braked_within(self, speed, acceleration=1.0):
        """Runs until rest and checks that the ramp was neither a jump nor longer than needed."""
        first = self.speeds[-1]
        assert first > 0
        self.run(speed / acceleration + 2 * DT_S)
        assert self.engine.at_rest
        return self


def test_first_command_is_the_measured_pose_at_rest():
    rig = Rig().run()
    assert rig.command == PoseCommand(START, ZERO_TWIST)


def test_moves_only_while_the_deadman_is_held():
    rig = Rig().arm()
    rig.hand(FORWARD)
    rig.run(0.2)
    assert rig.engine.at_rest
    rig.hand(FORWARD, "left")
    rig.run(0.5)
    assert rig.engine.phase is Phase.MOVING
    assert rig.engine.reference.linear == pytest.approx((0.1, 0, 0))
    rig.hand(FORWARD)
    rig.run()
    assert rig.engine.phase is Phase.BRAKING
    rig.braked_within(0.1)
    assert rig.engine.phase is Phase.HOLDING


def test_regripping_needs_no_ceremony_and_makes_no_step():
    rig = Rig().drive()
    rig.hand(FORWARD)
    rig.run(0.5)
    where = rig.engine.reference.pose
    rig.hand(FORWARD, "left")
    rig.run()
    assert norm(subtract(rig.engine.reference.pose.position, where.position)) < 1e-4
    rig.run(0.3)
    assert rig.engine.phase is Phase.MOVING


def test_a_deadman_held_from_the_start_does_not_count():
    rig = Rig()
    rig.hand(FORWARD, "left")
    rig.run(0.5)
    assert rig.engine.phase is Phase.DISARMED
    assert rig.engine.at_rest
    assert "let go" in rig.status.message


def test_a_deadman_released_while_deflected_does_not_arm():
    rig = Rig()
    rig.hand(FORWARD)
    rig.run(0.1)
    rig.hand(FORWARD, "left")
    rig.run(0.1)
    assert rig.engine.phase is Phase.DISARMED


def test_without_a_deadman_the_device_must_have_been_at_rest():
    rig = Rig(deadman=())
    rig.hand(FORWARD)
    rig.run(0.2)
    assert rig.engine.at_rest
    rig.hand(REST)
    rig.run()
    rig.hand(FORWARD)
    rig.run(0.2)
    assert rig.engine.phase is Phase.MOVING


@pytest.mark.parametrize("link", [DeviceLink.LOST, DeviceLink.STALE, DeviceLink.CLOSED])
def test_a_lost_device_brakes_and_needs_the_deliberate_act(link):
    rig = Rig().drive()
    rig.hand(REST, link=link, reason="the SpaceMouse was unplugged")
    rig.run()
    assert rig.engine.phase is Phase.BRAKING
    rig.braked_within(0.1)
    assert rig.engine.phase is Phase.DISARMED
    assert "unplugged" in rig.status.message
    assert rig.status.trips == 1
    # back again, still deflected and with the button held: not enough
    rig.hand(FORWARD, "left")
    rig.run(0.2)
    assert rig.engine.at_rest
    rig.hand()
    rig.run()
    rig.hand(FORWARD, "left")
    rig.run(0.2)
    assert rig.engine.phase is Phase.MOVING
    assert rig.status.message == ""


def test_silence_while_deflected_trips_even_if_the_driver_does_not_say_so():
    rig = Rig().drive()
    rig.fresh = False
    rig.run(0.096)
    assert rig.engine.phase is Phase.MOVING
    rig.run(0.008)
    assert rig.engine.phase is Phase.BRAKING
    assert "silent" in rig.status.message


def test_silence_at_rest_is_no_fault():
    rig = Rig().arm()
    rig.fresh = False
    rig.run(5.0)
    assert rig.engine.phase is Phase.HOLDING
    assert rig.status.trips == 0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_numbers_never_reach_the_reference(bad):
    rig = Rig().drive()
    rig.hand((bad, 0, 0, 0, 0, 0), "left")
    rig.run().braked_within(0.1)
    assert rig.engine.phase is Phase.DISARMED
    assert all(map(math.isfinite, rig.engine.reference.pose.position))
    rig.hand((bad, 0, 0, 0, 0, 0))
    rig.run()
    rig.hand(FORWARD, "left")
    rig.run()
    assert rig.engine.at_rest


def test_a_robot_that_stops_acting_is_followed_not_dragged():
    rig = Rig().drive()
    moved = Pose(Vector3(0.4, 0.1, 0.7), IDENTITY)
    rig.run(hold_reason="motors are off", pose=moved)
    assert rig.command == HoldCommand()
    assert rig.engine.phase is Phase.NO_ROBOT
    assert rig.status.message == "motors are off"
    rig.run(hold_reason="", pose=moved)
    assert rig.command.pose == moved
    assert rig.engine.phase is Phase.DISARMED
    rig.run(0.2)
    assert rig.command.pose == moved


def test_a_silent_robot_disarms():
    rig = Rig().drive()
    rig.run(link=RobotLink.LOST, hold_reason="no datagram for 0.1 s")
    assert rig.command == HoldCommand()
    rig.run(0.1, link=RobotLink.LIVE, hold_reason="")
    assert rig.engine.phase is Phase.DISARMED
    assert "silent" in rig.status.message


def test_a_restarted_controller_voids_the_reference():
    rig = Rig().drive()
    elsewhere = Pose(Vector3(0.3, 0.3, 0.6), IDENTITY)
    rig.run(session=2, pose=elsewhere)
    assert rig.command == PoseCommand(elsewhere, ZERO_TWIST)
    assert rig.engine.phase is Phase.DISARMED
    assert "new session" in rig.status.message


def test_a_late_tick_does_not_make_the_reference_leap():
    rig = Rig().drive()
    before = rig.engine.reference.pose.position
    rig.now_s += 0.06
    rig.run(period_s=0.06)
    moved = norm(subtract(rig.engine.reference.pose.position, before))
    assert moved <= 0.1 * Watchdogs().longest_step_s + 1e-9
    assert rig.engine.phase is Phase.MOVING


def test_after_a_stall_the_reference_is_where_the_robot_is():
    rig = Rig().drive()
    elsewhere = Pose(subtract(rig.robot.pose.position, Vector3(0.006, 0, 0)), IDENTITY)
    rig.now_s += 0.6
    state = rig.robot._replace(stamp_s=rig.now_s, pose=elsewhere, period_s=0.6)
    device = rig.device._replace(stamp_s=rig.now_s)
    assert rig.engine.tick(state, device) == PoseCommand(elsewhere, ZERO_TWIST)
    assert rig.engine.phase is Phase.DISARMED
    assert "stalled for 0.6 s" in rig.status.message


def test_gripper_needs_the_dead_man():
    rig = Rig(gripper=(("right", GripperAction.TOGGLE),)).arm()
    rig.hand()
    rig.run(events=[ButtonEvent(0.0, "right", True)])
    assert rig.engine.phase is Phase.HOLDING
    assert not rig.status.gripper_closed


def test_gravity_sag_does_not_creep_into_the_reference():
    rig = Rig().arm()
    where = rig.engine.reference.pose
    for _ in range(100):
        # the robot hangs 2 mm below what it is told, and the operator grips again and again
        sagged = Pose(subtract(where.position, Vector3(0, 0, 0.002)), IDENTITY)
        rig.hand(REST)
        rig.run(pose=sagged)
        rig.hand(REST, "left")
        rig.run(pose=sagged)
    assert rig.engine.reference.pose == where


def test_a_robot_held_by_something_else_gets_its_reference_back_gently():
    rig = Rig().drive()
    away = Pose(Vector3(0.5, -0.2, 0.8), IDENTITY)
    rig.run(pose=away)
    assert rig.engine.phase is Phase.BRAKING
    assert "something else holds it" in rig.status.message
    for _ in range(1000):
        rig.run(pose=away)
    error = norm(subtract(rig.engine.reference.pose.position, away.position))
    assert error <= 0.5 * ReferenceLimits().leash_m
    assert rig.engine.phase is Phase.DISARMED
    assert max(rig.speeds) <= ReferenceLimits().linear_speed_m_s * (1 + 1e-9)


def test_an_arm_that_lags_stops_when_the_hand_lets_go():
    rig = Rig().drive(0.3)
    stuck = rig.robot.pose
    for _ in range(200):
        rig.run(pose=stuck)
    assert rig.status.leash_used > 0.9
    rig.hand(FORWARD)
    for _ in range(300):
        rig.run(pose=stuck)
    assert rig.engine.at_rest
    assert rig.status.leash_used < 0.15
    assert rig.status.trips == 0


def test_stopping_brakes_and_stays():
    rig = Rig().drive()
    rig.engine.request_stop("stopped by SIGTERM")
    rig.run().braked_within(0.1)
    rig.hand()
    rig.run()
    rig.hand(FORWARD, "left")
    rig.run(0.2)
    assert rig.engine.at_rest
    assert rig.status.message == "stopped by SIGTERM"


def test_gripper_needs_an_armed_hand():
    rig = Rig(gripper=(("right", GripperAction.TOGGLE),))
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
    """A filter made of a function of the twist; notes what it was given."""

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
    assert rig.engine.reference.linear == pytest.approx((0, 0.05, 0))
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


def test_a_filter_cannot_start_a_motion():
    rig = Rig(filters=(Rule(faster),))
    rig.run(0.1)
    rig.arm().run(0.5)
    assert rig.engine.phase is Phase.HOLDING
    assert rig.engine.at_rest
    assert rig.command.pose == START


def test_a_filter_that_stops_brakes_in_a_ramp_and_lets_go_on():
    rule = Rule(lambda twist: twist)
    rig = Rig(filters=(rule,)).drive()
    rule.rule = lambda twist: ZERO_TWIST
    rig.run()
    assert rig.engine.phase is Phase.BRAKING
    rig.braked_within(0.1)
    assert rig.engine.phase is Phase.HOLDING
    assert rig.status.trips == 0
    rule.rule = lambda twist: twist
    rig.run(0.5)
    assert rig.engine.phase is Phase.MOVING


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
    assert rig.engine.phase is Phase.BRAKING
    assert last.given[-1] == ZERO_TWIST
    rig.braked_within(0.05)
    assert rig.engine.phase is Phase.DISARMED
    assert rig.status.message.startswith("the filter mine ")
    assert words in rig.status.message
    rig.arm().run(0.1)
    assert rig.engine.phase is Phase.DISARMED
    assert rig.status.trips == 1
    bad.rule = lambda t: t
    rig.run(0.1)
    assert rig.engine.phase is Phase.DISARMED
    rig.drive()


def test_without_a_deadman_a_failing_filter_trips_once():
    rule = Rule(halved)
    rig = Rig(deadman=(), filters=(rule,)).run()
    rule.rule = raises
    rig.run(0.5)
    assert rig.status.trips == 1
    rule.rule = halved
    rig.run()
    assert rig.engine.phase is Phase.DISARMED
    rig.run()
    assert rig.engine.phase is Phase.HOLDING


class Model:
    """An arm's model that is at START whatever its joints, and moves as the reference does."""

    moving = False

    def obstacle(self, robot, new):
        return ""

    def measured(self, robot):
        return START

    def place(self, robot):
        pass

    def worst_joint(self, robot):
        return "joint 1", 0.0

    def advance(self, reference, dt_s, rates):
        pass

    def steps(self, dt_s):
        return [dt_s]

    def command(self, robot, meeting=False):
        return HoldCommand()


def test_filters_see_the_pose_of_the_arms_model_where_there_is_one():
    seen = []
    rule = Rule(halved)
    rule.apply = lambda twist, robot: seen.append(robot.pose) or twist
    rig = Rig(filters=(rule,))
    rig.engine.arm = Model()
    rig.run(pose=None)
    assert seen == [START]
