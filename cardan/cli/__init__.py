"""The ``cardan`` command."""

from __future__ import annotations

import dataclasses
import io
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cardan import __version__
from cardan.cli.common import (
    EXIT_CANNOT_OPEN,
    EXIT_FAILED,
    EXIT_INCOMPLETE,
    EXIT_OK,
    EXIT_USAGE,
    ConfigFile,
    Seconds,
)
from cardan.cli.sim import sim
from cardan.drivers.base import FoundDevice, OperatorDevice
from cardan.errors import CaptureError, CardanError, ConfigurationError, OptionError, ScriptError
from cardan.gateway.session.snapshot import Snapshot
from cardan.types import DeviceLink, RobotLink

if TYPE_CHECKING:
    from cardan.gateway.session.config import SessionConfig

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
app.add_typer(sim)


def main() -> None:
    """Run the command line; errors become one line and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
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
    robot: Annotated[
        str, typer.Argument(metavar="gofa|gp8|omni", help="Which robot, or the drawing.")
    ] = "gofa",
    seconds: Annotated[float, typer.Option(min=3.0, help="How long to run.")] = 30.0,
) -> None:
    """Run the main job with no hardware: a simulated SpaceMouse drives a simulated robot, an ABB
    GoFa over EGM or a Motoman GP8 over MotoROS; or the hand on a simulated Phantom Omni draws with
    the GoFa's pen and feels its board (omni)."""
    from cardan.gateway.session.demo import run_demo

    raise typer.Exit(run_demo(seconds, robot))


@app.command(epilog=EPILOG)
def run(file: ConfigFile, seconds: Seconds = None) -> None:
    """Join the device and the robot of a configuration file until Ctrl-C."""
    from cardan.gateway.session.assembly import load_config
    from cardan.gateway.session.supervisor import supervise
    from cardan.gateway.session.view import SessionView, summary

    config = load_config(file)
    with SessionView() as view:
        outcome = supervise(config, math.inf if seconds is None else seconds, view.show)
    if outcome.last.cycles or outcome.last.elapsed_s:
        view.console.print(summary(outcome.last))
    if outcome.last.error:
        print(f"cardan: {outcome.last.error}", file=sys.stderr)
    if outcome.exit_code == EXIT_OK and (lack := _lack(outcome.last)):
        print(f"cardan: {lack}", file=sys.stderr)
        raise typer.Exit(EXIT_INCOMPLETE)
    raise typer.Exit(outcome.exit_code)


def _lack(last: Snapshot) -> str:
    """What was not as it should be when a session ended as asked; empty when all was."""
    if last.elapsed_s == 0.0:
        return ""
    if last.cycles == 0:
        return f"the robot was never commanded: {last.hold_reason or 'nothing was heard'}"
    if last.robot_link != RobotLink.LIVE.value:
        return f"at the end the robot was {last.robot_link}: {last.hold_reason}"
    if last.device_link in (DeviceLink.LOST.value, DeviceLink.STALE.value):
        return f"at the end the device was {last.device_link}: {last.device_reason}"
    return ""


@app.command()
def check(file: ConfigFile) -> None:
    """Check a configuration file without opening anything, and say what it would do."""
    from cardan.gateway.hand.mapping import Mode
    from cardan.gateway.session.assembly import load_config, make_filters

    config = load_config(file)
    mapping, limits = config.mapping, config.limits
    print(f"{file}: fine")
    print(f"  device   {config.device.driver if config.device else 'none'}")
    print(f"  robot    {config.robot.driver}")
    if config.device is None:
        print(f"  moved by {_moved_by_verbs(config)}")
    elif mapping.mode is Mode.POSITION:
        print(f"  mapping  the TCP moves as the hand does, {mapping.frame.value} axes")
    else:
        print(
            f"  mapping  full deflection is {mapping.linear_speed_m_s * 1e3:.0f} mm/s and "
            f"{math.degrees(mapping.angular_speed_rad_s):.0f} deg/s, {mapping.frame.value} axes"
        )
    for each in make_filters(config):
        print(f"  filter   {each.name}: {each.describe()}")
    if config.arm is not None:
        around = (
            f", {len(config.obstacles)} obstacles" if config.arm.collisions else ", collisions OFF"
        )
        print(f"  arm      {config.arm.model}, policy {config.arm.policy}{around}")
    if config.fixtures:
        print(f"  fixtures {', '.join(each.shape for each in config.fixtures)}")
    if config.force is not None and config.force.source != "none":
        how = f"{config.force.scale:g} N for each N of the robot"
        if config.force.source == "remote":
            how = f"by a force node at {config.force.socket}"
        print(f"  force    {config.force.source}, {how}")
    print(
        f"  limits   {limits.linear_speed_m_s * 1e3:.0f} mm/s, "
        f"{math.degrees(limits.angular_speed_rad_s):.0f} deg/s"
    )
    if config.device is None:
        return
    if mapping.deadman_buttons:
        held = " or ".join(repr(button) for button in mapping.deadman_buttons)
        print(f"  dead-man {held} must be held to move")
    elif mapping.clutch:
        print(f"  clutch   {mapping.clutch!r} begins and ends following; no dead-man is held")
    else:
        print("  dead-man NONE: any deflection moves the robot; set mapping.deadman beside people")


