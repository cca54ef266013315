"""A simulated peer that serves while a test does something else."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

from cardan.sim_peers.base import SimulatedPeer

_P = TypeVar("_P", bound=SimulatedPeer)
_SLICE_S = 0.02


@contextmanager
def in_a_thread(peer: _P) -> Iterator[_P]:
    """`peer`, opened, stepping in a thread of its own until the end."""
    peer.open()
    stopping = threading.Event()

    def serve() -> None:
        while not stopping.is_set():
            peer.step(time.monotonic() + _SLICE_S)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield peer
    finally:
        stopping.set()
        thread.join()
        peer.close()
