"""Compensation of the lag that lost time leaves between a robot and its commands."""

from __future__ import annotations

from itertools import pairwise

import pytest

from cardan.drivers.missed_cycles import LONGEST_REST_S, REST_S, SlipCompensation

PERIOD_S = 0.004


def play(lost, velocity, seconds, before=None):
    """Feed periods of a command that moves at `velocity`; return the compensating speeds."""
    rates = []
    moved = [v * PERIOD_S for v in velocity]
    for _ in range(round(seconds / PERIOD_S)):
        lost.step(moved, before or velocity, velocity, PERIOD_S)
        before = None
        rates.append(lost.rate[0])
    return rates


def after(gap_s, velocity=(0.1, 0.0), error=(), slip=()):
    lost = SlipCompensation(2)
    lost.passed(gap_s, error, slip)
    lost.step([v * PERIOD_S for v in velocity], velocity, velocity, PERIOD_S)
    return lost


def test_nothing_is_lost_at_first():
    assert not SlipCompensation(2).working


def test_a_command_that_went_on_from_where_it_was_is_behind_by_the_gap():
    lost = after(0.06)
    assert lost.offset == pytest.approx([0.006, 0.0], rel=0.01)


def test_a_command_that_took_the_gap_along_is_not():
    lost = SlipCompensation(2)
    lost.passed(0.06)
    lost.step([0.1 * (0.06 + PERIOD_S), 0.0], (0.1, 0.0), (0.1, 0.0), PERIOD_S)
    assert not lost.working


@pytest.mark.parametrize(
    ("jump_m", "left_m"),
    [
        (0.006, 0.0),
        (0.002, 0.004),
        (0.007, -0.001),
        (0.3 * 0.1 * PERIOD_S, 0.006),  # an inaccurate command
        (-0.002, 0.006),  # a jump away from the robot
        (0.013, 0.006),  # a jump beyond it
    ],
)
def test_a_command_that_takes_the_gap_along_one_cycle_later_moves_no_robot(jump_m, left_m):
    lost = after(0.06)
    lost.step([0.1 * PERIOD_S + jump_m, 0.0], (0.1, 0.0), (0.1, 0.0), PERIOD_S)
    assert lost.offset[0] == pytest.approx(left_m, abs=1e-4)


@pytest.mark.parametrize("every", [1, 2, 3, 25])
def test_an_application_whose_positions_lag_its_speeds_leaves_no_more_when_it_reverses(every):
    lost = after(0.06)
    before, offsets = 0.1, []
    for cycle in range(600):
        v = before if (cycle + 1) % every else -before
        lost.step([before * PERIOD_S, 0.0], (before, 0.0), (v, 0.0), PERIOD_S)
        before = v
        offsets.append(lost.offset[0])
    assert max(map(abs, offsets)) < 0.0061


def test_a_jump_counts_in_the_next_command_alone():
    lost = after(0.06)
    for jump_m in (0.0, 0.002):
        lost.step([0.1 * PERIOD_S + jump_m, 0.0], (0.1, 0.0), (0.1, 0.0), PERIOD_S)
    assert lost.offset[0] == pytest.approx(0.006, abs=1e-4)


def test_speeds_that_are_not_given_are_those_of_the_target():
    lost = SlipCompensation(1)
    lost.passed(0.06)
    assert lost.follow(([0.1], None), [0.12], None, PERIOD_S, 0.05) == (
        [0.12],
        pytest.approx([0.4]),
    )


def test_a_robot_that_is_ahead_is_slowed_and_never_hurried():
    lost = after(0.06)
    rates = play(lost, (0.1, 0.0), 12.0)
    assert max(rates) <= 0.0
    assert -0.02 < min(rates) < -0.002
    assert max(abs(b - a) for a, b in pairwise(rates)) <= 0.2 * PERIOD_S
    assert lost.offset[0] == pytest.approx(0.0, abs=5e-4)


def test_a_slow_robot_is_not_turned_back():
    assert min(play(after(1.0), (0.1, 0.0), 0.1)) > -0.1
    assert min(play(after(1.0, (0.02, 0.0)), (0.02, 0.0), 2.0)) >= -0.0101


