"""Profiles stay within their bounds at all times, and start and end exactly."""

import itertools
import math

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.motion.profiles import Profile

lengths = st.floats(1e-6, 1e3)
limits = st.floats(1e-2, 1e2)
jerks = st.one_of(st.floats(1e-1, 1e4), st.just(math.inf))
SAMPLES = 200


def assert_bounded(profile, speed, acceleration, jerk):
    """Check values, their consistency by finite differences, and all bounds."""
    duration = profile.duration_s
    step = duration / SAMPLES
    states = [profile.at(duration * i / SAMPLES) for i in range(SAMPLES + 1)]
    for earlier, later in itertools.pairwise(states):
        assert 0.0 <= later.ds <= speed * (1 + 1e-9)
        assert abs(later.dds) <= acceleration * (1 + 1e-9)
        assert later.s >= earlier.s - 1e-12 * later.s
        mean = (later.s - earlier.s) / step
        reach = acceleration * step
        assert min(earlier.ds, later.ds) - reach <= mean + 1e-9 * speed
        assert mean <= max(earlier.ds, later.ds) + reach + 1e-9 * speed
        assert abs(later.ds - earlier.ds) <= reach * (1 + 1e-6) + 1e-9 * speed
        if math.isfinite(jerk):
            slack = 1e-6 * acceleration
            assert abs(later.dds - earlier.dds) <= jerk * step * (1 + 1e-6) + slack


@given(lengths, limits, limits, jerks, st.one_of(st.none(), st.floats(1.0, 20.0)))
def test_bounds_hold_at_all_times_and_ends_are_exact(length, speed, acceleration, jerk, stretch):
    profile = Profile(length, speed, acceleration, jerk)
    if stretch is not None:
        duration_s = stretch * profile.duration_s
        profile = Profile(length, speed, acceleration, jerk, duration_s)
        assert profile.duration_s == pytest.approx(duration_s)
    assert_bounded(profile, speed, acceleration, jerk)
    assert profile.at(0.0)[:2] == (0.0, 0.0)
    assert profile.at(-1.0) == (0.0, 0.0, 0.0)
    assert profile.at(profile.duration_s) == profile.at(math.inf) == (length, 0.0, 0.0)
    assert profile.length == length
    half = profile.at(0.5 * profile.duration_s)
    assert half.s == pytest.approx(0.5 * length, rel=1e-6)
    nearly = profile.at(profile.duration_s * (1 - 1e-9))
    assert nearly.s == pytest.approx(length, rel=1e-8)
    assert nearly.ds <= 1e-6 * speed + 1e-8 * acceleration * profile.duration_s


@pytest.mark.parametrize(
    ("length", "duration_s", "peak"),
    [
        (0.05, 3.1623, 0.03162),
        (0.1, 4.4721, 0.04472),
        (0.125, 5.0, 0.05),
        (0.3, 8.5, 0.05),
        (1.5708, 33.916, 0.05),
    ],
)
def test_trapezoid_times(length, duration_s, peak):
    profile = Profile(length, 0.05, 0.02, math.inf)
    assert profile.duration_s == pytest.approx(duration_s, abs=6e-5)
    assert profile.at(0.5 * duration_s).ds == pytest.approx(peak, abs=1e-5)


def test_seven_phase_times_with_each_degenerate_case():
    # v = 1, a = 2, j = 4: a ramp takes v/a + a/j = 1 s and 0.5 m.
    assert Profile(3.0, 1.0, 2.0, 4.0).duration_s == pytest.approx(3.0 + 1.0)
    # No cruise, a = 2, j = 8: v²/a + v·a/j = L = 0.75 gives v = 1 and ramps of v/a + a/j.
    assert Profile(0.75, 10.0, 2.0, 8.0).duration_s == pytest.approx(1.5)
    assert Profile(0.75, 10.0, 2.0, 8.0).at(0.75).ds == pytest.approx(1.0)
    # No constant acceleration, no cruise: L = j·t³·2 with four phases of t.
    assert Profile(2 * 4 * 0.1**3, 10.0, 20.0, 4.0).duration_s == pytest.approx(0.4)
    # Cruise, but no constant acceleration: ramps of 2·sqrt(v/j).
    assert Profile(3.0, 1.0, 50.0, 4.0).duration_s == pytest.approx(3.0 + 1.0)


def test_infinite_limits():
    constant = Profile(3.0, 1.5, math.inf, math.inf)
    assert constant.duration_s == 2.0
    assert constant.at(1.0) == (1.5, 1.5, 0.0)
    assert Profile(3.0, 1.0, math.inf, 4.0).duration_s == pytest.approx(4.0)


def test_nothing_to_do_takes_no_time_or_as_long_as_asked():
    assert Profile(0.0, 1.0, 1.0, math.inf).duration_s == 0.0
    waiting = Profile(0.0, 1.0, 1.0, 1.0, duration_s=2.0)
    assert waiting.duration_s == 2.0
    assert waiting.at(1.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("duration_s", [8.0, math.inf, math.nan])
def test_a_duration_below_the_quickest_is_refused_with_both_times(duration_s):
    with pytest.raises(ValueError, match=rf"duration {duration_s:g} s .* 8.5 s"):
        Profile(0.3, 0.05, 0.02, math.inf, duration_s=duration_s)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((-1.0, 1.0, 1.0, 1.0), "length"),
        ((math.nan, 1.0, 1.0, 1.0), "length"),
        ((1.0, 0.0, 1.0, 1.0), "speed"),
        ((1.0, math.inf, 1.0, 1.0), "speed"),
        ((1.0, 1.0, -1.0, 1.0), "acceleration"),
        ((1.0, 1.0, 1.0, math.nan), "jerk"),
    ],
)
def test_senseless_arguments_are_refused(arguments, name):
    with pytest.raises(ValueError, match=name):
        Profile(*arguments)
