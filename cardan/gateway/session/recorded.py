"""Records a session while it runs, by ``cardan net record`` in a process of its own."""

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
"""How long the recorder goes on after the session has ended: its last messages are on their way."""


def why_incomplete(recorder: CardanSubprocess, path: Path) -> str:
    """Why a recorder that has ended did not come to its end in good order; empty: it did, or says
    itself which part is missing."""
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
    """Record the bus that `options` are of into `path`; gives the recorder, which has its report
    (`lines`, `code`) at the end.

    `join` has the options of the bus for ``cardan net record``. The router is there before the
    recorder, where it would be for the session to bring, so that the record has the first cycle.
    Raises DriverError where it cannot record.
    """
    with contextlib.closing(RouterKeeper(options)) as router:
        router.wait()
        recorder = CardanSubprocess("net", "record", "--output", str(path), *join)
        try:
            yield recorder
            time.sleep(LAST_S)
        finally:
            recorder.end()
