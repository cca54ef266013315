"""``cardan evaluate``: repeat published measurements, and write one report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cardan.cli.common import EXIT_INCOMPLETE, print_table
from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError


def evaluate(
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="About a minute: shorter and fewer runs. The report says which."
        ),
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="Where the report is written: report.html, report.md, report.json and pictures; "
            "default: report.",
        ),
    ] = None,
    only: Annotated[
        str,
        typer.Option(
            metavar="NAME,...",
            help="Only these studies: thesis, motoros, devices, cartesian, haptics.",
        ),
    ] = "",
    compare: Annotated[
        tuple[Path, Path] | None,
        typer.Option(
            metavar="OLD NEW",
            help="Measure nothing: compare the reports of two folders, and mark what got better "
            "or worse by more than it varies.",
        ),
    ] = None,
) -> None:
    """Repeat the measurements of the papers that Cardan follows.

    With simulated devices and robots; writes one report: published figures and ours, pictures,
    machine, versions, load and seeds. Real-time measurements need a quiet machine."""
    if compare is not None:
        if quick or only:
            raise ConfigurationError("--compare", "measures nothing: leave --quick and --only out")
        _compare(*compare, output)
        return
    from studies import report as reporting
    from studies.studies import chosen

    studies, folder = chosen(only), output or Path("report")
    report = reporting.evaluate(
        studies, quick, folder, lambda words: print(printable(words), flush=True)
    )
    if report.pictures_missing:
        print(printable(f"no pictures: {report.pictures_missing}"))
    print(printable(f"{folder / reporting.HTML}"))
    if report.failed:
        raise typer.Exit(EXIT_INCOMPLETE)


def _compare(old_path: Path, new_path: Path, folder: Path | None) -> None:
    from studies import comparison, report as reporting

    old, new = reporting.read(old_path), reporting.read(new_path)
    compared = comparison.compare(old, new)
    for words in comparison.differences(old, new):
        print(printable(words.replace("**", "")))
    rows = [(each.study, *comparison.cells(each)) for each in compared if each.verdict.value]
    print_table(("study", *comparison.COLUMNS), rows)
    print(comparison.count(compared))
    if folder is not None:
        comparison.write(folder, comparison.as_blocks(old, new, compared))
        print(printable(f"{folder / comparison.HTML}"))
