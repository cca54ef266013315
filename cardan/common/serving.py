"""Shared parts of the gateway's own commands that serve."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from cardan.common.signals import on_ending


@contextlib.contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Yield an event that is set by every signal that would end the process, in its main thread."""
    interrupted = threading.Event()
    with on_ending(lambda _signal: interrupted.set()):
        yield interrupted
