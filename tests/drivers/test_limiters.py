"""Limiters at start, in tracking, coasting and at walls. test_egm_limits.py has arbitrary
inputs."""

import math
import random

import pytest
from hypothesis import given, strategies as st

from cardan.common.braking import stopping_speed, within_walls
from cardan.drivers.limiters import JointLimiter, OrientationLimiter, PointLimiter
from cardan.spatial import from_rotation_vector, limit_norm, multiply, normalized, rotation_between
from cardan.types import IDENTITY, ZERO3, Quaternion, Vector3

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
    limiter.track((0.2, 0.3), None, DT_S)  # The previous target is forgotten.
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


AXES = (
    # lower, upper, speed, acceleration
    (-1.0, 0.5, 2.0, 10.0),
    (-0.4, 1.3, 1.0, 0.7),
    (-math.inf, math.inf, 3.0, 0.2),
    (-0.1, 0.01, 0.5, 8.0),
    (-0.5, 1.5, 0.8, 0.3),
)


def towards(distance, acceleration, dt_s):
    """Return the speed that closes `distance` and can still be stopped."""
    return math.copysign(stopping_speed(abs(distance), acceleration, dt_s), distance)


def next_speed(axis, position, before, wanted, target, dt_s):
    """Return the next speed of a joint at `wanted`, or towards a target that moves at `wanted`."""
    lower, upper, speed, acceleration = axis
    if target is not None:
        wanted = min(max(wanted, -speed), speed)
        wanted += towards(target - position - wanted * dt_s, acceleration, dt_s)
    most = acceleration * dt_s
    wanted = min(max(wanted, before - most, -speed), before + most, speed)
    lowest = -stopping_speed(position - lower, acceleration, dt_s)
    return min(max(wanted, lowest), stopping_speed(upper - position, acceleration, dt_s))


def script(seed, longest_s):
    """Yield verb, duration, rates and target steps of each period; half of the targets move."""
    rng = random.Random(seed)
    for _ in range(8):
        verb = rng.choice(("track", "track", "tracking", "drive", "brake", "reset", "coast"))
        rates = [rng.choice((0.0, 0.3, -0.9, 2.0, -5.0)) for _ in AXES]
        jumps = rng.random() < 0.5
        for _ in range(rng.choice((2, 9))):
            dt_s = longest_s * rng.choice((0.2, 0.5, 1.0))
            yield verb, dt_s, rates, [rng.uniform(-1.0, 1.0) * jumps for _ in AXES]


@pytest.mark.parametrize(("longest_s", "scale"), [(0.02, 1.0), (2.0, 20.0)])
def test_joints_follow_what_moves_and_close_what_is_left_as_fast_as_they_can_stop(longest_s, scale):
    axes = [(scale * low, scale * high, v, a) for low, high, v, a in AXES]
    for seed in range(40):
        limiter = JointLimiter(*zip(*axes, strict=True), longest_s)
        assert (limiter.reference, limiter.moving) == ([0.0] * 5, False)
        target, seen = [0.0] * 5, None
        for verb, dt_s, rates, jumps in script(seed, longest_s):
            at, before = list(limiter.reference), list(limiter.velocity)
            target = [
                q + dt_s * v + scale * j for q, v, j in zip(target, rates, jumps, strict=True)
            ]
            wanted, goal = [0.0] * 5, [None] * 5
            if verb in ("track", "tracking"):
                goal = list(target)
                if seen is not None:
                    wanted = [(q - was) / dt_s for q, was in zip(goal, seen, strict=True)]
                elif verb == "tracking":
                    wanted = rates
                limiter.track(goal, rates if verb == "tracking" else None, dt_s)
                seen = goal
            else:
                seen = None
            if verb == "drive":
                wanted = rates
                limiter.drive(rates, dt_s)
            elif verb == "brake":
                limiter.brake(dt_s)
            elif verb == "reset":
                limiter.reset(at)
                continue
            elif verb == "coast":
                limiter.coast(dt_s)
                continue
            cases = zip(axes, at, before, wanted, goal, strict=True)
            speeds = [next_speed(*case, dt_s) for case in cases]
            assert limiter.velocity == pytest.approx(speeds, abs=1e-9)
            assert limiter.reference == pytest.approx(
                [q + dt_s * v for q, v in zip(at, speeds, strict=True)], abs=1e-9
            )


