"""Tables and figures of each study from known results: virtual time, or synthetic recordings."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path

import pytest

from cardan.demos.demo import choose_demo
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.snapshot import BOUNDS_S, Snapshot
from cardan.gateway.session.supervisor import SessionExit
from cardan_omni.driver.limits import TickLimits
from studies.cartesian import study as cartesian
from studies.cartesian.command import Delays
from studies.devices import arms, sessions
from studies.haptics import drawing, study as haptics
from studies.haptics.stability import PUSHES, compare
from studies.motoros import study as motoros
from studies.motoros.analysis import PushDelays, Result
from studies.motoros.published import STANDARD, STANDARD_MEAN, VELOCITY, Delays as Stages
from studies.studies import STUDIES
from studies.thesis import study as thesis
from studies.thesis.line import simulated

pytestmark = pytest.mark.matrix


def by_name(figures):
    found = {figure.name: figure for figure in figures}
    assert len(found) == len(figures), "duplicate name"
    return found


def cells(table):
    """Cells of a table by the first cell of each row."""
    assert {len(row) for row in table.rows} == {len(table.columns)}
    return {row[0]: row[1:] for row in table.rows}


def test_every_study_can_be_imported_and_says_where_it_was_published():
    for study in STUDIES.values():
        assert study.source
        assert __import__(study.module, fromlist=["run"]).run


# -- thesis ------------------------------------------------------------------------------------


def test_the_thesis_has_the_published_beside_ours(short_thesis):
    whole = short_thesis._replace(others=simulated(0.5))
    tables = dict(thesis.tables(whole))
    assert len(tables) == 5
    line = {row.what: row for row in tables["Straight line, UR5"]}
    assert line["no arm: published mechanism"].ideal.endswith(" 349 ms")
    made = thesis._table("line", tables["Straight line, UR5"])
    found = cells(made)["x, relative: delay by correlation / least error"]
    assert found[0] == "350 ms"
    assert found[-1] in ("met", "MISSED")


def test_figures_of_the_thesis(short_thesis):
    found = by_name(thesis.figures(short_thesis))
    delay = found["line along x, relative: delay, ideal"]
    assert (delay.unit, delay.published, delay.spread) == ("ms", 350.0, 2.0)
    assert 0.0 < delay.value < 30.0
    wall = found["poses into a wall: least clearance, dynamic"]
    assert (wall.unit, wall.better) == ("mm", "more")
    assert wall.value == pytest.approx(10.0, abs=0.2)
    assert found["free motion, Cartesian device: refused poses, ideal"].value == 0.0


def test_a_shorter_turn_has_its_own_aim(short_thesis):
    free = dict(thesis.tables(short_thesis))["Arbitrary movements, PR2's right arm"]
    aims = {row.aim for row in free if "turns forward" in row.what}
    assert aims == {"> 0.1, 0, 0"}


# -- MotoROS -----------------------------------------------------------------------------------


def phase(shift_s=0.0):
    return PushDelays(Stages(0.01, 0.55 + shift_s, 0.56 + shift_s), 0.0, 0.3, 0.5, 4, 0.7)


def test_motoros_has_the_papers_phases_beside_ours():
    runs = [
        Result("standard", "paper", (phase(), phase(0.04))),
        Result("velocity", "paper", (phase(),)),
        Result("velocity", "ideal", (phase(),)),
    ]
    standard, velocity, overview = motoros.tables(runs)
    assert "standard driver" in standard.title
    assert cells(standard)["phase 2"] == ("0.235", "0.010", "0.545", "0.590", "0.780", "0.600")
    assert cells(standard)["phase 3"][1] == "–"
    assert cells(standard)["average"][0] == f"{STANDARD_MEAN.device_to_goal:.3f}"
    assert cells(velocity)["phase 1"][0] == f"{VELOCITY[0].device_to_goal:.3f}"
    assert len(standard.rows) == len(STANDARD) + 1
    assert len(overview.rows) == 3


def test_figures_of_motoros_vary_as_their_phases_do():
    twice = Result("standard", "paper", (phase(), phase(0.04)))
    once = Result("velocity", "ideal", (phase(),))
    found = by_name(motoros.figures([twice, once]))
    total = found["two-point trajectories, paper plant: total"]
    assert (total.value, total.spread, total.published) == pytest.approx((580.0, 40.0, 780.0))
    assert found["two-point trajectories, paper plant: device to goal"].spread == 10.0
    total = found["velocity mode, ideal plant: total"]
    assert (total.spread, total.published) == (None, None)


def test_a_run_that_does_not_move_is_tried_again(monkeypatch):
    tried = []

    def record(mode, plant, pushes):
        tried.append(mode)
        raise ValueError("0 pushes were seen, of 1")

    monkeypatch.setattr(motoros, "record", record)
    with pytest.raises(RuntimeError, match="velocity mode, paper plant, tried 3 times: 0 pushes"):
        motoros.measure([("velocity", "paper")], 1)
    assert len(tried) == motoros.TRIES


# -- devices -----------------------------------------------------------------------------------


def test_an_arm_follows_both_kinds_of_commands():
    moved = [arms.move("ur5", commands) for commands in ("velocity", "position")]
    for each in moved:
        assert each.reached_m == pytest.approx(arms.LENGTH_M, abs=1e-3)
        assert 0.0 <= each.delay_s < 0.05
        assert each.refusals == 0
        assert each.drop_m < 1e-3
    assert cells(arms.table(moved))["ur5"][0] == "–"
    assert by_name(arms.figures(moved))["ur5, position: delay"].value < 50.0


def test_a_device_is_shown_by_its_last_run():
    last = Snapshot.of(
        {
            "loop": {
                "cycles": 1000,
                "tick_p50_s": 2e-4,
                "tick_p99_s": 4e-4,
                "inputs": 1000,
                "input_age_sum_s": 5.0,
                "input_age_within": [100 * n for n in range(1, 10)],
            },
            "tracking": {"path_m": 0.1, "error_rms_m": 0.001, "error_max_m": 0.002},
        }
    )
    slower = dataclasses.replace(
        last,
        loop=dataclasses.replace(last.loop, tick_p50_s=3e-4),
        arm=dataclasses.replace(last.arm, trips=1),
    )
    leap = sessions.PUBLISHED[1]
    driven = [sessions.Driven(leap, "position, base", (last, slower), ("late", "late"))]
    row = cells(sessions.table(driven))["Leap Motion"]
    assert row[:3] == ("position, base", "position, base", "100 mm")
    assert row[4:6] == ("5.0 ms", "300 / 400 µs")
    assert row[-1] == "late"
    assert sessions.within(last)[0] == (BOUNDS_S[0], 0.1)
    found = by_name(sessions.figures(driven))
    assert found["Leap Motion: answer, median"].value == pytest.approx(250.0)
    assert found["Leap Motion: answer, median"].spread == pytest.approx(100.0)
    assert found["Leap Motion: disengaged"].value == 1.0
    once = [sessions.Driven(leap, "position, base", (last,), ())]
    assert by_name(sessions.figures(once))["Leap Motion: answer, median"].spread is None


def test_a_device_moves_for_as_long_as_its_demo_needs(monkeypatch):
    lengths = []

    def supervise(config, seconds, **_):
        lengths.append(seconds)
        return SessionExit(0, Snapshot.of({"loop": {"cycles": 1}, "tracking": {"path_m": 0.1}}))

    @contextlib.contextmanager
    def hardware(demo, seconds):
        yield parse_config(demo.prepare(Path("nowhere"))[0]), ()

    monkeypatch.setattr(sessions, "supervise", supervise)
    monkeypatch.setattr(sessions, "simulated_hardware", hardware)
    found = sessions.measure((sessions.PUBLISHED[1], sessions.Device("x", "spnav-ur5")), 5.0, 1)
    least_s = choose_demo("spnav-ur5").shortest_s
    assert least_s > 5.0
    assert lengths == [5.0, least_s]
    assert [each.commands for each in found] == ["position, base", "velocity, base"]
    assert [each.problems for each in found] == [(), ()]


# -- the Cartesian interface -------------------------------------------------------------------


def test_latencies_vary_as_their_blocks_do():
    slow = [0.002] * 80 + [0.004] * 20
    found = {"Zenoh": Delays([0.001] * 100, [1] * 100, 0), "DDS": Delays(slow, [2] * 100, 3)}
    (table,) = cartesian.tables(found)
    assert cells(table)["DDS"][0] == "2.00 ms"
    assert cells(table)["DDS"][2] == "2.00"
    figures = by_name(cartesian.figures(found))
    assert figures["DDS: median"].value == pytest.approx(2.0)
    assert figures["DDS: median"].spread == pytest.approx(2.0)
    assert figures["Zenoh: p99"].spread == 0.0
    assert figures["DDS: commands lost"].value == 3.0


# -- haptics -----------------------------------------------------------------------------------


def test_drawing_and_a_push_that_only_the_plain_loop_does_not_survive():
    push = PUSHES[0]
    pushed = [(push, compare(push.hand, *push.calm), compare(push.hand, *push.pushed))]
    last = Snapshot.of(
        {
            "elapsed_s": 10.0,
            "scheduling": "ordinary",
            "loop": {"cycles": 2500},
            "contact": {"path_m": 0.05},
            "force": {"peak_n": 0.8},
        }
    )
    drawn = drawing.Drawing(last, TickLimits().energy_budget_j, ("it was late",))
    draw, loops = haptics._tables(pushed, drawn, None, None)
    assert cells(draw)["robot's cycle"] == ("4 ms", "4.00 ms")
    assert cells(draw)["the same, p99"] == ("–", "–")
    assert "it was late" in draw.note
    calm, hard = loops.rows
    assert calm[4].startswith("0.")
    assert hard[4].startswith("**")
    found = by_name(haptics._figures(pushed, drawn, None, None))
    ours, plain = (
        found[f"push 1, stiffness, lightly held: energy, {loop}"] for loop in ("ours", "plain")
    )
    assert ours.value < 1e3 * drawn.budget_j < plain.value
    assert (ours.better, plain.better) == ("less", "")
    assert found["drawing: age of the force, p99"].value is None
