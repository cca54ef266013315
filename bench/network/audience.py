"""Clients of rosbridge in separate processes: some count, one measures the age of messages, one
reads slowly."""

from __future__ import annotations

import json
import multiprocessing
import selectors
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from websockets.frames import Frame, Opcode
from websockets.sync.client import connect

_UPGRADE = (
    b"GET %s HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)

_PING_BYTES = 4
_PING = bytes((0x80 | Opcode.PING, _PING_BYTES))
"""Header of a WebSocket frame as the library sends it."""

ANSWER_WITHIN_S = 20.0


class Place(NamedTuple):
    """Local address to which clients connect."""

    port: int
    path: str = "/"


class Heard(NamedTuple):
    """Messages that arrived in a measurement."""

    messages: float
    """Average per client; for the counting ones from the average length of a message."""
    ages_s: list[float]
    """Times from the stamp in a message's header until a client has read it."""


class Audience:
    """A number of clients, the first of which measures the age of its messages."""

    def __init__(self, crowd: Connection, probe: Connection, clients: int) -> None:
        self._crowd, self._probe, self._clients = crowd, probe, clients

    def listen(self, on: bool) -> None:
        """Subscribe to all topics, or unsubscribe."""
        for each in (self._crowd, self._probe):
            each.send(on)
        for each in (self._crowd, self._probe):
            _answer(each)

    def heard(self) -> Heard:
        """Return the messages since the last call."""
        for each in (self._crowd, self._probe):
            each.send(None)
        received_bytes = _answer(self._crowd)
        lengths, ages_s = _answer(self._probe)
        messages = len(lengths)
        if lengths:
            messages += received_bytes / (sum(lengths) / len(lengths))
        return Heard(messages / self._clients, ages_s)


def _answer(pipe: Connection) -> Any:
    if not pipe.poll(ANSWER_WITHIN_S):
        raise RuntimeError(f"the clients did not answer within {ANSWER_WITHIN_S:g} s")
    return pipe.recv()


@contextmanager
def audience(
    place: Place, topics: Sequence[str], clients: int, crawling: bool = False
) -> Iterator[Audience]:
    """Connect `clients` clients; with `crawling`, one more that reads 1 kB/s."""
    context = multiprocessing.get_context("spawn")
    pipes, processes = [], []
    for target, count in ((_crowd, clients - 1), (_probe, int(crawling))):
        pipe, far = context.Pipe()
        process = context.Process(target=target, args=(place, tuple(topics), count, far))
        process.start()
        pipes.append(pipe)
        processes.append(process)
    try:
        for pipe in pipes:
            _answer(pipe)
        yield Audience(*pipes, clients)
    finally:
        for pipe in pipes:
            pipe.send("end")
        for process in processes:
            process.join()


def _subscription(topic: str, on: bool) -> str:
    return json.dumps({"op": "subscribe" if on else "unsubscribe", "topic": topic})


def _frames(topics: Sequence[str], on: bool) -> bytes:
    return b"".join(
        Frame(Opcode.TEXT, _subscription(topic, on).encode()).serialize(mask=True)
        for topic in topics
    )


def _client(place: Place) -> socket.socket:
    client = socket.create_connection(("127.0.0.1", place.port))
    client.sendall(_UPGRADE % place.path.encode())
    while b"\r\n\r\n" not in client.recv(1000):
        pass
    return client


def _answer_ping(client: socket.socket, data: bytes) -> None:
    """Answer a ping; otherwise the server disconnects the client. Text messages are ASCII and never
    contain the ping's first byte."""
    at = data.find(_PING)
    if at >= 0:
        payload = data[at + len(_PING) :][:_PING_BYTES]
        client.sendall(Frame(Opcode.PONG, payload).serialize(mask=True))


def _crowd(place: Place, topics: Sequence[str], count: int, pipe: Connection) -> None:
    """Clients that count bytes."""
    clients = [_client(place) for _ in range(count)]
    waiting = selectors.DefaultSelector()
    for client in clients:
        client.setblocking(False)
        waiting.register(client, selectors.EVENT_READ)
    waiting.register(pipe, selectors.EVENT_READ)
    pipe.send("ready")
    received = 0
    while True:
        for key, _ in waiting.select():
            if key.fileobj is not pipe:
                client = key.fileobj
                assert isinstance(client, socket.socket)
                data = client.recv(1 << 20)
                received += len(data)
                _answer_ping(client, data)
                continue
            asked = pipe.recv()
            if asked == "end":
                return
            if asked is None:
                pipe.send(received)
                received = 0
                continue
            for client in clients:
                client.sendall(_frames(topics, asked))
            pipe.send("done")
        time.sleep(0.002)  # Like a page that draws: it processes many messages at a time.


def _probe(place: Place, topics: Sequence[str], crawling: int, pipe: Connection) -> None:
    """Client that reads all messages; with another one that reads slowly."""
    over = threading.Event()
    crawler = threading.Thread(target=_crawl, args=(place, topics, over))
    if crawling:
        crawler.start()
    lengths: list[int] = []
    ages_s: list[float] = []
    with connect(f"ws://127.0.0.1:{place.port}{place.path}", compression=None) as client:
        pipe.send("ready")
        while True:
            if pipe.poll():
                asked = pipe.recv()
                if asked == "end":
                    break
                if asked is None:
                    pipe.send((lengths, ages_s))
                    lengths, ages_s = [], []
                else:
                    for topic in topics:
                        client.send(_subscription(topic, asked))
                    pipe.send("done")
            try:
                text = str(client.recv(timeout=0.05))
            except TimeoutError:
                continue
            now_s = time.time()
            message = json.loads(text).get("msg")
            if message is None:
                continue  # The console's server asks its pages for their time.
            data = text.encode()
            lengths.append(len(Frame(Opcode.TEXT, data).serialize(mask=False)))
            header = message.get("header")
            if header is not None:
                stamp = header["stamp"]
                ages_s.append(now_s - stamp["sec"] - stamp["nanosec"] * 1e-9)
    over.set()
    if crawling:
        crawler.join()


def _crawl(place: Place, topics: Sequence[str], over: threading.Event) -> None:
    """Client that reads 1 kB/s without end."""
    with _client(place) as client:
        client.sendall(_frames(topics, True))
        while not over.wait(0.1) and client.recv(100):
            pass
