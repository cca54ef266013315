"""Web server of a network server: access by address, name and token, and TLS. The options are the
same for every such server."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import ssl
import threading
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from math import ceil
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol
from urllib.parse import SplitResult, urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve as serve_websocket
from websockets.datastructures import Headers
from websockets.frames import DATA_OPCODES, Frame
from websockets.http11 import Request, Response
from websockets.protocol import Event
from websockets.typing import Data, Subprotocol

from cardan.common.bounds import ANY_PORT, LISTEN_HOST, PATH, Range
from cardan.common.files import read_text
from cardan.common.options import CODE_ONLY, Options, require
from cardan.common.sockets import has_room, is_loopback, waiting_bytes
from cardan.errors import AddressError, ConfigurationError, OptionError
from cardan.gateway.arm.backlog import BACKLOGGED, Backlog
from cardan.gateway.servers import stats
from cardan.gateway.servers.access import AccessControl, AccessDenied, ClientInfo
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.pause_detector import BEAT_S, StandStill
from cardan.gateway.servers.tokens import (
    Role,
    Tokens,
    check_token,
    made_tokens,
    parse_tokens,
    read_tokens,
)
from cardan.types import NEVER_S

TOKEN_VARIABLE = "CARDAN_SERVER_TOKEN"
"""The environment variable for the token if no option has it."""
FORMER_TOKEN_VARIABLE = "CARDAN_FACE_TOKEN"

SEND_BUFFER_BYTES = 128 * 1024
"""System's buffer for a client that does not read: a larger one would only make its data older."""

FRAMES_AHEAD = 4
"""Most frames of a client that are read before their turn."""

PING_INTERVAL_S = 5.0
PING_TIMEOUT_S = 10.0
"""Time without an answer to a ping after which a client counts as gone, or too slow. If its cable
was pulled, its open-ended requests go on until then."""

CLOSE_TIMEOUT_S = 1.0
"""Longest wait for a client's closing handshake."""

LOOK_S = 0.1
"""Period of checks for a server's end."""
HANDSHAKE_S = 5.0
"""Longest time for a client's handshake, and before that for TLS."""

BACKLOG = 1024
"""Connections that the system keeps until this server takes them: further clients have to retry,
which systems do after a whole second."""

MAX_ARRIVALS = 256
ARRIVALS_PERIOD_S = 0.01
"""Number of kept samples of the bytes that had arrived, and their spacing: longer together than a
client may be backlogged."""

MOST_HANDSHAKES = 64
"""Most connections without a complete handshake; a further one replaces the oldest, so that clients
can connect while silent connections are opened."""

SOCKET_PATH = "/ws"
"""Path of the WebSocket on a server that has pages."""

MOST_DENIALS_SHOWN = 10
"""Most denials logged as warnings; later ones are debug messages, so that no client can fill a
disk."""

_CLIENTS = Range(1, 1000, "", "each costs a connection")
_FRAME_BYTES = Range(1000, 100_000_000, "bytes", "a frame is read before it is refused")
_SERVICE_S = Range(0.0, 86_400.0, "s", "a call that takes a day is an action", above=True)

_log = logging.getLogger(__name__)
_library_log = logging.getLogger(f"{__name__}.websockets")
"""Logger of the library, which would log request lines with tokens."""
_library_log.setLevel(logging.CRITICAL)


def refuse_former_variable() -> None:
    """Raise ConfigurationError if the token's environment variable has its former name: ignored, it
    would leave the server open."""
    if os.environ.get(FORMER_TOKEN_VARIABLE, "").strip():
        raise ConfigurationError(
            FORMER_TOKEN_VARIABLE,
            f"is now: {TOKEN_VARIABLE}; rename it where it is set, or unset it",
        )


Page = Callable[[str, Headers], Awaitable["Answer | None"]]
"""Returns a page's content for path and headers; None: there is no such path."""


class Answer(NamedTuple):
    """Answer of a page."""

    content_type: str
    body: bytes
    status: HTTPStatus = HTTPStatus.OK
    headers: tuple[tuple[str, str], ...] = ()
    """Further headers."""


