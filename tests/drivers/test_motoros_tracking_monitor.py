"""Comparison of an arm's position with its commanded path."""

from __future__ import annotations

import math

import pytest

from cardan.drivers.motoros.tracking_monitor import TrackingMonitor

LAG_S = 0.4
DT_S = 0.004


def followed(way, until_s, watch=None):
    """Return a monitor that was fed `way`, positions by time, up to `until_s`."""
    watch = watch or TrackingMonitor(LAG_S, way(0.0), 0.0)
    for k in range(1, round(until_s / DT_S) + 1):
        watch.record(way(k * DT_S), k * DT_S)
    return watch


def line(t):
    return [0.5 * t, -0.2 * t]


@pytest.mark.parametrize("behind_s", [0.02, 0.1, 0.27, 0.38])
def test_an_arm_that_lags_is_on_its_way(behind_s):
    watch = followed(line, 2.0)
    assert watch.away(line(2.0 - behind_s), line(2.0)) is None


def test_a_filter_that_cuts_a_curve_is_beside_the_way_and_no_loss():
    def circle(t, radius=0.4):
        return [radius * math.cos(6.0 * t), radius * math.sin(6.0 * t)]

    watch = followed(circle, 2.0)
    assert watch.away(circle(1.8, radius=0.25), circle(2.0)) is None


def test_an_arm_behind_all_of_its_way_has_lost_something():
    watch = followed(line, 2.0)
    away = watch.away(line(1.2), line(2.0))
    # Distance from the oldest part of the path within the allowed lag.
    assert away == pytest.approx([0.5 * -0.4, -0.2 * -0.4], abs=0.03)


def test_an_arm_ahead_of_its_command_is_away_from_it():
    watch = followed(line, 2.0)
    assert watch.away(line(2.3), line(2.0)) == pytest.approx([0.15, -0.06])


def test_at_rest_every_distance_counts():
    watch = followed(lambda t: line(min(t, 1.0)), 2.0)
    assert watch.away([0.51, -0.2], line(1.0)) == pytest.approx([0.01, 0.0])
    assert watch.away(line(1.0), line(1.0)) == pytest.approx([0.0, 0.0])


def test_a_way_that_was_somewhere_else_is_shifted_whole():
    watch = followed(line, 2.0)
    before = watch.away(line(1.2), line(2.0))
    watch.shift([-0.1, 0.0])
    shifted = watch.away([0.5 * 1.2 - 0.1, -0.2 * 1.2], [0.9, -0.4])
    assert shifted == pytest.approx(before)


def test_a_new_beginning_forgets_the_way():
    watch = followed(line, 2.0)
    watch.begin([0.0, 0.0], 2.0)
    assert watch.away([0.3, 0.0], [0.0, 0.0]) == pytest.approx([0.3, 0.0])
