"""The wires to a real server: connections to its socket."""

from __future__ import annotations

import socket

from cardan.conform.transports import CONNECT_S, StreamWire, TargetWire, Wires
from cardan.errors import AddressError


class UnixStream(Wires):
    """A Unix stream socket at a path; each channel is a connection of its own."""

    def __init__(self, path: str) -> None:
        self._path = path

    def open(self, channel: str) -> TargetWire:
        found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            found.settimeout(CONNECT_S)
            found.connect(self._path)
        except (OSError, ValueError) as error:
            found.close()
            raise AddressError(f"cannot connect to {self._path}: {error}") from None
        return StreamWire(found)
