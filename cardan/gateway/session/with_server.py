"""Serves a server beside a session, by ``cardan net server`` in a process of its own."""

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
    """Serve the server `name` at `host` and `port` (None: its own; 0: one that is free) while a
    session runs whose bus `options` are of; gives the server, whose `endpoint` is its address.
    Raises DriverError where it does not serve."""
    place = ("--host", host, *(() if port is None else ("--port", str(port))))
    with contextlib.closing(RouterKeeper(options)) as router:
        router.wait()
        server = CardanSubprocess("net", "server", name, *place, *bus_words(reachable(options)))
        try:
            yield server
        finally:
            server.end()
