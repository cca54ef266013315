"""Attacks by unauthorized clients on each server with a web server.

See docs/safety-and-access.md.
"""

from __future__ import annotations

import contextlib
import re
import socket
import ssl
import struct
import tempfile
import threading
from collections import deque
from pathlib import Path
from typing import NamedTuple

import pytest
from websockets.sync.client import connect

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")
pytest.importorskip("prometheus_client", reason="pip install cardan[metrics]")

from cardan.gateway.daemon.metrics import MetricsOptions, MetricsServer
from cardan.gateway.servers import web
from cardan.gateway.servers.rate_limit import BURST, FORGOTTEN_S
from cardan.gateway.servers.registry import BUILT_IN
from tests import certificates
from tests.gateway.servers.bench import WAIT_S, rosbridge, served
from tests.gateway.servers.console.bench import console
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.waiting import until

pytestmark = pytest.mark.matrix

TOKEN = "0123456789abcdef-token"
UPGRADE = (
    "Upgrade: websocket",
    "Connection: Upgrade",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Version: 13",
)


class Target(NamedTuple):
    """A server, and how an authorized client connects."""

    serve: object
    path: str
    headers: tuple[str, ...]
    welcome: int
    """HTTP status for an authorized client."""
    subprotocols: tuple[str, ...] = ()
    """WebSocket subprotocols that a client requests."""

    def request(self, path=None, host="localhost", *more):
        """Bytes of a request."""
        asked = (f"Sec-WebSocket-Protocol: {each}" for each in self.subprotocols)
        first = f"GET {path or self.path} HTTP/1.1", f"Host: {host}"
        lines = (*first, *self.headers, *asked, *more)
        return "".join(f"{line}\r\n" for line in (*lines, "")).encode()

    def path_with(self, token):
        return f"{self.path}?t={token}"


def metrics(**options):
    options = MetricsOptions(**{"port": 0, **options})
    return served(lambda: MetricsServer(options, lambda: {"version": "1", "units": []}))


@contextlib.contextmanager
def console_server(**options):
    with (
        tempfile.TemporaryDirectory() as folder,
        console(MemoryNetwork(), Path(folder), **options) as running,
    ):
        yield running


TARGETS = {
    "rosbridge": Target(lambda **o: rosbridge(MemoryNetwork(), **o), "/", UPGRADE, 101),
    "console": Target(console_server, "/ws", UPGRADE, 101),
    "metrics": Target(metrics, "/metrics", (), 200),
}


def test_no_server_is_left_out():
    no_web_servers = {"router", "recorder"}
    assert {*TARGETS} == {*BUILT_IN} - no_web_servers, "a router is tried in tests/bus"


@pytest.fixture(params=TARGETS)
def target(request):
    return TARGETS[request.param]


@pytest.fixture
def running(target):
    with target.serve(token=TOKEN) as running:
        yield running


def opened(running):
    return socket.create_connection(("127.0.0.1", running.port), WAIT_S)


def status(data):
    return int(data.split(None, 2)[1])


def answer(running, data):
    """Head of the response to a request; empty if the server closed the connection."""
    with opened(running) as connection:
        with contextlib.suppress(ConnectionError):
            connection.sendall(data)
        return head(connection)


def head(connection):
    received = b""
    with contextlib.suppress(ConnectionError):
        while b"\r\n\r\n" not in received and (more := connection.recv(65536)):
            received += more
    return received.partition(b"\r\n\r\n")[0]


def all_of(connection):
    """Bytes until the connection is closed."""
    received = b""
    with contextlib.suppress(ConnectionError):
        while more := connection.recv(65536):
            received += more
    return received


def welcomed(target, connection):
    """Return whether an authorized client is accepted on this connection."""
    connection.sendall(target.request(target.path_with(TOKEN)))
    return status(head(connection)) == target.welcome


def comes_in(target, running):
    """Return whether an authorized client can still connect."""
    return status(answer(running, target.request(target.path_with(TOKEN)))) == target.welcome


# -- tokens, names, pages -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("token", "header"),
    [
        ("", None),
        (TOKEN[:-1], None),
        (f"{TOKEN}x", None),
        (TOKEN.upper(), None),
        ("", f"Authorization: Bearer {TOKEN}x"),
        ("", f"Authorization: Basic {TOKEN}"),
        ("", f"Cookie: token={TOKEN}"),
    ],
)
def test_wrong_tokens_and_none(target, running, caplog, token, header):
    more = () if header is None else (header,)
    said = answer(running, target.request(target.path_with(token), "localhost", *more))
    assert status(said) == 401
    assert b"WWW-Authenticate: Bearer" in said
    assert running.server.counts["denied"] == 1
    assert "0123456789" not in caplog.text + said.decode()
    assert comes_in(target, running)


