"""A report: run studies, write their results, read them back."""

from __future__ import annotations

import dataclasses
import json
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cardan.common import files
from cardan.errors import CardanError, ConfigurationError, ExtraMissingError
from studies import conditions, document
from studies.document import Block, Heading, Paragraph, Picture, Points
from studies.result import Drawn, Figure, Result, Table
from studies.studies import Study

FORMAT = 1
"""Version of report.json; reports of another version cannot be compared."""

JSON, MARKDOWN, HTML = "report.json", "report.md", "report.html"
TITLE = "Published measurements, repeated"


@dataclass
class Part:
    """A study's part of a report."""

    name: str
    title: str
    source: str
    how: str = ""
    seconds: float = 0.0
    """Duration of the study."""
    load: float = 0.0
    """Load before the study; see :func:`studies.conditions.load`."""
    seeds: list[str] = field(default_factory=list)
    shortened: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    missing: str = ""
    """Package that is not installed, because of which the study did not run here."""
    failed: str = ""
    """Error that ended the study early."""
    tables: list[Table] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)


@dataclass
class Report:
    """A whole report."""

    quick: bool
    made: str
    """Time of the measurement, UTC."""
    machine: dict[str, str]
    versions: dict[str, str]
    parts: list[Part] = field(default_factory=list)
    pictures_missing: str = ""
    """Reason why there are no pictures."""

    @property
    def failed(self) -> list[Part]:
        """Studies that ended with an error."""
        return [part for part in self.parts if part.failed]


def evaluate(
    studies: Sequence[Study], quick: bool, folder: Path, say: Callable[[str], None]
) -> Report:
    """Run the studies in sequence, and write the report after each, so that results are kept.
    Raises ConfigurationError if `folder` is not writable."""
    made = time.strftime("%Y-%m-%d %H:%M", time.gmtime())
    report = Report(quick, made, conditions.machine(), conditions.versions())
    _writable(folder)
    for study in studies:
        say(f"{study.name}: {study.title}")
        part = _run(study, quick, folder, report)
        report.parts.append(part)
        write(report, folder)
        said = part.missing or part.failed
        say(f"{study.name}: {f'NOT MEASURED: {said}' if said else f'{part.seconds:.0f} s'}")
    return report


def _writable(folder: Path) -> None:
    file = folder / JSON
    try:
        folder.mkdir(parents=True, exist_ok=True)
        there = file.exists()
        with file.open("a"):
            pass
        if not there:  # Do not write a report before the first result.
            file.unlink()
    except OSError as error:
        raise ConfigurationError(
            "--output", f"nothing can be written into {folder}: {error.strerror}"
        ) from None


def _run(study: Study, quick: bool, folder: Path, report: Report) -> Part:
    part = Part(study.name, study.title, study.source, load=conditions.load())
    began_s = time.monotonic()
    try:
        found = study.run(quick)
        part.how = found.how
        part.seeds, part.shortened = list(found.seeds), list(found.shortened)
        part.left_out = list(found.left_out)
        part.tables, part.figures = list(found.tables), list(found.figures)
        part.pictures = _pictures(study, found, folder, report)
    except ExtraMissingError as error:
        part.missing = str(error)
    except CardanError as error:
        part.failed = str(error)
    except Exception as error:
        # Keep the measurements made so far.
        logging.getLogger(__name__).exception("%s broke off", study.name)
        part.failed = f"{type(error).__name__}: {error}"
    part.seconds = time.monotonic() - began_s
    return part


def _pictures(study: Study, found: Result, folder: Path, report: Report) -> list[Picture]:
    if found.draw is None or report.pictures_missing:
        return []
    try:
        from studies import plotting

        saved: list[Drawn] = plotting.save(
            folder, found.draw(), ("svg", "png"), prefix=f"{study.name}-"
        )
    except ExtraMissingError as error:
        report.pictures_missing = str(error)
        return []
    return [Picture(f"{study.name}-{drawn.name}", drawn.title) for drawn in saved]


# -- as documents ----------------------------------------------------------------------------------


