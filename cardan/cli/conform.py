"""``cardan conform``: checks a controller, a device or a driver by numbered requirements."""

from __future__ import annotations

import enum
import errno
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cardan.cli.common import EXIT_INCOMPLETE, check_seconds, print_table, print_unusable
from cardan.common.files import read_text
from cardan.common.realtime import ask_for_real_time
from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError

if TYPE_CHECKING:
    from cardan.conform import Level, Suite, SuiteReport


class Form(str, enum.Enum):
    """Output format of a report."""

    TEXT = "text"
    MARKDOWN = "markdown"
    JSON = "json"
    JUNIT = "junit"


_WARNINGS = {
    1: "level 1 opens a session and holds: it sends messages, has the drives powered where the "
    "protocol can, and lets the session time out; nothing is to move",
    2: "level 2 moves: by 1 mm or 0.2 degrees at most, there and back",
    3: "level 3 asks you to make faults by hand: press the emergency stop, pull a cable",
}


def conform(
    protocol: Annotated[
        str | None, typer.Argument(metavar="[PROTOCOL]", help="Protocol to check; see --list.")
    ] = None,
    target: Annotated[
        str,
        typer.Option(metavar="TARGET", help="The real one's address; default: its simulated peer."),
    ] = "",
    capture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Check a recording: pcap, pcapng, a log of a CAN bus, or a record.mcap of --save. "
            "--target selects its part: [HOST][:PORT] or a device as `cardan dissect` shows it.",
        ),
    ] = None,
    level: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=3,
            help="0 listens, 1 holds, 2 moves by a millimeter, 3 asks for faults by hand; "
            "default: at a target the highest that can do no harm, else 3.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(callback=check_seconds, help="About how long a phase takes; 10 at a target."),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=VALUE]",
            help="A fault of the simulated peer (repeatable); `cardan sim PEER --list-faults`.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, show_default="0", help="Seed of the simulated peer."),
    ] = None,
    form: Annotated[
        Form, typer.Option("--format", help="Format of the printed report.")
    ] = Form.TEXT,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Folder for the report in all formats, a capture and a record."
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Overwrite a report in the folder of --save.")
    ] = False,
    compare: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="A B", help="Compare two reports in JSON, then end."),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="Print the protocols, then end.")] = False,
    requirements: Annotated[
        bool,
        typer.Option("--requirements", help="Print the protocol's requirements, then end."),
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Do not ask before each level at a target.")
    ] = False,
    at_switch: Annotated[
        bool,
        typer.Option("--i-am-at-the-enable-switch", help="Required by levels 2 and 3 at a target."),
    ] = False,
) -> None:
    """Check a controller, a device or a driver by numbered requirements: its simulated peer in
    virtual time, or the real one at --target, or a --capture. Level 0, the default at a target,
    only listens. Exit code 4 if a requirement is not met."""
    from cardan.conform import registry

    if capture is not None:
        _as_it_is(
            {
                "--list": list_,
                "--requirements": requirements,
                "--compare": compare is not None,
            },
            {
                "--fault": bool(fault),
                "--level": level is not None,
                "--seconds": bool(seconds),
                "--seed": seed is not None,
                "--yes": yes,
                "--i-am-at-the-enable-switch": at_switch,
            },
        )
    if list_:
        found = registry.load_all()
        suites = found.classes.values()
        rows = [(each.name, each.judges, each.speaks, each.target) for each in suites]
        print_table(("protocol", "judges", "speaks", "target"), rows)
        print_unusable(found)
        return
    if compare is not None:
        _compare(compare)
        return
    if protocol is None:
        raise ConfigurationError("PROTOCOL", f"give one of: {', '.join(registry.names())}")
    suite = registry.load(protocol)
    if requirements:
        for each in suite.requirements:
            print(f"{each.id}  level {each.level:d}  {each.text}  [{each.source}]")
        return
    if save is not None and not overwrite and (save / "report.json").exists():
        raise ConfigurationError(
            "--save", f"{save} has a report: give another folder, or --overwrite"
        )
    if save is not None:
        _look_whether_written(save)
    if capture is not None:
        from cardan.conform import run

        report, timeline = run.captured(suite, capture, target)
        for line in timeline.strays:
            print(f"cardan: {line}", file=sys.stderr)
        report, missing = (report, []) if save is None else run.save(save, suite, report, timeline)
    else:
        report, missing = _checked(
            suite, target, level, seconds, fault or [], seed or 0, yes, at_switch, save
        )
    forms = {
        Form.TEXT: report.as_text,
        Form.MARKDOWN: report.as_markdown,
        Form.JSON: report.as_json,
        Form.JUNIT: report.as_junit,
    }
    print(printable(forms[form](), "\n"), end="")
    for line in missing:
        print(f"cardan: not attached: {printable(line)}", file=sys.stderr)
    doubted = [] if capture is None else report.doubted
    if doubted:
        print(
            f"cardan: {', '.join(doubted)}: perhaps not met, but the capture does not show it; "
            "check a complete capture",
            file=sys.stderr,
        )
    if report.failed or doubted:
        raise typer.Exit(EXIT_INCOMPLETE)


