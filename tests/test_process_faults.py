"""Cases from the fault table of whole programs; `make fault-table-processes` runs all of them."""

import numpy as np
import pytest

from tests.process_faults.cases import GOFA, SHORT, all_cases
from tests.process_faults.lab import PAIRS, Motion, Trace
from tests.process_faults.table import RESULTS, Row, judged, notes_of, run, tables

pytestmark = pytest.mark.matrix  # whole programs that move arms

CASES = {case.key: case for case in all_cases()}


def test_the_table_has_what_was_promised():
    assert len(CASES) >= 80
    assert {case.pair for case in CASES.values()} == set(PAIRS)
    assert len(PAIRS) == 5
    assert set(SHORT) <= set(CASES)
    assert RESULTS.read().startswith(f"{len(CASES)} of the {len(CASES)} cases")


@pytest.fixture(scope="module")
def rows():
    return {row.key: row for row in run([CASES[key] for key in SHORT], labs=2)}


@pytest.mark.timeout(400)  # the first one waits for all rows
@pytest.mark.parametrize("key", SHORT)
def test_what_the_arm_did(rows, key):
    assert rows[key].wrong == [], rows[key]


STOPPED = Motion(0.1, 0.2, 0.02, 0.1, 0.0)


@pytest.mark.parametrize(
    ("name", "motion", "lost", "wrong"),
    [
        ("session: SIGKILL", STOPPED, 0, []),
        ("session: SIGKILL", STOPPED._replace(again_m_s=0.05), 0, ["again by itself at 50 mm/s"]),
        ("session: SIGKILL", STOPPED._replace(stop_s=None), 0, ["went on"]),
        ("session: SIGKILL", STOPPED._replace(stop_s=3.0), 0, ["3.00 s to rest"]),
        ("session: SIGKILL", STOPPED._replace(peak_m_s=0.15), 0, ["150 mm/s"]),
        ("session: SIGKILL", STOPPED, 2, ["2 events"]),
        ("daemon: disk full", STOPPED._replace(stop_s=None), 2, []),
        ("daemon: disk full", STOPPED, 0, ["stopped"]),
    ],
)
def test_what_is_wrong_is_said(name, motion, lost, wrong):
    said = judged(CASES[f"{name} ({GOFA})"], motion, lost)
    assert len(said) == len(wrong)
    assert all(words in each for words, each in zip(wrong, said, strict=True))


def trace_of(speeds, gone_s=None):
    """Return the trace of an arm with these speeds, m/s, each for 0.1 s; from `gone_s` on another
    process of its robot is at another position."""
    trace, place = Trace(), 0.0
    trace.begin()
    for index in range(25 * len(speeds)):
        now_s = 0.004 * index
        if gone_s is not None and now_s >= gone_s and len(trace.begins) == 1:
            trace.begin()
            place = 5.0
        trace.add(now_s, np.array([place, 0.0, 0.0]))
        place += 0.004 * speeds[index // 25]
    return trace, 0.1 * len(speeds)


def test_an_arm_that_stops():
    trace, end_s = trace_of([0.1] * 5 + [0.05] + [0.0] * 10)
    motion = trace.motion(0.4, end_s)
    assert motion.had_m_s == pytest.approx(0.1, rel=0.05)
    assert motion.stop_s == pytest.approx(0.2, abs=0.01)
    assert motion.distance_m == pytest.approx(0.015, abs=1e-3)
    assert motion.peak_m_s == pytest.approx(0.1, rel=0.05)
    assert not motion.again


def test_an_arm_that_goes_on():
    trace, end_s = trace_of([0.1] * 15)
    assert trace.motion(0.4, end_s).stop_s is None


def test_an_arm_that_is_moved_again():
    trace, end_s = trace_of([0.1] * 5 + [0.0] * 8 + [0.1] * 4)
    motion = trace.motion(0.4, end_s)
    assert motion.stop_s == pytest.approx(0.1, abs=0.01)
    assert motion.again


def test_an_arm_whose_robot_has_another_process():
    trace, end_s = trace_of([0.1] * 5 + [0.0] * 10, gone_s=0.42)
    motion = trace.motion(0.4, end_s)
    assert motion.distance_m == pytest.approx(0.002, abs=1e-3)
    assert motion.peak_m_s < 0.11
    assert not motion.again


def test_the_tables_say_what_was_found():
    row = Row(
        "session: SIGKILL (x)", "session", "SIGKILL", "x", "stops", 0.1, 0.1, 0.2, 0.02, 0.1,
        False, "it ended", 3.0, 1.0, ["daemon"], 0, [],
    )  # fmt: skip
    found = {"rows": [row._asdict()], "labs": 2, "processors": 4, "loads": [3.0, 12.0]}
    text = tables([row], notes_of(found))
    assert "1 of the " in text
    assert "; 0 failed" in text
    assert "load of the computer from 3 to 12" in text
    assert "| SIGKILL | x | 200, 20.0, 100 | no | it ended |" in text
    assert "session back after 3.0 s, daemon started by hand, re-arm |" in text
    assert "**200, 20.0, 100**" in tables([row._replace(wrong=["went on"])], "")
