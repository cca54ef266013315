"""Waiting for the kernel with a time limit, and peers that run in processes."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from cardan.sim_peers.base import SimulatedPeer, serve

_T = TypeVar("_T")

PATIENCE_S = 60.0
"""Time limit. An emulated processor is slow, and slower on a busy computer: at a load of 13 on two
cores, steps of a second or two took more than 12 s."""

MOST_S = 280.0
"""Time after which a served peer ends by itself."""


def wait_for(ask: Callable[[], _T], patience_s: float = PATIENCE_S, poll_s: float = 0.005) -> _T:
    """First true result of `ask`."""
    end_s = time.monotonic() + patience_s
    while not (answer := ask()):
        assert time.monotonic() < end_s, f"not within {patience_s:g} s; at last: {answer!r}"
        time.sleep(poll_s)
    return answer


@contextmanager
def in_a_process(peer: SimulatedPeer, most_s: float = MOST_S) -> Iterator[str]:
    """Serve `peer` in a separate process; yields its endpoint.

    A thread would not do for calls that block this process: hidapi's libusb back end waits for the
    device with Python's global lock held.
    """
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            os.dup2(writer, 1)
            sys.stdout = os.fdopen(1, "w", closefd=False)
            serve(peer, most_s)
        finally:
            os._exit(0)
    os.close(writer)
    try:
        with os.fdopen(reader) as said:
            word, _, endpoint = said.readline().rstrip("\n").partition(" ")
            assert word == "READY", "the simulated peer did not start"
            yield endpoint
    finally:
        os.kill(child, signal.SIGTERM)
        os.waitpid(child, 0)
