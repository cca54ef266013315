"""Numbers of a server's clients, part of their names on the bus: a returning client has its number
again, and with it an arm's estimate of its clock."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator

from websockets.exceptions import ConnectionClosed

from cardan.bus.network import Network
from cardan.gateway.servers.read_only import network_for
from cardan.gateway.servers.tokens import Role
from cardan.gateway.servers.web import ListenerConnection

CAPACITY = 64
"""Most numbers kept for the addresses of clients that have left; the oldest are dropped first."""

RETENTION_S = 3600.0
"""Time for which they are kept."""


class ClientNumbers:
    """The numbers of one server, from 1 on. For one loop."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._new, self._clock = itertools.count(1), clock
        self._left: list[tuple[str, int, float]] = []
        """Address, number and time of clients that have left, the last one last."""

    @contextlib.contextmanager
    def of(self, address: str) -> Iterator[int]:
        """Return the number of a client from this address while it is connected: that of the last
        client of the same address that left, if there is one."""
        number = self._take(address)
        try:
            yield number
        finally:
            self._left = [*self._left[1 - CAPACITY :], (address, number, self._clock())]

    @contextlib.contextmanager
    def joined(
        self, kind: str, connection: ListenerConnection, network: Network, role: Role
    ) -> Iterator[tuple[str, Network]]:
        """Join a client of this kind while it is connected; yield its name on the network, and its
        part of the network. Its disconnection is no fault."""
        address = connection.remote_address
        with self.of(address[0] if address else "") as number:
            name = f"{kind}_client_{number}"
            # A node of its own: a motion without end that it asked for ends with it.
            part = network_for(role, network.part(name))
            try:
                with contextlib.suppress(ConnectionClosed):
                    yield name, part
            finally:
                part.close()

    def _take(self, address: str) -> int:
        now_s = self._clock()
        self._left = [each for each in self._left if now_s - each[2] <= RETENTION_S]
        for each in reversed(self._left):
            if each[0] == address:
                self._left.remove(each)
                return each[1]
        return next(self._new)
