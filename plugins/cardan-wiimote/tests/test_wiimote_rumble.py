"""Rumble: pulses that approximate a strength, and their end."""

import itertools
import math

import pytest
from hypothesis import given, strategies as st

from cardan_wiimote.driver.rumble import CUT_OFF_S, LONGEST_PERIOD_S, PULSE_S, Rumble, pulse


@given(st.floats(0.0, 1.0))
def test_a_pulse_has_its_share(level):
    on_s, off_s = pulse(level)
    if on_s in (0.0, math.inf):
        assert off_s == 0.0
        assert level <= 0.05 if on_s == 0.0 else level >= 0.95
        return
    assert min(on_s, off_s) >= PULSE_S - 1e-12
    assert on_s + off_s <= LONGEST_PERIOD_S + 1e-9
    assert on_s / (on_s + off_s) == pytest.approx(level)


@given(st.lists(st.tuples(st.floats(0.0, 0.05), st.floats(-1.0, 2.0)), max_size=300))
def test_never_more_than_fifty_writes_per_second(asked):
    rumble = Rumble()
    switched, now_s = [], 0.0
    for pause_s, level in asked:
        now_s += pause_s
        rumble.set(level, now_s)
        if rumble.update(now_s):
            switched.append(now_s)
    assert all(b - a >= PULSE_S - 1e-12 for a, b in itertools.pairwise(switched))


@given(st.floats(0.0, 1.0))
def test_it_ends_by_itself(level):
    rumble = Rumble()
    rumble.set(level, 0.0)
    for at in range(96):
        rumble.update(at / 100)
    assert not rumble.on
    assert rumble.level == 0.0
    assert not any(rumble.update(at / 100) for at in range(96, 200))
    assert CUT_OFF_S < 1.0


def test_what_is_no_strength_is_off():
    rumble = Rumble()
    for level in (math.nan, math.inf, -math.inf, -1.0):
        rumble.set(level, 0.0)
        assert rumble.level == 0.0
    rumble.set(7.0, 0.0)
    assert rumble.level == 1.0


def test_off_is_off_soon():
    rumble = Rumble()
    rumble.set(1.0, 0.0)
    assert rumble.update(0.0)
    assert rumble.on
    rumble.set(0.0, 0.005)
    assert not rumble.update(0.005)
    assert rumble.update(PULSE_S)
    assert not rumble.on


def test_a_new_link_begins_off():
    rumble = Rumble()
    rumble.set(1.0, 0.0)
    rumble.update(0.0)
    rumble.reset()
    assert not rumble.update(0.1)
    assert not rumble.on
