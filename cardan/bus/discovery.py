"""Discovery of the nodes on the bus, and remedies if there are none."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cardan.bus.dds_options import SERVER_NODE
from cardan.bus.network import ServiceInfo, Topic
from cardan.bus.options import BusOptions
from cardan.bus.router import router_address, routers_here
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.options import suggestion
from cardan.errors import ConfigurationError

DISCOVERY_S = 2.0
"""Time of discovery: peers that learn of each other from a router connect within a second."""

APPEARS_WITHIN_S = 5.0
"""Longest wait for a topic: peers that learn of each other from a router connect within a second,
and a session opens its arm's model in two."""


class Discovery(NamedTuple):
    """Nodes, topics and services on the bus, besides the node that searches."""

    nodes: Sequence[str]
    topics: Mapping[str, Topic]
    services: Mapping[str, ServiceInfo]
    routers: int
    """Number of connected routers."""
    peers: int
    """Number of other Zenoh sessions that are connected directly."""


def reachable(options: BusOptions) -> BusOptions:
    """Return options by which another process reaches a node with these options: by the same
    router, or without one at the endpoint where the node listens."""
    router = options.router
    if not router:
        fixed = (each for each in options.listen if not each.endswith(":0"))
        router = next(fixed, "")
    names = {each.name for each in dataclasses.fields(BusOptions)}
    values = {name: getattr(options, name) for name in names}
    return BusOptions(**{**values, "router": router, "listen": BusOptions().listen})


def bus_words(options: BusOptions) -> list[str]:
    """Return the options of ``cardan net server`` that select a bus."""
    words = {
        "domain": str(options.domain),
        "router": options.router,
        "mode": options.mode,
        "zenoh-config": options.zenoh_config,
        "distribution": options.distribution,
    }
    return [f"--{key}={value}" for key, value in words.items() if value or key == "router"]


def discover(options: BusOptions) -> Discovery:
    """Join the bus, wait, and return the graph. Raises ExtraMissingError, ConfigurationError, or
    DriverError."""
    with BusNetwork(options, f"cardan_network_{time.time_ns() % 10**9}") as network:
        time.sleep(DISCOVERY_S)
        routers, peers = network.node.neighbors()
        own = network.node.full_name
        return Discovery(
            [name for name in network.nodes() if name != own],
            network.topics(),
            network.services(),
            len(routers),
            len(peers),
        )


def published(network: BusNetwork, name: str, key: str, remedy: str = "") -> Topic:
    """Return the topic once a node publishes it. Raises ConfigurationError for the setting `key` if
    none does in time; `remedy`: further advice for the message."""
    options = network.node.options
    if not network.wait_for_publisher(name, APPEARS_WITHIN_S):
        others = [each for each in routers_here() if each != options.router]
        raise ConfigurationError(
            key,
            f"no node publishes {name}{suggestion(name, network.topics())}: waited for "
            f"{APPEARS_WITHIN_S:g} s, {met_by(options)}; `cardan net list` lists what "
            "it finds, with advice if that is nothing"
            + (f"; {remedy}" if remedy else "")
            + (f"; other routers of this computer: {', '.join(others)}" if others else ""),
        )
    return network.topics()[name]


def met_by(options: BusOptions) -> str:
    """Describe how others are met with these options."""
    if options.zenoh_config:
        return f"as {options.zenoh_config} has it"
    return f"by the router {options.router}" if options.router else "without a router"


def remedies(options: BusOptions, found: Discovery) -> list[str]:
    """Return advice in sentences if no node was found; empty if one was."""
    if found.nodes:
        return []
    if found.routers and options.mode == "peer":
        return [
            "A router answers, but no node was found. ROS 2's router introduces peers, and "
            "forwards nothing between them: each has to reach the others by itself.",
            'On this computer: let all be peers (mode = "peer") with gossip, which is Zenoh\'s '
            'default, and each listen at a loopback port of its own (listen = ["tcp/127.0.0.1:0"]'
            "): so it is by default, here and with rmw_zenoh.",
            'To nodes of another computer: join its router as a client (mode = "client"): then all '
            "goes through that router.",
        ]
    if found.routers:
        return ["A router answers, but no node is connected to it, or to others that it knows."]
    if found.peers:
        return [
            "Another session of Zenoh answers, and it has no node of ROS 2: no session or server."
        ]
    if options.zenoh_config:
        return [f"No router or session answers as {options.zenoh_config} has it."]
    if not options.router:
        return [
            "No node can be found: there is no router, and no endpoint of a fixed port to connect "
            "to."
        ]
    if router_address(options) is None:
        return [
            f"No router or session answers at {options.router}: is the router started there, and "
            "does it listen beyond its own computer?"
        ]
    place = "" if options.router == BusOptions().router else _at(options)
    return [
        f"No router or session answers at {options.router}: start a session with [network], or a "
        f"router: `cardan net server router{place}`, or rmw_zenohd."
    ]


def unseen(found: Discovery) -> str:
    """Describe in a sentence what discovery cannot see; empty if nothing."""
    if not any(name == f"/{SERVER_NODE}" for name in found.nodes):
        return ""
    return (
        "`cardan net server dds` imports only DDS topics that have a subscriber on the bus. Others "
        "are neither listed here nor recorded; `cardan net echo`, `hz` and `record` miss them."
    )


def _at(options: BusOptions) -> str:
    return f" --endpoint {options.router}"
