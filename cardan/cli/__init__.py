"""The ``cardan`` command."""

from __future__ import annotations

import contextlib
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cardan import __version__
from cardan.cli import completion
from cardan.cli.common import (
    EXIT_CANNOT_OPEN,
    EXIT_FAILED,
    EXIT_INCOMPLETE,
    EXIT_OK,
    EXIT_USAGE,
    AsJson,
    ConfigFile,
    Level,
    Seconds,
    Verbose,
    begin_serving,
    check_seconds,
    print_json,
    print_problem,
    print_table,
)
from cardan.cli.conform import conform
from cardan.cli.daemon import checked, daemon
from cardan.cli.devices import devices
from cardan.cli.doctor import doctor
from cardan.cli.explain import explain
from cardan.cli.installed import TOP, OpenGroup
from cardan.cli.net import net
from cardan.cli.robots import robots
from cardan.cli.sim import sim
from cardan.common import output
from cardan.common.logs import make_logs_printable
from cardan.common.resource_errors import shortage
from cardan.common.signals import raised_on_ending
from cardan.common.text_sanitizer import printable
from cardan.common.troubles import coded
from cardan.errors import CaptureError, CardanError, ConfigurationError, ScriptError
from cardan.gateway.daemon.control import ControlError
from cardan.gateway.session.snapshot import Snapshot
from cardan.types import DeviceLink, RobotLink

if TYPE_CHECKING:
    from cardan.gateway.session.config import SessionConfig
    from cardan.gateway.session.subprocesses import CardanSubprocess

app = typer.Typer(
    name=TOP,
    cls=OpenGroup,
    help="Drive a robot arm from a hand-held device. New here? `cardan demo` shows it without any "
    "hardware. Then copy a file from examples/, `cardan check` it, and `cardan run` it. "
    "`cardan explain CODE` explains a message.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_show_locals=False,
)
for _group in (daemon, devices, robots, net, sim):
    app.add_typer(_group)
for _command in (doctor, conform):
    app.command()(_command)
# The help names it above its list, whose lines have no room for it.
app.command(hidden=True)(explain)


def main() -> None:
    """Run the command line; errors become one line and an exit code.

    A signal that ends the process runs the clean-up first; the end never waits for a terminal or a
    pipe that is not read.
    """
    make_logs_printable()
    code = EXIT_FAILED
    try:
        with output.in_background(), raised_on_ending():
            try:
                code = _run()
            except SystemExit as ending:
                output.keep_up()
                code = _code(ending)
            if (error := output.finish("stdout")) is not None:
                code = code or EXIT_FAILED
                if why := output.why_unwritten(error):
                    print(f"cardan: {why}", file=sys.stderr)
            output.finish("stderr")
    except SystemExit as ending:  # Ended by a signal while it waited for a reader.
        code = _code(ending)
    sys.exit(code)


def _run() -> int:
    """Run the command line; return the exit code."""
    try:
        # Shell completion is installed for this name, whatever the program was started as.
        return app(standalone_mode=False, prog_name="cardan") or EXIT_OK
    except (ConfigurationError, ControlError, ScriptError, CaptureError) as error:
        return _fail(error, EXIT_USAGE)
    except CardanError as error:
        return _fail(error, EXIT_CANNOT_OPEN)
    except typer.Abort:
        return EXIT_FAILED
    except Exception as error:
        if isinstance(error, OSError) and output.failed(error):
            return EXIT_FAILED
        # The command line's own errors: typer's releases have them in different modules.
        message, context = getattr(error, "format_message", None), getattr(error, "ctx", None)
        if message is None:
            if words := shortage(error):
                print(f"cardan: {words}", file=sys.stderr)
                return EXIT_FAILED
            sys.excepthook(type(error), error, error.__traceback__)
            return EXIT_FAILED
        if type(error).__name__ == "NoArgsIsHelpError":
            if text := message():  # With rich installed, typer prints the error itself.
                print(text)
            return EXIT_USAGE
        words = " ".join(message().split()).removesuffix(".")
        if (near := _near(words, context)) and "Did you mean" not in words:
            words += f". Did you mean {near}?"
        command = context.command_path if context is not None else "cardan"
        if words.endswith("?"):
            print_problem(f"{words[:-1]}? `{command} --help` lists what is available")
        else:
            print_problem(f"{words}; `{command} --help` lists what is available")
        return EXIT_USAGE


def _near(words: str, context: typer.Context | None) -> str:
    """Commands of the group that have the missing name in theirs; empty: none."""
    typed = re.match("No such command '(.+)'", words)
    names = getattr(getattr(context, "command", None), "commands", {})
    return " or ".join(repr(name) for name in names if typed and typed[1] in name)


def _fail(error: CardanError, code: int) -> int:
    print_problem(str(error), "\n" if isinstance(error, ConfigurationError) else "")
    return code


def _code(ending: SystemExit) -> int:
    return ending.code if isinstance(ending.code, int) else EXIT_FAILED


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"cardan {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass


