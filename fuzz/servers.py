"""Servers over real sockets of this computer: garbage from many clients, then a good one.

Their protocols are fuzzed without sockets, at full speed. Here it is shown in a smaller number that
the programs around them, with their threads and loops, go on: each client sends a few damaged
messages in pieces, most leave without a word, and a good client is served afterwards.
"""

from __future__ import annotations

import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from random import Random

from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.daemon.control import Ask, Response, encode_ask
from cardan.gateway.daemon.server import ControlConnection, ControlServer
from fuzz.mutate import Mutator
from fuzz.run import Finding, Outcome
from fuzz.target import Input
from fuzz.targets import target_named

CONNECTIONS = 200
"""Clients in a run: each takes a few milliseconds."""
GOOD_EVERY = 20
"""A good client comes after so many."""
WAIT_S = 30.0
"""Longest wait for a server that does not answer; a busy computer takes some seconds."""


def _garbage(name: str, rng: Random) -> Iterator[bytes]:
    """Damaged input of a target, without end."""
    target = target_named(name)
    mutator = Mutator(target, rng, list(target.seeds()))
    while True:
        given: Input = mutator.next()
        yield b"".join(given) if isinstance(given, tuple) else given


def _hit(connect: Callable[[], socket.socket], data: bytes, rng: Random) -> None:
    """Act as a bad client; the server may close at any time."""
    with suppress(OSError), connect() as sock:
        sock.settimeout(WAIT_S)
        at = 0
        while at < len(data):
            size = 1 + rng.randrange(4096)
            sock.sendall(data[at : at + size])
            at += size
        if rng.random() < 0.3:
            sock.shutdown(socket.SHUT_WR)
            sock.recv(65536)


def _run(
    name: str,
    seed: str,
    count: int,
    connect: Callable[[], socket.socket],
    garbage: Iterator[bytes],
    good: Callable[[], None],
) -> Outcome:
    outcome, rng = Outcome(name), Random(seed)
    begin_s = time.process_time()
    data = b""
    try:
        for number in range(1, count + 1):
            data = next(garbage)
            _hit(connect, data, rng)
            outcome.inputs += 1
            if number % GOOD_EVERY == 0 or number == count:
                good()
    except Exception as error:
        what = f"{type(error).__name__}: a good client is not served: {error}"
        outcome.findings.append(Finding(name, what[:400], name, data))
    outcome.seconds = time.process_time() - begin_s
    return outcome


@contextmanager
def _control_server() -> Iterator[str]:
    """The daemon's socket, where every request is answered by itself."""
    with tempfile.TemporaryDirectory(prefix="cardan-fuzz-") as folder:
        path = str(Path(folder) / "control.sock")

        def handle(ask: Ask, connection: ControlConnection) -> None:
            connection.tell(Response(ask.id, "result", [ask.do, ask.name]))

        server, ended = ControlServer(path, "", handle), threading.Event()
        failed: list[BaseException] = []

        def serve() -> None:
            try:
                while not ended.is_set():
                    server.poll(0.05)
            except BaseException as error:
                failed.append(error)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield path
        finally:
            ended.set()
            server.wake()
            thread.join(WAIT_S)
            server.close()
            if failed:
                raise failed[0]


def control(seed: str, count: int) -> Outcome:
    """The daemon's control socket."""
    with _control_server() as path:

        def connect() -> socket.socket:
            sock = socket.socket(socket.AF_UNIX)
            sock.settimeout(WAIT_S)
            sock.connect(path)
            return sock

        def good() -> None:
            with ControlClient(path, WAIT_S) as client:
                assert client.ask("units", "gofa") == ["units", "gofa"]

        def lines() -> Iterator[bytes]:
            for each in _garbage("daemon.control", Random(seed)):
                yield each + b"\n" + encode_ask(Ask(1, "version")) + each[: len(each) // 2]

        return _run("server.control", seed, count, connect, lines(), good)


def rosbridge(seed: str, count: int) -> Outcome:
    """The front of a server: handshakes, WebSocket frames, operations."""
    from tests.gateway.servers.bench import plain_client, rosbridge as served
    from tests.gateway.servers.memory_network import MemoryNetwork

    with served(MemoryNetwork()) as running:

        def connect() -> socket.socket:
            return socket.create_connection(("127.0.0.1", running.port), WAIT_S)

        def good() -> None:
            with plain_client(running) as client:
                client.settle()

        return _run("server.rosbridge", seed, count, connect, _frames(seed), good)


def _frames(seed: str) -> Iterator[bytes]:
    """Handshakes, whole and damaged, with damaged frames behind them."""
    rng = Random(seed)
    head = (
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    for data in _garbage("rosbridge.session", rng):
        first = bytes([rng.choice((0x81, 0x81, 0x81, 0x82, 0x01, 0x89, 0x88, rng.randrange(256)))])
        size = len(data) & 0xFFFF
        frame = first + b"\xfe" + size.to_bytes(2, "big") + bytes(4) + data[:size]
        if rng.random() < 0.3:
            cut = rng.randrange(len(head))
            yield head[:cut] + bytes([rng.randrange(256)]) + head[cut + 1 :] + frame
        else:
            yield head + frame * rng.randrange(1, 4)


SERVERS: dict[str, Callable[[str, int], Outcome]] = {
    "server.control": control,
    "server.rosbridge": rosbridge,
}
"""By name: each takes a seed and a number of clients."""
