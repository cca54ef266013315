"""Sockets that several programs can connect to, served without ever waiting for one of them."""

from __future__ import annotations

import contextlib
import selectors
import socket
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from cardan.common.sockets import opened

_ROOM = 65536
_SMALLEST_BUFFER = 1
"""Smallest kernel buffer (a few packets), so that the client's own queue sets the limit."""


class DeviceClient(ABC):
    """Program that has the device open, with its unread reports."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        self.sock = sock

    @property
    @abstractmethod
    def waiting(self) -> bool:
        """True if data wait until the program reads."""

    @abstractmethod
    def _pass_on(self) -> None:
        """Send until nothing waits. Raises OSError: the buffer is full, or the client has left."""

    def flush(self) -> None:
        """Send as much as the program has room for. Raises OSError if it is gone."""
        with contextlib.suppress(BlockingIOError):
            self._pass_on()


class PacketClient(DeviceClient):
    """A client that gets packets.

    Subclasses put them into `_queue`, and count in `lost` packets dropped because it is full.
    """

    def __init__(self, sock: socket.socket) -> None:
        super().__init__(sock)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SMALLEST_BUFFER)
        self.lost = 0
        self._queue: deque[bytes] = deque()

    @property
    def waiting(self) -> bool:
        """True if packets wait until the program reads."""
        return bool(self._queue)

    def _pass_on(self) -> None:
        while self._queue:
            self.sock.send(self._queue[0])
            self._queue.popleft()


class StreamClient(DeviceClient):
    """TCP client that gets bytes, which are appended to `unsent`."""

    def __init__(self, sock: socket.socket) -> None:
        super().__init__(sock)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.unsent = bytearray()

    @property
    def waiting(self) -> bool:
        """True if bytes wait until the program reads."""
        return bool(self.unsent)

    def _pass_on(self) -> None:
        while self.unsent:
            del self.unsent[: self.sock.send(self.unsent)]


C = TypeVar("C", bound=DeviceClient)


class DeviceServer(Generic[C]):
    """Programs that connect to a listening socket, at most `most`, in `clients`.

    `meet` makes a client for a new connection, `take` gets a client's data, and `part` is called
    for a client that has left. The handlers in `selector` call them.
    """

    def __init__(
        self,
        selector: selectors.BaseSelector,
        most: int,
        *,
        meet: Callable[[socket.socket], C],
        take: Callable[[C, bytes], None],
        part: Callable[[C], None],
    ) -> None:
        self._selector = selector
        self._most = most
        self._meet, self._take, self._part = meet, take, part
        self._listener: socket.socket | None = None
        self.clients: list[C] = []

    @property
    def listening(self) -> bool:
        """True if programs can connect."""
        return self._listener is not None

    def listen_on(self, listener: socket.socket) -> None:
        """Let programs connect to this bound socket, from now on."""
        listener.setblocking(False)
        listener.listen(self._most)
        self._listener = listener
        self._selector.register(listener, selectors.EVENT_READ, self._accept)

    def stop_listening(self) -> None:
        """Close the listening socket; clients remain connected."""
        listener, self._listener = self._listener, None
        if listener is not None:
            self._selector.unregister(listener)
            listener.close()

    def flush(self, client: C) -> None:
        """Send the data that waits for `client`; continue when it has room again."""
        if client not in self.clients:
            return
        try:
            client.flush()
        except OSError:
            self.drop(client)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        key = self._selector.get_key(client.sock)
        if key.events != wanted:
            self._selector.modify(client.sock, wanted, key.data)

    def drop(self, client: C) -> None:
        """Close the connection of `client`, unless that is done."""
        if client in self.clients:
            self.clients.remove(client)
            self._selector.unregister(client.sock)
            client.sock.close()
            self._part(client)

    def close(self) -> None:
        """Close all connections and the listening socket."""
        for client in tuple(self.clients):
            self.drop(client)
        self.stop_listening()

    def _unwanted(self, sock: socket.socket) -> bool:
        """Return True if a new connection must not be served."""
        return len(self.clients) == self._most

    def _accept(self) -> None:
        if self._listener is None:
            return
        try:
            sock, _ = self._listener.accept()
        except OSError:  # The client left before it was accepted, or no file descriptor is free.
            return
        if self._unwanted(sock):
            sock.close()
            return
        client = self._meet(sock)
        self.clients.append(client)
        self._selector.register(sock, selectors.EVENT_READ, lambda: self._serve(client))

    def _serve(self, client: C) -> None:
        """Handle a client that wrote, has room again, or has left."""
        if client not in self.clients:
            return
        try:
            data = client.sock.recv(_ROOM)
        except BlockingIOError:
            self.flush(client)
            return
        except OSError:
            data = b""
        if data:
            self._take(client, data)
            self.flush(client)
        else:
            self.drop(client)


def bound_to(
    host: str, port: int, action: str, advice: str = "", family: int = socket.AF_UNSPEC
) -> socket.socket:
    """Return a TCP socket bound to `host` and `port` (0: any). Raises AddressError: `action` cannot
    be done there, the reason, and `advice`."""

    def bind(sock: socket.socket, address: Any) -> None:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)

    def problem(error: OSError) -> str:
        return f"cannot {action} on {host}:{port}: {error.strerror or error}{advice}"

    return opened(host, port, socket.SOCK_STREAM, bind, problem, socket.AddressFamily(family))
