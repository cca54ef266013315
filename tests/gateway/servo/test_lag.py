"""A robot that is behind by design, and one that is held."""

from __future__ import annotations

import numpy as np
import pytest

from cardan.gateway.servo.lag import ResponseLag

DT_S = 0.004
LAG_S = 0.3
FIXED = np.zeros(2, dtype=bool)


def _run(lag: ResponseLag, path, measured, until_s):
    """The largest difference between what is commanded and what is expected."""
    worst = 0.0
    for k in range(round(until_s / DT_S)):
        now_s = k * DT_S
        q = path(now_s)
        worst = max(worst, np.abs(q - lag.expected(measured(now_s), q)).max())
        lag.note(q, now_s)
    return worst


def _swing(t):
    return np.array([0.5 * np.sin(2.0 * t), 0.2 * t])


@pytest.mark.parametrize("behind_s", [0.0, 0.01, 0.1, 0.2, 0.29])
def test_a_robot_that_is_behind_in_good_order_is_expected_to_arrive(behind_s):
    lag = ResponseLag(LAG_S, FIXED)
    worst = _run(lag, _swing, lambda t: _swing(max(t - behind_s, 0.0)), 4.0)
    # Half a row apart at 1 rad/s.
    assert worst < 0.02


def test_without_the_lag_it_would_look_held():
    worst = _run(ResponseLag(0.0, FIXED), _swing, lambda t: _swing(max(t - 0.29, 0.0)), 4.0)
    assert worst > 0.2


def test_a_robot_that_is_held_shows():
    lag = ResponseLag(LAG_S, FIXED)
    worst = _run(lag, lambda t: np.array([0.5 * t, 0.0]), lambda t: np.array([0.0, 0.0]), 1.0)
    # Everything but the way of the last 0.3 s.
    assert worst == pytest.approx(0.5 * (1.0 - LAG_S), abs=0.02)


def test_a_robot_that_was_pushed_shows_at_once():
    lag = ResponseLag(LAG_S, FIXED)
    still = np.array([0.1, 0.2])
    for k in range(100):
        lag.note(still, k * DT_S)
    pushed = lag.expected(still + np.array([0.3, 0.0]), still)
    assert pushed == pytest.approx(still + np.array([0.3, 0.0]))


def test_after_a_gap_and_after_a_reset_the_past_is_gone():
    lag = ResponseLag(LAG_S, FIXED)
    for k in range(100):
        lag.note(np.array([0.01 * k, 0.0]), k * DT_S)
    lag.note(np.array([1.0, 0.0]), 10.0)
    behind, now = np.array([0.8, 0.0]), np.array([1.0, 0.0])
    assert lag.expected(behind, now) == pytest.approx(behind)
    lag.reset()
    assert lag.expected(behind, now) == pytest.approx(behind)


def test_whole_turns_of_a_continuous_joint_are_no_distance():
    lag = ResponseLag(LAG_S, np.array([True, False]))
    for k in range(200):
        lag.note(np.array([0.01 * k, 0.0]), k * DT_S)
    commanded = np.array([2.0, 0.0])
    behind = np.array([1.5 - 2.0 * np.pi, 0.0])
    expected = lag.expected(behind, commanded)
    assert np.abs(expected + np.array([2.0 * np.pi, 0.0]) - commanded).max() < 0.05
