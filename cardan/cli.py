"""The ``cardan`` command."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from cardan import __version__
from cardan.errors import CaptureError, CardanError, ConfigurationError, ScriptError
from cardan.sim_peers.base import FaultSwitch, SimulatedPeer, serve

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_CANNOT_OPEN = 3
EXIT_INCOMPLETE = 4

EPILOG = (
    "Exit codes: 0 done as asked; 1 failed inside; 2 wrong configuration or usage; "
    "3 a device or robot cannot be opened; 4 it ran, but not everything was as it should be."
)

app = typer.Typer(
    name="cardan",
    help="Drive a robot arm from a hand-held device.\n\n"
    "New here? [bold]cardan demo[/bold] shows it without any hardware. Then copy a file from "
    "examples/, [bold]cardan check[/bold] it, and [bold]cardan run[/bold] it.",
    epilog=EPILOG,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_show_locals=False,
)
sim = typer.Typer(
    name="sim",
    help="Stand in for a piece of hardware, speaking its real protocol.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
app.add_typer(sim)

ConfigFile = Annotated[Path, typer.Argument(metavar="FILE", help="Configuration file (TOML).")]
Seconds = Annotated[
    float | None, typer.Option(min=0.0, help="End after this time; default: on Ctrl-C.")
]
Script = Annotated[
    str | None, typer.Option(metavar="NAME|FILE", help="Its motion; see --list-scripts.")
]
Fault = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME[=VALUE]", help="A fault to have (repeatable); see --list-faults."),
]
ListFaults = Annotated[bool, typer.Option("--list-faults", help="Print the faults, then end.")]
ListScripts = Annotated[
    bool, typer.Option("--list-scripts", help="Print the built-in scripts, then end.")
]
Seed = Annotated[int, typer.Option(help="Seed of everything random.")]


def main() -> None:
    """Run the command line; errors become one line and an exit code."""
    try:
        app()
    except (ConfigurationError, ScriptError, CaptureError) as error:
        _fail(error, EXIT_USAGE)
    except CardanError as error:
        _fail(error, EXIT_CANNOT_OPEN)
    except BrokenPipeError:
        sys.exit(EXIT_FAILED)


def _fail(error: CardanError, code: int) -> None:
    print(f"cardan: {error}", file=sys.stderr)
    sys.exit(code)


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
    seconds: Annotated[float, typer.Option(min=3.0, help="How long to run.")] = 30.0,
) -> None:
    """Run the main job with no hardware: a simulated SpaceMouse drives a simulated GoFa."""
    from cardan.gateway.demo import run_demo

    raise typer.Exit(run_demo(seconds))


@app.command(epilog=EPILOG)
def run(file: ConfigFile, seconds: Seconds = None) -> None:
    """Join the device and the robot of a configuration file until Ctrl-C."""
    from cardan.gateway.config import load_config
    from cardan.gateway.supervisor import supervise
    from cardan.gateway.view import SessionView, summary

    config = load_config(file)
    with SessionView() as view:
        outcome = supervise(config, math.inf if seconds is None else seconds, view.show)
    if outcome.last.cycles or outcome.last.elapsed_s:
        view.console.print(summary(outcome.last))
    if outcome.last.error:
        print(f"cardan: {outcome.last.error}", file=sys.stderr)
    raise typer.Exit(outcome.exit_code)


@app.command()
def check(file: ConfigFile) -> None:
    """Check a configuration file without opening anything, and say what it would do."""
    from cardan.gateway.config import load_config

    config = load_config(file)
    mapping, limits = config.mapping, config.limits
    print(f"{file}: fine")
    print(f"  device   {config.device.driver}")
    print(f"  robot    {config.robot.driver}")
    print(
        f"  mapping  full deflection is {mapping.linear_speed_m_s * 1e3:.0f} mm/s and "
        f"{math.degrees(mapping.angular_speed_rad_s):.0f} deg/s, {mapping.frame.value} axes"
    )
    print(
        f"  limits   {limits.linear_speed_m_s * 1e3:.0f} mm/s, "
        f"{math.degrees(limits.angular_speed_rad_s):.0f} deg/s"
    )
    if mapping.deadman:
        print(f"  dead-man {mapping.deadman!r} must be held to move")
    else:
        print("  dead-man NONE: any deflection moves the robot; set mapping.deadman beside people")


@app.command()
def devices(
    udev: Annotated[
        bool, typer.Option("--udev", help="Print the udev rules that give users access.")
    ] = False,
) -> None:
    """List the operator devices that are plugged in, and what stands in their way."""
    from cardan.drivers.spacemouse import list_devices, udev_rules

    if udev:
        print(udev_rules(), end="")
        return
    found = list_devices()
    if not found:
        print("no 3Dconnexion device is plugged in")
        return
    table = Table(box=None)
    for column in ("device", "id", "transport", "path", "state"):
        table.add_column(column)
    for device in found:
        table.add_row(
            device.name,
            f"{device.vendor_id:04x}:{device.product_id:04x}",
            device.transport,
            device.path,
            device.obstacle or "ready",
        )
    Console().print(table)


@app.command()
def dissect(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A pcap or pcapng file.")],
    port: Annotated[
        list[int] | None,
        typer.Option(metavar="PORT", help="Another UDP port that carries EGM (repeatable)."),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Print at most this many packets.")
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Print the figures of each flow only.")
    ] = False,
) -> None:
    """Print a capture: EGM datagrams and 3Dconnexion reports, field by field."""
    from cardan.dissect import dissect_file

    dissect_file(file, sys.stdout, egm_ports=tuple(port or ()), limit=limit, summary=summary)


def _listed(
    list_faults: bool,
    faults: Iterable[FaultSwitch],
    list_scripts: bool,
    scripts: dict[str, str],
    verbs: dict[str, str],
) -> bool:
    """Print what was asked for; True when that is all there is to do."""
    if list_faults:
        for fault in faults:
            print(f"{fault.name:14} {fault.help} (default {fault.default:g})")
    if list_scripts:
        for name, text in scripts.items():
            first = text.strip().splitlines()[0]
            print(f"{name:14} {first.lstrip('# ') if first.startswith('#') else ''}")
        print("\na file has a line a step, SECONDS and then one of:")
        for usage in verbs.values():
            print(f"  {usage}")
    return list_faults or list_scripts


def _serve(peer: SimulatedPeer, seconds: float | None) -> None:
    logging.basicConfig(
        stream=sys.stderr, level=logging.INFO, format="%(asctime)s %(name)s: %(message)s"
    )
    serve(peer, seconds)