def test_distances_within_rounding_are_none():
    for sign in (1.0, -1.0):
        limiter = joints()
        limiter.track((sign * 1e-12, 0.0), None, DT_S)
        assert not limiter.moving
        limiter.reset((0.0, 0.0))
        limiter.track((sign * 1.5e-12, 0.0), None, DT_S)
        assert limiter.velocity == [pytest.approx(sign * 1.5e-12 / DT_S), 0.0]
        assert limiter.moving
    limiter = point()
    limiter.track((0.0, 1e-12, 0.0), None, DT_S)
    assert not limiter.moving
    limiter.reset(ZERO3)
    limiter.track((0.0, 1.5e-12, 0.0), None, DT_S)
    assert limiter.velocity == pytest.approx((0.0, 1.5e-12 / DT_S, 0.0), abs=1e-15)


def test_joints_that_are_seen_elsewhere_keep_their_speed():
    limiter = joints()
    limiter.reset((0.0, 0.0), (0.5, 0.2))
    limiter.relocate((0.1, -0.1))
    assert (limiter.reference, limiter.velocity) == ([0.1, -0.1], [0.5, 0.2])


@pytest.mark.parametrize("long", range(4))
def test_limits_are_of_as_many_joints(long):
    limits = [LOWER, UPPER, SPEED, ACCELERATION]
    limits[long] = (*limits[long], 3.0)
    with pytest.raises(ValueError, match="zip"):
        JointLimiter(*limits, DT_S)


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


def expected(place, now, wanted, dt_s=DT_S):
    """Return the largest multiple of `wanted` that walls and acceleration allow, by bisection."""
    low = [-stopping_speed(q - wall, A_WALL, dt_s) for q, wall in zip(place, BOX[0], strict=True)]
    high = [stopping_speed(wall - q, A_WALL, dt_s) for q, wall in zip(place, BOX[1], strict=True)]
    clipped = [min(max(v, a), b) for v, a, b in zip(wanted, low, high, strict=True)]
    due = [min(max(v, a), b) for v, a, b in zip(now, low, high, strict=True)]
    if clipped == list(wanted):
        return clipped
    below, above = 0.0, 1.0
    for _ in range(60):
        share = 0.5 * (below + above)
        change = [d + share * (c - d) - n for d, c, n in zip(due, clipped, now, strict=True)]
        fits = math.hypot(*change) <= 2.0 * dt_s
        below, above = (share, above) if fits else (below, share)
    return [d + below * (c - d) for d, c in zip(due, clipped, strict=True)]


shares = st.sampled_from((-1.0, -0.999, -0.9, 0.0, 0.9, 0.999, 1.0))
places = st.tuples(shares, shares, shares)
steps = st.tuples(*[st.sampled_from((-1.0, -0.4, 0.0, 0.3, 1.0))] * 3)


@given(places, steps, steps)
def test_walls_come_first_and_the_rest_as_far_as_it_fits(place, now, step):
    at = Vector3(*(share * wall for share, wall in zip(place, BOX[1], strict=True)))
    limiter = point()
    # A possible initial state: a velocity that the previous period allowed.
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


def plus(a, b, factor=1.0):
    """Return a + factor·b."""
    return Vector3(*(p + factor * q for p, q in zip(a, b, strict=True)))


def steered(now, error, forward, speed, acceleration, dt_s):
    """Return the next velocity of a point `error` away from a target that moves at `forward`."""
    wanted = limit_norm(Vector3(*forward), speed)
    left = plus(error, wanted, -dt_s)
    far = math.hypot(*left)
    if far > 0.0:
        wanted = plus(wanted, left, stopping_speed(far, acceleration, dt_s) / far)
    change = plus(limit_norm(wanted, speed), now, -1.0)
    return plus(now, limit_norm(change, acceleration * dt_s))


