"""Benchmark of a session at 1 kHz: its programs, and its place in the docs."""

import signal
from pathlib import Path

import pytest

from bench import kilohertz, pages
from bench.kilohertz import Floor, Row
from bench.sessions.crowd import compiler

FLOOR = Floor(60000, 2, 40000, 90000)
GOOD = Row("nothing", 30e-6, 60e-6, 150e-6, 280e-6, 60000, 0, 0.35, 0.7, "real time", FLOOR)


def test_the_session_is_one_at_1_khz_with_all_pairs(tmp_path):
    config = kilohertz.configuration(str(tmp_path / "mouse"))
    assert config.robot.options["period_s"] == 0.001
    assert kilohertz.pairs(config) >= kilohertz.PAIRS


def test_the_aim_is_both_of_its_halves():
    rows = [GOOD, GOOD._replace(missed=1), GOOD._replace(late_p99_s=101e-6)]
    verdicts = [line.split("|")[7].strip() for line in kilohertz.table(rows, "").splitlines()[2:5]]
    assert verdicts == ["met", "missed", "missed"]


def test_the_page_has_a_place_for_it():
    page = Path(kilohertz.PAGE).read_text("utf-8")
    body = kilohertz.table([GOOD], "conditions")
    assert body in pages.replaced(page, kilohertz.PART, body)


def test_busy_processes_end():
    with kilohertz.busy(2) as processes:
        assert [each.poll() for each in processes] == [None, None]
    assert [each.returncode for each in processes] == [-signal.SIGKILL] * 2


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_a_bare_loop_in_c_is_the_floor():
    floor = kilohertz.measure_floor(0.05)
    assert floor.instants == 50
    assert 0 <= floor.missed <= 50
    assert 0 <= floor.p50_ns <= floor.p99_ns