def _moved_by_verbs(config: SessionConfig) -> str:
    """What moves the arm of a session without a device."""
    from cardan.gateway.session.assembly import why_no_verbs

    if why := why_no_verbs(config):
        return f"NOTHING: {why}"
    authority = config.authority
    who = f"{authority.named!r} alone" if authority.named else "whoever has authority"
    return f"verbs and streams of a program (RemoteArm), {who}; `cardan run` shows it at rest"


@app.command()
def devices() -> None:
    """List the operator devices that are plugged in, and what stands in their way."""
    from cardan import api

    found = api.devices()
    if not found:
        print(
            "no operator device that shows itself is plugged in; serial, CAN and network devices "
            "do not, and their options name them"
        )
        return
    table = Table(box=None)
    for column in ("device", "driver", "id", "transport", "path", "state"):
        table.add_column(column)
    for device in _merged(found):
        table.add_row(
            *(
                Text(cell)  # What stands in brackets is no markup.
                for cell in (
                    device.name,
                    device.driver,
                    device.identity,
                    device.transport,
                    device.path,
                    device.obstacle or "ready",
                )
            )
        )
    Console().print(table)


def _merged(found: Sequence[FoundDevice]) -> list[FoundDevice]:
    """`found`, with one row for all drivers that the same thing hides the devices from."""
    rows: dict[object, list[FoundDevice]] = {}
    for number, device in enumerate(found):
        hidden = device.obstacle and not (device.path or device.identity)
        key = (device.transport, device.obstacle) if hidden else number
        rows.setdefault(key, []).append(device)
    return [
        row[0]._replace(
            name=", ".join(dict.fromkeys(device.name for device in row)),
            driver=", ".join(dict.fromkeys(device.driver for device in row)),
        )
        for row in rows.values()
    ]


@app.command()
def udev() -> None:
    """Print the udev rules that let the user at the console open the devices."""
    from cardan.drivers.udev import udev_rules

    print(udev_rules(), end="")


@app.command()
def spnav(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]",
            help="Configuration file whose device is served; default: the first SpaceMouse.",
        ),
    ] = None,
    socket: Annotated[
        str | None,
        typer.Option(metavar="PATH", help="The socket; default: spacenavd's own place."),
    ] = None,
    everybody: Annotated[
        bool, typer.Option("--everybody", help="Let every user of this machine connect.")
    ] = False,
    seconds: Seconds = None,
) -> None:
    """Serve an operator device to stock programs that use libspnav, as spacenavd does: version 0
    and 1 of its protocol. Prints READY and the socket's path once it serves."""
    from cardan.drivers.spacemouse import SpaceMouse, SpaceMouseOptions
    from cardan.gateway.session.assembly import load_served, make_device
    from cardan.gateway.spnav import SpnavServerOptions, serve_device

    if file is None:
        device: OperatorDevice = SpaceMouse(SpaceMouseOptions(wait_for_device=True))
        options = SpnavServerOptions()
    else:
        config = load_served(file)
        device, options = make_device(config), config.spnav.server_options()
    try:
        if socket is not None:
            options = dataclasses.replace(options, socket=socket)
    except OptionError as error:
        raise OptionError("--socket", error.value, error.allowed) from None
    if everybody:
        options = dataclasses.replace(options, access="everybody")
    serve_device(device, options, seconds)


@app.command(epilog=EPILOG)
def force(
    file: ConfigFile,
    connect: Annotated[
        str,
        typer.Option(metavar="PATH", help="The socket that the session offers: its force.socket."),
    ],
    seconds: Seconds = None,
) -> None:
    """Be the force node of a session in another process: read its robot's states, and send it the
    forces that the [force] and [[fixtures]] of FILE make of them. Prints READY once it does."""
    from cardan.gateway.session.assembly import load_force
    from cardan.gateway.session.force_node import run_force_node

    sent = run_force_node(load_force(file), connect, seconds)
    print(f"{sent} forces sent")
    if not sent:
        raise typer.Exit(EXIT_INCOMPLETE)


@app.command()
def dissect(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A pcap or pcapng file.")],
    port: Annotated[
        list[int] | None,
        typer.Option(
            metavar="PORT", min=1, max=65535, help="Another UDP port of EGM (repeatable)."
        ),
    ] = None,
    simple_message_port: Annotated[
        list[int] | None,
        typer.Option(
            metavar="PORT", min=1, max=65535, help="Another TCP port of MotoROS (repeatable)."
        ),
    ] = None,
    jr3_node: Annotated[
        list[int] | None,
        typer.Option(
            metavar="ID", min=1, max=127, help="Take this CAN node for a JR3 (repeatable)."
        ),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Print at most this many packets.")
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Print the figures of each flow only.")
    ] = False,
) -> None:
    """Print a capture, field by field: EGM, simple message (MotoROS), the joint stream, 3Dconnexion
    reports (usbmon), Wii Remotes (Bluetooth HCI) and JR3 sensors (CAN)."""
    from cardan.dissect import dissect_file

    dissect_file(
        file,
        sys.stdout,
        egm_ports=tuple(port or ()),
        simple_message_ports=tuple(simple_message_port or ()),
        jr3_nodes=tuple(jr3_node or ()),
        limit=limit,
        summary=summary,
    )