def test_a_right_token_comes_in_by_the_header(target, running):
    request = target.request(None, "localhost", f"Authorization: Bearer {TOKEN}")
    assert status(answer(running, request)) == target.welcome


@pytest.mark.real("console")
def test_guesses_are_counted(target, running):
    wrong = target.request(target.path_with("guess-0123456789"))
    tries = 0
    while status(said := answer(running, wrong)) == 401:
        tries += 1
    # On a slow computer, the first guesses have expired meanwhile.
    assert tries >= BURST
    assert status(said) == 429
    assert 0 < int(re.search(rb"Retry-After: (\d+)", said)[1]) <= FORGOTTEN_S
    right = answer(running, target.request(target.path_with(TOKEN)))
    assert status(right) == target.welcome, "wrong tokens do not delay the right one"


@pytest.mark.parametrize(
    ("host", "more", "denied"),
    [
        ("localhost", ["Origin: https://evil.example"], 403),
        ("localhost", ["Origin: null"], 403),
        ("localhost", ["Origin: http://localhost", "Origin: https://evil.example"], 403),
        ("rebound.example", [], 403),
        ("rebound.example", ["Origin: http://rebound.example"], 403),
        ("localhost", ["Host: localhost"], 400),
        ("", [], 400),
    ],
)
def test_foreign_pages_and_names_stay_out_even_with_the_token(target, running, host, more, denied):
    request = target.request(target.path_with(TOKEN), host, *more)
    assert status(answer(running, request)) == denied


# -- invalid requests -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "data",
    [
        b"\0" * 100,
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + b"\0" * 200,
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\n\r\nabc",
        b"GET / HTTP/1.0\r\n\r\n",
        b"GET\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\n folded\r\n\r\n",
        b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"a" * 100_000 + b"\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\n" + b"X: a\r\n" * 1000 + b"\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 999999999999\r\n\r\n",
        b"GET / HTTP/1.1\r\nX: " + b"a" * 1_000_000,
    ],
)
def test_garbage_and_what_is_too_long_is_refused(target, monkeypatch, data):
    # The data may be the beginning of a line, so the server waits.
    monkeypatch.setattr(web, "HANDSHAKE_S", 0.5)
    with target.serve(token=TOKEN) as running:
        said = answer(running, data)
        assert said == b"" or status(said) >= 400
        assert comes_in(target, running)


# -- slow clients and many clients ----------------------------------------------------------------


@pytest.mark.parametrize("begun", [b"", b"GET / HTTP/1.1\r\nHost: loc"])
def test_who_says_nothing_is_hung_up_on(target, monkeypatch, begun):
    monkeypatch.setattr(web, "HANDSHAKE_S", 0.2)
    with target.serve(token=TOKEN) as running, opened(running) as connection:
        connection.sendall(begun)
        assert head(connection) == b""
        assert comes_in(target, running)


def test_who_says_a_little_all_the_time_is_hung_up_on(target, monkeypatch):
    monkeypatch.setattr(web, "HANDSHAKE_S", 0.2)
    with target.serve(token=TOKEN) as running, opened(running) as connection:
        connection.settimeout(0.01)
        with pytest.raises((ConnectionError, BrokenPipeError)):  # noqa: PT012
            for _ in range(int(WAIT_S / 0.01)):
                connection.sendall(b"X")
                with contextlib.suppress(TimeoutError):
                    if connection.recv(100) == b"":
                        raise ConnectionError


def stays(target, running):
    """A connected client, if the server has lasting connections."""
    if target.welcome != 101:
        return contextlib.nullcontext()
    return connect(
        f"ws://127.0.0.1:{running.port}{target.path_with(TOKEN)}",
        subprotocols=target.subprotocols or None,
    )


AT_ONCE = 100
"""Number of simultaneous new connections. Server and clients share one processor here, so that more
of them would count as a pause of the server."""


def wait_until_taken(front, connection):
    """Wait until the server has accepted this connection."""
    address = connection.getsockname()
    until(lambda: address in {each.remote_address for each in [*front._unknown]})


