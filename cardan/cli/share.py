"""``cardan devices share``: an operator device for a session on another computer."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cardan.cli.common import Level, Seconds, Verbose, begin_serving
from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError, OptionError

if TYPE_CHECKING:
    from cardan.bus.options import BusOptions
    from cardan.drivers.registry import DriverTable


def share(
    device: Annotated[
        str,
        typer.Argument(
            metavar="FILE|DRIVER",
            help="Configuration file whose [device] is shared, or a driver with its defaults: "
            "spacemouse.",
        ),
    ],
    router: Annotated[
        str,
        typer.Option(
            metavar="ENDPOINT",
            help="Zenoh router, such as tcp/192.168.1.2:7447; default: this computer's.",
        ),
    ] = "",
    listen: Annotated[
        str,
        typer.Option(
            metavar="ENDPOINT", help="Without a router: the robot's side connects to this one."
        ),
    ] = "",
    zenoh_config: Annotated[
        str,
        typer.Option(
            metavar="PATH",
            help="Zenoh configuration file (JSON5), used as it is instead: for TLS, passwords and "
            "access control.",
        ),
    ] = "",
    name: Annotated[
        str, typer.Option(metavar="NAME", help="Name on the robot's side; default: DRIVER.")
    ] = "",
    seconds: Seconds = None,
    verbose: Verbose = False,
    log_level: Level = None,
) -> None:
    """Share an operator device with a session on another computer.

    The driver there is `remote`. Prints READY and the topic once it shares."""
    from cardan.common.serving import interruptible
    from cardan.gateway.bus.sharing import SharedConfig, ShareOptions, share_until
    from cardan.gateway.session.driver_assembly import make_device

    begin_serving(verbose, log_level)
    table = _table(device)
    opened = make_device(SharedConfig(device=table))
    bus = _bus(router, listen, zenoh_config)
    try:
        options = ShareOptions(name=name or table.driver, bus=bus)
    except OptionError as error:
        raise OptionError("--name", error.value, error.allowed) from None
    end_s = math.inf if seconds is None else time.monotonic() + seconds

    def ready(topic: str) -> None:
        print(f"READY {topic}", flush=True)

    def tell(words: str) -> None:
        print(f"cardan: {options.name}: {printable(words)}", file=sys.stderr, flush=True)

    with interruptible() as stop:
        share_until(opened, table.driver, options, ready, stop, end_s, tell)


def _table(given: str) -> DriverTable:
    """Return the table of a driver: from a file, or with its defaults."""
    from cardan.drivers import registry
    from cardan.gateway.bus.sharing import SharedConfig
    from cardan.gateway.session.config import read_part

    path = Path(given)
    if path.suffix == ".toml" or path.exists():
        return read_part(SharedConfig, path).device
    options = registry.load(given).Options
    waits = {"wait_for_device": True} if hasattr(options, "wait_for_device") else {}
    return registry.DriverTable(driver=given, options=waits)


def _bus(router: str, listen: str, zenoh_config: str) -> BusOptions:
    """Return the options to join the bus. Raises ConfigurationError."""
    from cardan.bus.options import BusOptions

    if sum(map(bool, (router, listen, zenoh_config))) > 1:
        raise ConfigurationError("--router, --listen, --zenoh-config", "give one of them")
    try:
        if zenoh_config:
            return BusOptions(zenoh_config=zenoh_config)
        if listen:
            return BusOptions(router="", listen=(listen,))
        return BusOptions(router=router, mode="client") if router else BusOptions(mode="client")
    except OptionError as error:
        key = "--listen" if listen else "--router"
        raise OptionError(key, error.value, error.allowed) from None
