"""TCP proxy between a page and its server that can delay, hold and break connections."""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time
from collections.abc import Iterator

_CHUNK = 65536


class Proxy:
    """Forwards connections to a port of this computer."""

    def __init__(self, port: int) -> None:
        self.delay_s = 0.0
        """Delay in each direction."""
        self._to = port
        self._up, self._down = threading.Event(), threading.Event()
        self._up.set()
        self._down.set()
        self._lock = threading.Lock()
        self._sockets: set[socket.socket] = set()
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=64)
        self.port: int = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    @contextlib.contextmanager
    def stalled(self, *, up: bool = True, down: bool = True) -> Iterator[None]:
        """Hold data back and deliver it afterwards, all at once: data from the page (`up`), and
        data to the page (`down`)."""
        ways = [way for way, wanted in ((self._up, up), (self._down, down)) if wanted]
        for way in ways:
            way.clear()
        try:
            yield
        finally:
            for way in ways:
                way.set()

    def cut(self) -> None:
        """Close all open connections."""
        with self._lock:
            sockets = list(self._sockets)
        for each in sockets:
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Stop listening and close all connections."""
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self.cut()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            try:
                server = socket.create_connection(("127.0.0.1", self._to))
            except OSError:
                client.close()
                continue
            for each in (client, server):
                each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._lock:
                self._sockets |= {client, server}
            over = threading.Semaphore(0)
            for source, sink, way in ((client, server, self._up), (server, client, self._down)):
                waiting: queue.Queue[tuple[float, bytes]] = queue.Queue()
                threading.Thread(target=self._read, args=(source, waiting), daemon=True).start()
                threading.Thread(
                    target=self._write, args=(waiting, sink, way, over), daemon=True
                ).start()
            threading.Thread(target=self._end, args=(client, server, over), daemon=True).start()

    def _read(self, source: socket.socket, waiting: queue.Queue[tuple[float, bytes]]) -> None:
        data = b"-"
        while data:
            try:
                data = source.recv(_CHUNK)
            except OSError:
                data = b""
            waiting.put((time.monotonic(), data))

    def _write(
        self,
        waiting: queue.Queue[tuple[float, bytes]],
        sink: socket.socket,
        way: threading.Event,
        over: threading.Semaphore,
    ) -> None:
        with contextlib.suppress(OSError):
            while True:
                came_s, data = waiting.get()
                late_s = came_s + self.delay_s - time.monotonic()
                if late_s > 0.0:
                    time.sleep(late_s)
                way.wait()
                if not data:
                    sink.shutdown(socket.SHUT_WR)
                    break
                sink.sendall(data)
        over.release()

    def _end(self, client: socket.socket, server: socket.socket, over: threading.Semaphore) -> None:
        # One direction may continue after the other has ended, but not forever after an error.
        over.acquire()
        over.acquire(timeout=5.0)
        with self._lock:
            self._sockets -= {client, server}
        client.close()
        server.close()


@contextlib.contextmanager
def network_to(port: int) -> Iterator[Proxy]:
    """A proxy for the server at that port."""
    proxy = Proxy(port)
    try:
        yield proxy
    finally:
        proxy.close()
