"""The controller between its robot and the sources of motion requests, in virtual time."""

import math

import numpy as np
import pytest

from cardan.errors import MotionRefusedError
from cardan.gateway.arm.commanded_arm import TaskSpaceArm
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.states import LEASE_S, Authority, AuthorityOptions, AuthorityPolicy, Inhibit
from cardan.gateway.arm.status import OPERATOR, VERBS, Phase
from cardan.gateway.arm.supervision import TRUST_AFTER_S
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import MappingOptions
from cardan.spatial import add, norm, scale, subtract
from cardan.types import (
    IDENTITY,
    ZERO3,
    DeviceLink,
    DeviceState,
    HoldCommand,
    JointCommand,
    Pose,
    PoseCommand,
    RobotLink,
    RobotState,
    Twist,
    Vector3,
)
from tests.controllers import PERIOD_S, controller_for_device
from tests.gateway.arm.arms import DT_S, HandWorld, World

START = Pose(Vector3(0.5, 0.0, 0.8), IDENTITY)
REST = (0.0,) * 6
FORWARD = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
MAPPING = MappingOptions(deadman=("left",))
LIMITS = ReferenceLimits()


class Driven:
    """A controller, an operator device and a robot commanded by poses; every tick is checked for
    steps."""

    def __init__(self, commanded=None, authority=None):
        self.core = controller_for_device(MAPPING, LIMITS, authority=authority)
        if commanded is not None:
            self.core.commanded = commanded
        self.robot = RobotState(
            100.0, RobotLink.LIVE, 1, 0, PERIOD_S, REST, (), START, ""
        )  # fmt: skip
        self.follows = 1.0
        """Fraction of the commanded motion that the robot follows."""
        self.axes, self.buttons = REST, frozenset()
        self.command = HoldCommand()
        self.twist = Twist(ZERO3, ZERO3)

    def hand(self, axes=REST, *buttons):
        self.axes, self.buttons = axes, frozenset(buttons)
        return self

    def run(self, seconds=PERIOD_S, **change):
        for _ in range(max(1, round(seconds / PERIOD_S))):
            self.robot = self.robot._replace(
                stamp_s=self.robot.stamp_s + PERIOD_S, sequence=self.robot.sequence + 1, **change
            )
            hand = DeviceState(self.robot.stamp_s, DeviceLink.LIVE, self.axes, self.buttons)
            before = self.command
            self.command = self.core.tick(self.robot, hand)
            self._check(before)
            if isinstance(self.command, PoseCommand):
                here = self.robot.pose.position
                step = subtract(self.command.pose.position, here)
                if self.follows < 1.0:
                    step = scale(self.command.twist.linear, self.follows * PERIOD_S)
                self.robot = self.robot._replace(pose=Pose(add(here, step), IDENTITY))
        return self

    def _check(self, before):
        twist = getattr(self.command, "twist", None) or Twist(ZERO3, ZERO3)
        change = norm(subtract(twist.linear, self.twist.linear))
        if self.follows == 1.0 and isinstance(before, PoseCommand):
            assert change <= LIMITS.linear_acceleration_m_s2 * PERIOD_S * (1.0 + 1e-9) + 1e-12
        self.twist = twist

    def arm(self):
        return self.hand().run().hand(REST, "left").run()

    def drive(self, seconds=0.5):
        self.arm().hand(FORWARD, "left").run(seconds)
        assert self.core.phase is Phase.MOVING
        return self

    @property
    def status(self):
        return self.core.status()


# -- a restarted robot controller ------------------------------------------------------------------


def test_a_new_session_while_moving_goes_on_in_a_ramp_from_the_speed_the_robot_has():
    bench = Driven().drive()
    speed = bench.twist.linear.x
    bench.run(session=2)
    assert bench.core.phase is Phase.BRAKING
    most = LIMITS.linear_acceleration_m_s2 * PERIOD_S
    assert bench.twist.linear.x == pytest.approx(speed - most, abs=1e-9)
    bench.run(speed / LIMITS.linear_acceleration_m_s2 + 2 * PERIOD_S)
    assert bench.core.at_rest
    assert bench.core.phase is Phase.DISARMED
    assert "new session" in bench.status.message
    assert bench.status.trips == 1
    before = bench.command.pose
    bench.run(0.5)  # The device stays deflected: that does not re-arm.
    assert bench.command.pose == before
    bench.drive()


def test_a_robot_that_was_slower_than_commanded_is_braked_from_its_own_speed():
    bench = Driven().drive(0.3)
    bench.follows = 0.5
    bench.run(0.1)
    speed = bench.twist.linear.x
    bench.run(session=2)
    assert 0.5 * speed - 0.005 < bench.twist.linear.x < 0.5 * speed
    assert norm(subtract(bench.command.pose.position, bench.robot.pose.position)) < 1e-3


