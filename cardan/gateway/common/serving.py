"""What the gateway's own commands that serve on a Unix socket share."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import socket
import stat
import threading
from collections.abc import Iterator
from types import FrameType

from cardan.errors import AddressError

PROBE_S = 1.0
"""Longest wait for an answer of a program that may serve at a path: it can be busy."""


@contextlib.contextmanager
def interruptible() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set, where signals can be taken (the main thread)."""
    interrupted = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        interrupted.set()

    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return
    previous = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield interrupted
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def make_room(path: str, kind: socket.SocketKind, other: str) -> None:
    """Remove a socket at `path` that nobody serves.

    `other` describes what may serve there. Raises AddressError for anything else at the path.
    """
    try:
        mode = os.stat(path, follow_symlinks=False).st_mode
    except FileNotFoundError:
        return
    except OSError as error:
        raise AddressError(f"cannot serve at {path}: {error.strerror or error}") from None
    if not stat.S_ISSOCK(mode):
        raise AddressError(f"cannot serve at {path}: there is something there that is no socket")
    with socket.socket(socket.AF_UNIX, kind) as probe:
        probe.settimeout(PROBE_S)
        try:
            probe.connect(path)
        except OSError as error:
            if error.errno != errno.ECONNREFUSED:
                raise AddressError(f"cannot serve at {path}: {error.strerror or error}") from None
        else:
            raise AddressError(
                f"cannot serve at {path}: {other} does; end it, or choose another path"
            )
    try:
        os.unlink(path)
    except FileNotFoundError:
        return
    except OSError as error:
        raise AddressError(f"cannot remove {path}: {error.strerror or error}") from None