@dataclass(frozen=True, kw_only=True)
class ListenerOptions(Options):
    """Address and access control of a server."""

    makes_certificate: ClassVar[bool] = False
    """True if the server makes a certificate of its own when it needs one."""

    host: Annotated[str, LISTEN_HOST] = "127.0.0.1"
    """Address to listen at; an address that others reach needs a certificate and a token."""
    port: Annotated[int, ANY_PORT] = 0
    """TCP port to listen at; 0: any free port."""
    token: str = field(default="", repr=False, metadata=CODE_ONLY)
    """Token in the clients' address: ws://HOST:PORT/?t=TOKEN, or /TOKEN; an operator's. Empty:
    those of `token_file` or of the environment. Not an option of a command, because all users see
    command lines."""
    token_file: Annotated[str, PATH] = ""
    """File with the tokens that clients have in the address, ws://HOST:PORT/?t=TOKEN or /TOKEN, or
    in a header; one per line, after its role: viewer, operator or admin (without: operator). Only
    its owner may read it. Without it the environment's CARDAN_SERVER_TOKEN; without both, none is
    needed on this computer, and for others some are generated."""
    certificate: Annotated[str, PATH] = ""
    """File with the certificate chain (PEM), for wss; empty: ws."""
    key: Annotated[str, PATH] = ""
    """File with the certificate's private key (PEM)."""
    plaintext: bool = False
    """Serve other computers without a certificate, if the network is protected otherwise (a VPN):
    an eavesdropper gets the token."""
    hosts: tuple[str, ...] = ()
    """Names of this machine that clients may use, beside its host name and its addresses."""
    origins: tuple[str, ...] = ()
    """Pages of other machines that may connect, as browsers name them: "https://app.example"."""
    max_clients: Annotated[int, _CLIENTS] = 64
    """Most connected clients; further ones are refused with HTTP status 503."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.token and self.token_file:
            raise OptionError("token_file", self.token_file, "left out, because there is a token")
        if self.token:
            check_token(self.token, "token")
        require(
            bool(self.certificate) == bool(self.key),
            "key" if self.certificate else "certificate",
            "",
            "a file, as wss needs both certificate and key",
        )
        require(
            self.encrypted or self.plaintext or is_loopback(self.host),
            "host",
            self.host,
            "127.0.0.1, unless there is a certificate and its key, or plaintext says that the "
            "network is protected otherwise: an eavesdropper could use the token",
        )

    @property
    def encrypted(self) -> bool:
        """True if it is served by TLS."""
        makes = self.makes_certificate and not self.plaintext and not is_loopback(self.host)
        return bool(self.certificate) or makes

    def endpoint(self, port: int, scheme: str = "ws") -> str:
        """Endpoint for clients, once it listens at `port`; `scheme` without TLS."""
        scheme = f"{scheme}s" if self.encrypted else scheme
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{scheme}://{host}:{port}"

    def tokens(self) -> Tokens:
        """Return the tokens: those given, or, if others reach the address, generated ones; empty:
        none is needed. Raises ConfigurationError if one is too short, or if others can read their
        file."""
        given = self.given_tokens()
        return given if given or is_loopback(self.host) else Tokens(made_tokens())

    def given_tokens(self) -> Tokens:
        """Return the tokens of the option, the file, or the environment. Raises
        ConfigurationError."""
        refuse_former_variable()
        given = os.environ.get(TOKEN_VARIABLE, "").strip()
        if self.token:
            found = parse_tokens(self.token, "token")
        elif self.token_file:
            found = read_tokens(self.token_file)
        elif given:
            found = parse_tokens(given, TOKEN_VARIABLE)
        else:
            found = {}
        return Tokens(found)


@dataclass(frozen=True, kw_only=True)
class WebOptions(ListenerOptions):
    """Address, access control and allow lists of the server."""

    topics: tuple[str, ...] = ("*",)
    """Patterns of the topics that clients may use."""
    services: tuple[str, ...] = ("*",)
    """Patterns of the services and actions that clients may use or offer."""
    parameters: tuple[str, ...] = ("*",)
    """Patterns of the parameters that clients may use, as "/node:parameter"."""
    max_frame_bytes: Annotated[int, _FRAME_BYTES] = 10_000_000
    """Largest frame of a client, and most bytes that wait for it and must not be dropped."""
    service_timeout_s: Annotated[float, _SERVICE_S] = 30.0
    """Longest time for a service's answer, unless a client gives another."""
    compress: bool = False
    """Offer permessage-deflate: less network traffic, more processor load."""

    @property
    def allowed(self) -> Allowed:
        """Allow lists for clients."""
        return Allowed(self.topics, self.services, self.parameters)


