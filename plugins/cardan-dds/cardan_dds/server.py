"""Bridge from the bus to DDS: ROS 2 programs without Zenoh observe and command the arms."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

from cardan.bus.dds_options import SERVER_NODE, DdsOptions
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.options import Options
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.base import Ready, Server
from cardan_dds.bridge import Bridge
from cardan_dds.network import DdsNetwork

LOOK_S = 0.05
"""Period of the checks for graph changes and for the end."""


@dataclass(frozen=True, kw_only=True)
class DdsBridgeOptions(Options):
    """Topics and services that the bridge joins."""

    topics: tuple[str, ...] = ("*",)
    """Patterns of the topics on DDS."""
    services: tuple[str, ...] = ()
    """Patterns of the services on DDS, including those of actions and parameters: "*" if all nodes
    there have rmw_cyclonedds. Others would see them as ready, and get no answer."""


@dataclass(frozen=True, kw_only=True)
class DdsServerOptions(Options):
    """The bus, the DDS domain, and the joined topics and services."""

    bus: BusOptions = field(default_factory=BusOptions)
    dds: DdsOptions = field(default_factory=DdsOptions)
    bridge: DdsBridgeOptions = field(default_factory=DdsBridgeOptions)


class Dds(Server[DdsServerOptions]):
    """Bridge the network to DDS, for ROS 2 nodes with rmw_cyclonedds or rmw_fastrtps: its topics
    and services, under their names; services for rmw_cyclonedds alone, where they are asked for."""

    Options = DdsServerOptions
    page = "../plugins/cardan-dds/README.md"
    example = "--dds-domain 0"
    epilog = "Prints READY and its DDS domain once it serves."

    @classmethod
    def serve(cls, options: DdsServerOptions, ready: Ready, stop: threading.Event) -> None:
        """Serve until `stop` is set. Raises ConfigurationError, ExtraMissingError, DriverError."""
        allowed = Allowed(options.bridge.topics, options.bridge.services, ())
        number = options.dds.number
        with (
            BusNetwork(options.bus, SERVER_NODE, deaf=True) as bus,
            DdsNetwork(options.dds, SERVER_NODE, deaf=True) as dds,
        ):
            bridge = Bridge(bus, dds, allowed)
            try:
                ready(f"dds/{number}")
                while not stop.wait(LOOK_S):
                    bridge.follow()
            finally:
                bridge.close()