@app.command()
def demo(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="A demo, or an example file with a demo.",
            autocompletion=completion.demos,
        ),
    ] = "gofa",
    seconds: Annotated[float, typer.Option(callback=check_seconds, help="How long to run.")] = 30.0,
    delay: Annotated[
        float | None,
        typer.Option(
            metavar="MS",
            help="Delay of the demo's simulated network, one way; default: the demo's own.",
        ),
    ] = None,
    extras: Annotated[
        bool,
        typer.Option(
            "--extras",
            help='Print the extras of Cardan that it needs besides "arm", then end.',
        ),
    ] = False,
    list_: Annotated[bool, typer.Option("--list", help="Print the demos, then end.")] = False,
    as_json: AsJson = False,
    verbose: Verbose = False,
    log_level: Level = None,
) -> None:
    """Run an example against simulated peers, with no hardware: gofa (a SpaceMouse drives an ABB
    GoFa over EGM), gp8 (a Motoman GP8 over MotoROS), ur5e (a UR5e over RTDE), and more, also
    those of installed plug-ins."""
    from cardan.demos.demo import check_length, choose_demo, run_demo, with_delay
    from cardan.demos.examples import find_demos

    if list_:
        demos = find_demos()
        if as_json:
            print_json(
                [
                    {"demo": name, "what_is_joined": each.description, "least_s": each.shortest_s}
                    for name, each in demos.items()
                ]
            )
        else:
            print_table(
                ("demo", "what is joined", "least time, s"),
                ((name, each.description, f"{each.shortest_s:g}") for name, each in demos.items()),
            )
        raise typer.Exit
    if as_json:
        raise ConfigurationError("--json", "goes with --list")
    chosen = with_delay(choose_demo(name), delay)
    if extras:
        print(",".join(chosen.extras))
        raise typer.Exit
    begin_serving(verbose, log_level)
    if chosen.is_lab:
        from cardan.demos.lab import run_lab

        check_length(chosen, seconds)
        raise typer.Exit(run_lab(chosen, seconds))
    from cardan.gateway.servers.console.address import picture

    raise typer.Exit(run_demo(seconds, name, picture, delay))


@app.command()
def run(
    file: ConfigFile,
    record_to: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="OUT",
            help="Record the network into this file (MCAP) while the session runs, as `cardan "
            "net record` does; the session needs a [network].",
        ),
    ] = None,
    console: Annotated[
        bool,
        typer.Option(
            help="Serve the page that shows and moves the arm, as `cardan net server console` "
            "does, and print its address; the session needs a [network]."
        ),
    ] = False,
    console_host: Annotated[
        str,
        typer.Option(
            metavar="HOST",
            help="Address of the page of --console: 0.0.0.0 for phones and other computers, "
            "too; by default 127.0.0.1.",
        ),
    ] = "",
    seconds: Seconds = None,
    verbose: Verbose = False,
    log_level: Level = None,
) -> None:
    """Connect the device and the robot of a file, until Ctrl-C."""
    from cardan.gateway.session.assembly import load_config
    from cardan.gateway.session.cautions import cautions
    from cardan.gateway.session.recorded import recorded, why_incomplete
    from cardan.gateway.session.supervisor import supervise
    from cardan.gateway.session.terminal_view import SessionView, summary

    begin_serving(verbose, log_level)
    config = load_config(file)
    for words in cautions(config):
        print_problem(f"WARNING: {words}")
    recorder: CardanSubprocess | None = None
    with contextlib.ExitStack() as opened:
        for option, wanted in (("--record", record_to is not None), ("--console", console)):
            if wanted and config.network is None:
                raise ConfigurationError(option, f"{file} has no table [network]: add one")
        if console_host and not console:
            raise ConfigurationError("--console-host", "is the address of --console: give both")
        if console and config.network is not None:
            from cardan.gateway.servers.console.address import picture
            from cardan.gateway.session.with_server import with_server

            host = console_host or "127.0.0.1"
            page = opened.enter_context(with_server("console", config.network, host))
            print("\n".join((*page.before, f"console {page.endpoint}")), flush=True)
            if sys.stdout.isatty():
                print(picture(page.endpoint), flush=True)
        if record_to is not None and config.network is not None:
            join = ("--session", str(file))
            recorder = opened.enter_context(recorded(config.network, record_to, *join))
        view = opened.enter_context(SessionView())
        outcome = supervise(
            config, math.inf if seconds is None else seconds, view.show, shown=output.is_read
        )
    if outcome.last.loop.cycles or outcome.last.elapsed_s:
        view.console.print(summary(outcome.last))
    if recorder is not None:
        sys.stderr.write(recorder.complaints)
        for line in recorder.lines:
            print(f"{record_to}: {printable(line)}")
        if record_to is not None and (why := why_incomplete(recorder, record_to)):
            print_problem(why)
    if outcome.last.error:
        print_problem(outcome.last.error, "\n")
    if outcome.exit_code == EXIT_OK and (problem := _final_problem(outcome.last)):
        print_problem(problem)
        raise typer.Exit(EXIT_INCOMPLETE)
    recorded_all = recorder is None or recorder.code == EXIT_OK
    raise typer.Exit(outcome.exit_code or (EXIT_OK if recorded_all else EXIT_INCOMPLETE))


