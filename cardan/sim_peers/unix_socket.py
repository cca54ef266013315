"""Unix sockets that stand for a device: one packet (SOCK_SEQPACKET) is one read or write."""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import socket
import stat
from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from cardan.errors import AddressError

_PACKET_ROOM = 4096
_SMALLEST_BUFFER = 1
"""Makes the kernel keep as little as it can (a few packets), so that a client's queue counts."""


class Advice(NamedTuple):
    """What to do when a path cannot be had, in words that fit what the user gave."""

    no_socket: str = "give another path"
    """The path is that of something else."""
    served: str = "end it or give another path"
    """Another program serves it."""
    refused: str = "give a short path in a directory that can be written"
    """The system refuses it."""


ANOTHER_PATH = Advice()


class PacketSocket:
    """A socket (AF_UNIX, SOCK_SEQPACKET) bound at `path`; it does not listen yet.

    A socket that a program left behind there is removed. Raises AddressError when the path cannot
    be had.
    """

    def __init__(self, path: str, advice: Advice = ANOTHER_PATH) -> None:
        _remove_stale(path, advice)
        self.path = path
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self.sock.setblocking(False)
            self.sock.bind(path)
            self._identity: tuple[int, int] | None = _identity(path)
        except OSError as error:
            self.sock.close()
            raise AddressError(
                f"cannot create the socket {path!r}: {error.strerror or error}; {advice.refused}"
            ) from None

    def close(self) -> None:
        """Close it and remove its path, if that is still ours. Never raises; twice is fine."""
        self.sock.close()
        with contextlib.suppress(OSError):
            if self._identity is not None and _identity(self.path) == self._identity:
                os.unlink(self.path)
        self._identity = None


class Client:
    """One program that has the device open, and what it has no room for yet.

    Subclasses put packets into `_queue`, and say which are lost when that is full.
    """

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SMALLEST_BUFFER)
        self.sock = sock
        self._queue: deque[bytes] = deque()

    @property
    def waiting(self) -> bool:
        """Whether something waits until the program reads."""
        return bool(self._queue)

    def flush(self) -> None:
        """Pass on what the program has room for. Raises OSError when it is gone."""
        with contextlib.suppress(BlockingIOError):
            while self._queue:
                self.sock.send(self._queue[0])
                self._queue.popleft()


C = TypeVar("C", bound=Client)


class PacketServer(Generic[C]):
    """A socket at a path, and the programs that have it open, at most `most`, in `clients`.

    `meet` makes a client of a new connection, `take` gets each packet that a client sends, and
    `part` hears of a client that is gone; all are called from the handlers that are the data of
    each file in `selector`. Raises AddressError when the path cannot be had.
    """

    def __init__(
        self,
        path: str,
        selector: selectors.BaseSelector,
        most: int,
        *,
        meet: Callable[[socket.socket], C],
        take: Callable[[C, bytes], None],
        part: Callable[[C], None],
    ) -> None:
        self._socket = PacketSocket(path)
        self._selector = selector
        self._most = most
        self._meet, self._take, self._part = meet, take, part
        self.listening = False
        self.clients: list[C] = []

    def listen(self) -> None:
        """Let programs connect, from now on."""
        self._socket.sock.listen(self._most)
        self._selector.register(self._socket.sock, selectors.EVENT_READ, self._accept)
        self.listening = True

    def flush(self, client: C) -> None:
        """Pass on what waits for `client`; go on when it has room again."""
        try:
            client.flush()
        except OSError:
            self._drop(client)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        key = self._selector.get_key(client.sock)
        if key.events != wanted:
            self._selector.modify(client.sock, wanted, key.data)

    def close(self) -> None:
        """Close every connection and remove the path, if it is still ours."""
        for client in tuple(self.clients):
            self._drop(client)
        if self.listening:
            self.listening = False
            self._selector.unregister(self._socket.sock)
        self._socket.close()

    def _accept(self) -> None:
        if not self.listening:
            return
        try:
            sock, _ = self._socket.sock.accept()
        except OSError:
            return
        if len(self.clients) == self._most or _only_looked(sock):
            sock.close()
            return
        client = self._meet(sock)
        self.clients.append(client)
        self._selector.register(sock, selectors.EVENT_READ, lambda: self._serve(client))

    def _serve(self, client: C) -> None:
        """The client wrote, has room again, or is gone."""
        if client not in self.clients:
            return
        try:
            packet = client.sock.recv(_PACKET_ROOM)
        except BlockingIOError:
            self.flush(client)
            return
        except OSError:
            packet = b""
        if packet:
            self._take(client, packet)
            self.flush(client)
        else:
            self._drop(client)

    def _drop(self, client: C) -> None:
        self._selector.unregister(client.sock)
        client.sock.close()
        self.clients.remove(client)
        self._part(client)


def _only_looked(sock: socket.socket) -> bool:
    """True when who connected has hung up again unsaid, as `_remove_stale` does."""
    try:
        return not sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False
    except OSError:
        return True


def _identity(path: str) -> tuple[int, int]:
    info = os.stat(path)
    return info.st_dev, info.st_ino


def _remove_stale(path: str, advice: Advice) -> None:
    """Remove a socket file that nobody listens on. Raises AddressError for anything else."""
    try:
        if not stat.S_ISSOCK(os.lstat(path).st_mode):
            raise AddressError(f"{path!r} exists and is not a socket; {advice.no_socket}")
    except FileNotFoundError:
        return
    except OSError as error:
        raise AddressError(f"cannot use {path!r}: {error.strerror}") from None
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        try:
            result = probe.connect_ex(path)
        except OSError as error:
            raise AddressError(f"cannot use {path!r}: {error}") from None
    if result == errno.ECONNREFUSED:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
    elif result != errno.ENOENT:
        how = os.strerror(result) if result else "it answers"
        raise AddressError(f"another program serves {path!r} ({how}); {advice.served}")
