"""Opens sockets to addresses as given by users, with errors that say what is wrong."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Callable, Iterator
from typing import Any, Final

from cardan.bounds import shared_address
from cardan.errors import AddressError

DRAIN_AT_MOST: Final = 256
"""Datagrams taken from a socket at once: a flood must not keep a cycle from its schedule."""

_ANY_PORT: Final = 9
"""For asking the system about an address: nothing is sent."""


def refuse_shared(problem: str, address: str, *, listens: bool) -> None:
    """Raise an AddressError that begins with `problem` unless `address`, a number, is one
    computer's; where it `listens`, it may stand for all of this computer's own."""
    kind = shared_address(address)
    if kind and listens and ipaddress.ip_address(address).is_unspecified:
        return
    if not kind and ":" not in address:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect((address, _ANY_PORT))
            except PermissionError:  # A network's broadcast address needs a permission of its own.
                kind = "a broadcast address"
            except OSError:
                pass
    if kind:
        raise AddressError(f"{problem}: {address} is {kind}; give the address of one computer")


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
        if kind is socket.SOCK_DGRAM:
            listens = join is not socket.socket.connect
            refuse_shared(problem, str(found[4][0]), listens=listens)
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