class Arrivals:
    """Earliest possible arrival times of one client's bytes. All times are the loop's."""

    def __init__(self, now_s: float) -> None:
        self._read = self._before = 0
        """Count of bytes read, and of those without the newest portion."""
        self._seen: deque[tuple[float, int]] = deque([(now_s, 0)])
        """Samples of time and number of bytes that had arrived."""
        self._frames: deque[int] = deque()
        """For each frame not handed on yet, the bytes read before the portion with its end."""

    def read(self, count: int) -> None:
        """Record a read portion."""
        self._before = self._read
        self._read += count

    def record(self, waiting: int, now_s: float) -> None:
        """Record that `waiting` bytes can be read, and that none have to wait at the sender."""
        arrived = self._read + waiting
        newest_s, before = self._seen[-1]
        if now_s - newest_s < ARRIVALS_PERIOD_S:
            return  # Bytes that came since count as that much older.
        if len(self._seen) >= MAX_ARRIVALS:
            del self._seen[1]
        self._seen.append((now_s, max(arrived, before)))

    def end_frame(self) -> None:
        """Record that the newest portion has the end of a frame."""
        self._frames.append(self._before)

    def take_frame(self) -> float:
        """Take the next frame; return the earliest time at which its end can have arrived."""
        before = self._frames.popleft()
        while len(self._seen) > 1 and self._seen[1][1] <= before:
            self._seen.popleft()
        return self._seen[0][0]


APART_NS = 1000
"""Least difference of the stamps of frames that may have arrived at the same time."""

CLOCK_SET_BACK_NS = 10**9
"""Difference by which a stamp must be earlier for the clock to count as set back."""


