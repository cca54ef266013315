"""The reference stays inside its limits whatever it is asked, and never steps."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.gateway.motion.reference import Reference, ReferenceLimits
from cardan.spatial import from_rotation_vector, norm, rotate, rotation_between, scale, subtract
from cardan.types import IDENTITY, ZERO3, ZERO_TWIST, Frame, Pose, Twist, Vector3
from tests.examples import examples

DT_S = 0.004
START = Pose(Vector3(0.5, 0.0, 0.8), IDENTITY)
speeds = st.floats(-1e3, 1e3)
vectors = st.builds(Vector3, speeds, speeds, speeds)
twists = st.builds(Twist, vectors, vectors, st.sampled_from(Frame))


def placed(limits=None, pose=START):
    reference = Reference(limits or ReferenceLimits())
    reference.place(pose)
    return reference


def follow(reference, target, ticks, dt_s=DT_S):
    """Advance with an ideal robot, one that is always where it is told."""
    for _ in range(ticks):
        reference.observe(reference.pose)
        reference.advance(target, dt_s)


def test_constant_twist_reaches_speed_and_integrates():
    reference = placed()
    follow(reference, Twist(Vector3(0.1, 0, 0), ZERO3), 250)
    assert reference.linear == pytest.approx((0.1, 0, 0))
    # 0.1 s of ramp at 1 m/s², then 0.9 s at 0.1 m/s
    assert reference.pose.position.x - 0.5 == pytest.approx(0.1 * 0.9 + 0.5 * 0.1 * 0.1, abs=3e-4)


def test_rotation_integrates_about_base_axes():
    reference = placed(ReferenceLimits(angular_acceleration_rad_s2=300.0))
    follow(reference, Twist(ZERO3, Vector3(0, 0, 0.5)), 500)
    turned = rotation_between(IDENTITY, reference.pose.orientation)
    assert turned == pytest.approx((0, 0, 1.0), abs=1e-9)


def test_tool_twist_is_along_the_tool():
    tilted = Pose(START.position, from_rotation_vector(Vector3(0, math.pi / 2, 0)))
    reference = placed(pose=tilted)
    follow(reference, Twist(Vector3(0, 0, 0.1), ZERO3, Frame.TOOL), 250)
    moved = subtract(reference.pose.position, tilted.position)
    assert moved.x > 0.09
    assert moved == pytest.approx(rotate(tilted.orientation, Vector3(0, 0, norm(moved))), abs=1e-12)


@settings(max_examples=examples(60))
@given(st.lists(st.tuples(twists, st.integers(1, 40)), min_size=1, max_size=8))
def test_speed_and_acceleration_are_never_exceeded(plan):
    limits = ReferenceLimits(
        workspace_x_m=(0.4, 0.6), workspace_y_m=(-0.1, 0.1), workspace_z_m=(0.7, 0.9)
    )
    reference = placed(limits)
    for target, ticks in plan:
        for _ in range(ticks):
            linear, angular, pose = reference.linear, reference.angular, reference.pose
            reference.observe(pose)
            reference.advance(target, DT_S)
            assert norm(reference.linear) <= limits.linear_speed_m_s * (1 + 1e-9)
            assert norm(reference.angular) <= limits.angular_speed_rad_s * (1 + 1e-9)
            step = norm(subtract(reference.linear, linear))
            assert step <= limits.linear_acceleration_m_s2 * DT_S * (1 + 1e-9)
            turn = norm(subtract(reference.angular, angular))
            assert turn <= limits.angular_acceleration_rad_s2 * DT_S * (1 + 1e-9)
            for value, bounds in zip(reference.pose.position, limits.workspace_m, strict=True):
                assert bounds[0] - 1e-9 <= value <= bounds[1] + 1e-9


def test_walls_do_not_hold_motion_along_them():
    reference = placed(ReferenceLimits(workspace_z_m=(0.7, 0.85)))
    follow(reference, Twist(Vector3(0.1, 0, 0.2), ZERO3), 750)
    assert reference.at_workspace_limit
    assert reference.pose.position.z == pytest.approx(0.85, abs=1e-6)
    assert reference.linear.x == pytest.approx(0.1)


def test_outside_the_workspace_only_inward_motion():
    reference = placed(ReferenceLimits(workspace_x_m=(0.6, 0.8)))
    follow(reference, Twist(Vector3(-0.1, 0, 0), ZERO3), 50)
    assert reference.pose.position.x == 0.5
    follow(reference, Twist(Vector3(0.1, 0, 0), ZERO3), 50)
    assert reference.pose.position.x > 0.51


@pytest.mark.parametrize("speed", [0.02, 0.25])
def test_blocked_robot_holds_the_leash(speed):
    limits = ReferenceLimits()
    reference = placed(limits)
    for _ in range(2000):
        reference.observe(START)
        reference.advance(Twist(Vector3(speed, 0, 0), Vector3(0, 0, 1.0)), DT_S)
        assert norm(subtract(reference.pose.position, START.position)) <= limits.leash_m + 1e-9
        turned = norm(rotation_between(IDENTITY, reference.pose.orientation))
        assert turned <= limits.leash_rad + 1e-9
    assert reference.leash_used == pytest.approx(1.0, abs=0.01)
    # back towards the robot is free at once
    before = reference.pose.position.x
    for _ in range(50):
        reference.observe(START)
        reference.advance(Twist(Vector3(-speed, 0, 0), ZERO3), DT_S)
    assert reference.pose.position.x < before


def test_leash_leaves_sideways_motion_alone():
    reference = placed()
    blocked_x = START
    for _ in range(500):
        reference.observe(blocked_x)
        reference.advance(Twist(Vector3(0.1, 0.05, 0), ZERO3), DT_S)
        y = reference.pose.position.y
        blocked_x = Pose(Vector3(0.5, y, 0.8), IDENTITY)
    assert reference.linear.y == pytest.approx(0.05)
    assert reference.linear.x == pytest.approx(0.0, abs=1e-3)


def test_zero_twist_brakes_to_exact_rest():
    reference = placed()
    follow(reference, Twist(Vector3(0.2, 0.1, 0), Vector3(0.5, 0, 0)), 200)
    assert reference.moving
    follow(reference, ZERO_TWIST, 200)
    assert not reference.moving


def test_placing_a_pose_that_is_none_is_refused():
    reference = Reference(ReferenceLimits())
    with pytest.raises(RuntimeError, match="placed"):
        reference.advance(ZERO_TWIST, DT_S)


SMOOTH = ReferenceLimits(linear_jerk_m_s3=20.0, angular_jerk_rad_s3=80.0)


def test_jerk_is_bounded_while_the_operator_steers():
    reference = placed(SMOOTH)
    acceleration = turning = ZERO3
    for target, ticks in (
        (Twist(Vector3(0.2, 0.1, 0), Vector3(0, 0.5, 0)), 300),
        (Twist(Vector3(-0.1, 0.2, 0), Vector3(0.3, 0, 0)), 300),
        (ZERO_TWIST, 300),
    ):
        for _ in range(ticks):
            linear, angular = reference.linear, reference.angular
            reference.observe(reference.pose)
            reference.advance(target, DT_S)
            now = scale(subtract(reference.linear, linear), 1.0 / DT_S)
            assert norm(subtract(now, acceleration)) <= 20.0 * DT_S * (1 + 1e-6)
            acceleration = now
            now = scale(subtract(reference.angular, angular), 1.0 / DT_S)
            assert norm(subtract(now, turning)) <= 80.0 * DT_S * (1 + 1e-6)
            turning = now
    assert not reference.moving


def test_a_fault_does_not_wait_for_the_jerk():
    rough, smooth = placed(ReferenceLimits()), placed(SMOOTH)
    for each in (rough, smooth):
        follow(each, Twist(Vector3(0.2, 0, 0), ZERO3), 300)
        each.place_before = each.pose.position.x
        for _ in range(100):
            each.observe(each.pose)
            each.advance(ZERO_TWIST, DT_S, smooth=False)
        assert not each.moving
    assert smooth.pose.position.x - smooth.place_before == pytest.approx(
        rough.pose.position.x - rough.place_before, abs=1e-6
    )
    follow(smooth, Twist(Vector3(0.1, 0, 0), ZERO3), 300)  # and it goes on from there
    assert smooth.linear.x == pytest.approx(0.1)
