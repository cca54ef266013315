"""The reference stays inside its limits for all requests, without steps."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.common.braking import stopping_speed
from cardan.errors import OptionError
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.spatial import (
    add,
    from_rotation_vector,
    multiply,
    norm,
    rotate,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import IDENTITY, ZERO3, ZERO_TWIST, Frame, Pose, Quaternion, Twist, Vector3
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
    """Advance with an ideal robot, which is always at its command."""
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


@pytest.mark.parametrize("way", [-0.1, 0.1])
def test_walls_along_one_axis_leave_the_others_free(way):
    reference = placed(ReferenceLimits(workspace_z_m=(0.7, 0.85)))
    for _ in range(250):
        reference.shape(Twist(Vector3(way, way, 0.0), ZERO3), 0.004)
    assert reference.linear == pytest.approx((way, way, 0.0))
    assert not reference.at_workspace_limit


def test_outside_the_workspace_only_inward_motion():
    reference = placed(ReferenceLimits(workspace_x_m=(0.6, 0.8)))
    follow(reference, Twist(Vector3(-0.1, 0, 0), ZERO3), 50)
    assert reference.pose.position.x == 0.5
    follow(reference, Twist(Vector3(0.1, 0, 0), ZERO3), 50)
    assert reference.pose.position.x > 0.51


@pytest.mark.parametrize("speed", [0.02, 0.25])
def test_blocked_robot_holds_the_maximum_lead(speed):
    limits = ReferenceLimits()
    reference = placed(limits)
    for _ in range(2000):
        reference.observe(START)
        reference.advance(Twist(Vector3(speed, 0, 0), Vector3(0, 0, 1.0)), DT_S)
        assert norm(subtract(reference.pose.position, START.position)) <= limits.max_lead_m + 1e-9
        turned = norm(rotation_between(IDENTITY, reference.pose.orientation))
        assert turned <= limits.max_lead_rad + 1e-9
    assert reference.lead_used == pytest.approx(1.0, abs=0.01)
    # back towards the robot is possible at once
    before = reference.pose.position.x
    for _ in range(50):
        reference.observe(START)
        reference.advance(Twist(Vector3(-speed, 0, 0), ZERO3), DT_S)
    assert reference.pose.position.x < before


@pytest.mark.parametrize(
    "direction", [(1.0, 2.0, 2.0), (-2.0, 1.0, 2.0), (2.0, -2.0, 1.0), (-1.0, -2.0, 2.0)]
)
def test_a_maximum_lead_holds_in_every_direction(direction):
    limits = ReferenceLimits()
    asked = scale(Vector3(*direction), 0.05)
    reference = placed(limits)
    for _ in range(1500):
        reference.observe(START)
        reference.advance(Twist(asked, scale(asked, 4.0)), DT_S)
        assert reference.ahead_m <= limits.max_lead_m + 1e-9
        assert reference.ahead_rad <= limits.max_lead_rad + 1e-9
    reference.observe(START)
    assert reference.ahead_m == pytest.approx(limits.max_lead_m, rel=0.01)
    assert reference.ahead_rad == pytest.approx(limits.max_lead_rad, rel=0.01)


def test_maximum_lead_leaves_sideways_motion_alone():
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
    follow(smooth, Twist(Vector3(0.1, 0, 0), ZERO3), 300)  # the motion continues from there
    assert smooth.linear.x == pytest.approx(0.1)


# -- limits, and placing the reference -------------------------------------------------------------


def test_the_limits_by_themselves():
    limits = ReferenceLimits()
    assert (limits.linear_speed_m_s, limits.linear_acceleration_m_s2) == (0.25, 1.0)
    assert (limits.angular_speed_rad_s, limits.angular_acceleration_rad_s2) == (1.0, 4.0)
    assert (limits.max_lead_m, limits.max_lead_rad) == (0.05, 0.3)
    assert limits.workspace_m == (None, None, None)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("workspace_x_m", (0.2, 0.1)),
        ("workspace_y_m", (0.1, 0.1)),
        ("workspace_z_m", (0.3, -0.3)),
        ("linear_speed_m_s", -1.0),
    ],
)
def test_limits_that_are_none_are_refused(key, value):
    with pytest.raises(OptionError) as refused:
        ReferenceLimits(**{key: value})
    assert refused.value.key == key


def stands(reference):
    assert (reference.linear, reference.angular) == (ZERO3, ZERO3)
    assert (reference.ahead_m, reference.ahead_rad, reference.lead_used) == (0.0, 0.0, 0.0)
    assert not reference.at_workspace_limit
    assert not reference.moving


def test_before_it_is_placed_it_is_nowhere_and_rests():
    reference = Reference(ReferenceLimits())
    stands(reference)
    for act in (
        lambda: reference.observe(START),
        lambda: reference.move(ZERO3, ZERO3, DT_S),
        lambda: reference.shape(ZERO_TWIST, DT_S),
    ):
        with pytest.raises(RuntimeError, match="placed"):
            act()


def test_where_it_is_placed_it_begins_anew():
    limits = ReferenceLimits(
        linear_jerk_m_s3=20.0, angular_jerk_rad_s3=80.0, workspace_z_m=(0.7, 0.8)
    )
    quick = Twist(Vector3(0.2, 0.0, 0.2), Vector3(0.0, 0.5, 0.0))
    used, fresh = placed(limits), placed(limits)
    follow(used, quick, 100)
    used.observe(START)
    assert used.at_workspace_limit
    assert used.lead_used > 0.0
    used.place(START)
    stands(used)
    for each in (used, fresh):
        each.advance(quick, DT_S)
    assert used.twist == fresh.twist
    assert used.pose == fresh.pose


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turn_alone_is_a_motion_and_so_is_a_way_alone(axis):
    some = [0.0, 0.0, 0.0]
    some[axis] = 0.1
    for twist in (Twist(Vector3(*some), ZERO3), Twist(ZERO3, Vector3(*some))):
        reference = placed()
        follow(reference, twist, 1)
        assert reference.moving


# -- lead of the reference -------------------------------------------------------------------------

turns = st.builds(Vector3, *[st.floats(-1.7, 1.7)] * 3)
places = st.builds(Vector3, *[st.floats(-1.0, 1.0)] * 3)


@given(places, turns, places, turns, st.booleans())
def test_how_far_it_is_ahead_of_what_was_measured(at, turn, seen_at, seen_turn, other_sign):
    reference = placed(pose=Pose(at, from_rotation_vector(turn)))
    q = from_rotation_vector(seen_turn)
    measured = Pose(seen_at, Quaternion(*(-c for c in q)) if other_sign else q)
    reference.observe(measured)
    ahead = rotation_between(q, reference.pose.orientation)
    assert reference.ahead_m == pytest.approx(math.dist(at, seen_at), abs=1e-12)
    assert reference.ahead_rad == pytest.approx(norm(ahead), abs=1e-7)
    assert reference._ahead == pytest.approx(subtract(at, seen_at))
    if norm(ahead) < 3.1:  # half a turn, in either direction
        assert reference._turned_ahead == pytest.approx(ahead, abs=1e-7)


@pytest.mark.parametrize("angle_rad", [1e-10, 1e-9, 1e-3, 0.1])
def test_a_turn_however_small_is_ahead_by_as_much(angle_rad):
    reference = placed(pose=Pose(ZERO3, from_rotation_vector(Vector3(0.0, angle_rad, 0.0))))
    reference.observe(Pose(ZERO3, IDENTITY))
    assert reference._turned_ahead.y == pytest.approx(angle_rad, rel=1e-4)


def test_the_share_of_the_maximum_lead_is_the_worse_of_the_two():
    reference = placed()
    for way_m, turn_rad, share in ((0.025, 0.03, 0.5), (0.005, 0.15, 0.5), (0.0, 0.6, 2.0)):
        seen = Pose(
            add(START.position, Vector3(0.0, way_m, 0.0)),
            from_rotation_vector(Vector3(0.0, 0.0, turn_rad)),
        )
        reference.observe(seen)
        assert reference.lead_used == pytest.approx(share)


# -- axes, smoothing, moving -----------------------------------------------------------------------

TILT = from_rotation_vector(Vector3(0.3, -0.8, 0.5))
TILTED = Pose(START.position, TILT)


@pytest.mark.parametrize("frame", Frame)
def test_along_which_axes_a_twist_is(frame):
    reference = placed(pose=TILTED)
    reference.shape(Twist(Vector3(0.1, 0.02, 0.0), Vector3(0.0, 0.3, 0.1), frame), 1.0)
    linear, angular = Vector3(0.1, 0.02, 0.0), Vector3(0.0, 0.3, 0.1)
    if frame is Frame.TOOL:
        linear = rotate(TILT, linear)
    if frame is not Frame.BASE:
        angular = rotate(TILT, angular)
    assert reference.linear == pytest.approx(linear)
    assert reference.angular == pytest.approx(angular)
    assert reference.pose == TILTED


def test_a_motion_is_integrated_along_the_base_s_axes():
    reference = placed(pose=TILTED)
    angular = Vector3(0.2, -0.3, 0.4)
    reference.move(Vector3(0.1, -0.2, 0.3), angular, 0.5)
    assert reference.pose.position == pytest.approx((0.55, -0.1, 0.95))
    turned = multiply(from_rotation_vector(scale(angular, 0.5)), TILT)
    assert reference.pose.orientation == pytest.approx(turned)


def test_after_a_stop_that_did_not_wait_the_jerk_is_bounded_from_the_speed_that_is_left():
    fast = Twist(Vector3(0.2, 0.0, 0.0), Vector3(0.0, 0.5, 0.0))
    reference = placed(SMOOTH)
    follow(reference, fast, 300)
    for _ in range(5):
        reference.observe(reference.pose)
        reference.shape(ZERO_TWIST, DT_S, smooth=False)
    linear, angular = reference.linear, reference.angular
    assert linear.x == pytest.approx(0.2 - 5 * 1.0 * DT_S)
    assert angular.y == pytest.approx(0.5 - 5 * 4.0 * DT_S)
    reference.shape(fast, DT_S)
    assert norm(subtract(reference.linear, linear)) <= 20.0 * DT_S**2 * (1 + 1e-6)
    assert norm(subtract(reference.angular, angular)) <= 80.0 * DT_S**2 * (1 + 1e-6)
    bare = placed()
    bare.shape(ZERO_TWIST, DT_S, smooth=False)
    assert not bare.moving


# -- walls -----------------------------------------------------------------------------------------

BOX = ReferenceLimits(workspace_x_m=(0.4, 0.6), workspace_y_m=(-0.1, 0.1), workspace_z_m=(0.7, 0.9))
A_WALL = 1.0 / math.sqrt(3.0)
"""Acceleration by itself, m/s², that each of three walls allows."""


def expected_at_walls(now, target, place):
    """Next velocity at the walls of BOX, found by bisection."""
    wanted, braked = list(target), list(now)
    for axis, (lower, upper) in enumerate(BOX.workspace_m):
        up = stopping_speed(upper - place[axis], A_WALL, DT_S)
        down = -stopping_speed(place[axis] - lower, A_WALL, DT_S)
        wanted[axis] = min(max(wanted[axis], down), up)
        step = A_WALL * DT_S
        braked[axis] = min(max(now[axis] - step, min(up, now[axis])), now[axis] + step)
        if now[axis] < down:
            braked[axis] = min(down, now[axis] + step)
    low, high = 0.0, 1.0
    for _ in range(60):
        share = 0.5 * (low + high)
        change = [b + share * (w - b) - n for b, w, n in zip(braked, wanted, now, strict=True)]
        low, high = (share, high) if math.hypot(*change) <= 1.0 * DT_S else (low, share)
    return [b + low * (w - b) for b, w in zip(braked, wanted, strict=True)]


near = st.sampled_from((0.0, 1e-4, 1e-3, 0.01, 0.05, 0.1))
signs = st.sampled_from((-1.0, 1.0))
speeds_m_s = st.sampled_from((-0.14, -0.1, -0.02, -0.001, 0.0, 0.001, 0.02, 0.1, 0.14))
triple = st.tuples(speeds_m_s, speeds_m_s, speeds_m_s)


@settings(max_examples=examples(300))
@given(triple, triple, st.tuples(near, near, near), st.tuples(signs, signs, signs))
def test_walls_come_first_and_the_rest_as_far_as_it_fits(now, target, gaps, sides):
    center = (0.5, 0.0, 0.8)
    place = [c + s * (0.1 - gap) for c, s, gap in zip(center, sides, gaps, strict=True)]
    reference = placed(BOX, Pose(Vector3(*place), IDENTITY))
    reference.linear = Vector3(*now)
    reference.shape(Twist(Vector3(*target), ZERO3), DT_S)
    assert reference.linear == pytest.approx(expected_at_walls(now, target, place), abs=1e-9)


def test_a_wall_is_reported_where_it_holds_and_not_where_the_reference_rests_at_it():
    at = Pose(Vector3(0.5, 0.0, 0.875), IDENTITY)
    for walls in ((0.75, 0.875), (0.875, 1.0)):
        reference = placed(ReferenceLimits(workspace_z_m=walls), at)
        reference.shape(ZERO_TWIST, DT_S)
        assert not reference.at_workspace_limit
        outwards = 0.1 if walls[1] == 0.875 else -0.1
        reference.shape(Twist(Vector3(0.0, 0.0, outwards), ZERO3), DT_S)
        assert reference.at_workspace_limit
        assert reference.linear == ZERO3
        reference.shape(ZERO_TWIST, DT_S)
        assert not reference.at_workspace_limit


@pytest.mark.parametrize("more", [0.0053, 0.02])
def test_at_a_wall_that_is_too_near_the_whole_budget_is_used_and_no_more(more):
    now = stopping_speed(0.02, A_WALL, DT_S) + more
    reference = placed(BOX, Pose(Vector3(0.58, 0.0, 0.8), IDENTITY))
    reference.linear = Vector3(now, 0.0, 0.0)
    reference.shape(Twist(Vector3(0.25, 0.0, 0.0), ZERO3), DT_S)
    assert reference.linear.x == pytest.approx(now - 1.0 * DT_S)


@pytest.mark.parametrize("limits", [ReferenceLimits(), BOX])
def test_however_slow_it_is_it_comes_to_rest(limits):
    reference = placed(limits)
    reference.linear = Vector3(1e-160, 0.0, 0.0)
    reference.shape(ZERO_TWIST, DT_S)
    assert not reference.moving


@pytest.mark.parametrize("speed", [0.02, 0.25])
def test_a_robot_that_is_a_little_behind_changes_no_speed(speed):
    reference = placed()
    for _ in range(100):
        x, y, z = reference.pose.position
        reference.observe(Pose(Vector3(x - 0.001, y, z), IDENTITY))
        reference.advance(Twist(Vector3(speed, 0.0, 0.0), ZERO3), DT_S)
    assert reference.linear.x == pytest.approx(speed)
    assert reference.twist == Twist(reference.linear, ZERO3, Frame.BASE)
