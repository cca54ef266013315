"""Comparison of two reports: figures that improved or worsened by more than their spread."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import NamedTuple

from studies import document
from studies.document import Block, Heading, Points
from studies.report import Report
from studies.result import Figure, Table

MARKDOWN, HTML = "comparison.md", "comparison.html"
TITLE = "Two reports compared"


COLUMNS = ("figure", "unit", "published", "old", "new", "difference", "spread", "")


class Verdict(str, enum.Enum):
    """Verdict on a figure of both reports."""

    BETTER = "better"
    WORSE = "WORSE"
    SAME = ""
    """The difference is within the spread."""
    CHANGED = "changed"
    """The difference exceeds the spread of a figure without a better direction."""
    ONCE = "measured once"
    """The spread is unknown."""
    GONE = "missing now"
    NEW = "new"


class Compared(NamedTuple):
    """A figure of both reports."""

    study: str
    name: str
    unit: str
    published: float | None
    old: float | None
    new: float | None
    spread: float | None
    """The larger spread of both."""
    verdict: Verdict


def compare(old: Report, new: Report) -> list[Compared]:
    """Compare every figure of the studies in both reports, in the order of the new one."""
    found = []
    before = {part.name: part for part in old.parts if not (part.missing or part.failed)}
    for part in new.parts:
        if part.missing or part.failed or part.name not in before:
            continue
        theirs = {figure.name: figure for figure in before[part.name].figures}
        ours = {figure.name: figure for figure in part.figures}
        names = dict.fromkeys((*ours, *theirs))
        found += [_compared(part.name, theirs.get(each), ours.get(each)) for each in names]
    return found


def _compared(study: str, old: Figure | None, new: Figure | None) -> Compared:
    one = new or old
    assert one is not None
    before, after = old and old.value, new and new.value
    spread: float | None = 0.0
    for figure in (old, new):
        if figure is not None and spread is not None:
            spread = None if figure.spread is None else max(spread, figure.spread)
    verdict = _verdict(before, after, spread, one)
    published = next((x.published for x in (new, old) if x and x.published is not None), None)
    return Compared(study, one.name, one.unit, published, before, after, spread, verdict)


def _verdict(old: float | None, new: float | None, spread: float | None, figure: Figure) -> Verdict:
    if old is None or new is None:
        return Verdict.SAME if old is new else Verdict.NEW if old is None else Verdict.GONE
    if spread is None:
        return Verdict.ONCE if old != new else Verdict.SAME
    # Calculated values differ in their last digits between machines.
    if abs(new - old) <= spread + 1e-9 * max(abs(old), abs(new)):
        return Verdict.SAME
    if not figure.better:
        return Verdict.CHANGED
    return Verdict.BETTER if (new < old) == (figure.better == "less") else Verdict.WORSE


def differences(old: Report, new: Report) -> list[str]:
    """List the other differences between two reports; each may explain a difference of figures."""
    found = []
    for what, before, after in (
        ("machine", old.machine, new.machine),
        ("version", old.versions, new.versions),
    ):
        for name in dict.fromkeys((*before, *after)):
            one, two = before.get(name, "–"), after.get(name, "–")
            if one != two:
                found.append(f"{what}, {name}: {one}, then {two}")
    if old.quick != new.quick:
        words = ["--quick" if report.quick else "whole" for report in (old, new)]
        found.append(f"**length: {words[0]}, then {words[1]}: figures differ for that alone**")
    loads = {part.name: part.load for part in old.parts}
    found += [
        f"load before {part.name}: {loads[part.name]:.1f}, then {part.load:.1f}"
        for part in new.parts
        if part.name in loads
    ]
    found += [
        f"{part.name} was not measured in the {which} report"
        for which, report in (("old", old), ("new", new))
        for part in report.parts
        if part.missing or part.failed
    ]
    return found


def as_blocks(old: Report, new: Report, compared: list[Compared]) -> list[Block]:
    """Return the comparison as a document."""
    found: list[Block] = [
        Heading(1, TITLE),
        Points((f"old: made {old.made} UTC", f"new: made {new.made} UTC", count(compared))),
        Heading(2, "What else is different"),
        Points(tuple(differences(old, new)) or ("nothing",)),
        Heading(2, "Figures"),
    ]
    for study in dict.fromkeys(each.study for each in compared):
        rows = tuple(_marked(cells(each), each.verdict) for each in compared if each.study == study)
        found.append(Table(study, COLUMNS, rows))
    return found


def count(compared: list[Compared]) -> str:
    """Describe the number of each verdict."""
    counts = {verdict: sum(each.verdict is verdict for each in compared) for verdict in Verdict}
    worse, better = counts[Verdict.WORSE], counts[Verdict.BETTER]
    others = sum(counts.values()) - worse - better - counts[Verdict.SAME]
    return f"{better} better, {worse} worse, {counts[Verdict.SAME]} the same, {others} not judged"


def cells(each: Compared) -> tuple[str, ...]:
    """Return the cells of a table row, by COLUMNS."""
    known = each.old is not None and each.new is not None
    difference = f"{each.new - each.old:+.4g}" if known else "–"  # type: ignore[operator]
    spread = "unknown" if each.spread is None else f"{each.spread:.3g}"
    numbers = (_number(value) for value in (each.published, each.old, each.new))
    return (each.name, each.unit, *numbers, difference, spread, each.verdict.value)


def _marked(row: tuple[str, ...], verdict: Verdict) -> tuple[str, ...]:
    judged = verdict in (Verdict.WORSE, Verdict.BETTER)
    return (*row[:-1], f"**{row[-1]}**") if judged else row


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def write(folder: Path, blocks: list[Block]) -> None:
    """Write comparison.md and comparison.html."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MARKDOWN).write_text(document.markdown(blocks), encoding="utf-8")
    (folder / HTML).write_text(document.page(TITLE, blocks, folder), encoding="utf-8")
