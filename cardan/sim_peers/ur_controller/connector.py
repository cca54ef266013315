"""Real sockets of programs: the shell of `ProgramSockets`."""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import socket
from dataclasses import dataclass, field

from cardan.sim_peers.ur_controller.sockets import Opening, ProgramSockets

_READ, _WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE
_READ_BYTES = 4096
_CONNECTING = (0, errno.EINPROGRESS, errno.EWOULDBLOCK)
"""Results of a connect that is in progress, or done."""


@dataclass(eq=False)
class _Link:
    number: int
    sock: socket.socket
    connected: bool = False
    backlog: bytearray = field(default_factory=bytearray)
    watched: int = 0
    ends: bool = False
    """Close it once the backlog is written."""


class Connector:
    """Opens the connections that programs request; `selector` calls back for their events."""

    def __init__(self, sockets: ProgramSockets, selector: selectors.BaseSelector) -> None:
        self._sockets = sockets
        self._selector = selector
        self._links: dict[int, _Link] = {}

    def serve(self) -> None:
        """Carry out the programs' requests since the last call, and watch the connections."""
        sockets = self._sockets
        for opening in sockets.openings():
            self._open(opening)
        for number, data in sockets.outgoing():
            link = self._links.get(number)
            if link is not None:
                link.backlog += data
                self._write(link)
        for number in sockets.closings():
            link = self._links.get(number)
            if link is not None:
                link.ends = True
                if not link.backlog or not link.connected:
                    self._forget(link)
        for link in tuple(self._links.values()):
            self._watch(link)

    def close(self) -> None:
        """Close all."""
        for link in tuple(self._links.values()):
            self._forget(link)

    def _open(self, opening: Opening) -> None:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                opening.host, opening.port, type=socket.SOCK_STREAM
            )[0]
            sock = socket.socket(family, kind, protocol)
        except OSError as error:
            self._sockets.lost(opening.number, str(error.strerror))
            return
        sock.setblocking(False)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        error_number = sock.connect_ex(address)
        if error_number not in _CONNECTING:
            sock.close()
            self._sockets.lost(opening.number, os.strerror(error_number))
            return
        self._links[opening.number] = _Link(opening.number, sock)

    def _happened(self, link: _Link, events: int) -> None:
        if link.number not in self._links:
            return
        if events & _WRITE:
            if not link.connected:
                error = link.sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
                if error:
                    self._lost(link, os.strerror(error))
                    return
                link.connected = True
                self._sockets.opened(link.number)
            self._write(link)
        if events & _READ and link.number in self._links:
            self._read(link)

    def _read(self, link: _Link) -> None:
        try:
            data = link.sock.recv(_READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(link, str(error.strerror))
            return
        if data:
            self._sockets.data(link.number, data)
        else:
            self._lost(link, "closed by the other end")

    def _write(self, link: _Link) -> None:
        try:
            while link.backlog and link.connected:
                del link.backlog[: link.sock.send(link.backlog)]
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(link, str(error.strerror))
            return
        if link.ends:
            self._forget(link)

    def _lost(self, link: _Link, reason: str) -> None:
        self._sockets.lost(link.number, reason)
        self._forget(link)

    def _forget(self, link: _Link) -> None:
        if self._links.pop(link.number, None) is not None:
            if link.watched:
                self._selector.unregister(link.sock)
            link.sock.close()

    def _watch(self, link: _Link) -> None:
        reads = link.connected and not link.ends and self._sockets.takes(link.number)
        writes = not link.connected or bool(link.backlog)
        wanted = (_READ if reads else 0) | (_WRITE if writes else 0)
        if wanted == link.watched:
            return

        def happened(events: int) -> None:
            self._happened(link, events)

        if not link.watched:
            self._selector.register(link.sock, wanted, happened)
        elif wanted:
            self._selector.modify(link.sock, wanted, happened)
        else:
            self._selector.unregister(link.sock)
        link.watched = wanted
