"""Outputs of the trajectory limiter stay inside range, speed and acceleration for any input."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence

import pytest
from hypothesis import given, settings, strategies as st

from cardan.common.braking import stopping_speed
from cardan.drivers.motoros.trajectory_limiter import JointTrajectoryLimiter
from cardan.errors import CommandError, ConfigurationError
from cardan.types import (
    IDENTITY_POSE,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    RobotCommand,
)
from tests.examples import examples

PERIOD_S = 0.004
EPSILON = 1e-9

LOWER = (-1.0, -0.02, -math.inf)
UPPER = (0.5, 0.02, math.inf)
SPEED = (2.0, 5.0, 1.0)
ACCELERATION = (10.0, 60.0, 3.0)

numbers = st.floats(-1000.0, 1000.0) | st.floats(-2.0, 2.0) | st.floats(-1e-3, 1e-3)
triples = st.tuples(numbers, numbers, numbers)
commands: st.SearchStrategy[RobotCommand] = st.one_of(
    triples.map(JointCommand),
    st.tuples(triples, triples).map(lambda both: JointCommand(*both)),
    triples.map(JointVelocityCommand),
    st.just(HoldCommand()),
)


def guide_at(
    *positions: float, velocities: Sequence[float] | None = None
) -> JointTrajectoryLimiter:
    guide = JointTrajectoryLimiter(LOWER, UPPER, SPEED, ACCELERATION)
    guide.reset(positions, velocities)
    return guide


def assert_within(guide: JointTrajectoryLimiter, before: Sequence[float], dt_s: float) -> None:
    for i, (v, v_before) in enumerate(zip(guide.velocity, before, strict=True)):
        assert abs(v) <= SPEED[i] * (1.0 + EPSILON)
        assert abs(v - v_before) <= ACCELERATION[i] * dt_s * (1.0 + EPSILON) + 1e-12
        assert LOWER[i] <= guide.reference[i] <= UPPER[i]


def run(
    guide: JointTrajectoryLimiter,
    command: RobotCommand,
    times: int,
    watch: Callable[[], None] | None = None,
) -> None:
    for _ in range(times):
        guide.step(command, PERIOD_S)
        if watch is not None:
            watch()


class TestGuarantees:
    @settings(max_examples=examples(150))
    @given(
        start=st.tuples(st.floats(-1.0, 0.5), st.floats(-0.02, 0.02), st.floats(-9.0, 9.0)),
        speeds=triples,
        script=st.lists(
            st.tuples(commands, st.integers(1, 40), st.floats(0.0, 0.2)), min_size=1, max_size=8
        ),
    )
    def test_any_commands_in_any_periods_stay_inside_every_limit(
        self, start: Sequence[float], speeds: Sequence[float], script
    ) -> None:
        guide = guide_at(*start, velocities=speeds)
        assert_within(guide, guide.velocity, 0.0)
        for command, times, dt_s in script:
            for _ in range(times):
                before = tuple(guide.velocity)
                guide.step(command, dt_s)
                assert_within(guide, before, min(dt_s, 0.1))

    @settings(max_examples=examples(100))
    @given(
        script=st.lists(
            st.tuples(commands, st.integers(1, 40), st.floats(PERIOD_S, 5.0 * PERIOD_S)),
            min_size=1,
            max_size=8,
        )
    )
    def test_within_a_factor_of_five_every_period_is_one_of_constant_acceleration(
        self, script
    ) -> None:
        guide = guide_at(0.0, 0.0, 0.0)
        for command, times, dt_s in script:
            for _ in range(times):
                before, speeds = tuple(guide.reference), tuple(guide.velocity)
                guide.step(command, dt_s)
                for i in range(3):
                    mean = 0.5 * (speeds[i] + guide.velocity[i])
                    assert guide.reference[i] == pytest.approx(before[i] + dt_s * mean, abs=1e-12)

    @pytest.mark.parametrize("outside", [0.7, -1.3])
    def test_a_joint_placed_outside_its_range_only_moves_inwards(self, outside: float) -> None:
        guide = guide_at(outside, 0.0, 0.0, velocities=(math.copysign(1.0, outside), 0.0, 0.0))
        assert guide.velocity[0] == 0.0
        run(guide, JointVelocityCommand((math.copysign(1.0, outside), 0.0, 0.0)), 10)
        run(guide, JointCommand((2.0 * outside, 0.0, 0.0)), 10)
        assert guide.reference[0] == outside
        distance = abs(outside)
        for _ in range(400):
            before = tuple(guide.velocity)
            guide.step(JointCommand((0.0, 0.0, 0.0)), PERIOD_S)
            assert abs(guide.reference[0]) <= distance
            assert abs(guide.velocity[0] - before[0]) <= 10.0 * PERIOD_S * (1.0 + EPSILON)
            distance = abs(guide.reference[0])
        assert distance == pytest.approx(0.0, abs=1e-9)

    def test_a_joint_asked_to_stay_outside_its_range_stays(self) -> None:
        guide = guide_at(0.6, 0.0, 0.0)
        run(guide, JointCommand((0.6, 0.0, 0.0)), 50)
        run(guide, HoldCommand(), 50)
        assert guide.reference == [0.6, 0.0, 0.0]

    def test_a_joint_that_must_stop_does_not_hold_the_others(self) -> None:
        guide = guide_at(0.4, 0.0, 0.0)
        run(guide, JointVelocityCommand((0.5, 0.0, 0.5)), 500)
        assert guide.reference[0] == pytest.approx(0.5, abs=1e-6)
        assert guide.velocity[2] == 0.5

    def test_the_end_of_the_range_is_reached_soon(self) -> None:
        guide = guide_at(-1.0, 0.0, 0.0)
        steps = 0
        while guide.reference[0] < 0.5 - 1e-4:
            guide.step(JointVelocityCommand((2.0, 0.0, 0.0)), PERIOD_S)
            steps += 1
        shortest_s = 1.5 / 2.0 + 2.0 / 10.0
        assert steps * PERIOD_S < shortest_s + 0.06

    @settings(max_examples=examples(50))
    @given(dt_s=st.sampled_from([0.0, -1.0, -math.inf, math.nan, 1e-9]), command=commands)
    def test_no_time_no_change(self, dt_s: float, command: RobotCommand) -> None:
        guide = guide_at(0.1, 0.0, 0.0, velocities=(0.5, 0.1, -0.5))
        guide.step(command, dt_s)
        assert guide.reference == [0.1, 0.0, 0.0]
        assert guide.velocity == [0.5, 0.1, -0.5]

    @given(dt_s=st.floats(0.1) | st.just(math.inf), command=commands)
    def test_a_long_period_counts_as_the_longest(self, dt_s: float, command: RobotCommand) -> None:
        long, longest = guide_at(0.1, 0.0, 0.0), guide_at(0.1, 0.0, 0.0)
        long.step(command, dt_s)
        longest.step(command, 0.1)
        assert long.reference == longest.reference
        assert long.velocity == longest.velocity

    @pytest.mark.parametrize(
        "command",
        [
            JointCommand((0.3, 0.0, 0.0)),
            JointVelocityCommand((0.5, 0.0, 0.0)),
            JointVelocityCommand((-0.5, 0.0, 0.0)),
            HoldCommand(),
        ],
    )
    def test_the_shortest_period_counts(self, command: RobotCommand) -> None:
        guide = guide_at(0.1, 0.0, 0.0, velocities=(0.2, 0.0, 0.0))
        guide.step(command, 1e-6)
        assert abs(guide.velocity[0] - 0.2) == pytest.approx(10.0 * 1e-6)
        assert guide.reference[0] > 0.1

    @pytest.mark.parametrize("gap_s", [1e-6, 0.05, 0.1, 0.37])
    def test_a_gap_is_coasted_through_at_the_speeds_there_are(self, gap_s: float) -> None:
        guide = guide_at(-0.5, 0.0, 0.3, velocities=(0.5, 0.0, -0.7))
        guide.coast(gap_s)
        assert guide.reference == pytest.approx([-0.5 + 0.5 * gap_s, 0.0, 0.3 - 0.7 * gap_s])
        assert guide.reference[0] > -0.5
        assert guide.velocity == [0.5, 0.0, -0.7]
        guide.coast(10.0)
        assert guide.reference[0] == pytest.approx(0.5, abs=1e-6)

    def test_a_new_guide_is_at_rest_at_zero(self) -> None:
        guide = JointTrajectoryLimiter(LOWER, UPPER, SPEED, ACCELERATION)
        assert (guide.reference, guide.velocity, guide.moving) == ([0.0] * 3, [0.0] * 3, False)
        assert (guide.speeds, guide.accelerations) == (SPEED, ACCELERATION)
        guide.step(JointVelocityCommand((0.0, 0.0, 0.1)), PERIOD_S)
        assert guide.moving

    @pytest.mark.parametrize(
        ("position", "velocity", "left"),
        [
            (0.0, 1.5, 1.5),
            (0.0, 9.0, 2.0),
            (0.0, -9.0, -2.0),
            (0.45, 1.5, math.sqrt(2 * 10.0 * 0.05)),
            (-0.95, -1.5, -math.sqrt(2 * 10.0 * 0.05)),
        ],
    )
    def test_a_start_is_at_the_speed_that_can_be_stopped(
        self, position: float, velocity: float, left: float
    ) -> None:
        guide = guide_at(position, 0.0, 0.0, velocities=(velocity, 0.0, 0.5))
        assert guide.reference == [position, 0.0, 0.0]
        assert guide.velocity == [pytest.approx(left), 0.0, 0.5]

    def test_a_correction_is_no_motion(self) -> None:
        guide = guide_at(0.1, 0.0, 0.2, velocities=(0.3, 0.0, -0.1))
        guide.relocate((0.11, -0.002, 0.23))
        assert guide.reference == [0.11, -0.002, 0.23]
        assert guide.velocity == [0.3, 0.0, -0.1]

    def test_the_lists_are_kept(self) -> None:
        guide = guide_at(0.0, 0.0, 0.0)
        positions, velocities = guide.reference, guide.velocity
        run(guide, JointVelocityCommand((0.1, 0.1, 0.1)), 3)
        guide.reset((0.2, 0.0, 0.0))
        assert guide.reference is positions
        assert guide.velocity is velocities


class TestDirection:
    @settings(max_examples=examples(100))
    @given(wanted=st.tuples(*[st.floats(-50.0, 50.0)] * 3))
    def test_from_rest_the_motion_has_the_direction_asked_for(
        self, wanted: Sequence[float]
    ) -> None:
        guide = JointTrajectoryLimiter((-1e3,) * 3, (1e3,) * 3, SPEED, ACCELERATION)
        size = math.hypot(*wanted)
        for _ in range(300):
            guide.step(JointVelocityCommand(tuple(wanted)), PERIOD_S)
            speed = math.hypot(*guide.velocity)
            for v, w in zip(guide.velocity, wanted, strict=True):
                assert v * size == pytest.approx(w * speed, abs=1e-9 * (1.0 + size))
        if size > 0.01:
            share = max(abs(w) / s for w, s in zip(wanted, SPEED, strict=True))
            expected = size / max(1.0, share)
            assert math.hypot(*guide.velocity) == pytest.approx(expected, rel=1e-9)

    def test_the_change_has_the_direction_of_the_difference(self) -> None:
        guide = guide_at(0.0, 0.0, 0.0, velocities=(0.5, 0.0, -0.5))
        guide.step(JointVelocityCommand((0.0, 0.1, 0.5)), PERIOD_S)
        # Joint 2 needs the longest time: 1 rad/s at 3 rad/s².
        share = 3.0 * PERIOD_S
        assert guide.velocity == pytest.approx([0.5 - 0.5 * share, 0.1 * share, -0.5 + share])

    def test_a_step_is_taken_along_a_straight_line(self) -> None:
        guide = JointTrajectoryLimiter((-9.0,) * 3, (9.0,) * 3, SPEED, ACCELERATION)
        goal = (1.0, -0.5, 0.25)

        def straight() -> None:
            x, y, z = guide.reference
            assert y == pytest.approx(-0.5 * x, abs=1e-9)
            assert z == pytest.approx(0.25 * x, abs=1e-9)

        run(guide, JointCommand(goal, (0.0,) * 3), 600, straight)
        assert guide.reference == pytest.approx(goal, abs=1e-9)


class TestFollowing:
    def test_a_trajectory_inside_the_limits_comes_out_unchanged(self) -> None:
        guide = guide_at(-0.9, -0.005, 0.3)
        q, v = list(guide.reference), [0.0, 0.0, 0.0]
        for k in range(500):
            t = PERIOD_S * k
            accelerations = (4.0 * math.sin(9.0 * t), 0.3 * math.cos(7.0 * t), -math.sin(4.0 * t))
            for i, a in enumerate(accelerations):
                q[i] += PERIOD_S * (v[i] + 0.5 * a * PERIOD_S)
                v[i] += a * PERIOD_S
            guide.step(JointCommand(tuple(q), tuple(v)), PERIOD_S)
            assert guide.reference == pytest.approx(q, abs=1e-9)
            assert guide.velocity == pytest.approx(v, abs=1e-9)

    @pytest.mark.parametrize("rate", [1.0, 3.0])
    def test_a_sine_is_met_as_nearly_as_constant_acceleration_allows(self, rate: float) -> None:
        guide = guide_at(0.0, 0.0, -0.2)
        worst = 0.0
        for k in range(1, 2000):
            t = rate * PERIOD_S * k
            goal = (0.0, 0.0, -0.2 * math.cos(t))
            guide.step(JointCommand(goal, (0.0, 0.0, 0.2 * rate * math.sin(t))), PERIOD_S)
            worst = max(worst, abs(guide.reference[2] - goal[2]))
        jerk = 0.2 * rate**3
        assert worst < jerk * PERIOD_S**3 / 12.0

    def test_without_velocities_the_lag_is_that_of_two_periods_of_acceleration(self) -> None:
        guide = guide_at(0.0, 0.0, -0.2)
        worst = 0.0
        for k in range(1, 2000):
            goal = -0.2 * math.cos(PERIOD_S * k)
            guide.step(JointCommand((0.0, 0.0, goal)), PERIOD_S)
            worst = max(worst, abs(guide.reference[2] - goal))
        assert worst < 0.2 * PERIOD_S**2

    @settings(max_examples=examples(60))
    @given(
        start=st.tuples(st.floats(-0.9, 0.4), st.floats(-0.015, 0.015), st.floats(-2.0, 2.0)),
        goal=st.tuples(st.floats(-0.9, 0.4), st.floats(-0.015, 0.015), st.floats(-2.0, 2.0)),
        speeds=st.none() | st.just((0.0, 0.0, 0.0)),
        dt_s=st.floats(0.001, 0.02),
    )
    def test_a_step_is_taken_without_overshoot_and_in_little_more_than_the_least_time(
        self, start: Sequence[float], goal: Sequence[float], speeds, dt_s: float
    ) -> None:
        guide = guide_at(*start)
        least_s = 0.0
        for i in range(3):
            way, v, a = abs(goal[i] - start[i]), SPEED[i], ACCELERATION[i]
            longer = way > v * v / a
            least_s = max(least_s, way / v + v / a if longer else 2.0 * math.sqrt(way / a))
        command = JointCommand(tuple(goal), speeds)
        time_s = arrived_s = 0.0
        while time_s < 1.1 * least_s + 20.0 * dt_s:
            guide.step(command, dt_s)
            time_s += dt_s
            for i in range(3):
                past = (guide.reference[i] - goal[i]) * math.copysign(1.0, goal[i] - start[i])
                assert past <= 1e-9
            if any(abs(guide.reference[i] - goal[i]) > 1e-4 for i in range(3)):
                arrived_s = time_s
        assert arrived_s <= 1.05 * least_s + 8.0 * dt_s
        assert guide.reference == pytest.approx(goal, abs=1e-6)

    @settings(max_examples=examples(60))
    @given(jumps=st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=20))
    def test_a_joint_does_not_overshoot_because_another_changes_its_mind(
        self, jumps: Sequence[float]
    ) -> None:
        guide = guide_at(-0.9, 0.0, 0.0)
        for goal in jumps:
            for _ in range(10):
                guide.step(JointCommand((0.3, 0.0, goal), (0.0, 0.0, 0.0)), PERIOD_S)
                assert guide.reference[0] <= 0.3 + 1e-9

    def test_a_target_that_moves_is_caught_up_with(self) -> None:
        guide = guide_at(0.0, 0.0, 0.0)
        for k in range(500):
            goal = 0.5 + 0.4 * PERIOD_S * k
            guide.step(JointCommand((0.0, 0.0, goal), (0.0, 0.0, 0.4)), PERIOD_S)
        assert guide.reference[2] == pytest.approx(goal, abs=1e-9)
        assert guide.velocity[2] == pytest.approx(0.4)

    def test_a_target_beyond_the_range_is_met_at_its_end(self) -> None:
        guide = guide_at(0.0, 0.0, 0.0)
        run(guide, JointCommand((3.0, 0.0, 0.5), (1.0, 0.0, 0.0)), 500)
        assert guide.reference == pytest.approx([0.5, 0.0, 0.5], abs=1e-6)


class TestBraking:
    def test_hold_brakes_in_the_least_time_of_the_slowest_joint_and_stays(self) -> None:
        guide = guide_at(-0.5, 0.0, 0.0, velocities=(1.0, 0.2, 0.9))
        command, steps = HoldCommand(), 0
        while guide.moving:
            guide.step(command, PERIOD_S)
            steps += 1
        assert steps == math.ceil(0.9 / 3.0 / PERIOD_S - 1e-9)
        stopped = tuple(guide.reference)
        assert stopped[2] == pytest.approx(0.9 * 0.9 / 6.0, abs=1e-3)
        run(guide, command, 50)
        assert tuple(guide.reference) == stopped

    def test_the_stop_follows_the_direction_of_motion(self) -> None:
        guide = guide_at(-0.5, 0.0, 0.0, velocities=(0.5, 0.1, -0.5))
        while guide.moving:
            guide.brake(PERIOD_S)
            x, y, z = guide.velocity
            assert y == pytest.approx(0.2 * x, abs=1e-12)
            assert z == pytest.approx(-x, abs=1e-12)

    def test_what_was_followed_before_a_brake_is_forgotten(self) -> None:
        guide = guide_at(0.0, 0.0, 0.0)
        for k in range(100):
            guide.step(JointCommand((0.0, 0.0, 0.002 * k)), PERIOD_S)
        while guide.moving:
            guide.brake(PERIOD_S)
        stopped = tuple(guide.reference)
        guide.step(JointCommand(stopped), PERIOD_S)
        assert not guide.moving


class TestRefused:
    BAD = (
        (0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0),
        (0.0, math.nan, 0.0),
        (0.0, 0.0, math.inf),
        (-math.inf, 0.0, math.inf),
        (0.0, 1e300, 0.0),
        (0.0, None, 0.0),
        (),
    )

    @pytest.mark.parametrize("bad", BAD)
    @pytest.mark.parametrize(
        "make",
        [
            JointCommand,
            lambda bad: JointCommand((0.0,) * 3, bad),
            JointVelocityCommand,
        ],
    )
    def test_bad_numbers_change_nothing(self, bad, make) -> None:
        guide = guide_at(0.1, 0.0, 0.2, velocities=(0.3, 0.1, -0.1))
        guide.step(JointVelocityCommand((9.0, 0.0, 0.0)), PERIOD_S)
        before = tuple(guide.reference), tuple(guide.velocity)
        with pytest.raises(CommandError, match=r"joints|finite"):
            guide.step(make(bad), PERIOD_S)
        assert (tuple(guide.reference), tuple(guide.velocity)) == before

    @pytest.mark.parametrize("bad", BAD)
    def test_nor_does_a_bad_place(self, bad) -> None:
        guide = guide_at(0.1, 0.0, 0.2, velocities=(0.3, 0.1, -0.1))
        with pytest.raises(CommandError, match="positions"):
            guide.reset(bad)
        with pytest.raises(CommandError, match="velocities"):
            guide.reset((0.0,) * 3, bad)
        assert guide.reference == [0.1, 0.0, 0.2]
        assert guide.velocity == [0.3, 0.1, -0.1]

    def test_other_commands(self) -> None:
        guide = guide_at(0.0, 0.0, 0.0)
        with pytest.raises(CommandError, match="takes no pose; it takes hold, joint"):
            guide.step(PoseCommand(IDENTITY_POSE), PERIOD_S)
        with pytest.raises(CommandError, match="external_axes"):
            guide.step(JointCommand((0.0,) * 3, None, (0.1,)), PERIOD_S)

    @pytest.mark.parametrize(
        ("key", "limits"),
        [
            ("lower", ((0.0,), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0))),
            ("upper", ((0.0, 2.0), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0))),
            ("upper", ((0.0, 1.0), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0))),
            ("upper", ((0.0, math.nan), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0))),
            ("velocity", ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (1.0, 1.0))),
            ("velocity", ((0.0, 0.0), (1.0, 1.0), (1.0, math.nan), (1.0, 1.0))),
            ("acceleration", ((0.0, 0.0), (1.0, 1.0), (1.0, 1.0), (math.inf, 1.0))),
        ],
    )
    def test_limits_that_make_no_sense(self, key: str, limits) -> None:
        with pytest.raises(ConfigurationError) as caught:
            JointTrajectoryLimiter(*limits)
        assert caught.value.key == key


def fastest_towards(room: float, acceleration: float, dt_s: float) -> float:
    """Return the speed from which a joint stops within `room`, in periods up to five times as long.

    By bisection, with three terms: v·dt/2 in this period, then v²/(2a), and a·later²/8, or
    v·later/2 if one later period suffices.
    """
    later_s = min(5.0 * dt_s, 0.1)
    low, high = 0.0, 20.0
    for _ in range(60):
        v = 0.5 * (low + high)
        if v <= 0.5 * acceleration * later_s:
            way = 0.5 * later_s * v
        else:
            way = 0.5 * v * v / acceleration + 0.125 * acceleration * later_s**2
        low, high = (v, high) if 0.5 * dt_s * v + way <= room else (low, v)
    return low


def share_of(values: Sequence[float], limits: Sequence[float]) -> float:
    """Return the largest multiple of the vector `values` that keeps the limits."""
    return min([1.0, *(most / abs(v) for v, most in zip(values, limits, strict=True) if v)])


class Expected:
    """Reference implementation of the next period's speeds, one rule after the other."""

    def __init__(self, limits: Sequence[Sequence[float]], closing_rad_s: float) -> None:
        self.lower, self.upper, self.speed, self.acceleration = limits
        self.closing_rad_s = closing_rad_s
        self.seen: list[list[float]] = []
        """Target position in the previous period, if it was followed then."""
        self.rates: list[list[float]] = []
        """Target velocity in the previous period."""

    def forget(self) -> None:
        self.seen, self.rates = [], []

    def follow(self, q, v, target, velocities, dt_s):
        """Return the wanted, lowest and highest speed on the way to `target`."""
        goal = [
            min(max(g, min(low, p)), max(high, p))
            for g, p, low, high in zip(target, q, self.lower, self.upper, strict=True)
        ]
        rates = [0.0] * len(q)
        if self.seen:
            rates = [(g - before) / dt_s for g, before in zip(goal, self.seen[-1], strict=True)]
        before = self.rates[-1] if self.rates else [0.0] * len(q)
        self.seen, self.rates = [goal], [rates]
        if velocities is None:
            forward = [
                min(now, was, key=abs) if now * was > 0.0 else 0.0
                for now, was in zip(rates, before, strict=True)
            ]
        else:
            forward = [
                min(f, 0.0) if g > high else max(f, 0.0) if g < low else f
                for f, g, low, high in zip(velocities, target, self.lower, self.upper, strict=True)
            ]
        share = share_of(forward, self.speed)
        forward = [share * f for f in forward]
        error = [
            g - p - 0.5 * dt_s * (now + f) for g, p, now, f in zip(goal, q, v, forward, strict=True)
        ]
        own = [
            stopping_speed(abs(e), a, dt_s) / abs(e) if abs(e) > 1e-13 else 1.0 / dt_s
            for e, a in zip(error, self.acceleration, strict=True)
        ]
        closing = min(own)
        if velocities is not None:
            closing *= share_of([closing * e for e in error], [self.closing_rad_s] * len(error))
        bounds = [
            (-math.inf, max(f + o * e, now - a * dt_s, 0.0))
            if e > 0.0
            else (min(f + o * e, now + a * dt_s, 0.0), math.inf)
            for f, o, e, now, a in zip(forward, own, error, v, self.acceleration, strict=True)
        ]
        return [f + closing * e for f, e in zip(forward, error, strict=True)], bounds

    def speeds(self, q, v, wanted, bounds, dt_s):
        """Return the speeds that ends, speed and acceleration limits allow, applied in this
        order."""
        wanted, ends = list(wanted), []
        mean_s = 0.5 * (dt_s + min(5.0 * dt_s, 0.1))
        for i, (p, now) in enumerate(zip(q, v, strict=True)):
            a, most = self.acceleration[i], self.speed[i]
            matters = 0.5 * most**2 / a + mean_s * most
            low, high = -math.inf, math.inf
            if (room := self.upper[i] - p - 0.5 * dt_s * now) < matters:
                high = max(fastest_towards(room, a, dt_s), now - a * dt_s)
            if (room := p + 0.5 * dt_s * now - self.lower[i]) < matters:
                low = min(-fastest_towards(room, a, dt_s), now + a * dt_s)
            wanted[i] = max(min(wanted[i], high), low)
            ends.append((low, high))
        share = share_of(wanted, self.speed)
        change = [share * w - now for w, now in zip(wanted, v, strict=True)]
        part = share_of(change, [a * dt_s for a in self.acceleration])
        speeds = [now + part * c for now, c in zip(v, change, strict=True)]
        for each in (bounds, ends):
            speeds = [max(min(s, high), low) for s, (low, high) in zip(speeds, each, strict=True)]
        return speeds


