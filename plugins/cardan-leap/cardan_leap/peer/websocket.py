"""WebSocket connections of the tracking service's clients."""

from __future__ import annotations

import contextlib
import logging
import socket
from collections.abc import Iterable

from websockets.exceptions import ConnectionClosed, InvalidState
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from cardan.errors import AddressError
from cardan.sim_peers.backends.base import DeviceBackend, Shell
from cardan.sim_peers.backends.server import DeviceServer, StreamClient, bound_to
from cardan_leap.peer.core import Message, SimulatedLeapService
from cardan_leap.protocol import HEARTBEAT_VERSIONS, ClientOptions, version_of

MAX_CLIENTS = 16
MAX_REQUEST_BYTES = 1 << 16
BACKLOG_BYTES = 1 << 18
"""Most bytes queued for a client that does not read; beyond it whole frames are dropped."""

_log = logging.getLogger(__name__)
_protocol_log = logging.getLogger(f"{__name__}.protocol")
"""Logger of websockets, which would otherwise log every frame."""
_protocol_log.setLevel(logging.WARNING)


class _Link(StreamClient):
    """A client's connection."""

    def __init__(self, sock: socket.socket, number: int) -> None:
        super().__init__(sock)
        self.number = number
        self.protocol = ServerProtocol(max_size=MAX_REQUEST_BYTES, logger=_protocol_log)
        self._ends = False
        """True: close the connection after the queued data."""

    @property
    def open(self) -> bool:
        """True if messages can be sent."""
        return self.protocol.state is State.OPEN

    def pump(self) -> None:
        """Queue the protocol's outgoing bytes."""
        for data in self.protocol.data_to_send():
            self.unsent += data
            self._ends |= not data

    def _pass_on(self) -> None:
        super()._pass_on()
        if self._ends:
            self.sock.shutdown(socket.SHUT_WR)
            self._ends = False


class LeapWebSocket(DeviceBackend[Message]):
    """Server at a port of `host` (0: any) for the clients of `service`. The script starts when the
    first client may receive frames.
    """

    def __init__(self, service: SimulatedLeapService, host: str, port: int) -> None:
        self._service = service
        self._host = host
        self.port = port
        """TCP port of the server."""
        self._next_number = 1
        self._restarts = 0

    @property
    def endpoint(self) -> str:
        """URL of the newest version."""
        return f"ws://{self._host}:{self.port}/v6.json"

    @property
    def there(self) -> bool:
        """True while the server listens."""
        return self._server.listening

    def open(self, shell: Shell) -> None:
        """Listen. Raises AddressError if that is impossible."""
        super().open(shell)
        self._server: DeviceServer[_Link] = DeviceServer(
            shell.selector, MAX_CLIENTS, meet=self._meet, take=self._receive, part=self._part
        )
        # Even if no client is to be accepted yet: a port in use is reported at once.
        self._listen()

    def appear(self) -> None:
        """Listen again."""
        # The port was free a moment ago; another program may have taken it meanwhile.
        with contextlib.suppress(AddressError):
            self._listen()

    def vanish(self) -> None:
        """Stop listening; connections stay."""
        self._server.stop_listening()

    def run_due(self, now_s: float) -> None:
        """Cut every connection when the service restarts."""
        if self._restarts != self._service.restarts:
            self._restarts = self._service.restarts
            _log.info("the service restarts")
            for link in tuple(self._server.clients):
                self._server.drop(link)

    def send(self, messages: Iterable[Message]) -> None:
        """Queue messages for their clients, except for a client with a full queue."""
        links = {link.number: link for link in self._server.clients}
        touched: dict[int, _Link] = {}
        for _, number, text in messages:
            link = links.get(number)
            if link is not None and link.open and len(link.unsent) <= BACKLOG_BYTES:
                link.protocol.send_text(text.encode())
                link.pump()
                touched[number] = link
        for link in touched.values():
            self._server.flush(link)

    def close(self) -> None:
        """Close every connection, with code 1001 like a service that ends."""
        for link in tuple(self._server.clients):
            with contextlib.suppress(ConnectionClosed, InvalidState):
                link.protocol.send_close(1001)
            self._pump(link)
        self._server.close()

    def _listen(self) -> None:
        listener = bound_to(self._host, self.port, "listen")
        self._server.listen_on(listener)
        self.port = int(listener.getsockname()[1])

    def _meet(self, sock: socket.socket) -> _Link:
        self._next_number += 1
        return _Link(sock, self._next_number - 1)

    def _part(self, link: _Link) -> None:
        self._service.disconnect(link.number)

    def _receive(self, link: _Link, data: bytes) -> None:
        link.protocol.receive_data(data)
        for event in link.protocol.events_received():
            if isinstance(event, Request):
                self._answer(link, event)
            elif isinstance(event, Frame) and event.opcode in (Opcode.TEXT, Opcode.BINARY):
                self._take(link, bytes(event.data))
        self._pump(link)

    def _answer(self, link: _Link, request: Request) -> None:
        """Answer the opening handshake and start the session."""
        protocol = link.protocol
        version = version_of(request.path)
        if version is None:
            protocol.send_response(protocol.reject(404, f"no such path: {request.path}\n"))
            return
        protocol.send_response(protocol.accept(request))
        if not link.open:
            return
        code = self._service.connect(link.number, version)
        if code is not None:
            _log.info("client %d asks for version %d: closed with %d", link.number, version, code)
            protocol.send_close(code)
            return
        _log.info("client %d speaks version %d", link.number, version)
        if version < HEARTBEAT_VERSIONS[0]:  # it gets frames without asking
            self.shell.begin()
        now_s = self.shell.device_s()
        self.send(Message(now_s, *message) for message in self._service.outgoing())

    def _take(self, link: _Link, data: bytes) -> None:
        self._service.receive(link.number, data, self.shell.device_s())
        newest = self._service.requests[-1][1]
        if isinstance(newest, ClientOptions) and newest.heartbeat:
            _log.debug("client %d: heartbeat", link.number)
        else:
            _log.info("client %d: %s", link.number, data.decode(errors="replace"))
        if link.number in self._service.clients:
            # A request shows that the client has read the service's version.
            self.shell.begin()

    def _pump(self, link: _Link) -> None:
        """Send the protocol's queued bytes."""
        link.pump()
        self._server.flush(link)
        if link.protocol.state is State.CLOSED:
            self._server.drop(link)