def test_a_new_session_of_a_robot_that_is_elsewhere_begins_there_at_rest():
    bench = Driven().drive()
    # No ramp to continue: the robot no longer follows the old command.
    bench.command = HoldCommand()
    there = Pose(Vector3(0.3, 0.3, 0.6), IDENTITY)
    bench.run(session=2, pose=there)
    assert bench.command.pose == there
    assert bench.twist.linear == ZERO3
    assert bench.core.phase is Phase.DISARMED


def test_a_new_session_of_an_arm_keeps_every_joint_within_its_acceleration():
    world = operator_and_verbs()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.2))
    world.tick(100)
    assert world.verbs.servo.moving
    world.session += 1
    world.tick()  # `World` checks every joint of every command.
    assert motion.outcome is Outcome.ABORTED
    assert isinstance(world.command, JointCommand)
    assert world.verbs.servo.moving
    world.rest()
    assert world.verbs.controller.phase is Phase.DISARMED


# -- the output check ----------------------------------------------------------------------------


class Broken(TaskSpaceArm):
    """A commanded arm that computes invalid commands on demand."""

    nonsense = None

    def command(self, state, dt_s, approaching=False, blind=False):
        command = super().command(state, dt_s, approaching, blind)
        return command if self.nonsense is None else self.nonsense(command)


def not_a_number(command):
    return command._replace(pose=Pose(Vector3(math.nan, 0.0, 0.0), IDENTITY))


def jumping(command):
    return command._replace(
        pose=Pose(add(command.pose.position, Vector3(0.0, 0.05, 0.0)), IDENTITY)
    )


def too_fast(command):
    return command._replace(twist=Twist(Vector3(3.0, 0.0, 0.0), ZERO3))


@pytest.mark.parametrize(
    ("nonsense", "words"),
    [
        (not_a_number, "a pose that is not numbers"),
        (jumping, "a step of the TCP by 50"),
        (too_fast, "a TCP speed of 3 m/s"),
    ],
)
def test_a_command_that_no_limit_allows_is_held_back_and_said(nonsense, words):
    commanded = Broken(LIMITS)
    bench = Driven(commanded).drive()
    # The commanded motion ends at once: no command is better than an invalid one.
    bench.command = HoldCommand()
    commanded.nonsense = nonsense
    bench.run()
    assert bench.command == HoldCommand()
    assert bench.core.phase is Phase.DISARMED
    assert "an invalid command was not sent" in bench.status.message
    assert words in bench.status.message
    assert bench.status.trips == 1
    commanded.nonsense = None
    bench.run(0.3)
    assert bench.core.at_rest
    assert bench.core.phase is Phase.DISARMED
    assert "an invalid command was not sent" in bench.status.message
    bench.drive()


def test_nonsense_that_goes_on_never_reaches_the_robot():
    commanded = Broken(LIMITS)
    bench = Driven(commanded).drive()
    bench.command, commanded.nonsense = HoldCommand(), not_a_number
    for _ in range(50):
        bench.run()
        assert bench.command == HoldCommand()
    assert bench.core.at_rest
    bench.arm().run(0.1)
    assert bench.command == HoldCommand()


def test_a_lost_datagram_while_joints_accelerate_fully_is_no_nonsense():
    world = World("ur5")
    world.verbs.set_parameters({"cpjs": 1.0, "cpja": 1.0})
    motion = world.verbs.relj([0.05, 0.05, 0.1, 0.0, 0.0, 0.8])
    for tick in range(400):
        late = 2 if tick % 5 == 4 else 1
        world.now_s += late * DT_S
        world.command = world.verbs.controller.tick(world.state()._replace(period_s=late * DT_S))
        world.q = np.array(world.command.positions)
        if motion.over:
            break
    assert motion.outcome is Outcome.DONE
    assert world.verbs.controller.trips == 0


# -- authority -----------------------------------------------------------------------------------


class Shared(HandWorld):
    """An arm with verbs, streams and an operator device, and its authority."""

    def act(self):
        """Re-arm as the operator."""
        self.hand()
        self.tick(2)
        self.hand(REST, "left")
        self.tick(2)

    @property
    def owner(self):
        return self.verbs.controller.authority.owner


def operator_and_verbs(policy=AuthorityPolicy.OPERATOR, named=""):
    world = Shared(
        "gofa_crb15000_5",
        options=ControllerOptions(authority=AuthorityOptions(policy=policy, named=named)),
        mapping=MappingOptions(deadman=("left",)),
    )
    world.verbs.set_parameters({"cpts": 0.25, "cpta": 1.0, "cprs": 1.0, "cpra": 4.0, "cpjs": 0.5})
    world.verbs.release()
    return world


