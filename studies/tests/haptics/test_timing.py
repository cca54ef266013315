"""Parts of the timing study that need no clock: the probe, the law alone, and the tables."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from studies.haptics import timing, zwidth
from studies.haptics.faults import FAULTS
from studies.haptics.stability import PUSHES, link_words

pytestmark = pytest.mark.matrix

PAGE = Path(__file__).parents[3] / "docs" / "stability.md"


@pytest.fixture(scope="module")
def probe(tmp_path_factory):
    return timing.compile_probe(tmp_path_factory.mktemp("probe"))


@pytest.mark.parametrize("fixtures", [1, 8])
def test_the_law_alone_is_timed_while_it_renders(probe, fixtures):
    costs = timing.law_alone(probe, fixtures, batches=80)
    assert costs.shape == (60 * 16,)
    assert np.all(costs > 0.0)


def test_the_age_ends_with_the_first_frame_whose_force_follows():
    ticks = np.zeros(6, timing._TICK)
    ticks["begin_s"] = 1e-3 * np.arange(6)
    ticks["sent_s"] = ticks["begin_s"] + 5e-6
    ticks["force_n"][4:, 2] = 0.05
    assert timing._first_change(ticks, 2.5e-3) == pytest.approx(4.005e-3)
    assert math.isnan(timing._first_change(ticks, 4.5e-3))


def test_how_busy_the_machine_was_is_said():
    assert re.match(r"Load in the minute before: \d+\.\d on \d+ processors", timing.load_words())


def test_the_tables():
    found = [
        timing.Evenness(what, load, fifo, True, np.full(10, 5e-5), np.full(10, 3e-6), 1000.0)
        for what in ("compiled", "Python")
        for load in timing.LOADS
        for fifo in (False, True)
    ]
    lines = timing.evenness_table(found).splitlines()
    assert len(lines) == 14
    assert "| **compiled** | idle | FIFO | 50 / 50 / 50 | 1000 Hz | 3.0 / 3.0 |" in lines
    ages = np.full(10, 1e-3)
    words = timing.verdicts(found, np.full(10, 1e-6), ages, ages, 7e-3)
    assert words.count(": met") == 5
    assert words.count("**missed**") == 1
    width = zwidth.Width(0.5, 0.0, 400.0, 302.0, 393.0, 427.0, 2309.0, 564.0, 733.0, 0.012, 0.1138)
    assert zwidth.table([width]).splitlines()[2].startswith("| 0.5 N·s/m | 0 | 400 | 302 | 393 |")
    assert zwidth.table([width]).endswith("| 2309 | 564 | 733 | 12.0 mJ | 113.8 mJ |")


def test_the_page_has_every_fault_and_everything_that_is_pushed():
    page = PAGE.read_text(encoding="utf-8")
    rows = set(re.findall(r"^\| ([^|]+) \|", page, re.MULTILINE))
    assert {fault.name for fault in FAULTS} <= rows
    for push in PUSHES:
        for stiffness, link in (push.calm, push.pushed):
            row = f"| {push.name} | {push.hand.name} | {stiffness:.0f} | {link_words(link)} |"
            assert row in page
