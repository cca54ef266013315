"""The rosbridge v2 server: connects web pages and programs without ROS to the network over
WebSocket.

`serve` runs it; docs/protocols/rosbridge.md has the protocol, and the limits of a client.
"""

from __future__ import annotations

import asyncio
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

from cardan.bus.network import Network
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.bounds import ANY_PORT
from cardan.common.options import Options
from cardan.gateway.servers.base import Ready, Server
from cardan.gateway.servers.calls import Mailbox, ServiceCaller
from cardan.gateway.servers.numbers import ClientNumbers
from cardan.gateway.servers.read_only import network_for
from cardan.gateway.servers.refusals import Refusals
from cardan.gateway.servers.rosapi import RosApi
from cardan.gateway.servers.rosbridge_client import RosbridgeClient
from cardan.gateway.servers.rosbridge_subscriptions import shared_subscriptions
from cardan.gateway.servers.tokens import Role
from cardan.gateway.servers.web import (
    ListenerConnection,
    Page,
    WebOptions,
    WebSocketListener,
    serve_until,
)

PORT = 9090
"""Port at which clients of rosbridge look for a server."""


@dataclass(frozen=True, kw_only=True)
class RosbridgeOptions(WebOptions):
    """Address, access control and allow lists of the server."""

    port: Annotated[int, ANY_PORT] = PORT


class RosbridgeServer:
    """The server, in an asyncio loop: ``async with RosbridgeServer(network, options): ...``"""

    def __init__(self, network: Network, options: RosbridgeOptions | None = None) -> None:
        self.options = options or RosbridgeOptions()
        self.counts: Counter[str] = Counter()
        """Counts. "denied": refused connections; "refused": operations; "unreadable": messages of
        the network that do not match their topic's type; "superseded": publications replaced by
        newer ones; "too slow": clients closed for not reading; "cut off": clients whose frames
        waited while this process was paused; "stale": publications that waited too long to be
        passed on; "backlogged": clients disconnected because they send more than can be handled."""
        self._network = network
        self._allowed = self.options.allowed
        self._listener = self._make_listener()
        self._clients: set[RosbridgeClient] = set()
        self._numbers = ClientNumbers()
        self._mailbox: Mailbox | None = None

    def _make_listener(self, page: Page | None = None, private: str = "") -> WebSocketListener:
        """Make the listener; `page` answers GET, for everybody, except paths that begin with
        `private`, which are for clients only."""
        return WebSocketListener(
            self.options,
            self.counts,
            self._run,
            page=page,
            public=True,
            private=private,
            max_frame_bytes=self.options.max_frame_bytes,
            compress=self.options.compress,
        )

    @property
    def port(self) -> int:
        """Port that it listens at."""
        return self._listener.port

    @property
    def clients(self) -> int:
        """Number of connected clients."""
        return len(self._clients)

    async def __aenter__(self) -> RosbridgeServer:
        """Listen. Raises AddressError and ConfigurationError."""
        self._mailbox = Mailbox(asyncio.get_running_loop())
        self._rosapis = {role: self._rosapi(role, self._mailbox) for role in Role}
        self._shared_subscriptions = shared_subscriptions(self._network, self._mailbox, self.counts)
        self._refusals = Refusals(self._network, self._mailbox)
        await self._listener.open()
        self._refusals.begin()
        return self

    async def __aexit__(self, *_exception: object) -> None:
        """Disconnect all clients, and close their endpoints."""
        await self._listener.close()
        self._refusals.end()
        if self._mailbox is not None:
            self._mailbox.close()

    def _rosapi(self, role: Role, mailbox: Mailbox) -> RosApi:
        network = network_for(role, self._network)
        return RosApi(network, ServiceCaller(network, mailbox), self._allowed)

    async def _run(self, connection: ListenerConnection, peer: str, role: Role) -> None:
        mailbox = self._mailbox
        assert mailbox is not None
        with self._numbers.joined("rosbridge", connection, self._network, role) as (name, network):
            client = RosbridgeClient(
                connection,
                peer,
                network,
                ServiceCaller(network, mailbox),
                self._rosapis[role],
                self._shared_subscriptions,
                mailbox,
                self._allowed,
                self.counts,
                lasting=ServiceCaller(network_for(role, self._network), mailbox),
                max_bytes=self.options.max_frame_bytes,
                service_timeout_s=self.options.service_timeout_s,
            )
            self._clients.add(client)
            try:
                async with client:
                    with self._refusals.telling(f"/{name}", client.tell_refused):
                        await self._serve(client, connection, network, role)
            finally:
                self._clients.discard(client)

    async def _serve(
        self,
        client: RosbridgeClient,
        connection: ListenerConnection,
        _network: Network,
        _role: Role,
    ) -> None:
        """Handle a client's frames until it leaves; `network`: its own part."""
        async for frame in connection:
            client.receive(frame)


def serve(
    network: Network,
    options: RosbridgeOptions | None = None,
    ready: Callable[[int], None] = lambda port: None,
    stop: threading.Event | None = None,
) -> None:
    """Serve until `stop` is set; `ready` is called with the port.

    Raises AddressError and ConfigurationError.
    """
    serve_until(RosbridgeServer(network, options), ready, stop)


@dataclass(frozen=True, kw_only=True)
class RosbridgeServerOptions(Options):
    """The bus behind the server, and the server."""

    bus: BusOptions = field(default_factory=BusOptions)
    server: RosbridgeOptions = field(default_factory=RosbridgeOptions)


class Rosbridge(Server[RosbridgeServerOptions]):
    """Serve the bus by rosbridge v2, for web pages and programs without ROS: roslibjs, roslibpy,
    Foxglove."""

    Options = RosbridgeServerOptions
    page = "protocols/rosbridge.md"
    example = "--port 9090"

    @classmethod
    def serve(cls, options: RosbridgeServerOptions, ready: Ready, stop: threading.Event) -> None:
        """Serve until `stop` is set. Raises AddressError, ConfigurationError, ExtraMissingError or
        DriverError."""
        server = options.server
        with BusNetwork(options.bus, "rosbridge") as network:
            serve(network, server, lambda port: ready(server.endpoint(port)), stop)