class ListenerConnection(ServerConnection):
    """A client's connection: it measures the waiting time of its frames, is ended if they wait too
    long, and is not read any more once it is cut off."""

    _cut_off = False
    _ending: asyncio.Task[None] | None = None
    _socket: socket.socket | None = None
    _since_s = NEVER_S
    since_ns = 0
    """Earliest time at which the end of the last frame can have arrived, ns since the epoch; of two
    frames between the same checks the later one has the later time."""

    def __init__(self, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        self.arrivals = Arrivals(self.loop.time())
        self._backlog = Backlog()

    def watch(self, look: Callable[[], None], backlogged: Callable[[], None]) -> None:
        """Call `look` before each frame is handed on, and `backlogged` when the connection is ended
        because too much waits."""
        self._look, self._tell_backlogged = look, backlogged
        self._socket = self.transport.get_extra_info("socket")
        self._since_s = self.loop.time()

    @property
    def waited_s(self) -> float:
        """Longest time that the end of the last frame can have waited to be read."""
        return self.loop.time() - self._since_s

    def data_received(self, data: bytes) -> None:
        self.arrivals.read(len(data))
        super().data_received(data)
        self.note_backlog()

    def process_event(self, event: Event) -> None:
        if isinstance(event, Frame) and event.fin and event.opcode in DATA_OPCODES:
            self.arrivals.end_frame()
        super().process_event(event)

    def note_backlog(self) -> None:
        """Record the bytes that have arrived until now, read or not."""
        now_s = self.loop.time()  # Before it looks: this process may stand still in between.
        if self._socket is not None and has_room(self._socket):
            self.arrivals.record(waiting_bytes(self._socket), now_s)

    def cut_off(self) -> None:
        """End it at once, with all unread data."""
        self._cut_off = True
        self.transport.abort()

    async def __aiter__(self) -> AsyncIterator[Data]:
        async for frame in super().__aiter__():
            self._look()
            self._since_s = self.arrivals.take_frame()
            since_ns = time.time_ns() - int(1e9 * self.waited_s)
            if -APART_NS < self.since_ns - since_ns < CLOCK_SET_BACK_NS:
                since_ns = self.since_ns + APART_NS
            self.since_ns = since_ns
            if self._cut_off:
                return
            if self._ending is None and self._backlog.lasts(self.waited_s, self.loop.time()):
                self._tell_backlogged()
                # Reading goes on, or the client's close frame would not be read.
                self._ending = self.loop.create_task(self.close(1008, BACKLOGGED))
            if self._ending is None:
                yield frame
            self.note_backlog()
            # Waiting frames are taken without a turn of the loop: others have theirs.
            await asyncio.sleep(0)


class WebServer(AbstractAsyncContextManager[Any], Protocol):
    """A server that listens inside its ``async with``."""

    @property
    def port(self) -> int:
        """Port that it listens at."""


def serve_until(
    server: WebServer, ready: Callable[[int], None], stop: threading.Event | None
) -> None:
    """Serve in a separate loop until `stop` is set (None: for ever); `ready` is called with the
    port. Raises the errors of entering the server."""
    ended = threading.Event() if stop is None else stop

    async def run() -> None:
        async with server:
            ready(server.port)
            while not ended.is_set():
                await asyncio.sleep(LOOK_S)

    asyncio.run(run())


class WebSocketListener:
    """Listens, and serves clients that pass access control."""

    def __init__(
        self,
        options: ListenerOptions,
        counts: Counter[str],
        run: Callable[[ListenerConnection, str, Role], Awaitable[None]] | None = None,
        subprotocols: Sequence[str] = (),
        *,
        page: Page | None = None,
        public: bool = False,
        private: str = "",
        max_frame_bytes: int = 1,
        compress: bool = False,
    ) -> None:
        """`run(connection, peer, role)`: serve a client until it leaves. `subprotocols`: those of
        which a client must request one; none: it need not. `page`: answers GET; clients of a server
        with pages connect at SOCKET_PATH, and no path is a token. `public`: pages are for
        everybody, since they have no secrets, except those whose path begins with `private` (empty:
        none does). Raises ConfigurationError."""
        self.options, self.counts = options, counts
        self.clients = 0
        """Number of connected clients."""
        self._run, self._page, self._public, self._private = run, page, public, private
        self._max_frame_bytes, self._compress = max_frame_bytes, compress
        self._subprotocols = [Subprotocol(each) for each in subprotocols]
        self._door = AccessControl(options.tokens(), options.hosts, options.origins)
        self._server: Server | None = None
        self._connections: set[ListenerConnection] = set()
        self._standstill = StandStill(self._stood_still)
        self._watching: asyncio.Task[None] | None = None
        self._telling: asyncio.Task[None] | None = None
        self._roles: dict[ServerConnection, Role] = {}
        """Roles of accepted connections that have not begun."""
        self._unknown: dict[ServerConnection, None] = {}
        """Connections without a complete handshake, the oldest first."""

    @property
    def port(self) -> int:
        """Port that it listens at."""
        assert self._server is not None, "the server is not open"
        port: int = next(iter(self._server.sockets)).getsockname()[1]
        return port

    async def open(self) -> None:
        """Listen. Raises AddressError and ConfigurationError."""
        options = self.options
        tls = tls_context(options.certificate, options.key)
        try:
            self._server = await serve_websocket(
                self._serve,
                options.host,
                options.port,
                process_request=self._let_in,
                subprotocols=self._subprotocols or None,
                ssl=tls,
                compression="deflate" if self._compress else None,
                max_size=self._max_frame_bytes,
                max_queue=FRAMES_AHEAD,
                ping_interval=PING_INTERVAL_S,
                ping_timeout=PING_TIMEOUT_S,
                close_timeout=CLOSE_TIMEOUT_S,
                open_timeout=HANDSHAKE_S,
                logger=_library_log,
                server_header=None,
                create_connection=_watched(self._arrived, self._left),
                ssl_handshake_timeout=None if tls is None else HANDSHAKE_S,
            )
        except OSError as error:
            raise AddressError(
                f"cannot listen at {options.host}:{options.port}: {error.strerror or error}"
            ) from None
        for each in self._server.sockets:
            with each.dup() as listening:
                # Not by serve's argument: asyncio takes as many as that in one turn of its loop.
                listening.listen(BACKLOG)
        self._standstill.start()
        self._watching = asyncio.get_running_loop().create_task(self._watch_backlogs())
        if stats.is_wanted():
            self._telling = asyncio.get_running_loop().create_task(self._tell())

    async def _watch_backlogs(self) -> None:
        """Check the backlog of clients whose frames are not read."""
        while True:
            await asyncio.sleep(BEAT_S)
            for each in self._connections:
                each.note_backlog()

    def _backlogged(self, peer: str) -> None:
        self.counts["backlogged"] += 1
        _log.warning("%s is disconnected: %s", peer, BACKLOGGED)

    async def _tell(self) -> None:
        """Report clients and counters to the daemon."""
        before: dict[str, int] = {}
        while True:
            round_trip = {stats.ROUND_TRIP: self._round_trip_us()}
            now = {"clients": self.clients, **round_trip, **self.counts}
            if now != before:
                stats.tell(now)
                before = now
            await asyncio.sleep(stats.PERIOD_S)

    def _round_trip_us(self) -> int:
        """Return the round-trip time of the slowest client; 0: none has answered a ping yet."""
        return round(1e6 * max((each.latency for each in self._connections), default=0.0))

    async def close(self) -> None:
        """Disconnect all clients."""
        self._standstill.stop()
        if self._watching is not None:
            self._watching.cancel()
        if self._telling is not None:
            self._telling.cancel()
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def _arrived(self, connection: ServerConnection) -> None:
        self._unknown[connection] = None
        if len(self._unknown) > MOST_HANDSHAKES:
            oldest = next(iter(self._unknown))
            del self._unknown[oldest]
            self._tell_denied(
                oldest, "its connection was needed for another client before it authenticated"
            )
            oldest.transport.abort()

    def _left(self, connection: ServerConnection) -> None:
        self._unknown.pop(connection, None)
        self._roles.pop(connection, None)

    def _tell_denied(self, connection: ServerConnection, reason: str) -> None:
        self.counts["denied"] += 1
        level = logging.WARNING if self.counts["denied"] <= MOST_DENIALS_SHOWN else logging.DEBUG
        _log.log(level, "%s was refused: %s", _peer(connection), reason)

    async def _let_in(self, connection: ServerConnection, request: Request) -> Response | None:
        headers, parts = request.headers, _split(request.path)
        address = connection.remote_address
        caller = ClientInfo(
            address[0] if address else "",
            request.path if self._page is None else f"/?{parts.query}",
            headers.get_all("Host"),
            headers.get_all("Origin"),
            headers.get_all("Authorization"),
        )
        is_page = self._page is not None and not (self._run and parts.path == SOCKET_PATH)
        private = bool(self._private) and parts.path.startswith(self._private)
        public = is_page and self._public and not private
        found = self._door.check(caller, time.monotonic(), public=public)
        is_full = self.clients >= self.options.max_clients and not is_page
        if is_full and not isinstance(found, AccessDenied):
            found = AccessDenied(HTTPStatus.SERVICE_UNAVAILABLE, "there are too many clients")
        if isinstance(found, AccessDenied):
            self._tell_denied(connection, found.reason)
            response = connection.respond(found.status, f"{found.reason}\n")
            if found.retry_s is not None:
                response.headers["Retry-After"] = str(ceil(found.retry_s))
            elif found.status is HTTPStatus.UNAUTHORIZED:
                response.headers["WWW-Authenticate"] = "Bearer"
            return response
        if not is_page:
            self._roles[connection] = found
            return None
        assert self._page is not None
        try:
            answer = await self._page(parts.path, headers)
        except Exception:
            _log.exception("%s failed: internal error of this server", _peer(connection))
            return connection.respond(
                HTTPStatus.INTERNAL_SERVER_ERROR, "an internal error: see the log\n"
            )
        if answer is None:
            return connection.respond(HTTPStatus.NOT_FOUND, "there is no such page\n")
        response = connection.respond(answer.status, "")
        response.body = answer.body
        for name, value in (
            ("Content-Type", answer.content_type),
            ("Content-Length", str(len(answer.body))),
            *answer.headers,
        ):
            if name in response.headers:
                del response.headers[name]
            response.headers[name] = value
        return response

    def _stood_still(self, seconds: float) -> None:
        for each in self._connections:
            each.cut_off()
        if self._connections:
            self.counts["cut off"] += len(self._connections)
            _log.warning(
                "this server stalled for %.1f s: messages that its clients sent meanwhile are "
                "dropped, and they have to reconnect",
                seconds,
            )

    async def _serve(self, connection: ServerConnection) -> None:
        assert isinstance(connection, ListenerConnection)
        role = self._roles.pop(connection)
        self._unknown.pop(connection, None)
        assert self._run is not None
        peer = _peer(connection)
        connection.watch(self._standstill.look, partial(self._backlogged, peer))
        sending: socket.socket = connection.transport.get_extra_info("socket")
        with contextlib.suppress(OSError):
            sending.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self.clients += 1
        self._connections.add(connection)
        _log.info("%s is here as %s", peer, role.word)
        try:
            await self._run(connection, peer, role)
        except Exception:
            _log.exception("%s is closed after an internal error of this server", peer)
        finally:
            self.clients -= 1
            self._connections.discard(connection)
            _log.info("%s is gone", peer)


def _watched(
    arrived: Callable[[ServerConnection], None], left: Callable[[ServerConnection], None]
) -> type[ListenerConnection]:
    """Make a connection class that reports arrival and end of its connections."""

    class Watched(ListenerConnection):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            arrived(self)

        def connection_lost(self, exc: Exception | None) -> None:
            left(self)
            super().connection_lost(exc)

    return Watched


def _split(path: str) -> SplitResult:
    """Return path and query of a request; empty for an invalid address."""
    try:
        return urlsplit(path)
    except ValueError:
        return urlsplit("")


def tls_context(certificate: str, key: str) -> ssl.SSLContext | None:
    """Return a server's TLS context with these two files; None without a certificate.

    Raises ConfigurationError.
    """
    if not certificate:
        return None
    for name, path in (("certificate", certificate), ("key", key)):
        try:
            text = read_text(path)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise ConfigurationError(name, f"{path} cannot be used: {why}; {_MAKE_ONE}") from None
        if "-----BEGIN " not in text:
            raise ConfigurationError(
                name, f"{path} cannot be used: not a PEM file, with a line -----BEGIN ...-----"
            )
        if "ENCRYPTED" in text:
            raise ConfigurationError(
                name,
                f"{path} cannot be used: it has a password, and Cardan asks for none; "
                f"take it off: openssl pkey -in {path} -out plain-key.pem",
            )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        why = str(error)
        if isinstance(error, ssl.SSLError) and error.reason == "KEY_VALUES_MISMATCH":
            why = "the key is that of another certificate"
        raise ConfigurationError(
            "certificate", f"{certificate} with the key {key} cannot be used: {why}; {_MAKE_ONE}"
        ) from None
    return context


_MAKE_ONE = (
    "one for trying is made by: openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 "
    "-nodes -days 365 -subj /CN=NAME -addext subjectAltName=DNS:NAME -keyout key.pem -out cert.pem"
)


def _peer(connection: ServerConnection) -> str:
    """Return a client's address, for logs."""
    address = connection.remote_address
    return f"{address[0]}:{address[1]}" if address else "a client that has left"
