"""Serves the console beside a session, by ``cardan face console`` in a process of its own."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from cardan.bus.options import BusOptions
from cardan.bus.router import RouterKeeper
from cardan.bus.survey import bus_words, reachable
from cardan.gateway.session.launched import Launched


@contextlib.contextmanager
def with_console(options: BusOptions, host: str, port: int | None = None) -> Iterator[Launched]:
    """Serve the page at `host` and `port` (None: the console's own; 0: one that is free) while a
    session runs whose bus `options` are of; gives the face, whose `endpoint` is the page's address.
    Raises DriverError where it does not serve."""
    place = ("--host", host, *(() if port is None else ("--port", str(port))))
    with contextlib.closing(RouterKeeper(options)) as router:
        router.wait()
        face = Launched("face", "console", *place, *bus_words(reachable(options)))
        try:
            yield face
        finally:
            face.end()
