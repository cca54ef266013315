"""Server of a session's device, from the bus, for programs that use libspnav."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, fields

from cardan.bus.options import BusOptions
from cardan.common.options import Options
from cardan.drivers.bus_devices import Ros2Spacenav
from cardan.drivers.ros2_nodes import Ros2SpacenavOptions
from cardan.gateway.bus.device_topics import SPACENAV_FULL
from cardan.gateway.servers.base import Ready, Server
from cardan_spnav_server.options import SpnavServerOptions
from cardan_spnav_server.server import serve_until


@dataclass(frozen=True, kw_only=True)
class DeviceTopic(Options):
    """Topic on which a session publishes its device."""

    topic: str = "/spacenav/joy"
    """Topic of the device, with its namespace, of a session with device = true in [network]."""


@dataclass(frozen=True, kw_only=True)
class SpnavBusServerOptions(Options):
    """Options: the bus, the device on it, and the socket."""

    bus: BusOptions = field(default_factory=BusOptions)
    device: DeviceTopic = field(default_factory=DeviceTopic)
    server: SpnavServerOptions = field(default_factory=SpnavServerOptions)


class SpnavBusServer(Server[SpnavBusServerOptions]):
    """Serve the operator device of a session to stock programs that use libspnav, as spacenavd
    does."""

    Options = SpnavBusServerOptions
    page = "../plugins/cardan-spnav-server/README.md"
    example = "--socket spnav.sock --model spacemouse-pro"

    @classmethod
    def serve(cls, options: SpnavBusServerOptions, ready: Ready, stop: threading.Event) -> None:
        """Serve until `stop` is set. Raises AddressError, ConfigurationError, ExtraMissingError or
        DriverError."""
        bus = {each.name: getattr(options.bus, each.name) for each in fields(options.bus)}
        device = Ros2Spacenav(
            Ros2SpacenavOptions(
                **bus,
                topic=options.device.topic,
                name="spnav_server",
                full_scale=SPACENAV_FULL,
                dead_zone=0.0,  # The session's driver has applied its own.
                wait_for_device=True,
            )
        )
        serve_until(device, options.server, ready, stop)