DOWN = [0.0, 0.0, -0.02, 0.0, 0.0, 0.0]


def test_with_the_policy_first_a_stream_keeps_the_hand_off_until_its_lease_ends():
    world = operator_and_verbs(AuthorityPolicy.FIRST)
    world.verbs.set_parameter("cpsc", "twst")
    assert world.verbs.stream("twist", DOWN, owner="a") == ""
    world.act()
    assert world.owner == "a"
    assert not world.verbs.controller.following
    status = world.verbs.controller.status()
    assert status.authority.refused == "device: 'a' has authority over the arm"
    assert "'a' has authority over the arm" in status.message
    world.rest()  # The stream is silent; its lease has not expired.
    world.act()
    assert world.owner == "a"
    world.hand()
    world.tick(int(LEASE_S / DT_S) + 200)
    world.act()
    assert world.owner == OPERATOR
    assert world.verbs.controller.phase is Phase.HOLDING
    assert world.verbs.controller.message == ""
    with pytest.raises(MotionRefusedError, match="'device' has authority over the arm"):
        world.verbs.set_parameter("cpsc", "twst")


def test_with_the_policy_hand_the_act_takes_the_arm_from_a_stream():
    world = operator_and_verbs()
    world.verbs.set_parameter("cpsc", "twst")
    assert world.verbs.stream("twist", DOWN, owner="a") == ""
    world.tick(20)
    world.act()
    assert world.owner == OPERATOR
    assert "the operator device took over" in world.verbs.stream("twist", DOWN, owner="a")
    with pytest.raises(MotionRefusedError, match="'device' has authority over the arm"):
        world.verbs.movl(world.moved(0.0, 0.0, -0.05))


def test_a_hand_that_lets_go_keeps_its_authority_for_a_lease_and_takes_it_again():
    world = operator_and_verbs()
    world.act()
    world.tick(int(2 * LEASE_S / DT_S))
    assert world.owner == OPERATOR  # held by the dead-man's switch, without motion
    world.hand()
    world.tick(int(0.9 * LEASE_S / DT_S))
    assert world.owner == OPERATOR
    world.tick(int(0.2 * LEASE_S / DT_S))
    assert world.owner == ""
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.05))
    world.tick(50)
    world.hand(REST, "left")
    world.tick()
    assert world.owner == OPERATOR
    assert "the operator device took over" in motion.reason


def test_a_stop_frees_the_authority_of_a_hand():
    world = operator_and_verbs()
    world.act()
    world.verbs.stop()
    assert world.owner == ""
    assert world.run(world.verbs.movl(world.moved(0.0, 0.0, -0.02))).outcome is Outcome.DONE


def test_authority_that_is_handed_over_stops_the_arm_and_is_somebody_elses():
    world = operator_and_verbs()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.2))
    world.tick(50)
    world.verbs.hand_over("b")
    assert motion.reason == "authority was handed over to 'b'"
    assert world.owner == "b"
    world.rest()
    with pytest.raises(MotionRefusedError, match="'b' has authority over the arm"):
        world.verbs.movl(world.moved(0.0, 0.0, -0.02))
    with pytest.raises(
        MotionRefusedError, match="'verbs' has no authority over the arm to hand over"
    ):
        world.verbs.hand_over("c")
    assert world.owner == "b"


def test_anybody_stops_each_source_that_moves_the_arm():
    world = operator_and_verbs()
    world.act()
    world.hand(FORWARD, "left")
    world.tick(50)
    assert world.verbs.controller.phase is Phase.MOVING
    world.verbs.stop(source="b")  # without authority, which a stop does not need
    world.tick()
    controller = world.verbs.controller
    assert controller.phase is Phase.BRAKING
    assert (controller.stops, controller.stopped_by) == (1, "b")
    world.rest()
    assert world.verbs.controller.phase is Phase.DISARMED
    world.tick(100)  # The device stays deflected.
    assert not world.verbs.servo.moving
    world.act()
    world.hand(FORWARD, "left")
    world.tick(50)
    assert world.verbs.controller.phase is Phase.MOVING


def test_where_the_arm_is_reserved_nobody_else_begins_anything():
    world = operator_and_verbs(AuthorityPolicy.OPERATOR)
    world.verbs.controller.authority = Authority(
        AuthorityOptions(policy=AuthorityPolicy.NAMED, named="pendant")
    )
    world.act()
    assert world.owner == ""
    with pytest.raises(MotionRefusedError, match="reserved for 'pendant'"):
        world.verbs.movl(world.moved(0.0, 0.0, -0.02))
    world.verbs.controller.authority = Authority(
        AuthorityOptions(policy=AuthorityPolicy.NAMED, named=VERBS)
    )
    assert world.run(world.verbs.movl(world.moved(0.0, 0.0, -0.02))).outcome is Outcome.DONE


