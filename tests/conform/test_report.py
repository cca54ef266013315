"""Reports in all formats, read back, compared, and without users' private data."""

from __future__ import annotations

import dataclasses
import json
from xml.etree import ElementTree

import pytest

from cardan.conform import Level, VerdictOutcome, registry
from cardan.conform.comparison import as_text, compare
from cardan.conform.redaction import Redaction
from cardan.conform.report import read
from cardan.conform.requirements import (
    Requirements,
    Words,
    failed,
    not_applicable,
    not_seen,
    passed,
)
from cardan.conform.run import simulated
from cardan.errors import ConfigurationError


def easier(first, second):
    """Return the ids of the requirements that a simulated peer meets more easily than real
    hardware."""
    marks = compare(first, second)
    return tuple(each.id for each in marks if each.remark.startswith("THE SIMULATED PEER"))


@pytest.fixture(scope="module")
def good():
    return simulated(registry.load("3dconnexion"), Level.HOLD)[0]


@pytest.fixture(scope="module")
def bad():
    return simulated(registry.load("3dconnexion"), Level.HOLD, {"unknown-id": 10.0})[0]


def test_text_says_what_failed_and_shows_it(bad):
    text = bad.as_text()
    assert "FAIL HID3D-003" in text
    assert "source: report descriptors" in text
    assert ": 2a" in text
    assert "1 failed" in text
    assert "simulated spacemouse with unknown-id=10" in text


def test_markdown_is_a_table_with_a_row_for_each(bad):
    rows = [line for line in bad.as_markdown().splitlines() if line.startswith("| HID3D-")]
    assert len(rows) == len(bad.results)
    assert all(line.count(" | ") == 4 for line in rows)


def test_json_reads_back(bad):
    assert read(bad.as_json(), "report.json") == bad
    assert json.loads(bad.as_json())["results"][2]["outcome"] == "failed"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no report"),
        ("[]", "no report"),
        ('{"form": 2}', "format 2; this version reads 1"),
        ('{"form": 1}', "no report"),
        ('{"form": 1, "results": 5}', "no report"),
        ('{"version": "1"}', r"format json`: it has no 'form'"),
        ('{"form": 1, "suite": "egm", "results": []}', r"format json`: it has no 'judges'"),
        ('{"form": 1, "suite": "egm", "results": [3]}', r"a value of it is of another kind"),
        ("[" * 100_000, "no report"),
    ],
)
def test_what_is_no_report_is_said_to_be_none(text, why):
    with pytest.raises(ConfigurationError, match=why):
        read(text, "it.json")


def test_a_failure_that_a_late_computer_can_have_made_is_not_judged():
    requires = Requirements("X")

    @requires(1, "the manual", late_s=0.1)
    def on_time(_decoded):
        """It answers in time."""
        return failed("after 70 ms")

    @requires(2, "the manual")
    def whole(_decoded):
        """It is whole."""
        return failed("cut")

    late, other = requires.all()
    assert late.verdict(None, 0.1) == failed("after 70 ms")
    found = late.verdict(None, 0.2)
    assert found.outcome is VerdictOutcome.NOT_SEEN
    assert found.said == "not judged: this computer was late by 200 ms; after 70 ms"
    assert other.verdict(None, 9.0) == failed("cut")


def test_a_judge_may_yield_what_it_finds_of_each_thing():
    requires = Requirements("X", "no numbers came")

    @requires(1, "the manual")
    def small(decoded):
        """They are below 5."""
        if "words" in decoded:
            return not_applicable("those are words")
        for number, each in enumerate(decoded):
            yield number, f"{each} is too large" if each > 4 else ""
        return Words("{} numbers")

    @requires(2, "the manual")
    def most_are_small(decoded):
        """Two in three are below 5."""
        for number, each in enumerate(decoded):
            yield number, f"{each} is too large" if each > 4 else ""
        return Words("{} numbers, {} large", not_applicable("it has none"), "numbers", few=0.34)

    first, second = requires.all()
    assert first.text == "They are below 5."
    assert first.verdict([1, 2], 0.0) == passed("2 numbers")
    assert first.verdict([1, 7, 9], 0.0) == failed("2 of 3: 7 is too large", [1, 2])
    assert first.verdict([], 0.0) == not_seen("no numbers came")
    assert first.verdict(["words"], 0.0) == not_applicable("those are words")
    assert second.verdict([1, 7, 2], 0.0) == passed("3 numbers, 1 large")
    assert second.verdict([1, 7], 0.0) == failed("1 of 2 numbers: 7 is too large", [1])
    assert second.verdict([], 0.0) == not_applicable("it has none")


def test_junit_has_a_case_for_each(bad):
    root = ElementTree.fromstring(bad.as_junit())
    assert len(root) == len(bad.results) == int(root.get("tests"))
    failures = [each.get("name") for each in root if each.find("failure") is not None]
    assert len(failures) == int(root.get("failures")) == len(bad.failed)
    assert failures[0].startswith("HID3D-003 ")
    skipped = [each for each in root if each.find("skipped") is not None]
    assert len(skipped) == int(root.get("skipped"))


def real(report, **changed):
    return dataclasses.replace(report, simulated=False, target="host-1", **changed)


def test_a_simulated_peer_that_is_easier_is_marked(good, bad):
    assert easier(good, real(bad)) == ("HID3D-003",)
    assert easier(real(bad), good) == ("HID3D-003",)
    text = as_text(good, real(bad))
    assert "THE SIMULATED PEER IS EASIER" in text
    assert f"{len(good.results) - 1} of {len(good.results)} requirements agree" in text


def test_one_that_is_harder_is_not(good, bad):
    assert easier(bad, real(good)) == ()
    (remark,) = [each.remark for each in compare(bad, real(good)) if each.remark]
    assert remark == "the simulated peer is stricter"


def test_a_figure_that_is_far_larger_is_marked_too(good):
    def slower(result):
        if result.figure is None:
            return result
        return dataclasses.replace(result, figure=2.0 * result.figure)

    results = tuple(map(slower, good.results))
    figures = {each.id for each in good.results if each.figure}
    assert {*easier(good, real(good, results=results))} == figures != set()


def test_reports_of_two_protocols_are_not_compared(good):
    other = dataclasses.replace(good, suite="egm")
    with pytest.raises(ConfigurationError, match="one report is of 3dconnexion, the other of egm"):
        compare(good, other)


def test_a_requirement_that_one_report_does_not_have_is_said(good):
    shorter = dataclasses.replace(good, results=good.results[1:])
    first = compare(good, shorter)[0]
    assert (first.id, first.remark) == ("HID3D-001", "only in one of them")


def test_addresses_and_serial_numbers_are_taken_out():
    hide = Redaction()
    hide.hide("robot7.lab")
    said = (
        "10.1.2.3:40000 after 10.1.2.4:5, 10.1.2.3 again, robot7.lab:6510, fe80::1:2, "
        "00:1F:32:AB:CD:EF, serial number: XY-1234, /home/ada/x, 127.0.0.1:5"
    )
    clean = hide(said)
    assert clean == (
        "host-2:40000 after host-3:5, host-2 again, host-1:6510, host-4, "
        "radio-1, serial number: (redacted), ~/x, 127.0.0.1:5"
    )


def test_bytes_and_times_are_no_addresses():
    said = "#3 at 1.2340 s data from it, 4 B: 00 11 22 33 (2:30:59)"
    assert Redaction()(said) == said


def test_levels_that_were_not_run_are_not_seen(good):
    last = good.results[-1]
    assert (last.level, last.outcome) == (3, VerdictOutcome.NOT_SEEN)
    assert last.said == "level 3 was not run"
