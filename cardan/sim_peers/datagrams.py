"""Shell of a simulated controller that exchanges datagrams in a fixed cycle."""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from cardan.common.sockets import opened, waiting
from cardan.sim_peers.base import SimulatedPeer
from cardan.sim_peers.link import FaultyLink

LARGEST_DATAGRAM = 65535


class DatagramPeer(SimulatedPeer):
    """Passes datagrams and cycles to a core; a subclass has its sockets and messages.

    Cycles follow an absolute schedule; after a stall they continue on the schedule, without a
    burst. `faults` of the network act on both directions, unless the core has them itself.
    """

    def __init__(
        self, period_s: float, faults: Mapping[str, float] | None = None, seed: int = 0
    ) -> None:
        self._period_s = period_s
        self._socket: socket.socket | None = None
        self._next_s = 0.0
        self._out: FaultyLink[bytes] | None = None
        self._in: FaultyLink[tuple[bytes, Any]] | None = None
        if faults is not None and FaultyLink.wanted(faults):
            self._out = FaultyLink(faults, seed + 2, True)
            self._in = FaultyLink(faults, seed + 3)

    @abstractmethod
    def _connect(self) -> socket.socket:
        """Return a non-blocking socket. Raises an AddressError that says what to do."""

    @abstractmethod
    def _cycle(self, now_s: float, scheduled_s: float) -> None:
        """Run a cycle of the core, at `now_s` instead of `scheduled_s`; `_send` its datagrams."""

    @abstractmethod
    def _receive(self, data: bytes, source: Any, now_s: float) -> None:
        """Pass a datagram to the core."""

    @abstractmethod
    def _transmit(self, data: bytes) -> None:
        """Send a datagram to the other side. Never raises."""

    def _heard(self, answered: bool) -> None:
        """Record that the other side was heard, or that the system reported a refused datagram."""

    def open(self) -> None:
        if self._socket is None:
            self._socket = self._connect()
            self._next_s = time.monotonic()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def step(self, until_s: float) -> None:
        while self._socket is not None and (now_s := time.monotonic()) < until_s:
            self._take_in(self._socket, now_s)
            if now_s >= self._next_s:
                late = int((now_s - self._next_s) / self._period_s)
                scheduled_s = self._next_s + late * self._period_s
                self._next_s = scheduled_s + self._period_s
                self._cycle(now_s, scheduled_s)
            if self._out is not None:
                for data in self._out.pop(now_s):
                    self._transmit(data)
            self._wait(until_s)

    def _send(self, data: bytes, now_s: float) -> None:
        if self._out is None:
            self._transmit(data)
        else:
            self._out.push(now_s, data)

    def _take_in(self, sock: socket.socket, now_s: float) -> None:
        for data, source in waiting(sock, LARGEST_DATAGRAM, lambda: self._heard(False)):
            self._heard(True)
            if self._in is None:
                self._receive(data, source, time.monotonic())
            else:
                self._in.push(now_s, (data, source))
        if self._in is not None:
            for data, source in self._in.pop(now_s):
                self._receive(data, source, now_s)

    def _wait(self, until_s: float) -> None:
        """Wait until data arrives, or the next work is due."""
        links = [link.next_s() for link in (self._out, self._in) if link is not None]
        wake_s = min(self._next_s, until_s, *(math.inf if at is None else at for at in links))
        timeout_s = wake_s - time.monotonic()
        if timeout_s > 0.0 and self._socket is not None:
            select.select([self._socket], [], [], timeout_s)


class ListeningPeer(DatagramPeer):
    """A controller that listens on `host` and `port`, and sends to its client."""

    def __init__(
        self,
        host: str,
        port: int,
        period_s: float,
        faults: Mapping[str, float] | None = None,
        seed: int = 0,
    ) -> None:
        """Port 0: any free one."""
        super().__init__(period_s, faults, seed)
        self._host, self._port = host, port
        self._client: Any = None
        """Source of its client's datagrams, once the core has received one."""

    @property
    def endpoint(self) -> str:
        port = self._port if self._socket is None else self._socket.getsockname()[1]
        return f"{self._host}:{port}"

    def _connect(self) -> socket.socket:
        problem = f"cannot listen on {self._host}:{self._port}"
        return opened(self._host, self._port, socket.SOCK_DGRAM, socket.socket.bind, problem)

    def _transmit(self, data: bytes) -> None:
        if self._socket is not None and self._client is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._client)
