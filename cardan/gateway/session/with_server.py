"""A server beside a session, by ``cardan net server`` in a separate process."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from cardan.bus.discovery import bus_words, reachable
from cardan.bus.options import BusOptions
from cardan.bus.router import RouterKeeper
from cardan.gateway.session.subprocesses import CardanSubprocess


@contextlib.contextmanager
def with_server(
    name: str, options: BusOptions, host: str, port: int | None = None
) -> Iterator[CardanSubprocess]:
    """Run the server `name` at `host` and `port` (None: its default; 0: a free one) while a session
    with the bus of `options` runs; yield the server, whose `endpoint` is its address. Raises
    DriverError if it does not serve."""
    place = ("--host", host, *(() if port is None else ("--port", str(port))))
    with contextlib.closing(RouterKeeper(options)) as router:
        router.wait()
        server = CardanSubprocess("net", "server", name, *place, *bus_words(reachable(options)))
        try:
            yield server
        finally:
            server.end()