def test_a_robot_that_is_behind_stays_behind_until_it_rests():
    lost = after(0.06, error=(-0.012, 0.0))
    assert lost.offset[0] == pytest.approx(-0.006, rel=0.01)
    assert max(map(abs, play(lost, (0.1, 0.0), 1.0))) < 1e-9
    assert lost.offset[0] == pytest.approx(-0.006, rel=0.01)
    play(lost, (0.0, 0.0), REST_S + PERIOD_S, before=(0.0, 0.0))
    assert not lost.working


def test_a_speed_that_was_lost_comes_back_gently():
    lost = after(0.0, slip=(-0.1, 0.0))
    assert lost.rate[0] == pytest.approx(-0.1, rel=0.02)
    rates = play(lost, (0.1, 0.0), 3.0)
    assert max(rates) <= 0.0
    assert max(b - a for a, b in pairwise(rates)) <= 0.4 * PERIOD_S + 1e-9


def speeds_of(lost, velocities, before):
    """Return the speeds sent to the robot, for commands that change their speed."""
    found = []
    for v in velocities:
        lost.step([v * PERIOD_S, 0.0], (before, 0.0), (v, 0.0), PERIOD_S)
        before = v
        found.append(v + lost.rate[0])
    return found


def ramp(first, last, acceleration=1.0):
    count = round(abs(last - first) / acceleration / PERIOD_S)
    return [first + (last - first) * (k + 1) / count for k in range(count)]


def test_a_robot_that_has_stopped_is_not_moved_back_while_its_command_brakes():
    lost = SlipCompensation(2)
    lost.passed(5.0, error=(-0.5, 0.0), slip=(-0.1, 0.0))
    found = speeds_of(lost, [*ramp(0.1, 0.0), *[0.0] * 250], 0.1)
    assert min(found) >= 0.0
    assert max(found) < 0.5 * 0.1  # necessary to reach the commanded position
    assert not any(found[-200:])
    assert lost.offset[0] == pytest.approx(0.0, abs=1e-9)


def test_nor_is_it_faster_than_a_command_that_turns_back():
    lost = SlipCompensation(2)
    lost.passed(5.0, error=(-0.5, 0.0), slip=(-0.1, 0.0))
    commanded = [*ramp(0.1, -0.1), *[-0.1] * 250]
    found = speeds_of(lost, commanded, 0.1)
    assert all(
        min(v, 0.0) - 1e-9 <= u <= max(v, 0.0) + 0.002
        for u, v in zip(found, commanded, strict=True)
    )
    assert found[-1] == pytest.approx(-0.1, rel=0.05)
    assert max(abs(b - a) for a, b in pairwise(found)) <= 1.05 * PERIOD_S


def test_one_that_went_on_brakes_as_it_should():
    lost = SlipCompensation(2)
    lost.passed(0.06, slip=(0.0, 0.0))
    found = speeds_of(lost, [*ramp(0.1, 0.0), *[0.0] * 500], 0.1)
    assert max(found) <= 0.1 + 1e-9
    assert max(a - b for a, b in pairwise(found)) <= 1.5 * PERIOD_S
    assert min(found) > -0.5 * 0.1  # back to the commanded position
    assert max(b - a for a, b in pairwise(found)) <= 1.0 * PERIOD_S


RESTING = [0.0] * round(REST_S / PERIOD_S)
RESTING_LONG = [0.0] * round(LONGEST_REST_S / PERIOD_S)


@pytest.mark.parametrize(
    ("gap_s", "rests"),
    [
        (0.004, RESTING),
        (0.016, RESTING),
        (0.06, RESTING),
        (0.08, RESTING_LONG),
        (2.0, RESTING_LONG),
    ],
)
@pytest.mark.parametrize("ahead", [1.0, -1.0])
@pytest.mark.parametrize("speed", [0.02, 0.1, 1.0])
def test_nothing_moves_for_long_after_its_command_has_come_to_rest(speed, ahead, gap_s, rests):
    lost = SlipCompensation(2)
    lost.passed(0.0, error=(ahead * speed * gap_s, 0.0))
    found = speeds_of(lost, [*ramp(speed, 0.0, 10.0 * speed), *rests, *[0.0] * 250], speed)
    assert not any(found[-250:])
    assert (lost.offset[0] == 0.0) == (gap_s < 1.0)
    resting = found[-250 - len(rests) :]
    # The correction is slow and smooth, and has a single direction.
    assert max(map(abs, resting)) <= (0.5 if gap_s <= 0.06 else 0.7) * speed
    assert max(abs(b - a) for a, b in pairwise(resting)) <= 10.0 * speed * PERIOD_S
    assert len({v > 0.0 for v in resting if abs(v) > 0.01 * speed}) <= 1


