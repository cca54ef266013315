"""The last gate: what is not a number, or leaps, does not pass."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.arm.output_check import (
    NOISE_M_S,
    NOISE_RAD_S,
    SLACK,
    STILL,
    UNEVEN,
    OutputCheck,
    OutputLimits,
)
from cardan.gateway.servo.servo import servo_steps
from cardan.spatial import (
    from_rotation_vector,
    is_finite,
    norm,
    rotation_between,
    subtract,
)
from cardan.types import (
    IDENTITY,
    ZERO3,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    Quaternion,
    TorqueCommand,
    Twist,
    TwistCommand,
    Vector3,
)

DT_S = 0.004
LIMITS = OutputLimits(
    0.25, 1.0, 1.0, 4.0, (-2.0, -1.0), (2.0, 1.0), (1.0, 3.0), (10.0, 20.0), (50.0, 20.0)
)
NAN, INF = math.nan, math.inf


def at(x=0.0, speed=None):
    twist = None if speed is None else Twist(Vector3(speed, 0.0, 0.0), ZERO3)
    return PoseCommand(Pose(Vector3(x, 0.0, 0.0), IDENTITY), twist)


def passed(*commands, dt_s=DT_S):
    """A gate that all of these passed, one a period."""
    gate = OutputCheck(LIMITS)
    for command in commands:
        assert gate.violation(command, dt_s) == ""
    return gate


# -- what is no number ---------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
@pytest.mark.parametrize(
    "command",
    [
        lambda bad: JointCommand((bad, 0.0)),
        lambda bad: JointCommand((0.0, 0.0), (0.0, bad)),
        lambda bad: JointCommand((0.0, 0.0), None, (bad,)),
        lambda bad: JointVelocityCommand((bad, 0.0)),
        lambda bad: TorqueCommand((bad, 0.0)),
        lambda bad: PoseCommand(Pose(Vector3(bad, 0.0, 0.0), IDENTITY)),
        lambda bad: PoseCommand(Pose(ZERO3, Quaternion(bad, 0.0, 0.0, 0.0))),
        lambda bad: PoseCommand(Pose(ZERO3, IDENTITY), Twist(Vector3(0.0, bad, 0.0), ZERO3)),
        lambda bad: PoseCommand(Pose(ZERO3, IDENTITY), Twist(ZERO3, Vector3(0.0, 0.0, bad))),
        lambda bad: PoseCommand(Pose(ZERO3, IDENTITY), None, (bad,)),
    ],
)
def test_what_is_no_number_never_passes_not_even_first(command, bad):
    assert "not numbers" in OutputCheck(LIMITS).violation(command(bad), DT_S)


@pytest.mark.parametrize("orientation", [(0.0,) * 4, (2.0, 0.0, 0.0, 0.0), (1e300,) * 4])
def test_an_orientation_that_is_no_rotation_does_not_pass(orientation):
    command = PoseCommand(Pose(ZERO3, Quaternion(*orientation)))
    assert "no rotation" in OutputCheck(LIMITS).violation(command, DT_S)


@pytest.mark.parametrize(
    "command",
    [
        JointCommand((0.0,)),
        JointCommand((0.0, 0.0), (0.0,)),
        JointVelocityCommand((0.0, 0.0, 0.0)),
        TorqueCommand((0.0,)),
    ],
)
def test_a_command_for_another_number_of_joints_does_not_pass(command):
    assert "for 2 joints" in passed(JointCommand((0.0, 0.0))).violation(command, DT_S)


def test_a_kind_of_command_that_nothing_limits_does_not_pass():
    assert "no limits are known" in OutputCheck(LIMITS).violation(
        TwistCommand(Twist(ZERO3, ZERO3)), DT_S
    )


# -- what leaps ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "command", "words"),
    [
        (JointCommand((0.0, 0.0)), JointCommand((0.01, 0.0)), "a step of joint 1 by 0.01 rad"),
        (JointCommand((0.0, 0.0)), JointCommand((0.0, 0.0), (0.0, 3.5)), "joint 2 at 3.5 rad/s"),
        (at(), at(0.01), "a step of the TCP by 10 mm"),
        (at(), at(0.0, 0.5), "a TCP speed of 0.5 m/s"),
        (at(0.0, 0.0), at(0.0, 0.2), "the TCP to change its speed by 0.2 m/s in 4 ms"),
        (JointVelocityCommand((0.0, 0.0)), JointVelocityCommand((1.5, 0.0)), "joint 1 at 1.5"),
        (
            JointVelocityCommand((0.0, 0.0)),
            JointVelocityCommand((0.0, 0.5)),
            "joint 2 to change its speed by 0.5 rad/s in 4 ms",
        ),
        (TorqueCommand((0.0, 0.0)), TorqueCommand((0.0, 30.0)), "joint 2 to exert 30 N·m"),
    ],
)
def test_what_no_limit_allows_is_named(before, command, words):
    assert words in passed(before).violation(command, DT_S)


def test_a_turn_of_the_tcp_that_is_too_far_is_named():
    turned = PoseCommand(Pose(ZERO3, from_rotation_vector(Vector3(0.0, 0.1, 0.0))))
    assert passed(at()).violation(turned, DT_S) == "a turn of the TCP by 0.1 rad"
    spinning = at()._replace(twist=Twist(ZERO3, Vector3(0.0, 2.0, 0.0)))
    assert passed(at()).violation(spinning, DT_S) == "a TCP turn of 2 rad/s"


def test_joints_that_turn_round_at_once_are_held_back():
    gate = passed(JointCommand((0.0, 0.0)), JointCommand((0.0, 0.01)))
    words = gate.violation(JointCommand((0.0, 0.0)), DT_S)
    assert words == "joint 2 to change its speed by 5 rad/s in 4 ms"


def test_a_joint_that_is_beyond_its_range_may_only_come_back():
    gate = passed(JointCommand((2.1, 0.0)), JointCommand((2.1, 0.0)))
    assert "joint 1 at 2.1 rad, beyond its range" in gate.violation(
        JointCommand((2.1 + 1e-4, 0.0)), DT_S
    )
    assert gate.violation(JointCommand((2.1 - 1e-4, 0.0)), DT_S) == ""


def test_where_no_time_passes_nothing_moves():
    for before, after in (
        (JointCommand((0.0, 0.0)), JointCommand((0.0, 0.001))),
        (at(), at(0.0001)),
        (JointVelocityCommand((0.0, 0.0)), JointVelocityCommand((0.1, 0.0))),
    ):
        for dt_s in (0.0, -DT_S, NAN):
            gate = passed(before)
            assert gate.violation(after, dt_s)
            assert gate.violation(before, dt_s) == ""


def test_what_was_held_back_is_not_what_the_next_is_compared_with():
    gate = passed(at())
    assert gate.violation(at(1.0), DT_S)
    assert gate.violation(at(1.0), DT_S)
    assert gate.violation(at(0.0005), DT_S) == ""


def test_after_a_reset_any_place_may_be_the_first():
    gate = passed(JointCommand((0.0, 0.0)), JointCommand((0.004, 0.0)))
    gate.reset()
    assert gate.violation(JointCommand((-1.9, 0.9)), DT_S) == ""


def test_a_hold_passes_and_breaks_no_comparison():
    gate = passed(at(), HoldCommand(), at(0.0005))
    assert gate.violation(at(0.5), DT_S)


# -- periods that are uneven ---------------------------------------------------------------------


@given(st.lists(st.sampled_from((0.0, 0.002, 0.004, 0.005, 0.0051, 0.01, 0.02, 0.05)), min_size=2))
def test_full_acceleration_passes_however_uneven_the_periods_are(periods):
    """The servo's steps, up to speed and back again: a lost datagram is no leap."""
    limits = LIMITS._replace(joint_lower=(), joint_upper=(), joint_speed=(1.0, 50.0))
    gate, fastest, acceleration = OutputCheck(limits), limits.joint_speed, limits.joint_acceleration
    q, v, sign = [0.0, 0.0], [0.0, 0.0], 1.0
    for dt_s in periods:
        for step in servo_steps(dt_s):
            for i in range(2):
                wanted = sign * fastest[i]
                most = acceleration[i] * step
                v[i] += min(max(wanted - v[i], -most), most)
                q[i] += v[i] * step
            if abs(v[0]) == fastest[0]:
                sign = -sign
        assert gate.violation(JointCommand(tuple(q), tuple(v)), dt_s) == ""