@pytest.mark.parametrize("ticks", [3, 40, 150])
def test_the_dead_man_in_the_middle_of_a_line_takes_the_arm_without_a_step(ticks):
    world = operator_and_verbs()
    world.tick(2)
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.2))
    world.tick(ticks)
    assert motion.outcome is Outcome.RUNNING
    world.hand(FORWARD, "left")  # deflected already while the line brakes
    rests = False
    for _ in range(300):
        world.tick()
        if not rests:
            assert not world.verbs.controller.target.following
        rests = rests or not world.verbs.servo.moving
        if rests and world.verbs.servo.moving:
            break
    assert motion.outcome is Outcome.ABORTED
    assert motion.reason == "the operator device took over"
    assert world.owner == OPERATOR
    assert rests
    # From rest, in the device's direction; `World` checks every joint's acceleration.
    first = world.verbs.servo.twist[0]
    assert 0.0 < np.linalg.norm(first) <= LIMITS.linear_acceleration_m_s2 * DT_S + 1e-9
    world.tick(50)
    assert world.verbs.controller.phase is Phase.MOVING
    assert world.verbs.servo.twist[0] == pytest.approx((0.1, 0.0, 0.0), abs=0.01)


# -- inhibited motion ----------------------------------------------------------------------------


def test_holding_off_brakes_each_source_and_bars_until_it_is_lifted():
    bench = Driven().drive()
    bench.core.inhibit("the supervisor is silent", Inhibit.WHILE_SAID)
    bench.run()
    assert bench.core.phase is Phase.BRAKING
    bench.run(0.3)
    bench.arm()
    assert bench.core.phase is Phase.DISARMED
    assert bench.status.message == "the supervisor is silent"
    bench.core.inhibit("", Inhibit.WHILE_SAID)
    bench.drive()


def test_a_trip_from_outside_is_one_trip_and_none_where_nobody_moves_the_arm():
    bench = Driven().run(0.1)
    bench.core.inhibit("nobody is there", Inhibit.ONCE)
    bench.run(0.1)
    assert bench.status.trips == 0
    bench.drive()
    bench.core.inhibit("the guard says no", Inhibit.ONCE)
    bench.run(0.3)
    assert bench.status.trips == 1
    assert "the guard says no" in bench.status.message


def test_the_end_of_a_session_is_said_also_where_the_robot_is_not_ready():
    bench = Driven().run(0.1, hold_reason="the motors are off")
    assert bench.status.message == "the motors are off"
    bench.core.inhibit("stopped on request", Inhibit.FOR_GOOD)
    assert bench.status.message == "stopped on request"


def test_an_acknowledgment_comes_too_early_while_readings_jump():
    bench = Driven().drive()
    there = Pose(add(bench.robot.pose.position, Vector3(0.0, 0.4, 0.0)), IDENTITY)
    bench.command = HoldCommand()
    bench.run(pose=there)
    assert "wait until the measured position is steady" in bench.core.acknowledge()
    for _ in range(math.ceil(TRUST_AFTER_S / PERIOD_S) + 1):
        bench.run(pose=there)
    assert bench.core.acknowledge() == ""
    assert bench.core.supervision.implausible == ""


def test_an_arm_that_is_acknowledged_where_it_was_moved_to_unseen_starts_from_there():
    world = HandWorld()
    world.tick(5)
    world.link = RobotLink.LOST
    world.tick(5)
    world.q, world.link, world.jammed = world.q + 1.0, RobotLink.LIVE, True
    world.tick(math.ceil(TRUST_AFTER_S / DT_S) + 2)
    assert world.verbs.controller.supervision.implausible
    assert world.verbs.controller.acknowledge() == ""
    np.testing.assert_allclose(world.verbs.servo.q, world.q)


def test_a_controller_without_a_hand_commands_nothing_until_somebody_asks():
    controller = ArmController(TaskSpaceArm(LIMITS), LIMITS, period_s=PERIOD_S)
    state = RobotState(1.0, RobotLink.LIVE, 1, 0, PERIOD_S, REST, (), START, "")
    for _ in range(3):
        state = state._replace(stamp_s=state.stamp_s + PERIOD_S)
        assert controller.tick(state) == HoldCommand()
    controller.engage()
    state = state._replace(stamp_s=state.stamp_s + PERIOD_S)
    assert controller.tick(state).pose == START
    assert controller.status().pose == START
    lost = state._replace(stamp_s=state.stamp_s + PERIOD_S, link=RobotLink.LOST)
    assert controller.tick(lost) == HoldCommand()
    assert controller.status().pose is None
