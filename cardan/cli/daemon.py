"""``cardan daemon``: runs a daemon, and sends requests to a running one."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cardan.cli import completion
from cardan.cli.common import (
    EXIT_INCOMPLETE,
    AsJson,
    Level,
    LogLevel,
    Seconds,
    Verbose,
    begin_serving,
    print_json,
    print_problem,
)
from cardan.cli.installed import CommandGroup, OpenGroup
from cardan.common.logs import LogFormat, found_format
from cardan.common.places import in_file
from cardan.common.text_sanitizer import printable
from cardan.common.troubles import coded
from cardan.errors import ConfigurationError, MotionRefusedError, below

if TYPE_CHECKING:
    from cardan.gateway.daemon.config import DaemonConfig

Socket = Annotated[
    str,
    typer.Option(metavar="PATH", help="The daemon's socket; default: that of this user's daemon."),
]
Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="A session or a server of the daemon.", autocompletion=completion.units
    ),
]

OfName = Annotated[
    str,
    typer.Argument(
        metavar="[NAME]", help="Only this session or server.", autocompletion=completion.units
    ),
]


def checked(config: DaemonConfig) -> DaemonConfig:
    """Return a configuration whose servers' options are checked. Raises ConfigurationError."""
    from cardan.cli.server import check_words
    from cardan.gateway.servers.web import refuse_former_variable

    if config.servers:
        refuse_former_variable()
    for name, entry in config.servers.items():
        with in_file(entry.file), below(f"servers.{name}"):
            try:
                check_words(entry.server, entry.words)
            except ConfigurationError as error:
                key = error.key.removeprefix("--").replace("-", "_")
                raise ConfigurationError(key, error.message) from None
    return config


def serve(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE|FOLDER]...",
            help="Sessions, as `cardan run` takes them, or files of the daemon; folders.",
        ),
    ] = None,
    seconds: Seconds = None,
    verbose: Verbose = False,
    log_level: Level = None,
    log_format: Annotated[
        LogFormat | None,
        typer.Option(
            "--log-format",
            help="How the log is written; default: journal under systemd, text for a terminal, "
            "else json, one object a line.",
        ),
    ] = None,
) -> None:
    """Run many sessions and servers, each in its own process.

    Runs until Ctrl-C. A session or server that dies is restarted, its arm disarmed. Prints READY
    and the path of its socket once it serves."""
    from cardan.common.signals import on_ending
    from cardan.gateway.daemon.config import read_daemon_config, read_daemon_config_in_subprocess
    from cardan.gateway.daemon.daemon import Daemon

    begin_serving(verbose, log_level, LogLevel.INFO, log_format or found_format())
    files = paths or []
    daemon = Daemon(
        checked(read_daemon_config(files)), lambda: checked(read_daemon_config_in_subprocess(files))
    )

    def on_signal(number: int) -> None:
        if number == signal.SIGHUP:
            daemon.ask_reload()
        else:
            daemon.end()

    with on_ending(on_signal):
        daemon.run(lambda path: print(f"READY {path}", flush=True), seconds)


def ps(
    name: OfName = "",
    socket: Socket = "",
    as_json: AsJson = False,
) -> None:
    """List the daemon's sessions and servers: state, source that moves the arm, reason why it does
    not move."""
    from rich.console import Console

    from cardan.gateway.daemon.client import ControlClient
    from cardan.gateway.daemon.view import table, width_of

    with ControlClient(socket) as client:
        rows = client.ask("units", name)
    if as_json:
        print_json(rows)
    else:
        console = Console()
        console.print(table(rows, width_of(console)), soft_wrap=True)


def top(
    socket: Socket = "",
    period_s: Annotated[
        float, typer.Option("--period", metavar="S", help="Time between updates.")
    ] = 0.5,
    seconds: Seconds = None,
    as_json: AsJson = False,
) -> None:
    """Show what `cardan daemon ps` does, live.

    Until Ctrl-C; as JSON an array a line. The daemon keeps running."""
    from rich.console import Console

    from cardan.gateway.daemon.client import ControlClient
    from cardan.gateway.daemon.view import show
    from cardan.gateway.session.live_display import LivePanel

    end_s = None if seconds is None else time.monotonic() + seconds
    console = Console()
    panel = LivePanel(console, transient=False)
    with (
        ControlClient(socket, timeout_s=None) as client,
        contextlib.nullcontext() if as_json else panel,
    ):
        for rows in client.events("watch", value=period_s):
            if as_json:
                print_json(rows)
            else:
                show(rows, console, panel)
            if end_s is not None and time.monotonic() >= end_s:
                break


