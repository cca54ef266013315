"""Estimate of another computer's clock from its answers."""

import random

import pytest

from cardan.common.clocks import MOST_ROUNDS, RemoteClock


def test_the_quickest_round_trip_tells_the_time():
    clock, chosen = RemoteClock(), random.Random(1)
    assert clock.here_s(0.0) is None
    offset_s = 1234.5
    for step in range(200):
        asked_s = 10.0 + 0.5 * step
        there_s, back_s = (0.002 + chosen.expovariate(50.0) for _ in range(2))
        said_s = asked_s + there_s - offset_s
        clock.heard(asked_s, said_s, asked_s + there_s + back_s)
        assert abs(clock.here_s(50.0) - 50.0 - offset_s) <= 0.5 * clock.round_s
    assert clock.round_s < 0.02
    assert clock.resets == 0


def test_a_page_that_blocks_for_once_changes_nothing():
    clock = RemoteClock()
    clock.heard(10.0, 0.001, 10.002)
    clock.heard(10.5, 0.501, 11.1)
    assert clock.here_s(1.0) == pytest.approx(11.0)
    clock.heard(11.0, 1.0, 13.0)
    assert clock.round_s == pytest.approx(0.002)
    assert clock.median_s == pytest.approx(0.6)


def test_a_clock_that_stood_still_is_another_one():
    clock = RemoteClock()
    for step in range(10):
        clock.heard(10.0 + step, 0.001 + step, 10.002 + step)
    # The computer of the page slept for an hour, including its clock.
    clock.heard(3620.0, 10.001, 3620.002)
    assert clock.resets == 1
    assert clock.here_s(10.001) == pytest.approx(3620.001)


def test_drift_is_followed():
    clock = RemoteClock()
    for step in range(20 * MOST_ROUNDS):
        now_s = 10.0 + 0.5 * step
        clock.heard(now_s, (now_s - 5.0) * (1.0 + 50e-6), now_s + 0.002)
    assert clock.here_s((now_s - 5.0) * (1.0 + 50e-6)) == pytest.approx(now_s, abs=0.003)


def test_the_quickest_round_trip_is_kept_whatever_the_other_clock_says():
    clock = RemoteClock()
    clock.heard(10.0, 0.001, 10.002)
    clock.heard(10.5, 90.0, 11.4)
    assert clock.resets == 1
    assert clock.round_s == pytest.approx(0.9)
    assert clock.quickest_s == pytest.approx(0.002)
