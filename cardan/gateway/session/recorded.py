"""Recording of a session while it runs, by ``cardan net record`` in a separate process."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Iterator
from pathlib import Path

from cardan.bus.options import BusOptions
from cardan.bus.router import RouterKeeper
from cardan.gateway.session.subprocesses import CardanSubprocess

LAST_S = 0.5
"""Time for which the recorder continues after the end of the session: its last messages are on
their way."""


def why_incomplete(recorder: CardanSubprocess, path: Path) -> str:
    """Return why a recorder did not shut down properly; empty if it did, or if it reports itself
    what is missing."""
    if recorder.code >= 0:
        return ""
    number = -recorder.code
    known = number in set(signal.Signals)
    name = signal.Signals(number).name if known else f"signal {number}"
    return (
        f"the recorder was ended by {name}: {path} has what came until less than a second before, "
        f"and no index; `cardan net record --repair {path}` writes a whole file of it"
    )


@contextlib.contextmanager
def recorded(options: BusOptions, path: Path, *join: str) -> Iterator[CardanSubprocess]:
    """Record the bus of `options` into `path`; yield the recorder, which has its report (`lines`,
    `code`) at the end. `join`: options of the bus for ``cardan net record``. A router that the
    session would start is started before the recorder, so that the record has the first cycle.
    Raises DriverError if it cannot record."""
    with contextlib.closing(RouterKeeper(options)) as router:
        router.wait()
        recorder = CardanSubprocess("net", "record", "--output", str(path), *join)
        try:
            yield recorder
            time.sleep(LAST_S)
        finally:
            recorder.end()