def _order(order: str, name: str, socket: str, as_json: bool) -> None:
    from cardan.gateway.daemon.client import ControlClient

    with ControlClient(socket) as client:
        rows = client.ask(order, name)
    if as_json:
        print_json(rows)
    else:
        for row in rows:
            print(f"{row['name']} is {row['state']}")


def start(name: Name, socket: Socket = "", as_json: AsJson = False) -> None:
    """Start a session or a server that the daemon stopped or gave up."""
    _order("start", name, socket, as_json)


def stop(name: Name, socket: Socket = "", as_json: AsJson = False) -> None:
    """Stop a session or a server of the daemon.

    The arm of a session brakes and holds; then the session disconnects."""
    _order("stop", name, socket, as_json)


def restart(name: Name, socket: Socket = "", as_json: AsJson = False) -> None:
    """Stop a session or a server of the daemon, and start it again."""
    _order("restart", name, socket, as_json)


def switch(
    device: Annotated[
        str,
        typer.Argument(
            metavar="DEVICE",
            help="A device that sessions share.",
            autocompletion=completion.devices,
        ),
    ],
    session: Annotated[
        str,
        typer.Argument(
            metavar="[SESSION]",
            help="Session that gets it; default: the next one.",
            autocompletion=completion.sharers,
        ),
    ] = "",
    socket: Socket = "",
    as_json: AsJson = False,
) -> None:
    """Pass a shared operator device on to another session.

    Takes effect as soon as the arm of its present session rests."""
    from cardan.gateway.daemon.client import ControlClient

    with ControlClient(socket) as client:
        on_signal = client.ask("switch", device, session or None)
    if as_json:
        print_json(on_signal)
        return
    print(f"{on_signal['name']} goes from {on_signal['from']} to {on_signal['to']}")


def reload(
    check: Annotated[
        bool, typer.Option("--check", help="Print the changes without making them.")
    ] = False,
    socket: Socket = "",
    as_json: AsJson = False,
) -> None:
    """Make the daemon reload its files: all changes take effect, or none. A changed session is
    restarted as soon as its arm is free; prints the changes that wait for that."""
    from cardan.gateway.daemon.changes import Change
    from cardan.gateway.daemon.client import RELOAD_S, ControlClient

    with ControlClient(socket, RELOAD_S) as client:
        changes = client.ask("reload", value=check)
    if as_json:
        print_json(changes)
        return
    for change in changes:
        print(printable(Change(**change).in_words))
    if not changes:
        print("nothing has changed")


def log(
    name: OfName = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Follow until Ctrl-C.")] = False,
    socket: Socket = "",
    as_json: AsJson = False,
) -> None:
    """Print the log of the daemon's sessions and servers."""
    from cardan.gateway.daemon.client import ANSWER_S, ControlClient

    with ControlClient(socket, None if follow else ANSWER_S) as client:
        lines = client.events("log", name, True) if follow else client.ask("log", name, False)
        for time_s, source, text, level in lines:
            if as_json:
                row = {"time_s": time_s, "name": source, "level": level, "text": text}
                print_json(row)
                continue
            clock = time.strftime("%H:%M:%S", time.localtime(time_s))
            print(f"{clock} {source}| {coded(printable(text))}", flush=True)


