"""Shell of a simulated controller that serves several TCP ports."""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import struct
import time
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, Generic

from cardan.common.sockets import opened
from cardan.sim_peers.base import SimulatedPeer
from cardan.sim_peers.tcp_servers import KindT, TcpServers

_READ_BYTES = 4096
_BACKLOG_BYTES = 64 * 1024
"""Most bytes kept here, beyond the kernel's buffer, for a client that does not read; at the limit
its connection is dropped, or the excess discarded."""
_WAITING_CLIENTS = 8
_RESET = struct.pack("ii", 1, 0)
_READ, _WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE

log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Link(Generic[KindT]):
    number: int
    kind: KindT
    connection: socket.socket
    backlog: bytearray = field(default_factory=bytearray)
    unread: bool = False
    """Data lie in the receive buffer of a port that is never read."""
    watched: int = 0
    lost: bool = False
    """The client has left, or does not read."""


class TcpPeer(SimulatedPeer, Generic[KindT]):
    """Serves `servers` on an absolute schedule.

    Subclasses define `_port_of`; with port 0 any free ports are taken.
    """

    servers: TcpServers[KindT, Any]

    def __init__(self, host: str, servers: TcpServers[KindT, Any]) -> None:
        self._host = host
        self.servers = servers
        self._listeners: dict[KindT, socket.socket] = {}
        self._links: dict[int, _Link[KindT]] = {}
        self._selector: selectors.BaseSelector | None = None
        self._logged: list[tuple[float, str] | None] = []

    @abstractmethod
    def _port_of(self, kind: KindT) -> int:
        """Return the requested port; 0: any free one."""

    def _opened(self) -> None:
        """Open further resources after the ports. Raises a CardanError."""

    def _served(self) -> None:
        """Finish a step."""

    @property
    def kinds(self) -> tuple[KindT, ...]:
        """The ports, in the order in which they are opened."""
        return self.servers.kinds

    @property
    def endpoint(self) -> str:
        return f"{self._host}:{self.port(self.kinds[0])}"

    def port(self, kind: KindT) -> int:
        """Return the listening port, or the requested one while it is not open."""
        listener = self._listeners.get(kind)
        if listener is not None:
            return int(listener.getsockname()[1])
        return self._port_of(kind)

    def open(self) -> None:
        if self._selector is not None:
            return
        try:
            for kind in self.kinds:
                host, port = self._host, self.port(kind)
                problem = f"cannot listen on {host}:{port}"
                self._listeners[kind] = opened(host, port, socket.SOCK_STREAM, listen, problem)
            self._opened()
        except BaseException:
            self.close()
            raise
        # select() waits to the microsecond; epoll and poll only to the millisecond.
        self._selector = selectors.SelectSelector()
        for kind, listener in self._listeners.items():
            self._selector.register(listener, _READ, kind)
        self.servers.advance(time.monotonic())

    def close(self) -> None:
        for link in self._links.values():
            link.connection.close()
        for listener in self._listeners.values():
            listener.close()
        self._links.clear()
        self._listeners.clear()
        if self._selector is not None:
            self._selector.close()
            self._selector = None

    def step(self, until_s: float) -> None:
        selector, servers = self._selector, self.servers
        if selector is None:
            return
        while (now_s := time.monotonic()) < until_s:
            servers.advance(now_s)
            self._flush()
            self._watch(selector)
            timeout_s = min(servers.next_s, until_s) - time.monotonic()
            for key, events in selector.select(max(0.0, timeout_s)):
                if isinstance(key.data, _Link):
                    if events & _WRITE:
                        self._send(key.data, b"")
                    if events & _READ:
                        self._read(key.data)
                elif callable(key.data):  # Files of a peer besides its ports.
                    key.data(events)
                else:
                    self._accept(key.data)
                self._flush()
            self._report()
        self._served()

    # -- sockets ----------------------------------------------------------------------------------

    def _accept(self, kind: KindT) -> None:
        try:
            connection, _ = self._listeners[kind].accept()
        except OSError:  # The client left before it was accepted, or no file descriptor is free.
            return
        number = self.servers.accepted(kind, time.monotonic())
        if number is None:
            connection.close()
            return
        connection.setblocking(False)
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BACKLOG_BYTES)
        self._links[number] = _Link(number, kind, connection)

    def _read(self, link: _Link[KindT]) -> None:
        if link.number not in self._links:
            return
        stays = link.kind in self.servers.never_read
        try:
            data = link.connection.recv(_READ_BYTES, socket.MSG_PEEK if stays else 0)
        except BlockingIOError:
            return
        except OSError as error:
            self.servers.lost(link.number, time.monotonic(), f"{error.strerror}")
            return
        now_s = time.monotonic()
        if not data:
            self.servers.eof(link.number, now_s)
            return
        link.unread = stays
        self.servers.data(link.number, data, now_s)

    def _flush(self) -> None:
        """Write the servers' data, then close the connections that they have ended."""
        servers = self.servers
        for number, data in servers.outgoing():
            link = self._links.get(number)
            if link is not None:
                self._send(link, data)
        for number in servers.aborting():
            link = self._links.get(number)
            if link is not None:
                with contextlib.suppress(OSError):
                    link.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
                self._forget(link)
        for number in servers.closing():
            link = self._links.get(number)
            if link is not None:
                self._forget(link)

    def _send(self, link: _Link[KindT], data: bytes) -> None:
        """Write after data that still waits; data that the socket does not accept waits."""
        if link.number not in self._links or link.lost:
            return
        backlog = link.backlog
        if len(backlog) + len(data) <= _BACKLOG_BYTES or link.kind not in self.servers.leaves_out:
            backlog += data
        try:
            while backlog:
                del backlog[: link.connection.send(backlog)]
        except BlockingIOError:
            if len(backlog) > _BACKLOG_BYTES:
                self._lost(link, "its client does not read")
        except OSError as error:
            self._lost(link, f"{error.strerror}")

    def _lost(self, link: _Link[KindT], reason: str) -> None:
        """End a link, once: its further events are ignored."""
        link.lost = True
        link.backlog.clear()
        self.servers.lost(link.number, time.monotonic(), reason)

    def _forget(self, link: _Link[KindT]) -> None:
        del self._links[link.number]
        if link.watched and self._selector is not None:
            self._selector.unregister(link.connection)
        link.connection.close()

    def _watch(self, selector: selectors.BaseSelector) -> None:
        """Watch the sockets that may be read or can be written now."""
        servers = self.servers
        for link in self._links.values():
            reads = servers.takes(link.number) and not link.unread
            wanted = (_READ if reads else 0) | (_WRITE if link.backlog else 0)
            if wanted == link.watched:
                continue
            if not link.watched:
                selector.register(link.connection, wanted, link)
            elif wanted:
                selector.modify(link.connection, wanted, link)
            else:
                selector.unregister(link.connection)
            link.watched = wanted
        if servers.silent and self._listeners:
            for listener in self._listeners.values():
                with contextlib.suppress(KeyError):
                    selector.unregister(listener)

    # -- events -----------------------------------------------------------------------------------

    def _report(self) -> None:
        lists = self.servers.histories
        self._logged += [None] * (len(lists) - len(self._logged))
        for index, events in enumerate(lists):
            last, fresh = self._logged[index], []
            for event in reversed(events):
                if event is last:
                    break
                fresh.append(event)
            for _, text in reversed(fresh):
                log.info("%s", text)
            if fresh:
                self._logged[index] = fresh[0]


def listen(sock: socket.socket, address: Any) -> None:
    """Bind to the address and accept connections; for :func:`cardan.common.sockets.opened`."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(address)
    sock.listen(_WAITING_CLIENTS)
