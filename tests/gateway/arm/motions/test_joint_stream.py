"""Joint jogging: joints at streamed speeds, in proportion and within limits."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from cardan.gateway.arm.joint_space_arm import JointSpaceArm
from cardan.gateway.arm.motions.base import ARRIVED, GOING
from cardan.gateway.arm.motions.joint_stream import FollowJointStream
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.servo.servo import Servo
from cardan.robots import load_arm
from cardan.types import CommandKind, RobotLink, RobotState

DT_S = 0.004
MODEL = load_arm("ur5")
KINEMATICS = ArmKinematics(MODEL)
ROBOT = RobotState(1.0, RobotLink.LIVE, 1, 0, DT_S, tuple(MODEL.home), (), None, "")
SPEED, ACCELERATION = 0.25, 0.5
RATES = np.array((0.1, -0.05, 0.02, 0.0, 0.04, -0.2))


class Stream:
    """A stream to an arm at its home position, without collision bodies."""

    def __init__(self, q=MODEL.home):
        self.commanded = JointSpaceArm(Servo(KINEMATICS), frozenset({CommandKind.JOINT}))
        self.commanded.place(ROBOT._replace(joints=tuple(q)))
        self.servo = self.commanded.servo
        self.motion = FollowJointStream(self.commanded, SPEED, ACCELERATION)
        self.fastest = SPEED * KINEMATICS.velocity
        self.most = ACCELERATION * KINEMATICS.acceleration * DT_S

    def tick(self, count=1):
        """Tick and return the last progress; check every joint's speed and acceleration."""
        for _ in range(count):
            before = self.servo.v.copy()
            progress = self.motion.tick(ROBOT, DT_S)
            assert (np.abs(self.servo.v) <= self.fastest + 1e-6).all()
            step = KINEMATICS.acceleration * DT_S
            assert (np.abs(self.servo.v - before) <= step + 1e-6).all()
        return progress


def test_joints_come_to_the_speeds_that_are_streamed():
    stream = Stream()
    assert stream.motion.idle
    assert stream.motion.aim(RATES) is False
    assert stream.motion.driven
    assert not stream.motion.idle
    before = stream.servo.q.copy()
    stream.tick(250)
    np.testing.assert_allclose(stream.servo.v, RATES, atol=1e-6)
    np.testing.assert_allclose(stream.servo.q - before, RATES, atol=0.01)


def test_joints_keep_their_proportion_while_they_speed_up():
    stream = Stream()
    wanted = stream.fastest * (1.0, -0.5, 0.25, 0.0, 0.1, -0.75)
    stream.motion.aim(wanted)
    for _ in range(20):
        stream.tick()
        share = stream.servo.v[0] / wanted[0]
        np.testing.assert_allclose(stream.servo.v, share * wanted, atol=1e-5)
    assert 0.3 < share < 0.9 + 1e-9


def test_too_fast_a_stream_is_slowed_in_proportion_and_said():
    stream = Stream()
    assert stream.motion.aim(100.0 * RATES) is True
    stream.tick(200)
    over = (np.abs(RATES) / stream.fastest).max()
    np.testing.assert_allclose(stream.servo.v, RATES / over, atol=1e-5)


def test_it_brakes_to_rest_and_only_then_has_arrived():
    stream = Stream()
    stream.motion.aim(stream.fastest.copy())
    stream.tick(100)
    stream.motion.brake()
    assert not stream.motion.driven
    slowest_s = SPEED / ACCELERATION * (KINEMATICS.velocity / KINEMATICS.acceleration).max()
    count, over = 0, False
    while not over:
        over = stream.tick() is ARRIVED
        assert not (over and stream.servo.moving)
        count += 1
        assert count < 200
    assert count * DT_S <= slowest_s + 5 * DT_S
    assert stream.motion.idle


def test_a_stream_of_zeros_rests_and_waits_for_more():
    stream = Stream()
    stream.motion.aim(RATES)
    stream.tick(50)
    stream.motion.aim(np.zeros(6))
    assert not stream.motion.driven
    assert stream.tick(100) is GOING
    assert stream.motion.idle
    where = stream.servo.q.copy()
    stream.tick(10)
    np.testing.assert_array_equal(stream.servo.q, where)
    stream.motion.aim(RATES)
    stream.tick(50)
    assert stream.servo.moving


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_stops_at_the_end_of_its_range(sign):
    end = (KINEMATICS.upper if sign > 0 else KINEMATICS.lower)[5]
    stream = Stream([*MODEL.home[:5], end - 0.05 * sign])
    stream.motion.aim(sign * np.array((0.0,) * 5 + (0.5,)))
    stream.tick(300)
    assert abs(stream.servo.q[5] - end) < 0.01
    assert KINEMATICS.lower[5] - 1e-6 <= stream.servo.q[5] <= KINEMATICS.upper[5] + 1e-6


rates = st.tuples(*[st.floats(-50.0, 50.0)] * 6)


@settings(max_examples=15, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(rates, st.integers(1, 15)), max_size=6))
def test_limits_hold_whatever_is_streamed_and_it_always_ends_at_rest(plan):
    stream = Stream()
    for values, ticks in plan:
        stream.motion.aim(np.array(values))
        stream.tick(ticks)
    stream.motion.brake()
    assert any(stream.tick() is ARRIVED for _ in range(500))
    assert not stream.servo.moving