class TestOnePeriod:
    LIMITS = (
        (-1.0, -0.05, -math.inf, -0.4),
        (0.5, 0.02, math.inf, 1.5),
        (2.0, 5.0, 1.0, 0.6),
        (10.0, 60.0, 3.0, 0.4),
    )

    @pytest.mark.parametrize("closing_rad_s", [math.inf, 0.3])
    def test_what_is_asked_is_cut_by_ends_speeds_and_accelerations_in_this_order(
        self, closing_rad_s: float
    ) -> None:
        for seed in range(60):
            rng = random.Random(seed)
            guide = JointTrajectoryLimiter(*self.LIMITS)
            guide.closing_rad_s = closing_rad_s
            law = Expected(self.LIMITS, closing_rad_s)
            target = [0.0] * 4
            for _ in range(6):
                self.several(rng, guide, law, target)

    @staticmethod
    def several(rng, guide, law, target) -> None:
        """Yield some periods of one kind."""
        verb = rng.choice(("follow", "follow", "lead", "lead", "drive", "hold", "place", "shift"))
        rates = [rng.choice((0.0, 0.01, -0.2, 0.5, -1.5, 8.0, -40.0)) for _ in target]
        steps = rng.random() < 0.4
        for _ in range(rng.choice((1, 3, 10))):
            dt_s = rng.choice((0.001, 0.004, 0.004, 0.03, 0.1))
            q, v = list(guide.reference), list(guide.velocity)
            for i, rate in enumerate(rates):
                target[i] += dt_s * rate * 0.3 + steps * rng.choice((0.0, 0.4, -0.4, 1e-3))
                if abs(target[i]) > 3.0 or rng.random() < 0.02:
                    target[i] = rng.uniform(-1.2, 1.6)
                elif i != 2 and rng.random() < 0.02:
                    target[i] = rng.choice((law.lower[i], law.upper[i]))
            wanted, bounds = [0.0] * 4, [(-math.inf, math.inf)] * 4
            if verb in ("follow", "lead"):
                forward = tuple(rates) if verb == "lead" else None
                wanted, bounds = law.follow(q, v, target, forward, dt_s)
                guide.step(JointCommand(tuple(target), forward), dt_s)
            elif verb != "shift":
                law.forget()
            if verb == "drive":
                wanted = rates
                guide.step(JointVelocityCommand(tuple(rates)), dt_s)
            elif verb == "hold":
                guide.step(HoldCommand(), dt_s)
            elif verb == "place":
                places = q if rng.random() < 0.5 else [rng.uniform(-1.2, 1.6) for _ in q]
                guide.reset(places, v if rng.random() < 0.5 else None)
                continue
            elif verb == "shift":
                guide.relocate([p + 1e-3 * rng.uniform(-1.0, 1.0) for p in q])
                continue
            speeds = law.speeds(q, v, wanted, bounds, dt_s)
            assert guide.velocity == pytest.approx(speeds, abs=1e-8)
            for p, now, new, after, low, high in zip(
                q, v, guide.velocity, guide.reference, law.lower, law.upper, strict=True
            ):
                moved = p + 0.5 * dt_s * (now + new)
                assert after == pytest.approx(min(max(moved, min(low, p)), max(high, p)), abs=1e-12)

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_an_end_matters_from_where_a_joint_at_full_speed_has_to_slow(self, sign: float) -> None:
        dt_s = 1.0 / 64.0
        reach = 1.0 + 3.0 * dt_s  # v²/(2a), and the mean speed over this period and five of them
        for away, share in ((reach, 1e-3), (reach - 1e-9, 1.0)):
            guide = JointTrajectoryLimiter((-2.0, -9.0), (2.0, 9.0), (1.0, 1.0), (0.5, 0.5))
            guide.reset((sign * (2.0 - away), 0.0))
            guide.step(JointVelocityCommand((sign * 1000.0, 1.0)), dt_s)
            # The other joint is slowed with the first one only if that one has to slow for its end.
            speeds = [sign * 0.5 * dt_s, 0.5 * dt_s * share]
            assert guide.velocity == pytest.approx(speeds, rel=0.03)

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_joint_that_can_just_stop_at_its_end_brakes_as_hard_as_it_may(
        self, sign: float
    ) -> None:
        guide = JointTrajectoryLimiter((-1.0,), (1.0,), (2.0,), (10.0,))
        guide.reset((sign * 0.95,), (sign * 1.0,))
        guide.step(JointVelocityCommand((sign * 1.0,)), PERIOD_S)
        assert guide.velocity == [pytest.approx(sign * (1.0 - 10.0 * PERIOD_S))]

    def test_joints_that_the_period_brings_to_their_targets_change_as_one(self) -> None:
        dt_s = 1.0 / 256.0
        before, forward = (0.5, -0.5, 0.0), (0.25, -0.25, 0.5)
        limits = (-1.0,) * 3, (1.0,) * 3, (2.0,) * 3, (10.0, 10.0, 3.0)
        guide = JointTrajectoryLimiter(*limits)
        guide.reset((0.0,) * 3, before)
        there = [0.5 * dt_s * (v + f) for v, f in zip(before, forward, strict=True)]
        guide.step(JointCommand(tuple(there), forward), dt_s)
        share = 3.0 * dt_s / 0.5  # Time of the third joint, which needs the longest.
        assert guide.velocity == pytest.approx(
            [v + share * (f - v) for v, f in zip(before, forward, strict=True)]
        )

    def test_what_can_be_had_within_the_period_is_had_to_the_last_bit(self) -> None:
        for before, wanted in ((0.7, -0.07), (-0.2, 0.23), (0.45, 0.03)):
            assert before + (wanted - before) != wanted
            guide = guide_at(0.0, 0.0, 0.0, velocities=(before, 0.0, 0.0))
            guide.step(JointVelocityCommand((wanted, 0.0, 0.0)), 0.1)
            assert guide.velocity == [wanted, 0.0, 0.0]
