"""``cardan doctor``: problems of this computer, why they matter, and the commands that fix them."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cardan.cli.common import EXIT_INCOMPLETE, AsJson
from cardan.cli.daemon import Socket
from cardan.common.text_sanitizer import printable
from cardan.common.troubles import code_of
from cardan.errors import ConfigurationError

if TYPE_CHECKING:
    from rich.text import Text

    from cardan.doctor.base import Finding

_MARKS = {"good": "✓", "caution": "!", "failure": "✗"}
_PLAIN_MARKS = {"good": "+", "caution": "!", "failure": "x"}
"""Marks for an output that cannot encode others."""
_STYLES = {"good": "green", "caution": "yellow", "failure": "bold red"}


def doctor(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE|FOLDER]...",
            help="Files to run here, as for `cardan run` and `cardan daemon run`.",
        ),
    ] = None,
    as_json: AsJson = False,
    as_report: Annotated[
        bool,
        typer.Option(
            "--report",
            help="Print versions and findings for an issue, without names and serial numbers.",
        ),
    ] = False,
    socket: Socket = "",
) -> None:
    """Examine this computer, and what the given files need of it. Prints each problem, why it
    matters, and the command that fixes it. Moves and changes nothing, and sends nothing to a robot:
    it only listens to controllers. Exit code 4 if a check fails."""
    from rich.console import Console
    from rich.text import Text

    from cardan import api
    from cardan.doctor import examine as examining
    from cardan.doctor.base import FindingLevel, Subject
    from cardan.doctor.files import read_files

    if as_json and as_report:
        raise ConfigurationError("--json, --report", "give one of them")
    files = tuple(paths or ())
    config, wrong = read_files(files)
    subject = Subject(files, config, wrong, devices=functools.cache(api.devices), socket=socket)
    found = []
    group = ""
    console = Console(highlight=False)
    for each in examining.examine(subject):
        found.append(each)
        if as_json or as_report:
            continue
        if each.group != group:
            group = each.group
            console.print(Text(printable(group), style="bold"))
        for line in _lines(each.finding):
            console.print(line, soft_wrap=True)
    if as_json:
        print(examining.as_json(found))
    elif as_report:
        print(printable(examining.report(found, examining.secrets_of(subject)), "\n"))
    else:
        levels = [each.finding.level for each in found]
        failures, cautions = levels.count(FindingLevel.FAILURE), levels.count(FindingLevel.CAUTION)
        console.print(
            f"{failures} failed, {cautions} to look at; docs/troubleshooting.md explains each"
        )
    if examining.worst(found) is FindingLevel.FAILURE:
        raise typer.Exit(EXIT_INCOMPLETE)


def _lines(finding: Finding) -> list[Text]:
    from rich.text import Text

    level = finding.level.value
    mark = (_MARKS if _has_marks() else _PLAIN_MARKS)[level]
    codes = ", ".join(filter(None, (finding.code, code_of(finding.what))))
    code = f"  [{codes}]" if finding.why else ""
    what = f" {printable(finding.what)}{printable(code)}"
    lines = [Text.assemble("  ", (mark, _STYLES[level]), what)]
    if finding.why:
        lines.append(Text(f"      why   {printable(finding.why)}", style="dim"))
    if finding.mend:
        lines.append(Text(f"      mend  {printable(finding.mend)}"))
    return lines


def _has_marks() -> bool:
    try:
        "✓✗".encode(sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True