def write(report: Report, folder: Path) -> None:
    """Write report.json, report.md and report.html next to the pictures."""
    blocks = as_blocks(report)
    texts = {
        JSON: json.dumps({"format": FORMAT, **dataclasses.asdict(report)}, indent=1) + "\n",
        MARKDOWN: document.markdown(blocks),
        HTML: document.page(TITLE, blocks, folder),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def as_blocks(report: Report) -> list[Block]:
    """Return the report as a document."""
    length = (
        "--quick: shorter and fewer runs, as each study says; figures for a paper take the whole"
        if report.quick
        else "whole"
    )
    found: list[Block] = [
        Heading(1, TITLE),
        Paragraph(
            "Papers on teleoperation, and the same measurements on Cardan with simulated devices "
            "and robots. Made by `cardan evaluate`."
        ),
        Points((f"made {report.made} UTC", f"length: {length}")),
        _facts("Machine", report.machine),
        _facts("Versions", report.versions),
        _overview(report),
    ]
    if report.pictures_missing:
        found.append(Paragraph(f"**No pictures:** {report.pictures_missing}"))
    for part in report.parts:
        found += _part(part)
    return found


def _facts(title: str, facts: dict[str, str]) -> Table:
    return Table(title, ("", ""), tuple(facts.items()))


def _overview(report: Report) -> Table:
    rows = tuple(
        (part.name, part.source, _outcome(part), f"{part.seconds:.0f} s", f"{part.load:.1f}")
        for part in report.parts
    )
    processors = report.machine.get("processors", "")
    note = (
        f"Load: how many programs wanted a processor in the minute before, of {processors} that "
        "there are. What is measured in real time needs a quiet machine."
    )
    columns = ("study", "published in", "", "took", "load before")
    return Table("Studies", columns, rows, note)


def _outcome(part: Part) -> str:
    if part.missing or part.failed:
        return "**not measured**"
    return "measured, parts left out" if part.left_out else "measured"


def _part(part: Part) -> list[Block]:
    found: list[Block] = [Heading(2, part.title), Paragraph(f"Published: {part.source}.")]
    if part.missing:
        return [*found, Paragraph(f"**Not measured here:** {part.missing}")]
    if part.failed:
        found.append(Paragraph(f"**It broke off:** {part.failed}"))
    if part.how:
        found.append(Paragraph(part.how))
    notes = [f"shortened by --quick: {words}" for words in part.shortened]
    notes += [f"**left out here:** {words}" for words in part.left_out]
    notes += [f"seed of {words}" for words in part.seeds]
    if notes:
        found.append(Points(tuple(notes)))
    return [*found, *part.pictures, *part.tables]


# -- read back -------------------------------------------------------------------------------------

LARGEST_BYTES = 16 * 2**20


def read(path: Path) -> Report:
    """Read the report of a folder, or of its report.json. Raises ConfigurationError."""
    file = path / JSON if path.is_dir() else path
    try:
        found = json.loads(files.read_text(file, LARGEST_BYTES))
    except OSError as error:
        raise ConfigurationError("--compare", f"cannot read {file}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigurationError("--compare", f"{file} is no report: {error}") from None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise ConfigurationError(
            "--compare", f"{file} is no report of this format ({FORMAT}): run cardan evaluate anew"
        )
    try:
        return _report(found)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigurationError("--compare", f"{file} is damaged: {error!r}") from None


def _report(found: dict[str, Any]) -> Report:
    parts = []
    for each in found["parts"]:
        more = dict(each)
        more["tables"] = [
            Table(a, tuple(b), tuple(tuple(row) for row in rows), note)
            for a, b, rows, note in each["tables"]
        ]
        more["figures"] = [Figure(*figure) for figure in each["figures"]]
        more["pictures"] = [Picture(*picture) for picture in each["pictures"]]
        parts.append(Part(**more))
    return Report(
        bool(found["quick"]),
        str(found["made"]),
        dict(found["machine"]),
        dict(found["versions"]),
        parts,
        str(found["pictures_missing"]),
    )
