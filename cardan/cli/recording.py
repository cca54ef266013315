"""``cardan net record``, ``cardan net replay`` and ``cardan net plot``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cardan.cli.bus import Router, Session, bus_options
from cardan.cli.common import EXIT_INCOMPLETE, Level, Seconds, Verbose, begin_serving
from cardan.common.text_sanitizer import printable
from cardan.errors import OptionError

Record = Annotated[Path, typer.Argument(metavar="FILE", help="A record (MCAP).")]


def record(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="The file to write (MCAP)."),
    ] = None,
    arms: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[ARM]...",
            help="Namespaces of arms, or names of nodes: only their topics, and those that all "
            "share; default: everything.",
        ),
    ] = None,
    session: Session = None,
    router: Router = "",
    seconds: Seconds = None,
    repair: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Record nothing: repair this record, which was cut off or damaged; without -o "
            "into NAME-repaired.mcap beside it.",
        ),
    ] = None,
    verbose: Verbose = False,
    log_level: Level = None,
) -> None:
    """Record what is on the network into FILE: all topics, also those that appear later, the raw
    bytes of devices and robots, and each session's configuration. Prints READY once it records."""
    if repair is not None:
        if arms or session or router or seconds is not None:
            raise OptionError("--repair", str(repair), "given with nothing but -o")
        _repair(repair, output)
        return
    from cardan.recording.recorder import record as run

    if output is None:
        raise typer.BadParameter("give the file to write", param_hint="--output / -o")
    begin_serving(verbose, log_level)
    report = run(bus_options(session, router), output, arms or (), seconds)
    for line in report.lines():
        print(printable(line))
    if not report.complete:
        raise typer.Exit(EXIT_INCOMPLETE)


def _repair(path: Path, output: Path | None) -> None:
    from cardan.recording.repair import repair, repaired_name

    report = repair(path, output or repaired_name(path))
    for line in report.lines():
        print(printable(line))
    if not report.complete:
        raise typer.Exit(EXIT_INCOMPLETE)


def replay(
    file: Record,
    rate: Annotated[float, typer.Option(help="2: twice as fast.")] = 1.0,
    topics: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this topic; * is anything (repeatable)."),
    ] = None,
    commands: Annotated[
        bool,
        typer.Option(
            "--commands",
            help="Publish topics, too, that may command something, and topics that have another "
            "publisher now. A live session accepts from them what its arming sequence and its "
            "authority allow.",
        ),
    ] = False,
    longest_pause: Annotated[
        float,
        typer.Option(
            metavar="S",
            help="Longest wait between messages; longer gaps (a pause, a set clock) are cut to it.",
        ),
    ] = 60.0,
    verify: Annotated[
        bool,
        typer.Option(
            "--verify",
            help="Publish nothing: feed the recorded inputs of sessions to the controller, and "
            "compare its commands with the recorded ones, bit for bit.",
        ),
    ] = False,
    engine: Annotated[bool, typer.Option("--engine", hidden=True, help="Now --verify.")] = False,
    session: Session = None,
    router: Router = "",
    verbose: Verbose = False,
    log_level: Level = None,
) -> None:
    """Publish a record onto the network.

    Under its own names, with its own spacing."""
    if engine:
        raise typer.BadParameter("is now --verify", param_hint="--engine")
    if verify:
        _verify(file)
        return
    from cardan.recording.replay import replay as run

    begin_serving(verbose, log_level)
    report = run(
        file,
        bus_options(session, router, publishes=True),
        rate=rate,
        topics=topics or (),
        commands=commands,
        longest_pause_s=longest_pause,
        say=lambda line: print(printable(line)),
    )
    for line in report.lines():
        print(printable(line))
    if not report.complete:
        raise typer.Exit(EXIT_INCOMPLETE)


def _verify(file: Path) -> None:
    from cardan.recording.verify import verify

    reports = verify(file)
    for report in reports:
        for line in report.lines():
            print(printable(line))
    if not all(report.same and not report.problems for report in reports):
        raise typer.Exit(EXIT_INCOMPLETE)


def plot(
    file: Record,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PICTURE",
            help="The picture to write, by its ending PNG, SVG or PDF; default: FILE's name with "
            ".png.",
        ),
    ] = None,
    arm: Annotated[
        str, typer.Option(metavar="NODE", help="Arm to draw, if a record has several.")
    ] = "",
) -> None:
    """Draw a session: the path of the TCP, the following error, latencies and forces."""
    from cardan.recording.plot import plot as draw

    picture = output or file.with_suffix(".png")
    problems = draw(file, picture, arm)
    print(picture)
    for line in problems:
        print(printable(line))
    if problems:
        raise typer.Exit(EXIT_INCOMPLETE)
