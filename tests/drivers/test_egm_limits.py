"""Outputs of the limiters stay inside position, speed and acceleration limits for any input."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from hypothesis import given, settings, strategies as st

from cardan.drivers.limiters import (
    JointLimiter,
    OrientationLimiter,
    PointLimiter,
)
from cardan.spatial import from_rotation_vector, normalized, rotation_between
from cardan.types import IDENTITY, Quaternion, Vector3
from tests.examples import examples

pytestmark = pytest.mark.matrix

PERIOD_S = 0.004032
LONGEST_S = 4 * PERIOD_S
EPSILON = 1e-9

# Periods, including those of lost and late datagrams.
periods = st.floats(0.25 * PERIOD_S, LONGEST_S)
numbers = st.floats(-1e5, 1e5) | st.floats(-2.0, 2.0) | st.floats(-1e-3, 1e-3)
triples = st.tuples(numbers, numbers, numbers)


def length(v: Sequence[float]) -> float:
    return math.sqrt(sum(c * c for c in v))


class TestJoints:
    LOWER = (-1.0, -math.inf)
    UPPER = (0.5, math.inf)
    SPEED = (2.0, 1.0)
    ACCELERATION = (10.0, 3.0)

    def limiter(self, *positions: float) -> JointLimiter:
        limiter = JointLimiter(self.LOWER, self.UPPER, self.SPEED, self.ACCELERATION, LONGEST_S)
        limiter.reset(positions)
        return limiter

    moves = st.one_of(
        st.tuples(st.just("track"), st.tuples(numbers, numbers), st.none()),
        st.tuples(st.just("track"), st.tuples(numbers, numbers), st.tuples(numbers, numbers)),
        st.tuples(st.just("drive"), st.tuples(numbers, numbers), st.none()),
        st.tuples(st.just("brake"), st.none(), st.none()),
    )

    @settings(max_examples=examples(150))
    @given(
        start=st.tuples(st.floats(-1.0, 0.5), st.floats(-9.0, 9.0)),
        script=st.lists(st.tuples(moves, st.integers(1, 60), periods), min_size=1, max_size=8),
    )
    def test_any_input_stays_inside_every_bound(self, start, script) -> None:
        limiter = self.limiter(*start)
        for (verb, values, speeds), times, dt_s in script:
            for _ in range(times):
                positions, velocities = list(limiter.reference), list(limiter.velocity)
                if verb == "track":
                    limiter.track(values, speeds, dt_s)
                elif verb == "drive":
                    limiter.drive(values, dt_s)
                else:
                    limiter.brake(dt_s)
                for i in (0, 1):
                    position, velocity = limiter.reference[i], limiter.velocity[i]
                    assert position == pytest.approx(positions[i] + velocity * dt_s, abs=EPSILON)
                    assert abs(velocity) <= self.SPEED[i] + EPSILON
                    change = abs(velocity - velocities[i])
                    assert change <= self.ACCELERATION[i] * dt_s + EPSILON
                    assert self.LOWER[i] - EPSILON <= position <= self.UPPER[i] + EPSILON

    @given(st.floats(-1.0, 0.5), st.floats(-0.99, 0.49))
    def test_a_resting_target_is_reached_without_passing_it(self, start, target) -> None:
        limiter = self.limiter(start, 0.0)
        way = math.copysign(1.0, target - start)
        for _ in range(500):
            limiter.track((target, 0.0), None, PERIOD_S)
            assert way * (target - limiter.reference[0]) >= -EPSILON
        assert limiter.reference[0] == pytest.approx(target, abs=EPSILON)
        assert limiter.velocity[0] == pytest.approx(0.0, abs=1e-6)

    def test_a_target_within_the_limits_is_followed_without_lag(self) -> None:
        limiter = self.limiter(0.0, 0.0)
        for k in range(1, 800):
            target = 0.3 * (1.0 - math.cos(3.0 * k * PERIOD_S))
            limiter.track((target - 0.5, 0.0), None, PERIOD_S)
            if k > 200:
                assert limiter.reference[0] == pytest.approx(target - 0.5, abs=1e-5)
                rate = 0.9 * math.sin(3.0 * (k - 0.5) * PERIOD_S)
                assert limiter.velocity[0] == pytest.approx(rate, abs=2e-3)

    def test_outside_its_range_a_joint_moves_only_inwards(self) -> None:
        limiter = self.limiter(0.9, 0.0)
        limiter.track((2.0, 0.0), None, PERIOD_S)
        assert limiter.reference[0] == 0.9
        for _ in range(400):
            before = limiter.reference[0]
            limiter.track((0.2, 0.0), None, PERIOD_S)
            assert limiter.reference[0] <= before
        assert limiter.reference[0] == pytest.approx(0.2)

    @given(st.floats(-1.0, 0.5), st.floats(-9.0, 9.0))
    def test_a_start_at_speed_keeps_the_bounds_too(self, position, velocity) -> None:
        limiter = self.limiter(position, 0.0)
        limiter.reset((position, 0.0), (velocity, 0.0))
        while limiter.moving:
            before = limiter.velocity[0]
            limiter.brake(PERIOD_S)
            assert abs(limiter.velocity[0]) <= abs(before)
            assert -1.0 - EPSILON <= limiter.reference[0] <= 0.5 + EPSILON


BOX = ((-0.2, -0.2, 0.0), (0.2, 0.3, 0.4))
point_moves = st.one_of(
    st.tuples(st.just("track"), triples, st.none() | triples),
    st.tuples(st.just("drive"), triples, st.none()),
    st.tuples(st.just("brake"), st.none(), st.none()),
)


class TestPoint:
    SPEED = 0.25
    ACCELERATION = 2.0

    @settings(max_examples=examples(150))
    @given(
        box=st.none() | st.just(BOX),
        start=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.3), st.floats(0.0, 0.4)),
        script=st.lists(st.tuples(point_moves, st.integers(1, 60), periods), max_size=8),
    )
    def test_any_input_stays_inside_every_bound(self, box, start, script) -> None:
        limiter = PointLimiter(self.SPEED, self.ACCELERATION, box)
        limiter.reset(Vector3(*start))
        for (verb, values, speeds), times, dt_s in script:
            for _ in range(times):
                position, velocity = limiter.reference, limiter.velocity
                if verb == "track":
                    limiter.track(values, speeds, dt_s)
                elif verb == "drive":
                    limiter.drive(values, dt_s)
                else:
                    limiter.brake(dt_s)
                assert length(limiter.velocity) <= self.SPEED + EPSILON
                change = [a - b for a, b in zip(limiter.velocity, velocity, strict=True)]
                assert length(change) <= self.ACCELERATION * dt_s + EPSILON
                for i in (0, 1, 2):
                    moved = position[i] + limiter.velocity[i] * dt_s
                    assert limiter.reference[i] == pytest.approx(moved, abs=EPSILON)
                    if box:
                        lowest, highest = box[0][i], box[1][i]
                        assert lowest - EPSILON <= limiter.reference[i] <= highest + EPSILON

    @given(
        st.tuples(st.floats(-0.19, 0.19), st.floats(-0.19, 0.29), st.floats(0.01, 0.39)),
        st.none() | st.just(BOX),
    )
    def test_a_resting_target_is_reached(self, target, box) -> None:
        limiter = PointLimiter(self.SPEED, self.ACCELERATION, box)
        limiter.reset(Vector3(0.0, 0.0, 0.2))
        for _ in range(900):
            limiter.track(target, None, PERIOD_S)
        assert limiter.reference == pytest.approx(target, abs=1e-6)

    def test_sliding_along_a_wall_is_not_slowed(self) -> None:
        limiter = PointLimiter(self.SPEED, self.ACCELERATION, BOX)
        limiter.reset(Vector3(0.2, -0.1, 0.2))
        for k in range(300):
            limiter.track((0.5, -0.1 + 0.1 * k * PERIOD_S, 0.2), None, PERIOD_S)
        assert limiter.reference[0] == pytest.approx(0.2, abs=EPSILON)
        assert limiter.velocity[1] == pytest.approx(0.1, abs=1e-4)


quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: length(q) > 0.1)
    .map(lambda q: normalized(Quaternion(*q)))
)
turns = st.one_of(
    st.tuples(st.just("track"), quaternions, st.none() | triples),
    st.tuples(st.just("drive"), triples, st.none()),
    st.tuples(st.just("brake"), st.none(), st.none()),
)


class TestOrientation:
    SPEED = 1.5
    ACCELERATION = 10.0

    @settings(max_examples=examples(150))
    @given(start=quaternions, script=st.lists(st.tuples(turns, st.integers(1, 60), periods)))
    def test_any_input_stays_inside_every_bound(self, start, script) -> None:
        limiter = OrientationLimiter(self.SPEED, self.ACCELERATION)
        limiter.reset(start)
        for (verb, values, speeds), times, dt_s in script[:8]:
            for _ in range(times):
                orientation, velocity = limiter.reference, limiter.velocity
                if verb == "track":
                    limiter.track(values, speeds, dt_s)
                elif verb == "drive":
                    limiter.drive(values, dt_s)
                else:
                    limiter.brake(dt_s)
                assert length(limiter.reference) == pytest.approx(1.0, abs=EPSILON)
                assert length(limiter.velocity) <= self.SPEED + EPSILON
                change = [a - b for a, b in zip(limiter.velocity, velocity, strict=True)]
                assert length(change) <= self.ACCELERATION * dt_s + EPSILON
                turned = rotation_between(orientation, limiter.reference)
                moved = [w * dt_s for w in limiter.velocity]
                assert turned == pytest.approx(moved, abs=1e-8)
                # The output never switches between the two quaternions of a rotation.
                products = zip(orientation, limiter.reference, strict=True)
                assert sum(a * b for a, b in products) > 0.9

    @given(quaternions, quaternions, st.booleans())
    def test_a_resting_target_is_reached_the_short_way(self, start, target, flip) -> None:
        limiter = OrientationLimiter(self.SPEED, self.ACCELERATION)
        limiter.reset(start)
        given_as = Quaternion(*(-c for c in target)) if flip else target
        traveled = 0.0
        for _ in range(900):
            limiter.track(given_as, None, PERIOD_S)
            traveled += length(limiter.velocity) * PERIOD_S
        assert length(rotation_between(limiter.reference, target)) == pytest.approx(0, abs=1e-6)
        assert traveled <= length(rotation_between(start, target)) + 1e-3

    def test_a_turning_target_is_followed_without_lag(self) -> None:
        limiter = OrientationLimiter(self.SPEED, self.ACCELERATION)
        limiter.reset(IDENTITY)
        for k in range(1, 500):
            target = from_rotation_vector(Vector3(0.0, 0.0, k * PERIOD_S))
            if k % 2:
                target = Quaternion(*(-c for c in target))
            limiter.track(target, None, PERIOD_S)
        assert length(rotation_between(limiter.reference, target)) < 1e-6
        assert limiter.velocity == pytest.approx((0.0, 0.0, 1.0), abs=1e-4)
