"""Records a session while it runs, by ``cardan record`` in a process of its own."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

from cardan.bus.options import BusOptions
from cardan.bus.router import RouterKeeper
from cardan.gateway.session.launched import Launched

LAST_S = 0.5
"""How long the recorder goes on after the session has ended: what it said last is on its way."""


@contextlib.contextmanager
def recorded(options: BusOptions, path: Path, *join: str) -> Iterator[Launched]:
    """Record the bus that `options` are of into `path`; gives the recorder, which has its report
    (`lines`, `code`) at the end.

    `join` is what ``cardan record`` is told of the bus. The router is there before the recorder,
    where it would be for the session to bring, so that the record has the first cycle. Raises
    DriverError where it cannot record.
    """
    with contextlib.closing(RouterKeeper(options)) as router:
        router.wait()
        recorder = Launched("record", "--output", str(path), *join)
        try:
            yield recorder
            time.sleep(LAST_S)
        finally:
            recorder.end()
