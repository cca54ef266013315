"""Unix sockets in place of a device node: one packet (SOCK_SEQPACKET) is one read or write."""

from __future__ import annotations

import selectors
import socket
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from cardan.common.sockets import OWNER_ONLY, UnixSocket
from cardan.sim_peers.backends.base import DeviceBackend, M
from cardan.sim_peers.backends.server import DeviceServer, PacketClient

MAX_CLIENTS = 8
"""Programs that may have the device open at once."""
QUEUE_REPORTS = 64
"""Reports kept for a program that does not read: as many as Linux keeps for a hidraw node."""


C = TypeVar("C", bound=PacketClient)


class PacketServer(DeviceServer[C]):
    """Socket at `path`, and the programs that have it open. Raises AddressError if the path cannot
    be used."""

    def __init__(
        self,
        path: str,
        selector: selectors.BaseSelector,
        most: int,
        *,
        meet: Callable[[socket.socket], C],
        take: Callable[[C, bytes], None],
        part: Callable[[C], None],
        mode: int = OWNER_ONLY,
    ) -> None:
        super().__init__(selector, most, meet=meet, take=take, part=part)
        self._socket = UnixSocket(path, socket.SOCK_SEQPACKET, mode)

    def listen(self) -> None:
        """Start to accept programs."""
        self.listen_on(self._socket.sock)

    def close(self) -> None:
        """Close all connections and remove the path, if this peer still owns it."""
        super().close()
        self._socket.close()

    def _unwanted(self, sock: socket.socket) -> bool:
        return super()._unwanted(sock) or _only_looked(sock)


class PacketBackend(DeviceBackend[M], Generic[M, C]):
    """Socket at `path` in place of a device node, for up to `MAX_CLIENTS` programs of the users
    that `mode` permits.

    Unplugging closes their connections and removes the socket.
    """

    def __init__(self, path: str, mode: int = OWNER_ONLY) -> None:
        self._path = path
        self._mode = mode
        self._server: PacketServer[C] | None = None
        self._lost_of_gone = 0

    @abstractmethod
    def _meet(self, sock: socket.socket) -> C:
        """Return the client of a new connection."""

    @abstractmethod
    def _take(self, client: C, packet: bytes) -> None:
        """Handle a packet from a client."""

    def _part(self, client: C) -> None:
        """Handle the end of a client."""
        self._lost_of_gone += client.lost

    @property
    def endpoint(self) -> str:
        """The socket's path."""
        return self._path

    @property
    def there(self) -> bool:
        """True if the socket exists."""
        return self._server is not None

    @property
    def clients(self) -> Sequence[C]:
        """The programs that have the device open."""
        return () if self._server is None else self._server.clients

    @property
    def lost(self) -> int:
        """Number of packets that slow programs lost."""
        return self._lost_of_gone + sum(client.lost for client in self.clients)

    def appear(self) -> None:
        """Create the socket. Raises AddressError."""

        def meet(sock: socket.socket) -> C:
            self.shell.begin()
            return self._meet(sock)

        self._server = PacketServer(
            self._path,
            self.shell.selector,
            MAX_CLIENTS,
            meet=meet,
            take=self._take,
            part=self._part,
            mode=self._mode,
        )

    def vanish(self) -> None:
        """Close all connections and remove the socket, if this peer still owns it."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def run_due(self, now_s: float) -> None:
        """Accept programs, unless the device refuses to be opened."""
        server = self._server
        if server is not None and not server.listening and now_s >= self.shell.refused_until_s:
            server.listen()

    def _flush(self) -> None:
        """Send the packets that wait for the programs."""
        for client in tuple(self.clients):
            if self._server is not None and client.waiting:
                self._server.flush(client)


class ReportClient(PacketClient):
    """Program with the kernel's queue for it; a full one loses the oldest report, or the newest."""

    def __init__(self, sock: socket.socket, *, keep_oldest: bool) -> None:
        super().__init__(sock)
        self._keep_oldest = keep_oldest

    def send(self, report: bytes) -> None:
        """Queue a report; a full queue loses one."""
        if len(self._queue) == QUEUE_REPORTS:
            self.lost += 1
            if self._keep_oldest:
                return
            self._queue.popleft()
        self._queue.append(report)


class ReportSocket(PacketBackend[bytes, ReportClient]):
    """A socket whose packets are raw HID reports: all programs get all input reports.

    `take` gets each output report and the device's time, s; without it they are ignored. While the
    device refuses to be opened its socket exists, but no program can connect.
    """

    tells_refusal = True

    def __init__(
        self,
        path: str,
        take: Callable[[bytes, float], None] = lambda *_: None,
        *,
        keep_oldest: bool = False,
        mode: int = OWNER_ONLY,
    ) -> None:
        super().__init__(path, mode)
        self._take_output = take
        self._keep_oldest = keep_oldest

    def send(self, messages: Sequence[bytes]) -> None:
        """Queue the reports for every program."""
        for client in self.clients:
            for report in messages:
                client.send(report)
        self._flush()

    def _meet(self, sock: socket.socket) -> ReportClient:
        return ReportClient(sock, keep_oldest=self._keep_oldest)

    def _take(self, client: ReportClient, packet: bytes) -> None:
        self._take_output(packet, self.shell.device_s())


def _only_looked(sock: socket.socket) -> bool:
    """Return True if a program connected and hung up at once to test that the path is served."""
    try:
        return not sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False
    except OSError:
        return True
