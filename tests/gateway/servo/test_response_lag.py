"""A robot that lags by design, and a robot that is held."""

from __future__ import annotations

import numpy as np
import pytest

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.response_lag import ResponseLag
from cardan.gateway.servo.servo import Servo
from cardan.robots import load_arm

DT_S = 0.004
LAG_S = 0.3
FIXED = np.zeros(2, dtype=bool)


def _run(lag: ResponseLag, path, measured, until_s):
    """Largest difference between the command and the expected position."""
    worst = 0.0
    for k in range(round(until_s / DT_S)):
        now_s = k * DT_S
        q = path(now_s)
        worst = max(worst, np.abs(q - lag.expected(measured(now_s), q)).max())
        lag.record_command(q, now_s)
    return worst


def _swing(t):
    return np.array([0.5 * np.sin(2.0 * t), 0.2 * t])


@pytest.mark.parametrize("behind_s", [0.0, 0.01, 0.1, 0.2, 0.29])
def test_a_robot_that_is_behind_in_good_order_is_expected_to_arrive(behind_s):
    lag = ResponseLag(LAG_S, FIXED)
    worst = _run(lag, _swing, lambda t: _swing(max(t - behind_s, 0.0)), 4.0)
    # half the spacing of recorded commands at 1 rad/s
    assert worst < 0.02


def test_without_the_lag_it_would_look_held():
    worst = _run(ResponseLag(0.0, FIXED), _swing, lambda t: _swing(max(t - 0.29, 0.0)), 4.0)
    assert worst > 0.2


def test_a_robot_that_is_held_shows():
    lag = ResponseLag(LAG_S, FIXED)
    worst = _run(lag, lambda t: np.array([0.5 * t, 0.0]), lambda t: np.array([0.0, 0.0]), 1.0)
    # all of the path but the last 0.3 s
    assert worst == pytest.approx(0.5 * (1.0 - LAG_S), abs=0.02)


def test_a_robot_that_was_pushed_shows_at_once():
    lag = ResponseLag(LAG_S, FIXED)
    still = np.array([0.1, 0.2])
    for k in range(100):
        lag.record_command(still, k * DT_S)
    pushed = lag.expected(still + np.array([0.3, 0.0]), still)
    assert pushed == pytest.approx(still + np.array([0.3, 0.0]))


def test_after_a_gap_the_past_is_gone():
    lag = ResponseLag(LAG_S, FIXED)
    for k in range(100):
        lag.record_command(np.array([0.01 * k, 0.0]), k * DT_S)
    lag.record_command(np.array([1.0, 0.0]), 10.0)
    behind, now = np.array([0.8, 0.0]), np.array([1.0, 0.0])
    assert lag.expected(behind, now) == pytest.approx(behind)


@pytest.mark.parametrize("make", [Servo, CompiledServo])
def test_a_servo_forgets_the_past_when_it_is_to_keep_it_anew(make):
    servo = make(ArmKinematics(load_arm("ur5e")))
    servo.keep_past(LAG_S)
    for k in range(100):
        servo.place(np.full(6, 0.01 * k))
        servo.record_command(k * DT_S)
    behind = [0.8] * 6
    assert servo.measure(behind)[1] < 0.02
    servo.keep_past(LAG_S)
    assert servo.measure(behind)[1] == pytest.approx(0.19)
    assert servo.expected(behind).tolist() == behind


def test_whole_turns_of_a_continuous_joint_are_no_distance():
    lag = ResponseLag(LAG_S, np.array([True, False]))
    for k in range(200):
        lag.record_command(np.array([0.01 * k, 0.0]), k * DT_S)
    commanded = np.array([2.0, 0.0])
    behind = np.array([1.5 - 2.0 * np.pi, 0.0])
    expected = lag.expected(behind, commanded)
    assert np.abs(expected + np.array([2.0 * np.pi, 0.0]) - commanded).max() < 0.05


def test_it_is_the_way_from_the_nearest_of_all_places_of_the_past():
    rng = np.random.default_rng(7)
    turns = np.array([False, True, False])
    lag, past = ResponseLag(LAG_S, turns), []
    q, found = np.zeros(3), 0
    for k in range(2000):
        q = q + rng.normal(scale=(0.01, 0.05, 0.01))
        if k % 5 == 0:  # more often than commands are recorded, so that every one of these is
            lag.record_command(q, k * LAG_S / 79)
            past = [*past, q][-17:] if past else [q] * 17
        measured = past[rng.integers(len(past))] + rng.normal(scale=0.02, size=3)
        measured[1] += 2.0 * np.pi * rng.integers(-2, 3)
        expected = lag.expected(tuple(measured.tolist()), q.tolist())
        away = np.array([*past, q]) - measured
        away[:, 1] -= 2.0 * np.pi * np.rint(away[:, 1] / (2.0 * np.pi))
        farthest = np.abs(away).max(axis=1)
        nearest = q if farthest[-1] <= farthest[:-1].min() else past[farthest[:-1].argmin()]
        assert expected == pytest.approx(measured + (q - nearest), abs=1e-12)
        found += nearest is not q
    assert 500 < found < 2000


def test_the_same_question_has_another_answer_once_the_past_has_changed():
    lag = ResponseLag(LAG_S, FIXED)
    for k in range(100):
        lag.record_command(np.array([0.01 * k, 0.0]), k * DT_S)
    measured, commanded = (0.7, 0.0), [1.0, 0.0]
    before = lag.expected(measured, commanded)
    assert before == pytest.approx((1.0, 0.0), abs=0.02)
    assert lag.expected(measured, commanded) is before
    assert lag.expected(measured, [2.0, 0.0]) == pytest.approx((2.0, 0.0), abs=0.02)
    lag.record_command(np.array([2.0, 0.0]), 10.0)  # after a gap
    assert lag.expected(measured, commanded) == measured


def test_a_command_just_one_spacing_after_the_last_is_recorded():
    lag = ResponseLag(1.0, FIXED)
    for k in range(2):
        lag.record_command(np.array([1.0 * k, 0.0]), k / 16)
    assert lag.expected((1.0, 0.0), [3.0, 0.0]) == [3.0, 0.0]
