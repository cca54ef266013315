"""Unix packet sockets in place of devices, served by simulated devices."""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable
from typing import TypeVar

from cardan.common.sockets import absence, connected, hang_up
from cardan.errors import DeviceAccessError

TIMEOUT_S = 1.0
"""Longest wait for a connection: a running program accepts it at once."""

FEEDBACK_TIMEOUT_S = 0.03
"""The same for feedback, which the reader sends: meanwhile nothing is read. A program that does not
read its socket accepts nothing once that is full."""

_ROOM = 4096
"""Size of every read, bytes: a smaller one would truncate packets."""

L = TypeVar("L")


def require_unix_sockets() -> None:
    """Raise DeviceAccessError if the system has no Unix sockets."""
    if not hasattr(socket, "AF_UNIX"):
        raise DeviceAccessError("this system has no Unix sockets: use another transport")


def open_simulated(name: str, path: str, link: Callable[[str], L]) -> L:
    """Open `link` at `path`, where the simulated device `name` is served. Raises
    DeviceAccessError."""
    require_unix_sockets()
    try:
        return link(path)
    except OSError as error:
        raise DeviceAccessError(
            f"cannot open {name} at {path}: {absence(path) or error.strerror or error}; "
            "is its simulated device running?"
        ) from None


class PacketSocket:
    """Connection to the socket at `path`; its methods raise OSError once the other end is gone."""

    def __init__(self, path: str) -> None:
        self._peer = connected(path, socket.SOCK_SEQPACKET, TIMEOUT_S)

    def receive(self, timeout_s: float) -> bytes | None:
        """Receive one packet; None if none comes in time."""
        self._peer.settimeout(timeout_s)
        try:
            packet = self._peer.recv(_ROOM)
        except (TimeoutError, BlockingIOError):
            return None
        if not packet:
            raise OSError(errno.ENODEV, "unplugged")
        return packet

    def send(self, packet: bytes, timeout_s: float = FEEDBACK_TIMEOUT_S) -> None:
        """Send one packet. Raises TimeoutError if it is not accepted in time."""
        self._peer.settimeout(timeout_s)
        self._peer.send(packet)

    def close(self) -> None:
        """Close the connection."""
        hang_up(self._peer)
