"""Braking from any speed of an arm."""

import pytest
from hypothesis import given, settings, strategies as st

from cardan.gateway.arm.commanded_arm import TaskSpaceArm
from cardan.gateway.arm.motions.base import ARRIVED
from cardan.gateway.arm.motions.reference_motion import Brake
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.spatial import norm, subtract
from cardan.types import (
    IDENTITY_POSE,
    ZERO3,
    ZERO_TWIST,
    RobotLink,
    RobotState,
    Twist,
    Vector3,
)
from tests.examples import examples

DT_S = 0.004
LIMITS = ReferenceLimits()
ROBOT = RobotState(1.0, RobotLink.LIVE, 1, 0, DT_S, (), (), IDENTITY_POSE, "")


def moving(linear=ZERO3, angular=ZERO3, limits=LIMITS):
    """An arm in task space at these velocities, and its reference."""
    commanded, reference = TaskSpaceArm(limits), Reference(limits)
    commanded.place(ROBOT)
    reference.place(commanded.pose)
    reference.linear, reference.angular = linear, angular
    commanded.follow(reference, DT_S)
    return commanded, reference


def ramp(commanded, brake):
    """Tick until the arm is at rest; check every step, and return the number of steps."""
    for count in range(1, 2000):
        before = commanded.twist
        over = brake.tick(ROBOT, DT_S) is ARRIVED
        change = norm(subtract(commanded.twist.linear, before.linear))
        assert change <= LIMITS.linear_acceleration_m_s2 * DT_S * (1.0 + 1e-9)
        change = norm(subtract(commanded.twist.angular, before.angular))
        assert change <= LIMITS.angular_acceleration_rad_s2 * DT_S * (1.0 + 1e-9)
        assert norm(commanded.twist.linear) <= norm(before.linear) + 1e-12
        assert norm(commanded.twist.angular) <= norm(before.angular) + 1e-12
        if over:
            assert not commanded.moving
            return count
    raise AssertionError("it never comes to rest")


def test_it_begins_at_the_bodys_own_speed_and_place_wherever_the_reference_was():
    commanded, reference = moving(Vector3(0.2, 0.0, 0.0))
    reference.place(IDENTITY_POSE)
    brake = Brake(commanded, reference)
    assert reference.pose == commanded.pose
    assert reference.twist == commanded.twist
    assert not brake.idle
    brake.tick(ROBOT, DT_S)
    most = LIMITS.linear_acceleration_m_s2 * DT_S
    assert commanded.twist.linear == pytest.approx((0.2 - most, 0.0, 0.0))


@settings(max_examples=examples(40))
@given(*[st.floats(-0.14, 0.14)] * 3, *[st.floats(-0.5, 0.5)] * 3)
def test_it_takes_no_longer_than_the_limits_demand(x, y, z, rx, ry, rz):
    linear, angular = Vector3(x, y, z), Vector3(rx, ry, rz)
    commanded, reference = moving(linear, angular)
    count = ramp(commanded, Brake(commanded, reference))
    fastest_s = max(
        norm(linear) / LIMITS.linear_acceleration_m_s2,
        norm(angular) / LIMITS.angular_acceleration_rad_s2,
    )
    assert count * DT_S <= fastest_s + 4 * DT_S


def test_it_does_not_wait_for_jerk():
    soft = ReferenceLimits(linear_jerk_m_s3=0.5, angular_jerk_rad_s3=0.5)
    commanded, reference = moving(Vector3(0.2, 0.0, 0.0), limits=soft)
    assert ramp(commanded, Brake(commanded, reference)) * DT_S <= 0.2 + 4 * DT_S


def test_an_arm_at_rest_has_arrived_where_it_is():
    commanded, reference = moving()
    where = commanded.pose
    ramp(commanded, Brake(commanded, reference))
    assert commanded.pose == where
    assert commanded.twist == Twist(*ZERO_TWIST)
