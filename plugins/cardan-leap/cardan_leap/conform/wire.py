"""A WebSocket to a tracking service, for `cardan.conform.live`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

from cardan.conform.transports import CONNECT_S, TargetWire, Wires
from cardan.errors import AddressError
from cardan_leap.driver.connection import Connection


class _WebSocket(TargetWire):
    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def fileno(self) -> int:
        return self._connection.fileno()

    def read(self) -> Iterator[tuple[bytes, str]]:
        try:
            messages = self._connection.receive(0.0)
        except OSError:
            self.ended = True
            return
        for each in messages:
            yield each, ""

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._connection.send(data.decode())

    def close(self) -> None:
        self._connection.close()


class Service(Wires):
    """Service at `host` and `port`; the channel's number is the requested version."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port

    def open(self, channel: str) -> TargetWire:
        host, port, version = self._host, self._port, int(channel.removeprefix("v"))
        try:
            return _WebSocket(Connection(host, port, version, time.monotonic() + CONNECT_S))
        except (OSError, UnicodeError) as error:
            raise AddressError(f"no tracking service at {host}:{port}: {error}") from None
