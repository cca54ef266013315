"""``cardan devices spnav``: serves an operator device to programs that use libspnav."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from cardan.cli.common import Level, Seconds, Verbose, begin_serving
from cardan.drivers.base import OperatorDevice
from cardan.errors import OptionError


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
    verbose: Verbose = False,
    log_level: Level = None,
) -> None:
    """Serve an operator device to programs that use libspnav.

    As spacenavd does: version 0 and 1 of its protocol. Prints READY and the socket's path once
    it serves."""
    from cardan.drivers.spacemouse import SpaceMouse, SpaceMouseOptions
    from cardan.gateway.session.config import read_part
    from cardan.gateway.session.driver_assembly import make_device
    from cardan_spnav_server import SpnavServerOptions, serve_device
    from cardan_spnav_server.config import ServedConfig

    begin_serving(verbose, log_level)
    if file is None:
        device: OperatorDevice = SpaceMouse(SpaceMouseOptions(wait_for_device=True))
        options = SpnavServerOptions()
    else:
        config = read_part(ServedConfig, file)
        device, options = make_device(config), config.spnav
    try:
        if socket is not None:
            options = dataclasses.replace(options, socket=socket)
    except OptionError as error:
        raise OptionError("--socket", error.value, error.allowed) from None
    if everybody:
        options = dataclasses.replace(options, access="everybody")
    serve_device(device, options, seconds)
