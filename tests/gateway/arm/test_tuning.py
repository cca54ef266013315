"""Other limits for an arm that is engaged, in virtual time: no jump, no loosening, and braking that
is possible."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from cardan.gateway.arm.authority import LEASE_S, AuthorityOptions
from cardan.gateway.arm.body import ServoTuning
from cardan.gateway.arm.status import Phase
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.arm.tuning import Tuning
from cardan.gateway.hand.mapping import MappingOptions, Mode, TwistMapping
from cardan.gateway.hand.source import HandTuning
from cardan.gateway.motion.reference import ReferenceLimits
from cardan.gateway.servo.options import ServoOptions
from cardan.spatial import norm, subtract
from cardan.types import IDENTITY, IDENTITY_POSE, Frame, Pose, PoseCommand, Twist, Vector3
from tests.gateway.arm.arms import DT_S, quick, streaming
from tests.gateway.arm.test_controller_hand import FORWARD, REST, Rig
from tests.gateway.hand_rig import HandRig, displaced

UP = [0.0, 0.0, 0.05, 0.0, 0.0, 0.0]


def tuning(mapping=None, servo=None, ends="", disarms=False, watchdogs=None, **limits):
    limits, watchdogs = ReferenceLimits(**limits), watchdogs or Watchdogs()
    hand = None
    if mapping is not None:
        hand = HandTuning(TwistMapping(mapping), limits, watchdogs.device_age_s)
    return Tuning(
        limits=limits,
        watchdogs=watchdogs,
        authority=AuthorityOptions(),
        hand=hand,
        servo=servo,
        ends=ends,
        disarms=disarms,
    )


FAST = MappingOptions(deadman="left", linear_speed_m_s=0.25)


def driven(mapping=FAST, **limits):
    """An arm that goes at 0.25 m/s; Rig holds every tick against the acceleration."""
    rig = Rig(limits=ReferenceLimits(**limits))
    rig.run()
    rig.core.tune(tuning(mapping, **limits))
    rig.drive(0.5)
    assert rig.speeds[-1] == pytest.approx(0.25)
    return rig


def test_a_speed_below_the_present_one_is_braked_to():
    rig = driven()
    rig.core.tune(tuning(FAST, linear_speed_m_s=0.05))
    speeds = []
    for _ in range(60):
        rig.run()
        speeds.append(rig.speeds[-1])
        assert rig.core.phase is Phase.MOVING
    # As hard as it may, by what it may change in a tick of its 1 m/s2.
    assert speeds[0] == pytest.approx(0.25 - 1.0 * DT_S)
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == pytest.approx(0.05)
    assert rig.core.trips == 0


def test_the_gate_holds_the_new_speed_as_soon_as_it_is_reached():
    rig = driven()
    rig.core.tune(tuning(FAST, linear_speed_m_s=0.05))
    rig.run(0.5)
    rig.core.body._twist = Twist(Vector3(0.1, 0.0, 0.0), Vector3(0.0, 0.0, 0.0), Frame.BASE)
    command = PoseCommand(rig.core.body.pose, rig.core.body.twist)
    assert "0.1 m/s" in rig.core._gate.violation(command, DT_S)


@pytest.mark.parametrize("wall_m", [0.7, 0.62, 0.4])
def test_a_nearer_wall_stops_the_arm_without_a_jump(wall_m):
    """Far enough ahead to stop before it, too near for that, and behind the TCP."""
    rig = driven()
    here = rig.core.reference.pose.position.x
    assert 0.55 < here < 0.62
    rig.core.tune(tuning(FAST, workspace_x_m=(0.0, wall_m)))
    rig.run(2.0)
    there = rig.core.reference.pose.position.x
    assert rig.core.trips == 0
    assert rig.status.twist.linear.x == pytest.approx(0.0, abs=1e-6)
    stop_m = 0.25**2 / 2.0 * 3.0**0.5 + 0.25 * DT_S  # a wall has its third of the deceleration
    assert there <= max(wall_m, here + stop_m) + 1e-9
    rig.hand((-1.0, 0, 0, 0, 0, 0), "left")
    rig.run(0.3)
    assert rig.status.twist.linear.x < -0.1


def test_a_shorter_leash_and_a_shorter_patience_are_those_of_the_next_tick():
    rig = driven()
    rig.core.tune(
        tuning(FAST, leash_m=0.01, watchdogs=Watchdogs(device_age_s=0.05, recovery=False))
    )
    rig.run(0.1)
    assert rig.core.phase is Phase.MOVING
    rig.fresh = False
    rig.run(0.06)
    assert rig.core.phase is Phase.BRAKING
    assert "deflected but silent for 0.05" in rig.core.message


def test_letting_go_brakes_within_the_new_limits():
    """Braking takes the limits that there are, not those of when the motion began."""
    rig = driven()
    rig.core.tune(tuning(FAST, linear_speed_m_s=0.1))
    rig.hand(FORWARD)
    rig.run(0.5)
    assert rig.core.at_rest
    rig.hand(FORWARD, "left")
    rig.run(0.5)
    assert rig.speeds[-1] == pytest.approx(0.1)
    assert rig.core.reference.limits.linear_speed_m_s == 0.1


def test_an_arm_that_somebody_has_is_not_disarmed():
    rig = driven()
    assert not rig.core.unclaimed
    rig.hand(FORWARD)
    rig.run(0.5)
    assert rig.core.phase is Phase.HOLDING
    assert not rig.core.unclaimed  # The lease goes on.
    rig.run(LEASE_S)
    assert rig.core.unclaimed
    rig.hand(REST, "left")
    rig.run()
    assert not rig.core.unclaimed


def test_going_on_after_a_loosening_takes_the_deliberate_act():
    rig = driven(linear_speed_m_s=0.25)
    rig.hand(FORWARD)
    rig.run(LEASE_S + 0.5)
    rig.core.tune(tuning(FAST, disarms=True, linear_speed_m_s=0.5))
    rig.hand(FORWARD, "left")
    rig.run(0.2)
    assert rig.core.at_rest
    assert rig.core.phase is Phase.DISARMED
    rig.arm()
    rig.hand(FORWARD, "left")
    rig.run(0.5)
    assert rig.speeds[-1] == pytest.approx(0.25)  # What the mapping asks for.


def test_speeds_and_scales_of_the_hand_change_while_it_drives():
    rig = driven()
    rig.core.tune(tuning(replace(FAST, linear_speed_m_s=0.1)))
    rig.run(0.5)
    assert rig.speeds[-1] == pytest.approx(0.1)
    rig.core.tune(tuning(replace(FAST, scale=(0.5, 1.0, 1.0, 1.0, 1.0, 1.0))))
    rig.run(0.5)
    assert rig.speeds[-1] == pytest.approx(0.125)


def test_another_deadman_is_the_deadman_once_the_hand_has_let_go():
    rig = driven()
    assert not rig.core.hand.let_go
    rig.hand(REST, "left")
    rig.run(0.5)
    assert not rig.core.hand.let_go
    rig.hand()
    rig.run()
    assert rig.core.hand.let_go
    rig.core.tune(tuning(replace(FAST, deadman="right")))
    rig.hand(FORWARD, "left")
    rig.run(0.2)
    assert rig.core.at_rest
    rig.hand(FORWARD, "right")
    rig.run(0.5)
    assert rig.speeds[-1] == pytest.approx(0.25)


def test_a_clutch_that_follows_the_hand_is_let_go_first_and_nothing_jumps():
    options = MappingOptions(mode=Mode.POSITION, clutch="button_2")
    rig = HandRig(mode=Mode.POSITION, clutch="button_2")
    rig.run()
    rig.tap("button_2")
    rig.send_hand(displaced(0.05)).run(1.0)
    assert not rig.core.hand.let_go
    # A limit may change all the same; the clutch stays engaged.
    rig.limits = replace(rig.limits, workspace_x_m=(0.0, 0.56))
    rig.core.tune(tuning(options, workspace_x_m=(0.0, 0.56)))
    rig.send_hand(displaced(0.2)).run(2.0)
    assert rig.core.following
    assert rig.tcp.position.x <= 0.56 + 1e-9
    rig.tap("button_2")
    assert rig.core.hand.let_go
    rig.core.tune(tuning(replace(options, scale=(3.0,) * 6), workspace_x_m=(0.0, 0.56)))
    where = rig.tcp.position
    rig.tap("button_2")
    rig.run(0.5)
    assert norm(subtract(rig.tcp.position, where)) < 1e-6
    rig.send_hand(displaced(0.15)).run(1.0)
    assert where.x - rig.tcp.position.x == pytest.approx(0.15, abs=2e-3)


def test_a_gripper_stays_as_it_is():
    rig = driven()
    rig.core.hand.mapping.gripper_closed = True
    rig.core.tune(tuning(FAST))
    assert rig.core.hand.mapping.gripper_closed


# -- arms with a model -----------------------------------------------------------------------------


def servo_tuning(tool=IDENTITY_POSE, **options):
    return ServoTuning(options=ServoOptions(**options), tcp_tolerance_m=None, tool=tool)


def test_joints_brake_to_a_lower_share_of_their_speeds():
    world = streaming("jnts", arm="ur5")
    rates = [0.0, 0.0, 0.0, 0.0, 0.0, 1.5]
    for _ in range(150):
        assert world.verbs.stream("joints", rates) == ""
        world.tick()
    v = world.verbs.servo.v[5]
    assert v == pytest.approx(1.5, rel=1e-3)
    # World holds every tick against the joints' accelerations.
    most = 0.2 * world.verbs.servo.kinematics.velocity[5]
    assert most < v
    world.verbs.controller.tune(tuning(servo=servo_tuning(speed_share=0.2)))
    for _ in range(300):
        world.verbs.stream("joints", rates)
        world.tick()
        assert world.verbs.servo.v[5] <= v + 1e-12
        v = world.verbs.servo.v[5]
    assert v == pytest.approx(most)
    assert world.verbs.status().trips == 0


def test_a_motion_that_was_planned_by_other_limits_ends_and_says_why():
    world = quick("ur5")
    motion = world.verbs.movv(UP)
    world.tick(100)
    world.verbs.controller.tune(tuning(ends="limits.linear_speed_m_s: tightened"))
    world.rest()
    assert motion.over
    assert motion.reason == "limits.linear_speed_m_s: tightened"
    # What is no limit ends nothing.
    motion = world.verbs.movv(UP)
    world.tick(100)
    world.verbs.controller.tune(tuning())
    world.tick(20)
    assert not motion.over


def test_verbs_plan_by_the_limits_that_they_have_by_now():
    world = quick("ur5")
    verbs = world.verbs
    slow = ReferenceLimits(linear_speed_m_s=0.02)
    with verbs.planning:
        verbs.controller.tune(tuning(servo=servo_tuning(policy=ServoOptions().policy)))
        streams = replace(verbs.options.streams, linear_speed_m_s=0.02)
        verbs.tune(replace(verbs.options, limits=slow, streams=streams), 0.5, 0.5)
    assert np.allclose(verbs.planner.kinematics.velocity, 0.5 * verbs.servo.kinematics.velocity)
    start = world.six()
    motion = verbs.movl(world.moved(0.0, 0.0, -0.02))
    fastest = 0.0
    while not motion.over:
        before = world.tcp[0]
        world.tick()
        fastest = max(fastest, float(np.linalg.norm(world.tcp[0] - before)) / DT_S)
    assert fastest == pytest.approx(0.02, rel=0.05)
    assert world.six()[2] == pytest.approx(start[2] - 0.02, abs=1e-4)


def test_another_tool_moves_nothing():
    world = quick("ur5")
    world.run(world.verbs.movj(world.moved(0.0, 0.0, -0.02)))
    world.tick(round((LEASE_S + 0.1) / DT_S))
    verbs, before = world.verbs, world.verbs.servo.q.copy()
    tcp = world.tcp[0]
    tool = Pose(Vector3(0.0, 0.0, 0.1), IDENTITY)
    assert verbs.controller.unclaimed
    with verbs.planning:
        verbs.controller.tune(tuning(servo=servo_tuning(tool), disarms=True))
        verbs.tune(verbs.options, 1.0, 1.0)
    world.tick(10)
    assert np.array_equal(verbs.servo.q, before)
    assert np.linalg.norm(world.tcp[0] - tcp) == pytest.approx(0.1)
    assert np.linalg.norm(world.six()[:3] - tcp) == pytest.approx(0.1)
    motion = world.run(verbs.movl(world.moved(0.0, 0.0, 0.02)))
    assert not motion.reason


# -- anything, at any time -------------------------------------------------------------------------

SPANS = st.none() | st.tuples(st.floats(-0.5, 0.45), st.floats(0.55, 1.5))
LIMITS = st.fixed_dictionaries(
    {
        "linear_speed_m_s": st.floats(0.02, 0.25),
        "angular_speed_rad_s": st.floats(0.1, 1.0),
        "leash_m": st.floats(0.01, 0.05),
        "workspace_x_m": SPANS,
        "workspace_y_m": st.none() | st.tuples(st.floats(-1.0, -0.05), st.floats(0.05, 1.0)),
    }
)
HANDS = st.tuples(*[st.floats(-1.0, 1.0)] * 6)
STEPS = st.lists(st.tuples(HANDS, st.booleans(), LIMITS, st.integers(1, 40)), max_size=4)


def narrower(limits, than):
    """Of both, the tighter."""
    spans = {}
    for key in ("workspace_x_m", "workspace_y_m"):
        one, other = limits[key], getattr(than, key)
        spans[key] = one if other is None else other if one is None else (
            max(one[0], other[0]), min(one[1], other[1])
        )  # fmt: skip
    return spans | {
        key: min(limits[key], getattr(than, key))
        for key in ("linear_speed_m_s", "angular_speed_rad_s", "leash_m")
    }


@settings(max_examples=20, deadline=None)
@given(STEPS)
def test_whatever_is_tightened_whenever_no_command_jumps_and_none_is_refused(steps):
    """Rig holds every tick against the acceleration; the gate trips where a command is beyond the
    limits that it has by then."""
    rig = Rig()
    rig.arm()
    limits = ReferenceLimits()
    for hand, held, wanted, ticks in steps:
        rig.hand(hand, *(("left",) if held else ()))
        limits = ReferenceLimits(**narrower(wanted, limits))
        first = before = norm(rig.core.body.twist.linear)
        most = limits.linear_speed_m_s
        rig.core.tune(tuning(FAST, **vars_of(limits)))
        for tick in range(1, ticks + 1):
            rig.run()
            assert rig.core.trips == 0
            # A hand that asks for another direction has a part of the acceleration for that: then
            # the whole change of velocity, `first + most` at worst, is made at its limit.
            turned = tick * limits.linear_acceleration_m_s2 * DT_S >= first + most
            now = norm(rig.core.body.twist.linear)
            assert now <= (most if turned else max(most, before)) + 1e-9
            before = now


def vars_of(limits):
    return {
        key: getattr(limits, key)
        for key in (
            *("linear_speed_m_s", "angular_speed_rad_s", "leash_m"),
            *("workspace_x_m", "workspace_y_m"),
        )
    }