def test_what_is_not_worked_off_by_then_stays_and_is_no_step_later():
    lost = SlipCompensation(2)
    lost.passed(0.5)
    speeds_of(lost, [*ramp(0.1, 0.0), *RESTING_LONG], 0.1)
    stays = lost.offset[0]
    assert stays > 0.01
    assert not any(speeds_of(lost, [0.0] * 1000, 0.0))
    assert lost.offset[0] == stays
    found = speeds_of(lost, [*ramp(0.0, 0.1), *[0.1] * 1000], 0.0)
    assert min(found) >= 0.0
    assert max(found) <= 0.1
    assert max(abs(b - a) for a, b in pairwise(found)) <= 1.05 * PERIOD_S
    assert lost.offset[0] < 0.2 * stays


def test_a_robot_that_was_not_commanded_to_move_does_not():
    lost = SlipCompensation(2)
    lost.passed(0.06, error=(0.01, -0.01))
    assert not any(speeds_of(lost, [0.0] * 1000, 0.0))


def test_nor_once_more_when_time_is_lost_at_rest():
    lost = SlipCompensation(2)
    lost.passed(0.5)
    speeds_of(lost, [*ramp(0.1, 0.0), *RESTING_LONG], 0.1)
    lost.passed(0.05)
    assert not any(speeds_of(lost, [0.0] * 1000, 0.0))


def test_time_that_is_lost_while_it_comes_to_rest_is_no_step():
    lost = SlipCompensation(2)
    lost.passed(0.06)
    found = speeds_of(lost, [*ramp(0.1, 0.0), *RESTING[:20]], 0.1)
    place = lost.offset[0]
    lost.passed(0.02)
    found += speeds_of(lost, [0.0], 0.0)
    went = 0.02 * found[-2]
    assert lost.offset[0] == pytest.approx(place + went, abs=abs(found[-2]) * 2.0 * PERIOD_S)
    found += speeds_of(lost, [*RESTING, 0.0], 0.0)
    assert max(abs(b - a) for a, b in pairwise(found)) <= 1.2 * PERIOD_S
    assert found[-1] == 0.0
    assert lost.offset[0] == pytest.approx(0.0, abs=1e-4)


def test_motion_goes_on_from_a_robot_that_comes_to_rest():
    lost = SlipCompensation(2)
    lost.passed(0.06)
    found = speeds_of(lost, [*ramp(0.1, 0.0), *RESTING[:20], *ramp(0.0, 0.1)], 0.1)
    assert max(abs(b - a) for a, b in pairwise(found)) <= 1.5 * PERIOD_S


def test_a_speed_is_forgotten_that_was_commanded_long_ago():
    lost = SlipCompensation(2)
    lost.passed(0.0, error=(-0.006, 0.0))
    found = speeds_of(
        lost, [*ramp(0.1, 0.01), *[0.01] * 5000, *ramp(0.01, 0.0), *RESTING_LONG], 0.1
    )
    assert max(found[-len(RESTING_LONG) :]) <= 0.01


def test_what_comes_in_several_parts_adds_up():
    lost = SlipCompensation(2)
    lost.passed(0.02, slip=(-0.05, 0.0))
    lost.passed(0.02)
    lost.step([0.1 * PERIOD_S, 0.0], (0.1, 0.0), (0.1, 0.0), PERIOD_S)
    assert lost.offset[0] == pytest.approx(0.1 * 0.04 - 0.05 * 0.02, rel=0.1)


def test_reset():
    lost = after(0.06)
    lost.reset()
    assert lost.offset == [0.0, 0.0]
    assert not lost.working
