"""The output check stops commands that are NaN or jump."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.arm.commanded_arm import equal_steps
from cardan.gateway.arm.output_check import (
    NOISE_M_S,
    NOISE_RAD_S,
    SLACK,
    STILL,
    UNEVEN,
    OutputCheck,
    OutputLimits,
)
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.servo.servo import LONGEST_SERVO_STEP_S
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
    """A check after these commands, one per period, all of which passed."""
    check = OutputCheck(LIMITS)
    for command in commands:
        assert check.violation(command, dt_s) == ""
    return check


# -- NaN and infinite values ----------------------------------------------------------------------


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
    assert "not a rotation" in OutputCheck(LIMITS).violation(command, DT_S)


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


# -- jumps ---------------------------------------------------------------------------------------


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
    check = passed(JointCommand((0.0, 0.0)), JointCommand((0.0, 0.01)))
    words = check.violation(JointCommand((0.0, 0.0)), DT_S)
    assert words == "joint 2 to change its speed by 5 rad/s in 4 ms"


def test_a_joint_that_is_beyond_its_range_may_only_come_back():
    check = passed(JointCommand((2.1, 0.0)), JointCommand((2.1, 0.0)))
    assert "joint 1 at 2.1 rad, beyond its range" in check.violation(
        JointCommand((2.1 + 1e-4, 0.0)), DT_S
    )
    assert check.violation(JointCommand((2.1 - 1e-4, 0.0)), DT_S) == ""


def test_where_no_time_passes_nothing_moves():
    for before, after in (
        (JointCommand((0.0, 0.0)), JointCommand((0.0, 0.001))),
        (at(), at(0.0001)),
        (JointVelocityCommand((0.0, 0.0)), JointVelocityCommand((0.1, 0.0))),
    ):
        for dt_s in (0.0, -DT_S, NAN):
            check = passed(before)
            assert check.violation(after, dt_s)
            assert check.violation(before, dt_s) == ""


def test_what_was_held_back_is_not_what_the_next_is_compared_with():
    check = passed(at())
    assert check.violation(at(1.0), DT_S)
    assert check.violation(at(1.0), DT_S)
    assert check.violation(at(0.0005), DT_S) == ""


def test_after_a_reset_any_place_may_be_the_first():
    check = passed(JointCommand((0.0, 0.0)), JointCommand((0.004, 0.0)))
    check.reset()
    assert check.violation(JointCommand((-1.9, 0.9)), DT_S) == ""


def test_a_hold_passes_and_breaks_no_comparison():
    check = passed(at(), HoldCommand(), at(0.0005))
    assert check.violation(at(0.5), DT_S)


# -- exact limits --------------------------------------------------------------------------------

FASTEST_RAD_S = 1.05 * 1.0 + 5e-3
LONG_S = 0.01


def turned(rad, rate=None):
    """A command that turns the TCP about z by `rad`, at `rate`."""
    twist = None if rate is None else Twist(ZERO3, Vector3(0.0, 0.0, rate))
    return PoseCommand(Pose(ZERO3, from_rotation_vector(Vector3(0.0, 0.0, rad))), twist)


def after_a_long_period():
    check = passed(JointCommand((0.0, 0.0)))
    assert check.violation(JointCommand((0.0, 0.0)), LONG_S) == ""
    return check


@pytest.mark.parametrize(
    ("limit", "check", "command"),
    [
        (FASTEST_RAD_S, passed, lambda x: JointCommand((0.0, 0.0), (x, 0.0))),
        (
            FASTEST_RAD_S * DT_S,
            lambda: passed(JointCommand((0.0, 0.0))),
            lambda x: JointCommand((x, 0.0)),
        ),
        (
            (1.05 * 20.0 * 1.25 * DT_S + 5e-3) * DT_S,
            lambda: passed(JointCommand((0.0, 0.0)), JointCommand((0.0, 0.0))),
            lambda x: JointCommand((0.0, x)),
        ),
        (
            (1.05 * 20.0 * 1.25 * LONG_S + 5e-3) * DT_S,
            after_a_long_period,
            lambda x: JointCommand((0.0, x)),
        ),
        (FASTEST_RAD_S, passed, lambda x: JointVelocityCommand((x, 0.0))),
        (
            1.05 * 20.0 * DT_S + 5e-3,
            lambda: passed(JointVelocityCommand((0.0, 0.0))),
            lambda x: JointVelocityCommand((0.0, x)),
        ),
        (1.05 * 20.0, passed, lambda x: TorqueCommand((0.0, x))),
        (1.05 * 0.25 + 1e-3, passed, lambda x: at(0.0, x)),
        (FASTEST_RAD_S, passed, lambda x: turned(0.0, x)),
        ((1.05 * 0.25 + 1e-3) * DT_S + 1e-6, lambda: passed(at()), at),
        (FASTEST_RAD_S * DT_S + 1e-6, lambda: passed(turned(0.3)), lambda x: turned(0.3 + x)),
        (
            1.05 * 1.0 * DT_S + 1e-3,
            lambda: passed(at(0.0, 0.1)),
            lambda x: at(0.0, 0.1 + x),
        ),
        (
            1.05 * 4.0 * DT_S + 5e-3,
            lambda: passed(turned(0.0, 0.1)),
            lambda x: turned(0.0, 0.1 + x),
        ),
        (1e-6, passed, lambda x: PoseCommand(Pose(ZERO3, Quaternion(1.0 + x, 0.0, 0.0, 0.0)))),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_limit_is_kept_to_the_last_digit_on_both_sides(limit, check, command, sign):
    assert check().violation(command(sign * limit * (1.0 - 1e-6)), DT_S) == ""
    assert check().violation(command(sign * limit * (1.0 + 1e-6)), DT_S)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_end_of_a_joints_range_is_kept_to_a_thousandth(sign):
    def check():
        return passed(JointCommand((sign * 1.9, 0.0)), JointCommand((sign * 1.95, 0.0)), dt_s=1.0)

    assert check().violation(JointCommand((sign * (2.001 - 1e-9), 0.0)), 1.0) == ""
    words = f"joint 1 at {sign * 2.001:.4g} rad, beyond its range"
    assert check().violation(JointCommand((sign * (2.001 + 1e-9), 0.0)), 1.0) == words


@pytest.mark.parametrize(
    "command",
    [
        JointCommand((0.0, 0.0), (FASTEST_RAD_S, 0.0)),
        JointVelocityCommand((FASTEST_RAD_S, 0.0)),
        TorqueCommand((0.0, 1.05 * 20.0)),
        at(0.0, 1.05 * 0.25 + 1e-3),
        turned(0.0, FASTEST_RAD_S),
        JointCommand((0.0, 0.0), None, (3.0,)),
        PoseCommand(Pose(ZERO3, IDENTITY), None, (3.0,)),
    ],
)
def test_what_is_just_allowed_passes(command):
    assert OutputCheck(LIMITS).violation(command, DT_S) == ""


@pytest.mark.parametrize("between", [HoldCommand(), at()])
def test_speeds_from_before_another_kind_of_command_are_forgotten(between):
    check = passed(*(JointCommand((0.004 * step, 0.0)) for step in range(3)), between)
    for _ in range(2):
        assert check.violation(JointCommand((0.008, 0.0)), DT_S) == ""


def test_of_an_arm_whose_limits_are_not_known_numbers_pass():
    free = OutputLimits.of_free_body(
        ReferenceLimits(
            linear_speed_m_s=0.1,
            linear_acceleration_m_s2=2.0,
            angular_speed_rad_s=0.5,
            angular_acceleration_rad_s2=3.0,
        )
    )
    assert free == OutputLimits(0.1, 2.0, 0.5, 3.0)
    for command in (
        JointCommand((9.0,) * 3, (9.0,)),
        JointVelocityCommand((9.0,) * 7),
        TorqueCommand((99.0,)),
    ):
        assert OutputCheck(free).violation(command, DT_S) == ""


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ((0.3, 0.2), (0.3, 0.201), "a step of joint 2 by 0.001 rad in zero time"),
        ((0.3, 0.2), (0.299, 0.2), "a step of joint 1 by -0.001 rad in zero time"),
    ],
)
def test_a_step_in_zero_time_is_named_with_its_joint(before, after, words):
    assert passed(JointCommand(before)).violation(JointCommand(after), 0.0) == words


def test_a_step_is_reported_by_its_size():
    check = passed(JointCommand((0.3, 0.2)))
    words = check.violation(JointCommand((0.3, 0.25)), DT_S)
    assert words == "a step of joint 2 by 0.05 rad"


def test_a_change_of_speed_is_counted_from_the_speed_before():
    check = passed(JointVelocityCommand((0.5, 0.0)))
    assert check.violation(JointVelocityCommand((0.5, 0.0)), DT_S) == ""


def test_a_twist_is_compared_where_both_commands_have_one():
    assert passed(at()).violation(at(0.0, 0.2), DT_S) == ""
    assert passed(at(0.0, 0.2)).violation(at(), DT_S) == ""


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_joint_beyond_either_end_of_its_range_may_only_come_back(way):
    check = passed(JointCommand((way * 2.1, 0.0)), JointCommand((way * 2.1, 0.0)))
    assert check.violation(JointCommand((way * (2.1 + 0.9e-9), 0.0)), DT_S) == ""
    assert check.violation(JointCommand((way * (2.1 + 2e-9), 0.0)), DT_S)
    assert check.violation(JointCommand((way * (2.1 - 1e-4), 0.0)), DT_S) == ""


@pytest.mark.parametrize(
    ("most", "first", "next_"),
    [
        (1.05 * 2.0 * DT_S + 1e-3, (at(0.0, 0.0),), lambda x: at(0.0, x)),
        (1.05 * 0.5 + 5e-3, (), lambda x: turned(0.0, x)),
    ],
)
def test_limits_of_the_tcp_that_are_not_one_are_kept_to_the_last_digit(most, first, next_):
    limits = LIMITS._replace(linear_acceleration_m_s2=2.0, angular_speed_rad_s=0.5)
    for share, passes in ((1.0 - 1e-6, True), (1.0 + 1e-6, False)):
        check = OutputCheck(limits)
        for command in first:
            assert check.violation(command, DT_S) == ""
        assert (check.violation(next_(share * most), DT_S) == "") is passes


def test_a_turn_is_measured_the_short_way_whichever_sign_its_quaternions_have():
    far = from_rotation_vector(Vector3(0.0, 0.0, 0.002))
    other = PoseCommand(Pose(ZERO3, Quaternion(*(-each for each in far))))
    assert passed(at()).violation(other, DT_S) == ""


# -- uneven periods ------------------------------------------------------------------------------


@given(st.lists(st.sampled_from((0.0, 0.002, 0.004, 0.005, 0.0051, 0.01, 0.02, 0.05)), min_size=2))
def test_full_acceleration_passes_however_uneven_the_periods_are(periods):
    """The servo's steps while accelerating and braking: a lost datagram must not count as a
    jump."""
    limits = LIMITS._replace(joint_lower=(), joint_upper=(), joint_speed=(1.0, 50.0))
    check = OutputCheck(limits)
    fastest, acceleration = limits.joint_speed, limits.joint_acceleration
    q, v, sign = [0.0, 0.0], [0.0, 0.0], 1.0
    for dt_s in periods:
        for step in equal_steps(dt_s, LONGEST_SERVO_STEP_S):
            for i in range(2):
                wanted = sign * fastest[i]
                most = acceleration[i] * step
                v[i] += min(max(wanted - v[i], -most), most)
                q[i] += v[i] * step
            if abs(v[0]) == fastest[0]:
                sign = -sign
        assert check.violation(JointCommand(tuple(q), tuple(v)), dt_s) == ""


# -- any commands --------------------------------------------------------------------------------

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
    check, last, rates = OutputCheck(LIMITS), None, None
    for command, dt_s in sequence:
        if check.violation(command, dt_s) or isinstance(command, HoldCommand):
            rates = None if isinstance(command, HoldCommand) else rates
            continue
        dt_s = max(0.0, dt_s)
        same = type(last) is type(command)
        rates = judge(command, last if same else None, rates if same else None, dt_s)
        last = command


def judge(command, last, rates, dt_s):
    """Check one command that passed after `last`; return the joints' mean speeds and the period."""
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
        check_pose(command, last, dt_s)
    return None


def check_pose(command, last, dt_s):
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