# -- whatever comes ------------------------------------------------------------------------------

numbers = st.one_of(
    st.floats(-0.02, 0.02), st.floats(), st.sampled_from((0.0, NAN, INF, -INF, 1e308, -1e308))
)
pairs = st.tuples(numbers, numbers)
vectors = st.builds(Vector3, numbers, numbers, numbers)
rotations = st.one_of(
    st.builds(
        lambda x, y, z: from_rotation_vector(Vector3(x, y, z)),
        *[st.floats(-0.01, 0.01)] * 3,
    ),
    st.builds(Quaternion, numbers, numbers, numbers, numbers),
)
twists = st.one_of(st.none(), st.builds(Twist, vectors, vectors))
commands = st.one_of(
    st.builds(JointCommand, pairs, st.one_of(st.none(), pairs)),
    st.builds(PoseCommand, st.builds(Pose, vectors, rotations), twists),
    st.builds(JointVelocityCommand, pairs),
    st.builds(TorqueCommand, pairs),
    st.just(HoldCommand()),
)
periods = st.sampled_from((0.0, 0.004, 0.01, NAN))


@given(st.lists(st.tuples(commands, periods), max_size=12))
def test_what_passes_is_finite_and_within_speed_and_acceleration_of_the_last(sequence):
    gate, last, rates = OutputCheck(LIMITS), None, None
    for command, dt_s in sequence:
        if gate.violation(command, dt_s) or isinstance(command, HoldCommand):
            rates = None if isinstance(command, HoldCommand) else rates
            continue
        dt_s = max(0.0, dt_s)
        same = type(last) is type(command)
        rates = judge(command, last if same else None, rates if same else None, dt_s)
        last = command


