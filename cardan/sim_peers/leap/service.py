"""The simulated tracking service on a real TCP port, speaking WebSocket."""

from __future__ import annotations

import contextlib
import logging
import math
import selectors
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated

from websockets.exceptions import ConnectionClosed, InvalidState
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from cardan import bounds
from cardan.bounds import Range
from cardan.errors import AddressError
from cardan.options import check_options
from cardan.protocols.leap import HEARTBEAT_VERSIONS, PORT, ClientOptions, version_of
from cardan.sim_peers.base import SimulatedPeer, load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.leap.core import DEFAULT_JITTER, DEFAULT_RATE_HZ, SimulatedLeapService
from cardan.sim_peers.leap.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHands, play

MAX_CLIENTS = 16
MAX_REQUEST_BYTES = 1 << 16
BACKLOG_BYTES = 1 << 18
"""A client that does not read gets no more frames beyond this; nothing that was begun is cut."""
_READ_BYTES = 1 << 16
_WAITING_CLIENTS = 8
_READ, _WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE

_log = logging.getLogger(__name__)
_protocol_log = logging.getLogger(f"{__name__}.websocket")
"""Of the library: it would tell of every frame."""
_protocol_log.setLevel(logging.WARNING)

RATE_HZ = Range(1.0, 1000.0, "Hz", "no tracker is faster")
JITTER = Range(0.0, 0.9, "", "a frame comes before the next one")


@dataclass(frozen=True)
class LeapPeerOptions:
    """What to simulate and where. Raises OptionError for a value that is not allowed."""

    host: Annotated[str, bounds.HOST] = option(
        "127.0.0.1", "The address it listens on.", metavar="HOST"
    )
    port: Annotated[int, bounds.ANY_PORT] = option(PORT, "Its port; 0: any.", metavar="PORT")
    script: str = "demo"
    """A built-in script or a file."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by the names of `FAULTS`; times count from the start of the script."""
    rate_hz: Annotated[float, RATE_HZ] = option(DEFAULT_RATE_HZ, "Frames a second.")
    jitter: Annotated[float, JITTER] = DEFAULT_JITTER
    """How late a frame may be, as a share of the period."""
    seed: int = 0
    """Of the jitter and of the faults' choices."""
    start_on_connect: bool = True
    """The script starts when the first client may get frames, not when the peer opens."""

    def __post_init__(self) -> None:
        check_options(self)


class _Link:
    """One client's connection."""

    def __init__(self, number: int, connection: socket.socket) -> None:
        self.number = number
        self.connection = connection
        self.protocol = ServerProtocol(max_size=MAX_REQUEST_BYTES, logger=_protocol_log)
        self.backlog = bytearray()
        self.watched = _READ
        self.ends = False
        """Nothing more is to be sent after the backlog."""
        self.skipped = 0
        """Messages it was too slow for."""