def _final_problem(last: Snapshot) -> str:
    """Problem at the end of a session that ended as asked; empty if there was none."""
    if last.elapsed_s == 0.0:
        return ""
    if last.loop.cycles == 0:
        return f"the robot was never commanded: {last.robot.hold_reason or 'no state was received'}"
    if last.robot.link != RobotLink.LIVE.value:
        return f"at the end the robot was {last.robot.link}: {last.robot.hold_reason}"
    if last.device.link in (DeviceLink.LOST.value, DeviceLink.STALE.value):
        return f"at the end the device was {last.device.link}: {last.device.reason}"
    return ""


@app.command()
def check(file: ConfigFile, as_json: AsJson = False) -> None:
    """Check a configuration file without opening anything.

    The file is that of a session or of the daemon. Prints what they would do."""
    from cardan.common.tables import read_toml
    from cardan.gateway.daemon.config import is_of_daemon, read_daemon_config
    from cardan.gateway.session.arm_assembly import disagreements
    from cardan.gateway.session.assembly import load_config
    from cardan.gateway.session.cautions import cautions

    if is_of_daemon(read_toml(file)):
        daemon_config = checked(read_daemon_config([file]))
        warnings = [
            f"{name}: {words}"
            for name, entry in daemon_config.sessions.items()
            for words in cautions(entry.config)
        ]
        warnings += disagreements(
            {name: each.config for name, each in daemon_config.sessions.items()}
        )
        parts = [("session", name) for name in daemon_config.sessions]
        parts += [("server", name) for name in daemon_config.servers]
    else:
        config = load_config(file)
        warnings, parts = list(cautions(config)), list(_parts(config))
    if as_json:
        described: dict[str, list[str]] = {}
        for part, words in parts:
            described.setdefault(part, []).append(words)
        print_json({"file": str(file), "warnings": warnings, **described})
        return
    print(f"{file}: fine{', with WARNINGS' if warnings else ''}")
    for words in warnings:
        print(f"  WARNING  {coded(words)}")
    for part, words in parts:
        print(f"  {part:<8} {printable(words)}")


def _parts(config: SessionConfig) -> Iterator[tuple[str, str]]:
    """Parts of a session, each with its function."""
    from cardan.gateway.operator.mapping import Mode
    from cardan.gateway.session.assembly import make_filters, servo_in_words

    mapping, limits, force = config.mapping, config.limits, config.force
    yield "device", config.device.driver if config.device else "none"
    yield "robot", config.robot.driver
    if config.device is None:
        yield "moved by", _moved_by_verbs(config)
    elif mapping.mode is Mode.POSITION:
        yield "mapping", f"the TCP moves as the device does, {mapping.frame.value} axes"
    elif mapping.mode is Mode.ABSOLUTE:
        yield (
            "mapping",
            "the TCP goes where the device is, base axes, at "
            f"{mapping.approach_speed_m_s * 1e3:.0f} mm/s and "
            f"{math.degrees(mapping.approach_speed_rad_s):.0f} deg/s until it has arrived",
        )
    else:
        yield (
            "mapping",
            f"full deflection is {mapping.linear_speed_m_s * 1e3:.0f} mm/s and "
            f"{math.degrees(mapping.angular_speed_rad_s):.0f} deg/s, {mapping.frame.value} axes",
        )
    for each in make_filters(config):
        yield "filter", f"{each.name}: {each.describe()}"
    if config.arm is not None:
        around = (
            f", {len(config.obstacles)} obstacles" if config.arm.collisions else ", collisions OFF"
        )
        yield "arm", f"{config.arm.model}, policy {config.arm.policy.value}{around}"
        yield "servo", servo_in_words(config)
    if config.fixtures:
        yield "fixtures", ", ".join(each.shape for each in config.fixtures)
    if force.source == "remote":
        yield "force", f"remote, by a force node at {force.socket}"
    elif force.source != "none":
        yield "force", f"{force.source}, {force.scale:g} N for each N of the robot"
    yield (
        "limits",
        f"{limits.linear_speed_m_s * 1e3:.0f} mm/s, "
        f"{math.degrees(limits.angular_speed_rad_s):.0f} deg/s",
    )
    if config.device is None:
        return
    if mapping.deadman_buttons:
        held = " or ".join(repr(button) for button in mapping.deadman_buttons)
        yield "dead-man", f"{held} must be held to move"
    elif mapping.clutch:
        yield (
            "clutch",
            f"{mapping.clutch!r} starts and stops following; no dead-man has to be held",
        )
    else:
        yield (
            "dead-man",
            "NONE: any deflection moves the robot; set mapping.deadman near people",
        )


def _moved_by_verbs(config: SessionConfig) -> str:
    """Sources that may move the arm of a session without a device."""
    from cardan.gateway.session.arm_assembly import why_no_verbs

    if why := why_no_verbs(config):
        return f"NOTHING: {why}"
    authority = config.authority
    who = f"{authority.named!r} alone" if authority.named else "any source that has authority"
    return f"verbs and streams of a program (session_arm), {who}; `cardan run` shows it at rest"
