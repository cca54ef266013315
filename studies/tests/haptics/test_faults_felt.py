"""Every fault during a press on a wall: the force stays within the limits, and ramps to zero in
time where force is forbidden."""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import pytest

from cardan.common.haptics import OperatingState
from studies.haptics.faults import FAULT_S, FAULTS, LIMITS, feel, table
from studies.haptics.loop import TICK_S

pytestmark = pytest.mark.matrix

BY_NAME = {fault.name: fault for fault in FAULTS}
SILENT = "commands stopped coming"


@functools.cache
def response_to(name):
    return feel(BY_NAME[name])


@pytest.mark.parametrize("name", BY_NAME)
def test_within_the_limits(name):
    one = response_to(name)
    assert one.before_n == pytest.approx(0.83, abs=0.02)
    assert one.most_n <= LIMITS.clamp_n
    assert one.rise_n_ms <= 1e-3 * LIMITS.slew_rise_n_s + 1e-9
    if not one.fault.device_cuts:
        assert one.fall_n_ms <= 1e-3 * LIMITS.slew_fall_n_s + 1e-9
    assert one.in_time
    assert np.linalg.norm(one.trace.rendered_n, axis=1).max() <= LIMITS.clamp_n + 0.003


@pytest.mark.parametrize("name", [fault.name for fault in FAULTS if fault.forbidden])
def test_what_forbids_force_has_it_at_zero_within_the_release_and_keeps_it_there(name):
    one = response_to(name)
    assert one.fault.forbidden in {reason for _, reason in one.trace.states}
    assert one.forbidden_s <= LIMITS.release_s + 1e-6
    assert not one._replace(forbidden_s=LIMITS.release_s + TICK_S).in_time
    assert not one._replace(forbidden_s=math.inf).in_time


def test_what_is_let_go_is_ended_by_the_energy_budget_alone():
    one = response_to("let go under 2 N")
    assert one.reasons[-1] == "enabled: limited to stay passive"
    assert one.trace.given_j[-1] == pytest.approx(LIMITS.energy_budget_j, rel=0.2)


@pytest.mark.parametrize("name", ["command source dead", "stamps frozen", "NaN in commands"])
def test_a_dead_source_is_a_ramp_of_5_ms(name):
    trace = response_to(name).trace
    sizes = np.linalg.norm(trace.sent_n, axis=1)
    silent = next(k for k, (_, reason) in enumerate(trace.states) if reason == SILENT)
    last_stamp_s = FAULT_S - 0.004
    assert trace.times_s[silent] - last_stamp_s == pytest.approx(LIMITS.hold_s, abs=2.5 * TICK_S)
    ramp = sizes[silent - 1 :]
    zero = int(np.argmax(ramp == 0.0))
    assert 1 < zero <= round(LIMITS.release_s / TICK_S)
    assert np.all(np.diff(ramp[: zero + 1]) < 0.0)
    assert not ramp[zero:].any()
    assert response_to(name).after.state is OperatingState.PAUSED


@pytest.mark.parametrize(
    ("name", "state", "reason"),
    [
        ("comm error", OperatingState.FAULT, "the device is lost"),
        ("unplugged", OperatingState.FAULT, "the device is lost"),
        ("NaN as position", OperatingState.FAULT, "a number was not finite"),
        ("thrown along the wall", OperatingState.FAULT, "moved too fast"),
        ("calibration lost", OperatingState.ENABLED, "not calibrated"),
        ("docked", OperatingState.ENABLED, "inkwell"),
        ("ticks at 200 Hz", OperatingState.ENABLED, "too slow"),
        ("warm motors", OperatingState.ENABLED, "too large to engage"),
        ("over-force", OperatingState.ENABLED, "too large to engage"),
    ],
)
def test_no_force_afterwards_and_why(name, state, reason):
    one = response_to(name)
    assert one.after.state is state
    assert reason in one.after.reason
    assert not one.again
    assert not one.trace.sent_n[-1].any()


def test_after_a_tick_that_comes_5_ms_late_the_force_comes_back_by_ramp_but_not_for_ever():
    one = response_to("ticks 5 ms late")
    assert one.after.late_ticks == 10
    reasons = [reason for reason, _ in itertools.groupby(reason for _, reason in one.trace.states)]
    first = reasons.index("the tick was late")
    assert reasons[first + 1] == "engaging"
    assert one.after.state is OperatingState.PAUSED
    assert "too irregular" in one.after.reason
    assert not one.trace.sent_n[-1].any()


def test_ticks_that_come_30_ms_late_pause_it():
    states = {state for state, _ in response_to("ticks 30 ms late").trace.states}
    assert OperatingState.PAUSED in states
    assert not response_to("ticks 30 ms late").trace.sent_n[-1].any()


@pytest.mark.parametrize(
    "name", ["jitter 500 µs", "measured force 1 s late", "commands out of order", "button bounces"]
)
def test_what_is_not_felt_at_all(name):
    one = response_to(name)
    assert one.most_n - one.before_n < 0.02
    assert np.linalg.norm(one.trace.sent_n[-1]) == pytest.approx(one.before_n, abs=0.02)
    assert np.abs(one.trace.sent_n[:, 1]).max() < 0.02


def test_one_press_of_a_bouncing_button_is_one_press():
    assert response_to("button bounces").after.presses == (1, 0)


@pytest.mark.parametrize(
    "name",
    ["wall jumps 20 mm", "scale × 5", "recaptured 20 mm off", "measured force steps to 50 N"],
)
def test_a_step_in_what_is_commanded_is_a_ramp_in_the_hand(name):
    one = response_to(name)
    assert one.most_n > 1.5
    assert one.rise_n_ms == pytest.approx(1e-3 * LIMITS.slew_rise_n_s, rel=1e-6)


def test_the_table_has_them_all():
    lines = table([response_to(name) for name in BY_NAME]).splitlines()
    assert len(lines) == len(FAULTS) + 2
    assert all(line.count("|") == 6 for line in lines)
