"""Comparison of two reports: requirements on which the simulated peer is easier than the target."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.report import Result, SuiteReport
from cardan.conform.requirements import VerdictOutcome
from cardan.errors import ConfigurationError

EASIER_BY = 1.5
"""Ratio of the figures in two reports from which on a difference is marked."""


class ReportDifference(NamedTuple):
    """A requirement in both reports."""

    id: str
    text: str
    first: Result | None
    """None: that report does not have it."""
    second: Result | None
    remark: str
    """Empty if they agree."""


def compare(first: SuiteReport, second: SuiteReport) -> tuple[ReportDifference, ...]:
    """Compare each requirement. Raises ConfigurationError for reports of two suites."""
    if first.suite != second.suite:
        raise ConfigurationError(
            "--compare", f"one report is of {first.suite}, the other of {second.suite}"
        )
    one = {each.id: each for each in first.results}
    other = {each.id: each for each in second.results}
    found = []
    for name in sorted(one.keys() | other.keys()):
        a, b = one.get(name), other.get(name)
        text = (a or b or next(iter(first.results))).text
        found.append(ReportDifference(name, text, a, b, _remark(first, second, a, b)))
    return tuple(found)


def _remark(first: SuiteReport, second: SuiteReport, a: Result | None, b: Result | None) -> str:
    if a is None or b is None:
        return "only in one of them"
    outcomes = (a.outcome, b.outcome)
    if outcomes == (VerdictOutcome.PASSED, VerdictOutcome.FAILED):
        return _easier(first, second)
    if outcomes == (VerdictOutcome.FAILED, VerdictOutcome.PASSED):
        return _easier(second, first)
    if a.figure is not None and b.figure is not None and a.unit == b.unit:
        low, high = abs(a.figure), abs(b.figure)
        if high > EASIER_BY * low:
            return f"{_easier(first, second)}: {low:.3g} against {high:.3g} {a.unit}".rstrip()
        if low > EASIER_BY * high:
            return f"{_easier(second, first)}: {high:.3g} against {low:.3g} {a.unit}".rstrip()
    return "" if a.outcome is b.outcome else "one of them does not show it"


def _easier(easy: SuiteReport, hard: SuiteReport) -> str:
    """Return words that say that `easy` demands less of a program than `hard`."""
    if easy.simulated and not hard.simulated:
        return "THE SIMULATED PEER IS EASIER"
    if hard.simulated and not easy.simulated:
        return "the simulated peer is stricter"
    return f"{easy.target} is easier"


def as_text(first: SuiteReport, second: SuiteReport) -> str:
    """Return the comparison for a terminal: one line for all that agree, a few per difference."""
    differences = compare(first, second)
    lines = [f"A {first.target}", f"B {second.target}"]
    for each in differences:
        if each.remark:
            lines.append(f"{each.id:12} {each.text}")
            lines.append(f"{'':12} A {_said(each.first)}")
            lines.append(f"{'':12} B {_said(each.second)}")
            lines.append(f"{'':12} -> {each.remark}")
    same = sum(not each.remark for each in differences)
    return "\n".join([*lines, f"{same} of {len(differences)} requirements agree"]) + "\n"


def _said(result: Result | None) -> str:
    return "-" if result is None else f"{result.outcome.value}: {result.said}"