def keep_many_open(target, running, count):
    """Open idle connections; the newest 300 stay open, as far as the server allows."""
    front = running.server._listener
    retained, most = deque(), 0
    with stays(target, running):
        clients = front.clients
        try:
            for number in range(count):
                retained.append(opened(running))
                if len(retained) > 300:
                    retained.popleft().close()
                most = max(most, len(front._unknown))
                if number % AT_ONCE == AT_ONCE - 1:
                    wait_until_taken(front, retained[-1])
                if number % 500 == 499:
                    assert comes_in(target, running), "refused during the attack"
        finally:
            for each in retained:
                each.close()
        assert front.clients >= clients, "a client was disconnected"
    assert most <= web.MOST_HANDSHAKES + 1, "the newest is counted before the oldest is closed"


def test_as_many_as_come_at_once_are_kept_by_the_system(running):
    """The kernel drops a connection beyond the backlog, and its client retries a second later."""
    (listening,) = running.server._listener._server.sockets
    with listening.dup() as same:
        info = same.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 32)
    # in a listening socket, tcpi_sacked is the backlog
    (retained,) = struct.unpack_from("=I", info, 28)
    allowed = int(Path("/proc/sys/net/core/somaxconn").read_text())
    assert retained == min(web.BACKLOG, allowed)


@pytest.mark.real("rosbridge")
def test_many_connections_keep_nobody_out(target, running):
    keep_many_open(target, running, 1000)


def test_ten_thousand_connections_keep_nobody_out():
    target = TARGETS["rosbridge"]
    with target.serve(token=TOKEN) as running:
        keep_many_open(target, running, 10_000)


# -- TLS ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tls")
    path, key = certificates.make(folder, names="DNS:localhost")
    return {"certificate": str(path), "key": str(key)}


def by_tls(running, certificate):
    trusting = ssl.create_default_context(cafile=certificate["certificate"])
    return trusting.wrap_socket(opened(running), server_hostname="localhost")


class Tap:
    """Man in the middle: forwards one connection, and stores the client's bytes."""

    def __init__(self, port):
        self._there = port
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self.heard = b""
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    def _carry(self):
        near, _ = self._socket.accept()
        far = socket.create_connection(("127.0.0.1", self._there), WAIT_S)
        back = threading.Thread(target=self._copy, args=(far, near))
        back.start()
        self._copy(near, far, keep=True)
        back.join()
        near.close()
        far.close()

    def _copy(self, source, to, keep=False):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if keep:
                    self.heard += data
                to.sendall(data)
        for each in (source, to):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def close(self):
        self._thread.join(WAIT_S)
        self._socket.close()


def test_a_replayed_handshake_comes_in_nowhere(target, certificate):
    with target.serve(token=TOKEN, **certificate) as running:
        tap = Tap(running.port)
        with by_tls(tap, certificate) as connection:
            assert welcomed(target, connection)
        tap.close()
        assert TOKEN.encode() not in tap.heard
        with opened(running) as thief:
            thief.sendall(tap.heard)
            received = all_of(thief)
        assert b"HTTP" not in received
        with by_tls(running, certificate) as connection:
            assert welcomed(target, connection)


def test_plain_requests_to_tls_are_not_answered(target, certificate):
    with target.serve(token=TOKEN, **certificate) as running:
        assert b"HTTP/1.1" not in answer(running, target.request(target.path_with(TOKEN)))


def test_old_tls_is_not_spoken(target, certificate):
    old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    old.load_verify_locations(certificate["certificate"])
    with pytest.warns(DeprecationWarning, match="TLSv1_1"):
        old.maximum_version = ssl.TLSVersion.TLSv1_1
    with (
        target.serve(token=TOKEN, **certificate) as running,
        opened(running) as plain,
        pytest.raises((ssl.SSLError, ConnectionError)),
    ):
        old.wrap_socket(plain, server_hostname="localhost")


def test_connections_that_speak_no_tls_are_hung_up_on(target, certificate, monkeypatch):
    monkeypatch.setattr(web, "HANDSHAKE_S", 0.5)
    with target.serve(token=TOKEN, **certificate) as running, contextlib.ExitStack() as stack:
        idle = [stack.enter_context(opened(running)) for _ in range(200)]
        for each in idle:
            assert head(each) == b""
        with by_tls(running, certificate) as connection:
            assert welcomed(target, connection)


def test_what_a_refused_client_sends_later_is_not_heard(target, running):
    """Two requests at once: the second one must not bypass the refusal of the first."""
    with opened(running) as connection:
        connection.sendall(target.request() + target.request(target.path_with(TOKEN)))
        received = all_of(connection)
    # The server closes with the second request unread, which may discard the response.
    assert received == b"" or status(received) == 401
    assert b"HTTP/1.1 %d" % target.welcome not in received
    assert running.server.clients == 0
