"""Estimate of the gyroscopes' rest point."""

import math

import pytest

from cardan_wiimote.driver.gyro import LARGEST_BIAS_RAD_S, Gyro

DRIFT = (math.radians(2.0), math.radians(-2.9), 0.0)


def run(gyro, rates, seconds, at_rest=True, start_s=0.0, rate_hz=100):
    value = rates
    for at in range(round(seconds * rate_hz)):
        value = gyro.update(rates, start_s + at / rate_hz, at_rest)
    return value


def test_a_still_remote_shows_its_rest_point():
    gyro = Gyro()
    assert run(gyro, DRIFT, 0.9) == DRIFT
    assert run(gyro, DRIFT, 0.5, start_s=0.9) == pytest.approx((0.0, 0.0, 0.0))
    assert gyro.updates == 1


def test_not_while_the_clutch_is_held():
    gyro = Gyro()
    run(gyro, DRIFT, 0.9)
    assert run(gyro, DRIFT, 5.0, at_rest=False, start_s=0.9) == DRIFT
    assert gyro.updates == 0


@pytest.mark.parametrize("allowed_rad_s", [0.0, 0.02, 1.0])
@pytest.mark.parametrize("rate_deg_s", [-9.0, 5.0, 9.0])
def test_a_slow_steady_turn_is_believed_to_be_rest_only_within_limits(rate_deg_s, allowed_rad_s):
    gyro = Gyro(allowed_rad_s)
    rates = (0.0, 0.0, math.radians(rate_deg_s))
    run(gyro, rates, 5.0)
    largest = min(allowed_rad_s, LARGEST_BIAS_RAD_S)
    assert gyro.bias_rad_s == pytest.approx((0.0, 0.0, math.copysign(largest, rate_deg_s)))


@pytest.mark.parametrize("rate_deg_s", [11.0, -30.0])
def test_a_steady_turn_is_none(rate_deg_s):
    gyro = Gyro()
    rates = (0.0, 0.0, math.radians(rate_deg_s))
    assert run(gyro, rates, 5.0) == rates


def test_a_moving_hand_is_none():
    gyro = Gyro()
    for at in range(500):
        gyro.update((0.1 * math.sin(at / 10), 0.0, 0.0), at / 100, True)
    assert gyro.updates == 0


def test_a_few_samples_are_none():
    gyro = Gyro()
    run(gyro, DRIFT, 5.0, rate_hz=2)
    assert gyro.updates == 0


def test_a_new_one_has_none():
    gyro = Gyro()
    run(gyro, DRIFT, 2.0)
    gyro.reset()
    assert gyro.bias_rad_s == (0.0, 0.0, 0.0)