def _as_it_is(printing: Mapping[str, bool], running: Mapping[str, bool]) -> None:
    """Refuse options that have no meaning with --capture. `printing`: options that print something
    else and end; `running`: those of a run. Each has its name, and whether it was given."""
    if ends := [name for name, given in printing.items() if given]:
        raise ConfigurationError(
            "--capture",
            f"nothing is checked with {' and '.join(ends)}, which prints and ends: give one alone",
        )
    if of_a_run := [name for name, given in running.items() if given]:
        raise ConfigurationError(
            "--capture",
            f"it is checked as it is, and nothing is run: leave {' and '.join(of_a_run)} out",
        )


def _look_whether_written(folder: Path) -> None:
    """Raise ConfigurationError if `folder` cannot be created or written. It is created when there
    is something to write."""
    there = next(each for each in (folder, *folder.absolute().parents) if os.path.lexists(each))
    if not there.is_dir():
        why = os.strerror(errno.EEXIST if there == folder else errno.ENOTDIR)
    elif not os.access(there, os.W_OK | os.X_OK):
        why = os.strerror(errno.EACCES)
    else:
        return
    raise ConfigurationError("--save", f"{folder} cannot be written: {why}")


def _checked(
    suite: Suite[Any],
    target: str,
    level: int | None,
    seconds: float | None,
    fault: Sequence[str],
    seed: int,
    yes: bool,
    at_switch: bool,
    save: Path | None,
) -> tuple[SuiteReport, list[str]]:
    from cardan.conform import Level, run

    if target:
        if fault:
            raise ConfigurationError("--fault, --target", "only a simulated peer has faults")
        wanted = suite.harmless if level is None else Level(level)
        _consent(suite.harmless, wanted, yes, at_switch)
        ask_for_real_time()

        def instruct(instruction: str) -> None:
            print(f">>> {instruction}", file=sys.stderr, flush=True)

        report, timeline = run.at(suite, target, wanted, instruct, seconds or run.LIVE_S)
    else:
        wanted = suite.levels if level is None else Level(level)
        faults = suite.faults(fault)
        report, timeline = run.simulated(suite, wanted, faults, seed, seconds or None)
    return (report, []) if save is None else run.save(save, suite, report, timeline)


def _consent(harmless: Level, level: Level, yes: bool, at_switch: bool) -> None:
    if level >= 2 and harmless == 0 and not at_switch:
        raise ConfigurationError(
            "--level",
            f"level {level:d} moves the arm: give --i-am-at-the-enable-switch, and be there",
        )
    for each in range(harmless + 1, level + 1):
        print(f"cardan: {_WARNINGS[each]}", file=sys.stderr)
        if not yes:
            typer.confirm("go on?", abort=True, err=True)


def _compare(paths: tuple[Path, Path]) -> None:
    from cardan.conform import comparison
    from cardan.conform.report import read

    found = []
    for path in paths:
        try:
            text = read_text(path)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise ConfigurationError("--compare", f"{path} cannot be read: {why}") from None
        found.append(read(text, str(path)))
    first, second = found
    print(printable(comparison.as_text(first, second), "\n"), end="")