def events(
    name: OfName = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Follow until Ctrl-C.")] = False,
    socket: Socket = "",
    as_json: AsJson = False,
) -> None:
    """Print the events of the daemon's sessions: sources that took the authority over an arm, arms
    that were armed, stopped or lost, and why."""
    from cardan.gateway.daemon.client import ANSWER_S, ControlClient

    with ControlClient(socket, None if follow else ANSWER_S) as client:
        found = client.events("events", name, True) if follow else client.ask("events", name)
        for event in found:
            if as_json:
                print_json(event)
                continue
            clock = time.strftime("%H:%M:%S", time.localtime(event["time_s"]))
            why = f": {event['why']}" if event["why"] else ""
            words = f"{clock} {event['name']}  {event['event']}  {event['what']}{why}"
            print(coded(printable(words)), flush=True)


def arm(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A session of the daemon.", autocompletion=completion.sessions
        ),
    ],
    verb: Annotated[
        str,
        typer.Argument(
            metavar="VERB", help="stat, movj, movl, stop, ...", autocompletion=completion.verbs
        ),
    ],
    numbers: Annotated[
        list[str] | None, typer.Argument(metavar="[VALUE]...", help="Values of the verb.")
    ] = None,
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait until a motion has ended; Ctrl-C stops it.")
    ] = False,
    source: Annotated[
        str, typer.Option(metavar="NAME", help="Source name for the arm's authority.")
    ] = "verbs",
    socket: Socket = "",
    as_json: AsJson = False,
) -> None:
    """Make an arm of the daemon execute a verb: `stat`, `stop`, `movl
    0.4 0 0.4 3.14 0 0 --wait` (m, then a rotation vector in rad), `get_parameters`,
    `set_parameter gain 0.1`. A motion that does not end by itself ends with this command."""
    from cardan.cli.verbs import as_plain, carry_out, in_words
    from cardan.gateway.daemon.client import daemon_arm

    try:
        with daemon_arm(name, path=socket, source=source) as device:
            found, good = carry_out(device, verb, numbers or [], wait)
    except MotionRefusedError as error:
        print_problem(str(error))
        raise typer.Exit(EXIT_INCOMPLETE) from None
    if as_json:
        print_json(as_plain(found))
    elif said := in_words(found):
        print(printable(said, "\n"))
    if not good:
        raise typer.Exit(EXIT_INCOMPLETE)


service = typer.Typer(
    name="service",
    cls=CommandGroup,
    no_args_is_help=True,
    help="Run the daemon as a service of systemd.",
)
System = Annotated[
    bool,
    typer.Option("--system", help="For the computer, started at boot; default: for this user."),
]
Account = Annotated[
    str, typer.Option("--user", metavar="NAME", help="Account for --system; default: yours.")
]
Files = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[FILE|FOLDER]...", help="As for `cardan daemon run`."),
]


def _service(files: list[Path] | None, system: bool, account: str) -> Any:
    import getpass

    from cardan.gateway.daemon.config import read_daemon_config
    from cardan.gateway.daemon.service import make_service

    checked(read_daemon_config(files or []))  # Report now a unit that cannot run.
    user = account or os.environ.get("SUDO_USER") or getpass.getuser()
    return make_service(files or [], system=system, account=user)


@service.command()
def show(files: Files = None, system: System = False, user: Account = "") -> None:
    """Print the unit that `install` would write."""
    made = _service(files, system, user)
    print(f"# {made.path}")
    print(made.text, end="")


@service.command("install")
def install_service(files: Files = None, system: System = False, user: Account = "") -> None:
    """Write the unit, and start it. With --system it starts again at boot, else at this user's
    login."""
    from cardan.gateway.daemon.service import install

    for line in install(_service(files, system, user)):
        print(line)
    if not system:
        print("`loginctl enable-linger` lets it run without a login, too")


@service.command("remove")
def remove_service(system: System = False) -> None:
    """Stop the service and remove its unit."""
    from cardan.gateway.daemon.service import installed, remove

    for line in remove(installed(system)):
        print(line)


daemon = typer.Typer(
    name="daemon",
    cls=OpenGroup,
    help="Run many sessions and servers; monitor and command them.",
    no_args_is_help=True,
)
daemon.add_typer(service)
daemon.command("run")(serve)
for _command in (ps, top, start, stop, restart, switch, reload, log, events):
    daemon.command()(_command)
# Among an arm's verbs, -0.1 is a number and not an option.
daemon.command(context_settings={"ignore_unknown_options": True})(arm)
