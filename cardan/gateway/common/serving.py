"""What the gateway's own commands that serve on a Unix socket share."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import stat
import threading
from collections.abc import Iterator

from cardan.errors import AddressError
from cardan.signals import on_ending

PROBE_S = 1.0
"""Longest wait for an answer of a program that may serve at a path: it can be busy."""


@contextlib.contextmanager
def interruptible() -> Iterator[threading.Event]:
    """An event that every signal sets which would end the process, in its main thread."""
    interrupted = threading.Event()
    with on_ending(lambda _signal: interrupted.set()):
        yield interrupted


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
