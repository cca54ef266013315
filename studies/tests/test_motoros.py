"""The latency study: its arithmetic on synthetic motion, and its result in virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from bench import yaskawa
from cardan.gateway.session.snapshot import Snapshot
from cardan.types import JointCommand
from studies.motoros import recording as study
from studies.motoros.analysis import analyze
from studies.motoros.published import (
    STANDARD,
    STANDARD_MEAN,
    VELOCITY,
    VELOCITY_MEAN,
    mean,
)
from studies.motoros.recording import GRID_S, PUSH_S, Recording
from studies.motoros.two_point import TwoPointSession
from tests.drivers.motoros_bench import SessionBench

pytestmark = pytest.mark.matrix

FIRST_S = 1.0
SPEED = 0.3


def swung(times_s, pushes=2):
    """Joint 1 driven by alternating forward and backward pushes, rad."""
    position = np.zeros_like(times_s)
    for push in range(pushes):
        sign = 1.0 if push % 2 == 0 else -1.0
        since = np.clip(times_s - FIRST_S - push * PUSH_S, 0.0, study.HOLD_S + study.RAMP_S)
        ramp = study.RAMP_S
        up = np.minimum(since, ramp)
        down = np.clip(since - study.HOLD_S, 0.0, ramp)
        path = up**2 / (2 * ramp) + np.maximum(since - ramp, 0.0) - down**2 / (2 * ramp)
        position = position + sign * SPEED * path
    return position


def recording(mode, plant, device, goal, command, measured, times_s, pushes=2):
    starts = FIRST_S + PUSH_S * np.arange(pushes)
    return Recording(mode, plant, times_s, device, goal, command, measured, starts, Snapshot())


def test_delays_of_made_up_motion():
    times_s = np.arange(0.0, FIRST_S + 2 * PUSH_S + 2.0, GRID_S)

    def late(delay_s):
        return 0.8 * swung(times_s - delay_s)

    made = recording(
        "velocity", "ideal", swung(times_s), late(0.02), late(0.05), late(0.3), times_s
    )
    result = analyze(made)
    assert len(result.phases) == 2
    for phase in result.phases:
        assert phase.delays == pytest.approx((0.02, 0.28, 0.30), abs=0.002)
        assert phase.device_to_command_s == pytest.approx(0.05, abs=0.002)
        assert phase.correlated_total_s == pytest.approx(0.30, abs=0.002)
        assert phase.stops == 0
    assert result.mean == pytest.approx((0.02, 0.28, 0.30), abs=0.002)


def test_stops_are_counted_and_a_joint_that_does_not_move_is_reported():
    times_s = np.arange(0.0, FIRST_S + 2 * PUSH_S + 2.0, GRID_S)
    path = swung(times_s)
    stairs = np.round(path / 0.1) * 0.1
    smooth = np.convolve(np.pad(stairs, 10, "edge"), np.ones(21) / 21, "valid")
    result = analyze(recording("standard", "ideal", path, path, smooth, smooth, times_s))
    assert result.stops >= 4
    assert result.stopped_s > 0.5
    with pytest.raises(ValueError, match=r"moved 0\.0000 rad"):
        analyze(recording("standard", "ideal", path, path, path, 0.0 * path, times_s))


def test_the_published_averages_are_those_of_the_published_phases():
    assert mean(STANDARD) == pytest.approx(STANDARD_MEAN, abs=6e-4)
    assert mean(VELOCITY) == pytest.approx(VELOCITY_MEAN, abs=6e-4)


class TwoPointBench(SessionBench):
    """Bench for two-point trajectories."""

    kind_of_session = TwoPointSession


def in_virtual_time(mode, plant):
    """Driver and controller connected by their bytes; the goal is the path of the device."""
    goals = []
    begin_s = 0.0

    def answer(state):
        at_s = state.stamp_s - begin_s + state.period_s
        here, before = (float(swung(np.array([t]))[0]) for t in (at_s, at_s - state.period_s))
        goals.append((state.stamp_s, here))
        rate = (here - before) / state.period_s if state.period_s else 0.0
        return JointCommand((start + here, *rest), (rate, 0.0, 0.0, 0.0, 0.0, 0.0))

    kind, known = (TwoPointBench, "stream") if mode == "standard" else (SessionBench, mode)
    bench = kind({"mode": known}, answer, plant=plant, velocity_mode=mode == "velocity")
    start, *rest = bench.controller.measured_rad(0)
    begin_s = bench.now_s + 1e6
    bench.ready()
    begin_s = bench.now_s
    bench.run(FIRST_S + 2 * PUSH_S + 0.6)
    rows = np.array(bench.trace)
    goal_s, goal = np.array(goals).T
    times_s = np.arange(begin_s, bench.now_s - 0.1, GRID_S)
    return analyze(
        recording(
            mode,
            plant,
            swung(times_s - begin_s),
            np.interp(times_s, goal_s, goal),
            np.interp(times_s, rows[:, 0], rows[:, 1]),
            np.interp(times_s, rows[:, 0], rows[:, 2]),
            times_s - begin_s,
        )
    )


@pytest.fixture(scope="module")
def results():
    return {
        (mode, plant): in_virtual_time(mode, plant)
        for mode in study.MODES
        for plant in study.PLANTS
    }


def test_the_order_of_the_paper_comes_out(results):
    standard = results["standard", "paper"]
    low, high = yaskawa.GOAL_RANGE_S
    assert low <= standard.mean.goal_to_measured <= high
    assert standard.stops > 4
    for plant, lag_s in (("paper", 0.268), ("ideal", 0.004)):
        velocity, stream = results["velocity", plant], results["stream", plant]
        assert velocity.stops == stream.stops == 0
        assert velocity.mean.total < stream.mean.total < results["standard", plant].mean.total
        assert velocity.mean.total - lag_s < 0.015
        assert stream.mean.total - lag_s < 0.040
    assert results["velocity", "paper"].mean.total < VELOCITY_MEAN.total
    assert results["velocity", "ideal"].average("device_to_command_s") <= yaskawa.ADDED_AT_MOST_S


def test_the_tables_say_so(results):
    words = yaskawa.verdicts(results)
    assert "MISSED" not in words
    assert words.count("met") == 5
    table = yaskawa.compared("Table 2", VELOCITY, results["velocity", "paper"])
    assert "phase 2" in table
    assert "average" in table
    assert "0.445" in table
    assert len(yaskawa.overview(list(results.values())).splitlines()) > 8


def test_a_recording_that_misses_a_push_is_none():
    times_s = np.arange(0.0, 12.0, GRID_S)
    rows = {"monotonic_s": times_s, "command_joint_1_s": times_s, "measured_joint_1_s": times_s}
    goals = [(float(t), float(t)) for t in times_s]

    def on_a_grid(start_s, pushes=1):
        reports = [(0.0, 0.0), (start_s, 0.8), (start_s + 2.0, 0.0)]
        snapshot = Snapshot()
        return study._on_a_grid("velocity", "ideal", snapshot, reports, goals, rows, pushes)

    assert on_a_grid(3.0).pushes == pytest.approx([3.0])
    with pytest.raises(ValueError, match="0 pushes were seen, of 1"):
        on_a_grid(0.5)
    with pytest.raises(ValueError, match="1 pushes were seen, of 2"):
        on_a_grid(3.0, 2)
    goals = []
    with pytest.raises(ValueError, match="said nothing"):
        on_a_grid(3.0)