class LeapPeer(SimulatedPeer):
    """Serves a `SimulatedLeapService` to any number of clients up to `MAX_CLIENTS`.

    Raises ScriptError for a script or fault that does not exist or makes no sense.
    """

    def __init__(self, options: LeapPeerOptions | None = None) -> None:
        self.options = options = LeapPeerOptions() if options is None else options
        self.service = SimulatedLeapService(
            rate_hz=options.rate_hz,
            jitter=options.jitter,
            faults=options.faults,
            seed=options.seed,
        )
        self._hands = ScriptedHands(load_script(options.script, SCRIPTS, SCRIPT_VERBS))
        self._selector: selectors.BaseSelector | None = None
        self._listener: socket.socket | None = None
        self._port = options.port
        self._links: dict[int, _Link] = {}
        self._next_number = 1
        self._opened_s = 0.0
        self._start_s: float | None = None
        self._restarts = 0

    @property
    def endpoint(self) -> str:
        """The URL of the newest version."""
        return f"ws://{self.options.host}:{self._port}/v6.json"

    @property
    def port(self) -> int:
        """The port it listens on."""
        return self._port

    def open(self) -> None:
        """Listen. Raises AddressError where that cannot be."""
        if self._selector is not None:
            return
        # select() waits to the microsecond; epoll and poll only to the millisecond.
        self._selector = selectors.SelectSelector()
        self._opened_s = time.monotonic()
        if not self.options.start_on_connect:
            self._start_s = self._opened_s
        try:
            # Even where nobody is to be heard yet: a taken port shows at once.
            self._listen()
            if self._refuses(self._opened_s):
                self._stop_listening()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close every connection, with code 1001 as a service that ends."""
        for link in tuple(self._links.values()):
            with contextlib.suppress(ConnectionClosed, InvalidState):
                link.protocol.send_close(1001)
            self._pump(link)
            if link.number in self._links:
                self._forget(link)
        self._stop_listening()
        if self._selector is not None:
            self._selector.close()
            self._selector = None
        self._start_s = None

    def step(self, until_s: float) -> None:
        """Serve until the monotonic time `until_s`."""
        selector = self._selector
        if selector is None:
            return
        while True:
            now_s = time.monotonic()
            self._play(now_s)
            if now_s >= until_s:
                return
            due_s = min(until_s, self._next_due_s(now_s))
            if not selector.get_map():
                time.sleep(max(0.0, due_s - now_s))
                continue
            for key, events in selector.select(max(0.0, due_s - now_s)):
                if isinstance(key.data, _Link):
                    if events & _WRITE:
                        self._write(key.data)
                    if events & _READ:
                        self._read(key.data)
                else:
                    handle: Callable[[], None] = key.data
                    handle()

    # -- time ----------------------------------------------------------------------------------

    def _script_s(self, now_s: float) -> float:
        return 0.0 if self._start_s is None else now_s - self._start_s

    def _refuses(self, now_s: float) -> bool:
        """Whether nobody listens: at first, by the fault, or during a restart."""
        refused_s = self.options.faults.get("refuse", 0.0)
        return now_s - self._opened_s < refused_s or not self.service.listening

    def _next_due_s(self, now_s: float) -> float:
        if self._start_s is None:
            refused_s = self._opened_s + self.options.faults.get("refuse", 0.0)
            return refused_s if refused_s > now_s else math.inf
        return self._start_s + min(self.service.next_due_s, self._hands.next_due_s)

    def _play(self, now_s: float) -> None:
        if self._start_s is not None:
            script_s = self._script_s(now_s)
            self.service.skip_to(script_s)
            self._send(play(self.service, self._hands, script_s))
        if self._restarts != self.service.restarts:
            self._restarts = self.service.restarts
            _log.info("the service restarts")
            for link in tuple(self._links.values()):
                self._forget(link)
        if self._refuses(now_s):
            self._stop_listening()
        elif self._listener is None:
            # A port that was free a moment ago; whoever took it meanwhile keeps it for now.
            with contextlib.suppress(AddressError):
                self._listen()

    def _send(self, sent: list[tuple[float, int, str]]) -> None:
        touched: dict[int, _Link] = {}
        for _, number, text in sent:
            link = self._links.get(number)
            if link is None or link.protocol.state is not State.OPEN:
                continue
            if len(link.backlog) > BACKLOG_BYTES:
                link.skipped += 1
                continue
            link.protocol.send_text(text.encode())
            link.backlog += b"".join(link.protocol.data_to_send())
            touched[number] = link
        for link in touched.values():
            self._write(link)

    # -- sockets -------------------------------------------------------------------------------

    def _listen(self) -> None:
        assert self._selector is not None
        host = self.options.host
        listener = None
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, self._port, type=socket.SOCK_STREAM
            )[0]
            listener = socket.socket(family, kind, protocol)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(_WAITING_CLIENTS)
        except (OSError, UnicodeError) as error:
            if listener is not None:
                listener.close()
            raise AddressError(f"cannot listen on {host}:{self._port}: {error}") from None
        listener.setblocking(False)
        self._port = int(listener.getsockname()[1])
        self._listener = listener
        self._selector.register(listener, _READ, self._accept)

    def _stop_listening(self) -> None:
        if self._listener is not None:
            if self._selector is not None:
                self._selector.unregister(self._listener)
            self._listener.close()
            self._listener = None

    def _accept(self) -> None:
        assert self._listener is not None
        assert self._selector is not None
        try:
            connection, _ = self._listener.accept()
        except OSError:  # gone before it was taken, or no more file descriptors
            return
        if len(self._links) >= MAX_CLIENTS:
            connection.close()
            return
        connection.setblocking(False)
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link = _Link(self._next_number, connection)
        self._next_number += 1
        self._links[link.number] = link
        self._selector.register(connection, _READ, link)

    def _read(self, link: _Link) -> None:
        if link.number not in self._links:
            return
        try:
            data = link.connection.recv(_READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            self._forget(link)
            return
        if data:
            link.protocol.receive_data(data)
        else:
            link.protocol.receive_eof()
        for event in link.protocol.events_received():
            if isinstance(event, Request):
                self._answer(link, event)
            elif isinstance(event, Frame) and event.opcode in (Opcode.TEXT, Opcode.BINARY):
                self._take(link, bytes(event.data))
        self._pump(link)
        if not data and link.number in self._links:
            self._forget(link)

    def _answer(self, link: _Link, request: Request) -> None:
        """Answer the opening handshake, and begin to serve."""
        protocol = link.protocol
        version = version_of(request.path)
        if version is None:
            protocol.send_response(protocol.reject(404, f"no such path: {request.path}\n"))
            return
        protocol.send_response(protocol.accept(request))
        if protocol.state is not State.OPEN:
            return
        code = self.service.connect(link.number, version)
        if code is not None:
            _log.info("client %d asks for version %d: closed with %d", link.number, version, code)
            protocol.send_close(code)
            return
        _log.info("client %d speaks version %d", link.number, version)
        if version < HEARTBEAT_VERSIONS[0]:  # it gets frames without asking
            self._begin()
        for number, text in self.service.outgoing():
            other = self._links.get(number)
            if other is not None and other.protocol.state is State.OPEN:
                other.protocol.send_text(text.encode())
                self._pump(other)

    def _take(self, link: _Link, data: bytes) -> None:
        now_s = time.monotonic()
        self.service.receive(link.number, data, self._script_s(now_s))
        newest = self.service.requests[-1][1]
        if isinstance(newest, ClientOptions) and newest.heartbeat:
            _log.debug("client %d: heartbeat", link.number)
        else:
            _log.info("client %d: %s", link.number, data.decode(errors="replace"))
        if link.number in self.service.clients:
            # Asking for anything means that the client has read the service's version.
            self._begin()

    def _begin(self) -> None:
        """Start the script, unless it has begun."""
        if self._start_s is None:
            self._start_s = time.monotonic()

    def _pump(self, link: _Link) -> None:
        """Pass on what the protocol has to say."""
        for data in link.protocol.data_to_send():
            if data:
                link.backlog += data
            else:
                link.ends = True
        self._write(link)
        if link.protocol.state is State.CLOSED and link.number in self._links:
            self._forget(link)

    def _write(self, link: _Link) -> None:
        if link.number not in self._links:
            return
        try:
            while link.backlog:
                del link.backlog[: link.connection.send(link.backlog)]
            if link.ends:
                link.connection.shutdown(socket.SHUT_WR)
                link.ends = False
        except BlockingIOError:
            pass
        except OSError:
            self._forget(link)
            return
        wanted = _READ | (_WRITE if link.backlog else 0)
        if wanted != link.watched and self._selector is not None:
            link.watched = wanted
            self._selector.modify(link.connection, wanted, link)

    def _forget(self, link: _Link) -> None:
        del self._links[link.number]
        self.service.disconnect(link.number)
        if self._selector is not None:
            self._selector.unregister(link.connection)
        link.connection.close()
