"""Tables of tests/results/faults.md: equal to the measurements, and within the limits."""

import itertools
import math
import re

import pytest

from tests import fault_table
from tests.fault_benches import BENCHES
from tests.fault_scenarios import SCENARIOS

pytestmark = [pytest.mark.matrix, pytest.mark.timeout(1200)]

NEAR = (12.0, 0.6, 2.0, 0.15)
"""ms, mm, mm/s, m/s²: tolerance for the arithmetic of another computer."""


@pytest.fixture(scope="module")
def rows():
    return list(fault_table.rows())


def cells(markdown):
    """Return the text of each cell by (source, fault, column number)."""
    source, found = "", {}
    for line, below in itertools.pairwise([*markdown.splitlines(), ""]):
        if line.startswith("### "):
            source = line[4:]
        elif line.startswith("| ") and not below.startswith("|--"):
            fault, *texts = (part.strip() for part in line.strip("|").split("|"))
            found |= {(source, fault, n): text for n, text in enumerate(texts)}
    return found


def numbers(text):
    parts = text.strip("*").split(", ")
    return [math.inf if part == "continues" else float(part) for part in parts]


def assert_are(results, table):
    """Assert that the written table equals these results."""
    written, now = cells(results.read()), cells(table)
    assert now
    assert written.keys() == now.keys(), "make fault-table rewrites it"
    for key, text in now.items():
        if text == "–" or written[key] == "–":
            assert written[key] == text, key
            continue
        for old, new, near in zip(numbers(written[key]), numbers(text), NEAR, strict=True):
            assert old == new or abs(old - new) <= near, (key, written[key], text)


def test_what_is_written_is_what_is_measured(rows):
    assert_are(fault_table.RESULTS, fault_table.table(rows))


def test_every_source_fault_and_robot_is_there(rows):
    found = {(row.source, row.robot) for row in rows}
    assert found == {(source, kind.name) for source in SCENARIOS for kind in BENCHES}
    assert {row.fault for row in rows} == set(fault_table.FAULTS)


JUMP = "measured place jumps by 200 mm"


def too_much(rows):
    return [f"{r.source}, {r.fault}, {r.robot}: {r.too_much}" for r in rows if r.too_much]


def test_nothing_is_faster_or_harder_than_asked(rows):
    assert too_much(r for r in rows if r.fault != JUMP) == []


def test_a_measured_place_that_jumps_makes_nothing_faster_or_harder(rows):
    assert too_much(r for r in rows if r.fault == JUMP) == []


def test_what_stops_stops_soon(rows):
    """A fault that ends motion stops the arm within a second; a short stall need not."""
    for row in rows:
        if not re.search(r"stalls|late|jumps|^clock", row.fault):
            assert row.motion.stop_s < 1.0, row


def test_a_wrong_clock_ends_motion(rows):
    """2 % are no fault, MotoROS' clock is not used, and a slow one is certain only after 1 to 1.5
    s: tests/drivers/test_agreed_time.py."""
    for row in rows:
        other = row.robot.startswith("MotoROS") or row.fault.startswith("clock 1.02")
        if row.fault.startswith("clock") and other:
            assert math.isinf(row.motion.stop_s), row
        elif row.fault.startswith("clock"):
            slow = row.fault.startswith("clock 0.5")
            assert row.motion.stop_s < (1.7 if slow else 0.6), row