@pytest.mark.parametrize("box", [None, BOX])
def test_a_point_follows_what_moves_and_closes_what_is_left_as_fast_as_it_can_stop(box):
    for seed in range(40):
        limiter = point(box)
        assert (limiter.reference, limiter.moving) == (ZERO3, False)
        target, seen = ZERO3, None
        for verb, dt_s, rates, jumps in script(seed, 0.05):
            rates = Vector3(*rates[:3])
            at, before = limiter.reference, limiter.velocity
            target = plus(plus(target, rates, 0.2 * dt_s), jumps[:3], 0.3)
            error = wanted = ZERO3
            if verb in ("track", "tracking"):
                goal = target
                if box is not None:
                    goal = [
                        min(max(q, *ends[:1]), ends[1]) for q, *ends in zip(goal, *box, strict=True)
                    ]
                error = plus(goal, at, -1.0)
                if seen is not None:
                    wanted = [(q - was) / dt_s for q, was in zip(goal, seen, strict=True)]
                elif verb == "tracking":
                    wanted = rates
                limiter.track(target, rates if verb == "tracking" else None, dt_s)
                seen = goal
            else:
                seen = None
            if verb == "drive":
                wanted = limit_norm(rates, 0.5)
                error = plus(ZERO3, wanted, dt_s)
                limiter.drive(rates, dt_s)
            elif verb == "brake":
                limiter.brake(dt_s)
            elif verb == "reset":
                limiter.reset(at)
                continue
            elif verb == "coast":
                limiter.coast(dt_s)
                continue
            velocity = steered(before, error, wanted, 0.5, 2.0, dt_s)
            if box is not None:
                velocity = expected(at, before, velocity, dt_s)
            assert limiter.velocity == pytest.approx(velocity, abs=1e-9)
            assert limiter.reference == pytest.approx(plus(at, velocity, dt_s), abs=1e-9)


def test_what_is_seen_elsewhere_keeps_its_velocity():
    limiter = point()
    limiter.reset(ZERO3, (0.1, 0.2, 0.3))
    limiter.relocate(Vector3(0.01, 0.02, 0.03))
    assert (limiter.reference, limiter.velocity) == ((0.01, 0.02, 0.03), (0.1, 0.2, 0.3))
    limiter = turning()
    limiter.reset(IDENTITY, (0.1, 0.2, 0.3))
    limiter.relocate(Quaternion(0.0, 0.0, 1.0, 0.0))
    assert (limiter.reference, limiter.velocity) == ((0.0, 0.0, 1.0, 0.0), (0.1, 0.2, 0.3))


# -- an orientation --------------------------------------------------------------------------------


def turning(speed=1.5):
    return OrientationLimiter(speed, 10.0)


def any_orientation(rng):
    return normalized(Quaternion(*(rng.gauss(0.0, 1.0) for _ in range(4))))


