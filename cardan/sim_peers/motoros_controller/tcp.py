"""The simulated controller on three real TCP ports."""

from __future__ import annotations

import contextlib
import csv
import logging
import selectors
import socket
import struct
import time
from dataclasses import dataclass, field
from typing import Any, TextIO

from cardan.errors import ConfigurationError
from cardan.files import create_file
from cardan.sim_peers.base import SimulatedPeer
from cardan.sim_peers.motoros_controller.controller import MotorosController
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.servers import PORT_KINDS, MotorosServers, PortKind
from cardan.sockets import opened

_READ_BYTES = 4096
_BACKLOG_BYTES = 64 * 1024
"""Most bytes kept here, beside the kernel's buffer, for a client that does not read; with more its
connection is dropped."""
_WAITING_CLIENTS = 8
_RESET = struct.pack("ii", 1, 0)
_READ, _WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE

log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Link:
    number: int
    kind: PortKind
    connection: socket.socket
    backlog: bytearray = field(default_factory=bytearray)
    unread: bool = False
    """Something lies in the state port's receive buffer, where it stays."""
    watched: int = 0


class MotorosControllerPeer(SimulatedPeer):
    """Serves a `MotorosController` as MotoROS does: listens for motion, state and I/O clients.

    The interpolation clock and the state cycle keep an absolute schedule. With `options.log` every
    interpolation cycle becomes a row of a CSV file; with base port 0 any free ports are taken.
    """

    def __init__(self, options: MotorosControllerOptions | None = None) -> None:
        self.options = options = MotorosControllerOptions() if options is None else options
        self.controller = MotorosController(options)
        self.servers = MotorosServers(self.controller, options)
        self._listeners: dict[PortKind, socket.socket] = {}
        self._links: dict[int, _Link] = {}
        self._selector: selectors.BaseSelector | None = None
        self._log_file: TextIO | None = None
        self._logged: list[tuple[float, str] | None] = [None, None]

    @property
    def endpoint(self) -> str:
        return f"{self.options.host}:{self.motion_port}"

    @property
    def motion_port(self) -> int:
        """Where motion commands are served."""
        return self._port("motion")

    @property
    def state_port(self) -> int:
        """Where states are published."""
        return self._port("state")

    @property
    def io_port(self) -> int:
        """Where inputs, outputs and registers are served."""
        return self._port("io")

    def _port(self, kind: PortKind) -> int:
        listener = self._listeners.get(kind)
        if listener is not None:
            return int(listener.getsockname()[1])
        base = self.options.base_port
        return base + PORT_KINDS.index(kind) if base else 0

    def open(self) -> None:
        if self._selector is not None:
            return
        try:
            for kind in PORT_KINDS:
                host, port = self.options.host, self._port(kind)
                problem = f"cannot listen on {host}:{port}"
                self._listeners[kind] = opened(host, port, socket.SOCK_STREAM, _listen, problem)
            if self.options.log:
                # Only now: a peer that fails to start must not empty another one's log.
                self._log_file = _created(self.options.log)
                self.controller.log.insert(0, self.controller.log_columns)
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
        self._write_log()
        self._end_log()

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
                else:
                    self._accept(key.data)
                self._flush()
            self._report()
        self._write_log()

    # -- sockets ----------------------------------------------------------------------------------

    def _accept(self, kind: PortKind) -> None:
        try:
            connection, _ = self._listeners[kind].accept()
        except OSError:  # gone before it was taken, or no more file descriptors
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

    def _read(self, link: _Link) -> None:
        if link.number not in self._links:
            return
        flags = socket.MSG_PEEK if link.kind == "state" else 0
        try:
            data = link.connection.recv(_READ_BYTES, flags)
        except BlockingIOError:
            return
        except OSError as error:
            self.servers.lost(link.number, time.monotonic(), f"{error.strerror}")
            return
        now_s = time.monotonic()
        if not data:
            self.servers.eof(link.number, now_s)
            return
        link.unread = link.kind == "state"
        self.servers.data(link.number, data, now_s)

    def _flush(self) -> None:
        """Write what the servers have, then close what they have done with."""
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

    def _send(self, link: _Link, data: bytes) -> None:
        """Write, after what still waits; what the socket does not take waits."""
        if link.number not in self._links:
            return
        backlog = link.backlog
        backlog += data
        try:
            while backlog:
                del backlog[: link.connection.send(backlog)]
        except BlockingIOError:
            if len(backlog) > _BACKLOG_BYTES:
                backlog.clear()
                self.servers.lost(link.number, time.monotonic(), "its client does not read")
        except OSError as error:
            backlog.clear()
            self.servers.lost(link.number, time.monotonic(), f"{error.strerror}")

    def _forget(self, link: _Link) -> None:
        del self._links[link.number]
        if link.watched and self._selector is not None:
            self._selector.unregister(link.connection)
        link.connection.close()

    def _watch(self, selector: selectors.BaseSelector) -> None:
        """Listen to those sockets that may be read or can be written now."""
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
        for index, events in enumerate((self.controller.events, self.servers.events)):
            last, fresh = self._logged[index], []
            for event in reversed(events):
                if event is last:
                    break
                fresh.append(event)
            for _, text in reversed(fresh):
                log.info("%s", text)
            if fresh:
                self._logged[index] = fresh[0]

    def _write_log(self) -> None:
        """The rows since the last time; the controller keeps none of them. A file that cannot be
        written any more ends, and nothing else does."""
        rows = self.controller.log
        if self._log_file is not None and rows:
            try:
                csv.writer(self._log_file).writerows(rows)
            except OSError as error:
                self._end_log(error)
        rows.clear()

    def _end_log(self, error: OSError | None = None) -> None:
        file, self._log_file = self._log_file, None
        if file is None:
            return
        try:
            file.close()
        except OSError as closing:
            error = error or closing
        if error is not None:
            log.error("%s ends here, it cannot be written: %s", self.options.log, error.strerror)


def _listen(sock: socket.socket, address: Any) -> None:
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(address)
    sock.listen(_WAITING_CLIENTS)


def _created(path: str) -> TextIO:
    try:
        return create_file(path)
    except OSError as error:
        raise ConfigurationError("log", f"{path!r} cannot be written: {error.strerror}") from None
