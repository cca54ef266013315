"""Serves a simulated 3Dconnexion device on a Unix socket: one raw HID report is one packet."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import selectors
import socket
import stat
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from cardan.errors import AddressError
from cardan.sim_peers.spacemouse.shell import PuckOptions, PuckPeer

QUEUE_REPORTS = 64
"""Reports kept for a client that does not read: what Linux keeps for a hidraw node."""
MAX_CLIENTS = 8
"""Programs that may have the device open at once."""
_REPORT_ROOM = 4096
_SMALLEST_BUFFER = 1
"""Makes the kernel keep as little as it can (about six reports), so that QUEUE_REPORTS counts."""


@dataclass(frozen=True)
class SpaceMousePeerOptions(PuckOptions):
    """What to simulate and where."""

    path: str
    """The socket to create (AF_UNIX, SOCK_SEQPACKET)."""


class _Client:
    """One program that has the device open."""

    def __init__(self, sock: socket.socket, *, keep_oldest: bool) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SMALLEST_BUFFER)
        self.sock = sock
        self.lost = 0
        self._keep_oldest = keep_oldest
        self._queue: deque[bytes] = deque()

    @property
    def waiting(self) -> bool:
        return bool(self._queue)

    def send(self, report: bytes) -> None:
        """Queue a report; a full queue loses one."""
        if len(self._queue) == QUEUE_REPORTS:
            self.lost += 1
            if self._keep_oldest:
                return
            self._queue.popleft()
        self._queue.append(report)

    def flush(self) -> None:
        """Pass on what the client has room for. Raises OSError when it is gone."""
        with contextlib.suppress(BlockingIOError):
            while self._queue:
                self.sock.send(self._queue[0])
                self._queue.popleft()


class SpaceMousePeer(PuckPeer):
    """A simulated device at a socket path, for any number of programs up to `MAX_CLIENTS`.

    All get all reports. Unplugging closes them and removes the socket; replugging brings it back.
    Raises ScriptError for a model, script or fault that does not exist or does not fit.
    """

    def __init__(self, options: SpaceMousePeerOptions) -> None:
        super().__init__(options)
        self.options = options
        self._listener: socket.socket | None = None
        self._identity: tuple[int, int] | None = None
        self._clients: list[_Client] = []
        self._lost_of_gone = 0

    @property
    def endpoint(self) -> str:
        """The socket's path."""
        return self.options.path

    @property
    def lost_reports(self) -> int:
        """Reports that clients were too slow for."""
        return self._lost_of_gone + sum(client.lost for client in self._clients)

    # -- the carrier ---------------------------------------------------------------------------

    @property
    def _there(self) -> bool:
        return self._listener is not None

    def _appear(self) -> None:
        """Create the socket; it can be connected to unless the device refuses to be opened."""
        path = self.options.path
        _remove_stale(path)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            listener.setblocking(False)
            listener.bind(path)
            info = os.stat(path)
        except OSError as error:
            listener.close()
            raise AddressError(
                f"cannot create the socket {path!r}: {error.strerror or error}; "
                f"give a short path in a directory that can be written"
            ) from None
        self._identity = (info.st_dev, info.st_ino)
        self._listener = listener
        self._attend(time.monotonic())

    def _vanish(self) -> None:
        """Close every connection and remove the socket, if it is still ours."""
        for client in tuple(self._clients):
            self._drop(client)
        if self._listener is None:
            return
        if self._listening:
            assert self._selector is not None
            self._selector.unregister(self._listener)
        self._listener.close()
        self._listener = None
        with contextlib.suppress(OSError):
            info = os.stat(self.options.path)
            if (info.st_dev, info.st_ino) == self._identity:
                os.unlink(self.options.path)

    def _deliver(self, reports: Sequence[bytes]) -> None:
        for client in tuple(self._clients):
            for report in reports:
                client.send(report)
            self._flush(client)

    @property
    def _listens_s(self) -> float:
        """Until then the device refuses to be opened."""
        return self._opened_s + self._faults.get("refuse", 0.0)

    @property
    def _listening(self) -> bool:
        return (
            self._listener is not None
            and self._selector is not None
            and self._listener in self._selector.get_map()
        )

    def _carrier_due_s(self) -> float:
        refusing = self._listener is not None and not self._listening
        return self._listens_s if refusing else math.inf

    def _attend(self, now_s: float) -> None:
        if self._listener is None or self._listening or now_s < self._listens_s:
            return
        assert self._selector is not None
        self._listener.listen(MAX_CLIENTS)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    # -- the clients ---------------------------------------------------------------------------

    def _accept(self) -> None:
        if self._listener is None or self._selector is None:
            return
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return
        if len(self._clients) == MAX_CLIENTS or _hung_up(sock):
            sock.close()
            return
        client = _Client(sock, keep_oldest=bool(self._faults.get("newest-lost")))
        self._clients.append(client)
        self._selector.register(sock, selectors.EVENT_READ, lambda: self._serve(client))
        self._begin()

    def _serve(self, client: _Client) -> None:
        """The client wrote, has room again, or is gone."""
        if client not in self._clients:
            return
        try:
            report = client.sock.recv(_REPORT_ROOM)
        except BlockingIOError:
            self._flush(client)
            return
        except OSError:
            report = b""
        if report:
            self._take_output(report)
            self._flush(client)
        else:
            self._drop(client)

    def _flush(self, client: _Client) -> None:
        assert self._selector is not None
        try:
            client.flush()
        except OSError:
            self._drop(client)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        key = self._selector.get_key(client.sock)
        if key.events != wanted:
            self._selector.modify(client.sock, wanted, key.data)

    def _drop(self, client: _Client) -> None:
        if self._selector is not None:
            self._selector.unregister(client.sock)
        client.sock.close()
        self._clients.remove(client)
        self._lost_of_gone += client.lost


def _hung_up(sock: socket.socket) -> bool:
    """True when whoever connected only looked whether somebody listens (as `_remove_stale`)."""
    try:
        return not sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False
    except OSError:
        return True


def _remove_stale(path: str) -> None:
    """Remove a socket file that nobody listens on. Raises AddressError for anything else."""
    try:
        if not stat.S_ISSOCK(os.lstat(path).st_mode):
            raise AddressError(f"{path!r} exists and is not a socket; give another path")
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
        raise AddressError(f"another program serves {path!r} ({how}); end it or give another path")
