"""Tilt from the accelerometer: angles, filter, validity, neutral."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan_wiimote.driver.tilt import FREEZE_S, Tilt

ANGLES = st.floats(-180.0, 180.0)


def held(right_deg, down_deg, weight_g=1.0):
    """Specific force in the operator's axes after a tilt nose down, then to the right."""
    roll, pitch = math.radians(right_deg), math.radians(down_deg)
    return (
        -weight_g * math.sin(pitch),
        weight_g * math.cos(pitch) * math.sin(roll),
        weight_g * math.cos(pitch) * math.cos(roll),
    )


def settled(tilt, force_g, now_s=0.0):
    for at in range(200):
        tilt.update(force_g, now_s + at / 100)
    return now_s + 1.99


@given(ANGLES, st.floats(-90.0, 90.0))
def test_sines_of_the_angles(right_deg, down_deg):
    tilt = Tilt(7.0, 90.0)
    now_s = settled(tilt, held(right_deg, down_deg))
    rolled, dipped = tilt.rolled_and_dipped(now_s)
    assert dipped == pytest.approx(math.sin(math.radians(down_deg)), abs=1e-6)
    expected = math.sin(math.radians(right_deg)) * math.cos(math.radians(down_deg))
    assert rolled == pytest.approx(expected, abs=1e-6)


def test_full_tilt_is_clamped():
    tilt = Tilt(7.0, 30.0)
    now_s = settled(tilt, held(30.0, 0.0))
    assert tilt.rolled_and_dipped(now_s)[0] == pytest.approx(1.0)
    settled(tilt, held(80.0, 0.0), now_s)
    assert tilt.rolled_and_dipped(now_s + 1.99)[0] == 1.0


@given(ANGLES, ANGLES, st.floats(-40.0, 40.0), st.floats(-40.0, 40.0))
def test_neutral_is_how_it_was_held(right_deg, down_deg, more_right_deg, more_down_deg):
    tilt = Tilt(7.0, 90.0)
    now_s = settled(tilt, held(right_deg, down_deg))
    tilt.capture()
    assert tilt.rolled_and_dipped(now_s) == (0.0, 0.0)
    tilt.update(held(right_deg, down_deg), now_s)
    assert tilt.rolled_and_dipped(now_s) == pytest.approx((0.0, 0.0), abs=1e-4)
    now_s = settled(tilt, held(right_deg + more_right_deg, down_deg + more_down_deg), now_s)
    rolled, dipped = tilt.rolled_and_dipped(now_s)
    # For any axis, the angle from neutral is that between the two forces.
    cosine = sum(
        a * b
        for a, b in zip(
            held(right_deg, down_deg),
            held(right_deg + more_right_deg, down_deg + more_down_deg),
            strict=True,
        )
    )
    assert math.hypot(rolled, dipped) == pytest.approx(
        math.sqrt(max(0.0, 1.0 - cosine * cosine)), abs=1e-4
    )


def test_the_cut_off_frequency():
    """A tilt that oscillates at the cut-off frequency is attenuated to 1/sqrt(2)."""
    tilt = Tilt(5.0, 90.0)
    largest = 0.0
    for at in range(2000):
        now_s = at / 500
        sine = 0.2 * math.sin(2 * math.pi * 5.0 * now_s)
        tilt.update((0.0, sine, math.sqrt(1.0 - sine * sine)), now_s)
        if now_s > 2.0:
            largest = max(largest, tilt.rolled_and_dipped(now_s)[0])
    assert largest == pytest.approx(0.2 / math.sqrt(2.0), rel=0.05)


@pytest.mark.parametrize("shaken_s", [0.05, 0.2, 1.0])
def test_neutral_is_the_first_that_can_be_trusted(shaken_s):
    """The remote is turned while it is shaken, and the clutch is pressed meanwhile."""
    tilt = Tilt(7.0, 90.0)
    now_s = settled(tilt, held(60.0, 0.0))
    for at in range(1, round(shaken_s * 100)):
        tilt.update(held(-20.0, 30.0, 2.0), now_s + at / 100)
    now_s += shaken_s
    tilt.capture()
    tilt.update(held(-20.0, 30.0, 2.0), now_s)
    assert tilt.rolled_and_dipped(now_s) == (0.0, 0.0)
    for at in range(1, 100):
        tilt.update(held(-20.0, 30.0), now_s + at / 100)
        assert tilt.rolled_and_dipped(now_s + at / 100) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("weight_g", [0.0, 0.79, 1.21, 4.0])
def test_acceleration_freezes_and_then_counts_as_none(weight_g):
    tilt = Tilt(7.0, 90.0)
    now_s = settled(tilt, held(30.0, 0.0))
    for at in (*range(1, 25), *range(26, 60)):
        tilt.update(held(-60.0, 0.0, weight_g), now_s + at / 100)
        expected = 0.5 if at / 100 <= FREEZE_S else 0.0
        assert tilt.rolled_and_dipped(now_s + at / 100)[0] == pytest.approx(expected, abs=1e-6)
    tilt.update(held(10.0, 0.0), now_s + 0.6)
    assert tilt.rolled_and_dipped(now_s + 0.6)[0] == pytest.approx(math.sin(math.radians(10)))


def test_a_remote_without_calibration_is_trusted_farther():
    tilt = Tilt(7.0, 90.0)
    tilt.update(held(30.0, 0.0, 1.3), 0.0)
    assert not tilt.trusted(0.0)
    tilt.update(held(30.0, 0.0, 1.3), 0.01, calibrated=False)
    assert tilt.trusted(0.01)


def test_unknown_is_level():
    tilt = Tilt(7.0, 90.0)
    assert tilt.rolled_and_dipped(0.0) == (0.0, 0.0)
    tilt.capture()
    assert not tilt.trusted(0.0)


def test_a_waving_hand_is_no_neutral():
    """Sideways motion with 0.3 g stays within the valid range of gravity, but not within a few
    degrees."""
    tilt = Tilt(7.0, 45.0)
    now_s = settled(tilt, held(0.0, 0.0))
    tilt.capture()
    shaken_s = now_s + 2.0
    tilt.update((0.0, 0.6, 0.9), now_s + 0.01)
    now_s += 0.01
    tilt.capture()
    while now_s < shaken_s:
        now_s += 0.01
        tilt.update((0.0, 0.3 * math.sin(12.0 * now_s), 1.0), now_s)
    now_s = settled(tilt, held(0.0, 0.0), now_s)
    assert tilt.rolled_and_dipped(now_s) == pytest.approx((0.0, 0.0), abs=0.08)
