"""Metrics against signals with a known delay."""

import numpy as np
import pytest

from studies.metrics import (
    delay_by_correlation,
    delay_by_least_error,
    delays_per_command,
    errors,
    stop_phases,
)

DT_S = 0.002
TIMES_S = np.arange(0.0, 6.0, DT_S)


def wave(times_s):
    return np.stack((np.sin(2.0 * times_s), 0.5 * np.cos(3.1 * times_s), 0 * times_s), axis=1)


@pytest.mark.parametrize("delay_s", [0.0, 0.031, 0.35])
def test_a_shifted_motion_has_that_delay(delay_s):
    commanded, measured = wave(TIMES_S), wave(TIMES_S - delay_s)
    for measure in (delay_by_correlation, delay_by_least_error):
        assert measure(DT_S, commanded, measured, 1.0) == pytest.approx(delay_s, abs=DT_S)
    found = errors(DT_S, commanded, measured, delay_s)
    assert found.max_without_delay_m < 4e-3
    assert delay_s <= found.max_m <= 3.0 * delay_s


def test_a_ramp_reaches_each_command_after_the_delay():
    times = np.arange(0.2, 3.0, 0.05)
    commands = 0.1 * times[:, None]
    measured = 0.1 * (TIMES_S - 0.12)[:, None]
    found = delays_per_command(times, commands, TIMES_S, measured, 1.0)
    assert found == pytest.approx(np.full(len(times), 0.12), abs=DT_S)


def test_a_command_never_reached_has_no_delay():
    found = delays_per_command(
        np.array([1.0]), np.array([[5.0]]), TIMES_S, 0.0 * TIMES_S[:, None], 1.0
    )
    assert np.isnan(found).all()


def test_stops_inside_a_motion_are_counted_once_each():
    commanded = 0.1 * TIMES_S[:, None]
    stopped = commanded.copy()
    for start_s in (1.0, 3.0):
        inside = (start_s <= TIMES_S) & (start_s + 0.3 > TIMES_S)
        stopped[inside] = stopped[inside][0]
    found = stop_phases(TIMES_S, commanded, stopped)
    assert found.count == 2
    assert found.total_s == pytest.approx(0.6, abs=0.02)
    assert stop_phases(TIMES_S, commanded, commanded).count == 0


def test_motion_of_axes_at_rest_is_leakage():
    commanded = np.stack((0.1 * TIMES_S, 0.0 * TIMES_S), axis=1)
    measured = commanded + np.stack((0 * TIMES_S, 0.003 * np.sin(TIMES_S)), axis=1)
    assert errors(DT_S, commanded, measured, 0.0).leakage_m == pytest.approx(0.003, rel=1e-2)
