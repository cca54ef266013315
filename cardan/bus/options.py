"""Options to join the bus."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common.bounds import ANY_PORT, FILE, Range
from cardan.common.options import Options
from cardan.errors import OptionError

ROUTER = "tcp/127.0.0.1:7447"
"""Endpoint of rmw_zenoh's router."""

DOMAIN = Range(0, 232, "", "beyond it DDS has no ports")
"""ROS_DOMAIN_ID."""


_IP_PORT = re.compile(r"(?:tcp|udp|tls|quic|ws)/[^?#]*:([0-9]+)(?:[?#]|$)")


@dataclass(frozen=True, kw_only=True)
class BusOptions(Options):
    """Options to join the bus."""

    domain: Annotated[int, DOMAIN] = 0
    """ROS_DOMAIN_ID."""
    router: str = ROUTER
    """Endpoint of the Zenoh router; empty: none, others connect to `listen`."""
    listen: tuple[str, ...] = ("tcp/127.0.0.1:0",)
    """Endpoints that others connect to; port 0: any. Not used by a client."""
    mode: Literal["peer", "client"] = "peer"
    """"peer": others on this computer connect directly. "client": all messages pass the router, as
    a router on another computer requires."""
    zenoh_config: Annotated[str, FILE] = ""
    """Zenoh configuration file (JSON5), used unchanged instead of `router`, `listen` and `mode`."""
    distribution: Literal["humble", "iron and later", "kilted and later"] = "iron and later"
    """Distribution of the ROS 2 nodes: Humble has no type hashes, Kilted and later have more in the
    feedback of FollowJointTrajectory."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, endpoints in (("router", (self.router,)), ("listen", self.listen)):
            for each in endpoints:
                if each and "/" not in each:
                    raise OptionError(key, each, "an endpoint of Zenoh, such as tcp/127.0.0.1:7447")
                port = _IP_PORT.match(each)
                if port and (len(port[1]) > 5 or int(port[1]) not in ANY_PORT):
                    raise OptionError(key, each, "an endpoint with a port from 0 to 65535")
        if self.mode == "client" and not self.router and not self.zenoh_config:
            raise OptionError("router", self.router, "an endpoint, as a client needs one")
