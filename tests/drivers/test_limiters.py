"""Limiters that start, coast and meet walls: exact cases. Any input: test_egm_limits.py."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.common.braking import stopping_speed, within_walls
from cardan.drivers.limiters import JointLimiter, PointLimiter
from cardan.types import ZERO3, Vector3

DT_S = 0.004
LOWER, UPPER = (-1.0, -2.0), (0.5, 3.0)
SPEED, ACCELERATION = (2.0, 1.0), (10.0, 3.0)
BOX = ((-0.1, -0.2, -0.3), (0.1, 0.2, 0.3))
A_WALL = 2.0 / math.sqrt(3.0)


def joints():
    return JointLimiter(LOWER, UPPER, SPEED, ACCELERATION, 4 * DT_S)


def point(box=BOX):
    return PointLimiter(0.5, 2.0, box)


# -- joints ----------------------------------------------------------------------------------------


def test_joints_start_at_rest_where_they_are():
    limiter = joints()
    limiter.drive((1.0, 1.0), DT_S)
    limiter.reset((0.2, 0.3))
    assert limiter.reference == [0.2, 0.3]
    assert limiter.velocity == [0.0, 0.0]
    assert not limiter.moving
    limiter.track((0.2, 0.3), None, DT_S)  # The target of before is forgotten.
    assert not limiter.moving


@pytest.mark.parametrize(
    ("position", "velocity", "left"),
    [
        (0.0, 1.5, 1.5),
        (0.0, -1.5, -1.5),
        (0.0, 9.0, 2.0),
        (0.0, -9.0, -2.0),
        (0.45, 1.5, math.sqrt(2 * 10.0 * 0.05)),
        (-0.95, -1.5, -math.sqrt(2 * 10.0 * 0.05)),
        (0.45, -1.5, -1.5),
        (-0.95, 1.5, 1.5),
        (0.6, 1.5, 0.0),
        (-1.1, -1.5, 0.0),
    ],
)
def test_joints_start_at_the_speed_that_can_be_stopped(position, velocity, left):
    limiter = joints()
    limiter.reset((position, 0.0), (velocity, 0.5))
    assert limiter.velocity == pytest.approx([left, 0.5])
    assert limiter.reference == [position, 0.0]


@pytest.mark.parametrize(
    ("position", "velocity", "gap_s", "after"),
    [
        (0.0, 1.5, 0.1, 0.15),
        (0.0, -1.5, 0.1, -0.15),
        (0.3, 1.5, 1.0, 0.5),
        (-0.8, -1.5, 1.0, -1.0),
        (0.7, -1.0, 0.1, 0.6),
        (-1.2, 1.0, 0.1, -1.1),
    ],
)
def test_joints_coast_to_the_ends_of_their_range(position, velocity, gap_s, after):
    limiter = joints()
    limiter.reset((position, 0.0), (velocity, 0.5))
    limiter.coast(gap_s)
    assert limiter.reference == pytest.approx([after, 0.5 * gap_s])
    at_an_end = after in (0.5, -1.0)
    assert limiter.velocity == pytest.approx([0.0 if at_an_end else velocity, 0.5])


# -- a point ---------------------------------------------------------------------------------------


def test_a_point_starts_at_the_velocity_that_can_be_stopped():
    limiter = point()
    limiter.reset(Vector3(0.0, 0.19, -0.3), (0.3, 0.3, -0.1))
    assert limiter.reference == (0.0, 0.19, -0.3)
    fastest = math.sqrt(2 * A_WALL * 0.01)
    assert limiter.velocity == pytest.approx((0.3, fastest, 0.0))
    limiter.reset(Vector3(0.0, -0.19, 0.3), (0.3, -0.3, 0.1))
    assert limiter.velocity == pytest.approx((0.3, -fastest, 0.0))
    free = point(None)
    free.reset(Vector3(9.0, 0.0, 0.0), (3.0, 0.0, 4.0))
    assert free.velocity == pytest.approx((0.3, 0.0, 0.4))
    free.track((9.0, 0.0, 0.0), ZERO3, DT_S)
    free.reset(ZERO3)
    assert not free.moving
    free.track(ZERO3, None, DT_S)
    assert not free.moving


@pytest.mark.parametrize(
    ("start", "velocity", "after"),
    [
        ((0.0, 0.0, 0.0), (0.1, -0.2, 0.3), (0.02, -0.04, 0.06)),
        ((0.09, 0.0, 0.0), (0.1, 0.2, 0.0), (0.1, 0.04, 0.0)),
        ((0.0, -0.19, 0.0), (0.1, -0.2, 0.0), (0.02, -0.2, 0.0)),
        ((0.5, 0.0, 0.0), (-0.1, 0.2, -0.3), (0.48, 0.04, -0.06)),
    ],
)
def test_a_point_coasts_to_the_walls_and_from_outside_as_it_moves(start, velocity, after):
    limiter = point()
    limiter.reset(Vector3(*start), velocity)
    limiter.coast(0.2)
    assert limiter.reference == pytest.approx(after)
    free = point(None)
    free.reset(Vector3(*start), velocity)
    free.coast(0.2)
    assert free.reference == pytest.approx(
        [q + 0.2 * v for q, v in zip(start, velocity, strict=True)]
    )
    assert free.velocity == pytest.approx(velocity)


def expected(place, now, wanted):
    """As much of `wanted` as walls and acceleration leave, found by halving."""
    low = [-stopping_speed(q - wall, A_WALL, DT_S) for q, wall in zip(place, BOX[0], strict=True)]
    high = [stopping_speed(wall - q, A_WALL, DT_S) for q, wall in zip(place, BOX[1], strict=True)]
    clipped = [min(max(v, a), b) for v, a, b in zip(wanted, low, high, strict=True)]
    due = [min(max(v, a), b) for v, a, b in zip(now, low, high, strict=True)]
    if clipped == list(wanted):
        return clipped
    below, above = 0.0, 1.0
    for _ in range(60):
        share = 0.5 * (below + above)
        change = [d + share * (c - d) - n for d, c, n in zip(due, clipped, now, strict=True)]
        fits = math.hypot(*change) <= 2.0 * DT_S
        below, above = (share, above) if fits else (below, share)
    return [d + below * (c - d) for d, c in zip(due, clipped, strict=True)]


shares = st.sampled_from((-1.0, -0.999, -0.9, 0.0, 0.9, 0.999, 1.0))
places = st.tuples(shares, shares, shares)
steps = st.tuples(*[st.sampled_from((-1.0, -0.4, 0.0, 0.3, 1.0))] * 3)


@given(places, steps, steps)
def test_walls_come_first_and_the_rest_as_far_as_it_fits(place, now, step):
    at = Vector3(*(share * wall for share, wall in zip(place, BOX[1], strict=True)))
    limiter = point()
    # What may be there: a velocity that the period before allowed.
    limiter.reset(at, [0.28 * v for v in now])
    before = limiter.velocity
    change = 2.0 * DT_S / max(1.0, math.hypot(*step))
    wanted = Vector3(*(v + change * s for v, s in zip(before, step, strict=True)))
    got = within_walls(before, wanted, *limiter._bounds(BOX, DT_S), 2.0 * DT_S)
    assert got == pytest.approx(expected(at, before, wanted), abs=1e-9)


@given(places, steps, steps)
def test_walls_that_come_up_suddenly_are_braked_for_no_harder_than_allowed(place, now, step):
    before, most = Vector3(*now), 0.1
    lowest, highest = [min(0.0, p) for p in place], [max(0.0, p) for p in place]
    braking = most / math.sqrt(3.0)
    got = within_walls(before, step, lowest, highest, most, braking)
    assert math.dist(got, before) <= most + 1e-9
    for v, was, wanted, low, high in zip(got, now, step, lowest, highest, strict=True):
        due = min(max(min(max(was, low), high), was - braking), was + braking)
        clipped = min(max(wanted, low), high)
        assert min(due, clipped) - 1e-12 <= v <= max(due, clipped) + 1e-12


def test_what_walls_demand_beyond_the_longest_change_leaves_nothing_for_the_rest():
    walls = [-0.2, -1.0, -1.0], [0.2, 1.0, 1.0]
    assert within_walls((1.0, 0.0, 0.0), (1.0, 0.5, 0.0), *walls, 0.1) == (0.2, 0.0, 0.0)


def test_what_walls_demand_and_the_rest_together_are_no_more_than_the_walls_want():
    walls = [-1.0] * 3, [0.9, 1.0, 1.0]
    got = within_walls((1.0, 0.0, 0.0), (2.0, 0.0, 0.0), *walls, 0.11, 0.065)
    assert got == (0.9, 0.0, 0.0)
