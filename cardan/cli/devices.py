"""``cardan devices``: operator devices, their drivers, and servers that give them to programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import typer

from cardan.cli import completion
from cardan.cli.common import (
    EXIT_INCOMPLETE,
    AsJson,
    ConfigFile,
    Level,
    Seconds,
    Verbose,
    begin_serving,
    page_path,
    print_table,
    print_unusable,
)
from cardan.cli.installed import OpenGroup
from cardan.cli.share import share
from cardan.common.plugins import Loaded
from cardan.common.troubles import coded
from cardan.drivers.base import FoundDevice, OperatorDevice
from cardan.errors import ConfigurationError

devices = typer.Typer(name="devices", cls=OpenGroup)
devices.command()(share)


@devices.callback(invoke_without_command=True)
def _devices(context: typer.Context, as_json: AsJson = False) -> None:
    """List operator devices and drivers, and serve devices to programs. Without a command:
    `list`."""
    if context.invoked_subcommand is None:
        list_devices(as_json)
    elif as_json:
        raise ConfigurationError("--json", "goes behind the command's name")


@devices.command("list")
def list_devices(as_json: AsJson = False) -> None:
    """List plugged-in operator devices and their problems. `cardan devices` does the same."""
    from cardan import api

    found = api.devices()
    if not found and not as_json:
        print(
            "no operator device was found; serial, CAN and network devices are not detected: "
            "the options of their drivers name them"
        )
        return
    print_table(
        ("device", "driver", "id", "transport", "path", "state"),
        (
            (
                device.name,
                device.driver,
                device.identity,
                device.transport,
                device.path,
                (device.obstacle if as_json else coded(device.obstacle)) or "ready",
            )
            for device in (found if as_json else _merged(found))
        ),
        as_json,
    )


@devices.command()
def drivers(
    name: Annotated[
        str,
        typer.Argument(metavar="[NAME]", help="A driver.", autocompletion=completion.drivers),
    ] = "",
    as_json: AsJson = False,
) -> None:
    """List the drivers, those of other installed packages included: the names that a
    configuration's driver = "..." takes. With NAME, its options too."""
    from cardan.drivers import registry

    if name:
        found = Loaded({name: registry.load(name)}, {}, [])
    else:
        found = registry.load_all()
    print_table(
        ("driver", "table", "drives", "simulated by", "documentation"),
        [
            (
                name,
                "[device]" if issubclass(driver, OperatorDevice) else "[robot]",
                driver.summary,
                driver.peer and f"cardan sim {driver.peer}",
                page_path(driver.page),
            )
            for name, driver in found.classes.items()
        ],
        as_json,
    )
    if not as_json:
        print_unusable(found)
    if name and not as_json:
        from cardan.cli.driver_options import driver_options

        print()
        print_table(
            ("option", "default", "allowed", "meaning"), driver_options(found.classes[name].Options)
        )


def _merged(found: Sequence[FoundDevice]) -> list[FoundDevice]:
    """Merge the rows of all drivers whose search fails for the same reason."""
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


@devices.command()
def udev() -> None:
    """Print udev rules that let the user at the console open devices."""
    from cardan.drivers.udev import udev_rules

    print(udev_rules(), end="")


@devices.command()
def force(
    file: ConfigFile,
    connect: Annotated[
        str,
        typer.Option(metavar="PATH", help="Socket of the session: its force.socket."),
    ],
    seconds: Seconds = None,
    verbose: Verbose = False,
    log_level: Level = None,
) -> None:
    """Run the force node of a session in another process: read its robot's states, and send it the
    forces that the [force] and [[fixtures]] of FILE make of them. Prints READY once it runs."""
    from cardan.gateway.session.force_assembly import load_force
    from cardan.gateway.session.force_node import run_force_node

    begin_serving(verbose, log_level)
    sent = run_force_node(load_force(file), connect, seconds)
    print(f"{sent} forces sent")
    if not sent:
        raise typer.Exit(EXIT_INCOMPLETE)


@devices.command()
def haptic(
    file: ConfigFile,
    seconds: Seconds = None,
    verbose: Verbose = False,
    log_level: Level = None,
) -> None:
    """Serve a haptic device to ROS 2 without an arm: publish its pose and buttons, and render the
    feedback that programs publish. Of FILE it reads [device] and [network]. Prints READY and
    the name of its node once it serves."""
    from cardan.gateway.session.force_assembly import load_haptic
    from cardan.gateway.session.haptic_session import serve_haptic

    begin_serving(verbose, log_level)
    serve_haptic(load_haptic(file), seconds)
