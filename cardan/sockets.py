"""Opens sockets to addresses as given by users, with errors that say what is wrong."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from typing import Any, Final

from cardan.errors import AddressError

DRAIN_AT_MOST: Final = 256
"""Datagrams taken from a socket at once: a flood must not keep a cycle from its schedule."""


def opened(
    host: str,
    port: int,
    kind: socket.SocketKind,
    join: Callable[[socket.socket, Any], object],
    problem: str,
    family: socket.AddressFamily = socket.AF_INET,
) -> socket.socket:
    """A non-blocking socket that `join` has bound or connected to `host` and `port`.

    Raises an AddressError that begins with `problem`.
    """
    sock = None
    try:
        found = socket.getaddrinfo(host, port, family=family, type=kind)[0]
        sock = socket.socket(*found[:3])
        join(sock, found[4])
    except (OSError, UnicodeError) as error:
        if sock is not None:
            sock.close()
        raise AddressError(f"{problem}: {error}") from None
    sock.setblocking(False)
    return sock


def waiting(
    sock: socket.socket, largest: int, failed: Callable[[], object] = lambda: None
) -> Iterator[tuple[bytes, Any]]:
    """The datagrams of at most `largest` bytes that are there already, with their sources.

    `failed` is called for each OSError, as of an earlier datagram that was undeliverable.
    """
    for _ in range(DRAIN_AT_MOST):
        try:
            yield sock.recvfrom(largest)
        except BlockingIOError:
            return
        except OSError:
            failed()