def judge(command, last, rates, dt_s):
    """Check one command that passed after `last`; returns the joints' mean speeds and period."""
    if isinstance(command, JointCommand):
        assert is_finite(command.positions)
        assert is_finite(command.velocities or ())
        for value, fastest in zip(command.velocities or (), LIMITS.joint_speed, strict=False):
            assert abs(value) <= 1.01 * SLACK * fastest
        if last is None:
            return None
        ways = [a - b for a, b in zip(command.positions, last.positions, strict=True)]
        if dt_s == 0.0:
            assert max(map(abs, ways)) <= STILL
            return rates
        now = tuple(way / dt_s for way in ways)
        for rate, fastest in zip(now, LIMITS.joint_speed, strict=True):
            assert abs(rate) <= SLACK * fastest + NOISE_RAD_S
        if rates is not None:
            between_s = UNEVEN * max(dt_s, rates[1])
            for a, b, most in zip(now, rates[0], LIMITS.joint_acceleration, strict=True):
                assert abs(a - b) <= SLACK * most * between_s + NOISE_RAD_S
        return now, dt_s
    if isinstance(command, JointVelocityCommand):
        assert is_finite(command.velocities)
        for index, value in enumerate(command.velocities):
            assert abs(value) <= SLACK * LIMITS.joint_speed[index] + NOISE_RAD_S
            if last is not None:
                most = SLACK * LIMITS.joint_acceleration[index] * dt_s + NOISE_RAD_S
                assert abs(value - last.velocities[index]) <= most
    elif isinstance(command, TorqueCommand):
        for value, most in zip(command.torques, LIMITS.joint_effort, strict=True):
            assert abs(value) <= SLACK * most
    else:
        judge_pose(command, last, dt_s)
    return None


def judge_pose(command, last, dt_s):
    pose, twist = command.pose, command.twist
    fastest = SLACK * LIMITS.linear_speed_m_s + NOISE_M_S
    fastest_rad_s = SLACK * LIMITS.angular_speed_rad_s + NOISE_RAD_S
    assert is_finite((*pose.position, *pose.orientation))
    if twist is not None:
        assert norm(twist.linear) <= fastest
        assert norm(twist.angular) <= fastest_rad_s
    if last is None:
        return
    assert norm(subtract(pose.position, last.pose.position)) <= fastest * dt_s + STILL
    turn_rad = norm(rotation_between(last.pose.orientation, pose.orientation))
    assert turn_rad <= fastest_rad_s * dt_s + STILL
    if twist is not None and last.twist is not None:
        change = norm(subtract(twist.linear, last.twist.linear))
        assert change <= SLACK * LIMITS.linear_acceleration_m_s2 * dt_s + NOISE_M_S
        change = norm(subtract(twist.angular, last.twist.angular))
        assert change <= SLACK * LIMITS.angular_acceleration_rad_s2 * dt_s + NOISE_RAD_S
