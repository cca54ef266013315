"""Zenoh's router, by which sessions, servers and ROS 2 nodes over rmw_zenoh find each other."""

from __future__ import annotations

import os
import select
import sys
import threading
from dataclasses import dataclass
from typing import Annotated

from cardan.bus.node import close_session, router_config, words_of, zenoh_module
from cardan.bus.options import ROUTER
from cardan.bus.router import announced
from cardan.common.bounds import FILE
from cardan.common.options import Options
from cardan.errors import AddressError, OptionError
from cardan.gateway.servers.base import Ready, Server

LOOK_S = 0.1
"""Period of checks for its end."""


@dataclass(frozen=True, kw_only=True)
class RouterOptions(Options):
    """Endpoints and configuration of the router."""

    endpoint: tuple[str, ...] = (ROUTER,)
    """Endpoints for others. Each client in reach can move the arms on the bus: the default is this
    computer alone; tcp/0.0.0.0:7447 is every network of it."""
    connect: tuple[str, ...] = ()
    """Routers of other computers to join with."""
    zenoh_config: Annotated[str, FILE] = ""
    """Zenoh configuration file (JSON5), used as it is instead of `endpoint` and `connect`: for TLS,
    passwords and access control."""
    attached: bool = False
    """End with the standard input, together with the program at its other end."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, endpoints in (("endpoint", self.endpoint), ("connect", self.connect)):
            for each in endpoints:
                if "/" not in each:
                    raise OptionError(key, each, f"an endpoint of Zenoh, such as {ROUTER}")


class Router(Server[RouterOptions]):
    """Run a Zenoh router, like rmw_zenohd, by which sessions, servers and ROS 2 nodes meet."""

    Options = RouterOptions
    page = "ros2.md"
    example = "--endpoint tcp/0.0.0.0:7447"

    @classmethod
    def serve(cls, options: RouterOptions, ready: Ready, stop: threading.Event) -> None:
        """Route until `stop` is set. Raises AddressError, ConfigurationError, ExtraMissingError."""
        zenoh = zenoh_module()
        config = router_config(options.endpoint, options.connect, options.zenoh_config)
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise AddressError(
                f"the router cannot serve at {', '.join(options.endpoint)}; another router may "
                "already "
                f"serve there: {words_of(error)}"
            ) from None
        try:
            with announced(() if options.zenoh_config else options.endpoint):
                ready(options.zenoh_config or " ".join(options.endpoint))
                while not stop.wait(LOOK_S):
                    if options.attached and _at_its_end(sys.stdin.fileno()):
                        break
        finally:
            close_session(session)


def _at_its_end(descriptor: int) -> bool:
    """Return whether the end was reached; data is read, and has no meaning."""
    readable, _, _ = select.select((descriptor,), (), (), 0.0)
    return bool(readable) and not os.read(descriptor, 4096)