def test_an_orientation_follows_what_turns_and_takes_the_short_way_as_fast_as_it_can_stop():
    for seed in range(60):
        rng = random.Random(seed)
        limiter = turning()
        assert (limiter.reference, limiter.moving) == (IDENTITY, False)
        limiter.reset(any_orientation(rng))
        target, seen = any_orientation(rng), None
        for verb, dt_s, rates, jumps in script(seed, 0.01):
            rates = Vector3(*rates[:3])
            at, before = limiter.reference, limiter.velocity
            if any(jumps) and rng.random() < 0.2:
                target, seen = any_orientation(rng), None
                limiter.reset(at, before)
            # Values as sent by controllers: either sign, and a length that is not exactly 1.
            target = multiply(from_rotation_vector(plus(ZERO3, rates, 0.3 * dt_s)), target)
            length = rng.choice((1.0, -1.0)) * (1.0 + rng.choice((0.0, 1e-7)))
            error = wanted = ZERO3
            if verb in ("track", "tracking"):
                error = rotation_between(at, target)
                if seen is not None:
                    wanted = plus(ZERO3, rotation_between(seen, target), 1.0 / dt_s)
                elif verb == "tracking":
                    wanted = rates
                sent = Quaternion(*(length * c for c in target))
                limiter.track(sent, rates if verb == "tracking" else None, dt_s)
                seen = target
            else:
                seen = None
            if verb == "drive":
                wanted = limit_norm(rates, 1.5)
                error = plus(ZERO3, wanted, dt_s)
                limiter.drive(rates, dt_s)
            elif verb == "brake":
                limiter.brake(dt_s)
            elif verb == "reset":
                limiter.reset(at)
                assert not limiter.moving
                continue
            elif verb == "coast":
                limiter.coast(dt_s)
                turned = multiply(from_rotation_vector(plus(ZERO3, before, dt_s)), at)
                assert limiter.velocity == before
                assert limiter.reference == pytest.approx(turned, abs=1e-9)
                continue
            velocity = steered(before, error, wanted, 1.5, 10.0, dt_s)
            assert limiter.velocity == pytest.approx(velocity, abs=1e-5)
            turned = multiply(from_rotation_vector(plus(ZERO3, limiter.velocity, dt_s)), at)
            assert limiter.reference == pytest.approx(turned, abs=1e-9)


@pytest.mark.parametrize("speed", [1.5, 20.0])
def test_half_a_turn_is_taken_in_one_sense(speed):
    limiter = turning(speed)
    limiter.track(IDENTITY, None, DT_S)
    limiter.track(Quaternion(0.0, 1.0, 0.0, 0.0), None, DT_S)
    assert limiter.velocity == pytest.approx((10.0 * DT_S, 0.0, 0.0))


def test_an_orientation_whose_sign_changes_does_not_turn():
    limiter = turning()
    limiter.reset(Quaternion(0.0, 1.0, 0.0, 0.0))
    limiter.track(Quaternion(0.0, 1.0, 0.0, 0.0), None, DT_S)
    limiter.track(Quaternion(0.0, -1.0, 0.0, 0.0), None, DT_S)
    assert not limiter.moving


def test_an_orientation_starts_and_coasts_at_the_velocity_it_may_have():
    limiter = turning()
    limiter.track(Quaternion(0.0, 1.0, 0.0, 0.0), None, DT_S)
    limiter.reset(IDENTITY, (3.0, 0.0, 4.0))
    assert limiter.velocity == pytest.approx((0.9, 0.0, 1.2))
    limiter.coast(2.0)
    turned = from_rotation_vector(Vector3(1.8, 0.0, 2.4))
    assert limiter.reference == pytest.approx(turned, abs=1e-9)
    limiter.reset(IDENTITY)
    limiter.track(IDENTITY, None, DT_S)  # The previous target is forgotten.
    assert not limiter.moving


def test_turns_within_rounding_are_none():
    limiter = turning()
    limiter.track(Quaternion(1.0, 0.0, 0.9e-12, 0.0), None, DT_S)
    assert limiter.velocity == pytest.approx((0.0, 1.8e-12 / DT_S, 0.0), abs=1e-12)
    limiter.reset(IDENTITY, (1e-12, 0.0, 0.0))
    limiter.coast(1.0)
    assert limiter.reference == (1.0, 5e-13, 0.0, 0.0)
    limiter.reset(IDENTITY, (0.9e-12, 0.0, 0.0))
    limiter.coast(1.0)
    assert limiter.reference == IDENTITY


def test_the_length_of_an_orientation_comes_back_to_one():
    limiter = turning()
    limiter.reset(Quaternion(*(1.001 * c for c in normalized(Quaternion(0.9, -0.2, 0.3, 0.4)))))
    limiter.drive((0.1, -0.2, 0.3), DT_S)
    assert math.hypot(*limiter.reference) == pytest.approx(1.0 - 1.5e-6, abs=1e-8)
