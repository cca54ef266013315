"""The Foxglove server: live view and commands for Foxglove and Lichtblick, by foxglove-sdk.

`serve` runs it; the plug-in's README.md describes the protocol and the bounds of a client.

The SDK has no access control. Therefore clients connect to Cardan's listener; behind it each has a
separate SDK server at a loopback address that only this process knows.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any

from cardan.bus.network import Handle, Network, NetworkError
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.bounds import ANY_PORT
from cardan.common.options import Options
from cardan.gateway.servers.base import Ready, Server
from cardan.gateway.servers.calls import Mailbox, ServiceCaller
from cardan.gateway.servers.graph import VisibleGraph
from cardan.gateway.servers.numbers import ClientNumbers
from cardan.gateway.servers.parameters import EVENT, EVENTS
from cardan.gateway.servers.refusals import Refusals
from cardan.gateway.servers.tokens import Role
from cardan.gateway.servers.web import (
    ListenerConnection,
    WebOptions,
    WebSocketListener,
    serve_until,
)
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan_foxglove.assets import Packages
from cardan_foxglove.client import AdvertisedGraph, FoxgloveConnection, sdk, shared_subscriptions
from cardan_foxglove.protocol import SUBPROTOCOLS

PORT = 8765
"""Foxglove's default port."""

LOOK_S = 0.25
"""Period of checks of the graph."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class FoxgloveOptions(WebOptions):
    """Access of clients to the server, and their rights."""

    port: Annotated[int, ANY_PORT] = PORT
    packages: tuple[str, ...] = ()
    """Folders of URDF packages whose meshes clients get, for "package://NAME/PATH" in a robot's
    description."""


class FoxgloveServer:
    """Server in an asyncio loop: ``async with FoxgloveServer(network, options): ...``"""

    def __init__(self, network: Network, options: FoxgloveOptions | None = None) -> None:
        """Raises ConfigurationError and ExtraMissingError."""
        sdk()
        # The SDK logs clients' mistakes without limit; the clients get error replies, which
        # suffice.
        logging.getLogger("foxglove").setLevel(logging.CRITICAL)
        self.options = options or FoxgloveOptions()
        self.counts: Counter[str] = Counter()
        """"denied": connections without access; "refused": refused requests of clients;
        "superseded": publications replaced by newer ones; "too slow": clients that were closed for
        not reading; "cut off": clients whose frames waited during a pause of this process; "stale":
        publications that waited for too long to be passed on; "backlogged": clients that sent more
        than can be handled and were disconnected."""
        self._network = network
        self._allowed = self.options.allowed
        self._packages = Packages(self.options.packages)
        self._graph = VisibleGraph(network, self._allowed)
        self._listener = WebSocketListener(
            self.options,
            self.counts,
            self._run,
            SUBPROTOCOLS,
            max_frame_bytes=self.options.max_frame_bytes,
            compress=self.options.compress,
        )
        self._clients: set[FoxgloveConnection] = set()
        self._numbers = ClientNumbers()
        self._mailbox: Mailbox | None = None
        self._looking: asyncio.Task[None] | None = None
        self._events: Handle | None = None

    @property
    def port(self) -> int:
        """Listening port."""
        return self._listener.port

    @property
    def clients(self) -> int:
        """Number of connected clients."""
        return len(self._clients)

    async def __aenter__(self) -> FoxgloveServer:
        """Listen. Raises AddressError and ConfigurationError."""
        loop = asyncio.get_running_loop()
        mailbox = self._mailbox = Mailbox(loop)
        self._shared_subscriptions = shared_subscriptions(self._network)
        self._looking = loop.create_task(self._look())
        with contextlib.suppress(NetworkError):
            self._events = self._network.subscribe(
                EVENTS, EVENT, lambda cdr, _stamp_ns: mailbox.put(lambda: self._tell_event(cdr))
            )
        self._refusals = Refusals(self._network, mailbox)
        await self._listener.open()
        self._refusals.begin()
        return self

    async def __aexit__(self, *_exception: object) -> None:
        """Disconnect all clients, and remove what they had."""
        await self._listener.close()
        self._refusals.end()
        if self._looking is not None:
            self._looking.cancel()
        if self._events is not None:
            self._events.close()
        if self._mailbox is not None:
            self._mailbox.close()

    async def _run(self, connection: ListenerConnection, peer: str, role: Role) -> None:
        mailbox = self._mailbox
        assert mailbox is not None
        with self._numbers.joined("foxglove", connection, self._network, role) as (name, network):
            client = FoxgloveConnection(
                connection,
                peer,
                network,
                ServiceCaller(network, mailbox),
                mailbox,
                self._shared_subscriptions,
                self._allowed,
                self._packages,
                self.counts,
                self._shown(),
                max_bytes=self.options.max_frame_bytes,
                service_timeout_s=self.options.service_timeout_s,
            )
            self._clients.add(client)
            try:
                async with client:
                    with self._refusals.telling(f"/{name}", client.tell_refused):
                        await client.relay()
            finally:
                self._clients.discard(client)

    def _shown(self) -> AdvertisedGraph:
        return AdvertisedGraph(self._graph.topics(), self._graph.callable_services())

    async def _look(self) -> None:
        """Update the clients' topics and services after changes of the graph."""
        before: AdvertisedGraph | None = None
        while True:
            await asyncio.sleep(LOOK_S)
            if not self._clients:
                continue
            try:
                now = self._shown()
                if now != before:
                    for client in tuple(self._clients):
                        client.show(now)
                before = now
            except Exception:
                _log.exception("the network's topics cannot be shown")

    def _tell_event(self, cdr: bytes) -> None:
        """Send changed parameters to clients."""
        event = codec_of(EVENT).decode(cdr)
        if isinstance(event, MalformedCdr):
            return
        changed: list[Any] = [*event["new_parameters"], *event["changed_parameters"]]
        for client in tuple(self._clients):
            client.tell_parameters(event["node"], changed)


def serve(
    network: Network,
    options: FoxgloveOptions | None = None,
    ready: Callable[[int], None] = lambda port: None,
    stop: threading.Event | None = None,
) -> None:
    """Serve until `stop` is set; `ready` is called with the port.

    Raises AddressError, ConfigurationError and ExtraMissingError.
    """
    serve_until(FoxgloveServer(network, options), ready, stop)


@dataclass(frozen=True, kw_only=True)
class FoxgloveServerOptions(Options):
    """Options of the bus and the server."""

    bus: BusOptions = field(default_factory=BusOptions)
    server: FoxgloveOptions = field(default_factory=FoxgloveOptions)


class Foxglove(Server[FoxgloveServerOptions]):
    """Serve the bus to Foxglove and Lichtblick: topics, services and parameters, live."""

    Options = FoxgloveServerOptions
    page = "../plugins/cardan-foxglove/README.md"
    example = "--origins https://app.foxglove.dev"

    @classmethod
    def serve(cls, options: FoxgloveServerOptions, ready: Ready, stop: threading.Event) -> None:
        """Serve until `stop` is set. Raises AddressError, ConfigurationError, ExtraMissingError or
        DriverError."""
        server = options.server
        with BusNetwork(options.bus, "foxglove") as network:
            serve(network, server, lambda port: ready(server.endpoint(port)), stop)
