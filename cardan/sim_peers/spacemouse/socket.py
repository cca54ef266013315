"""Serves a simulated 3Dconnexion device on a Unix socket: one raw HID report is one packet."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass

from cardan.sim_peers.spacemouse.shell import PuckOptions, PuckPeer
from cardan.sim_peers.unix_socket import Client, PacketServer

QUEUE_REPORTS = 64
"""Reports kept for a client that does not read: what Linux keeps for a hidraw node."""
MAX_CLIENTS = 8
"""Programs that may have the device open at once."""


@dataclass(frozen=True)
class SpaceMousePeerOptions(PuckOptions):
    """What to simulate and where."""

    path: str
    """The socket to create (AF_UNIX, SOCK_SEQPACKET)."""


class _Client(Client):
    def __init__(self, sock: socket.socket, *, keep_oldest: bool) -> None:
        super().__init__(sock)
        self.lost = 0
        self._keep_oldest = keep_oldest

    def send(self, report: bytes) -> None:
        """Queue a report; a full queue loses one."""
        if len(self._queue) == QUEUE_REPORTS:
            self.lost += 1
            if self._keep_oldest:
                return
            self._queue.popleft()
        self._queue.append(report)


class SpaceMousePeer(PuckPeer):
    """A simulated device at a socket path, for any number of programs up to `MAX_CLIENTS`.

    All get all reports. Unplugging closes them and removes the socket; replugging brings it back.
    Raises ScriptError for a model, script or fault that does not exist or does not fit.
    """

    def __init__(self, options: SpaceMousePeerOptions) -> None:
        super().__init__(options)
        self.options = options
        self._server: PacketServer[_Client] | None = None
        self._lost_of_gone = 0

    @property
    def endpoint(self) -> str:
        """The socket's path."""
        return self.options.path

    @property
    def lost_reports(self) -> int:
        """Reports that clients were too slow for."""
        return self._lost_of_gone + sum(client.lost for client in self._clients)

    @property
    def _clients(self) -> Sequence[_Client]:
        return () if self._server is None else self._server.clients

    # -- the carrier ---------------------------------------------------------------------------

    @property
    def _there(self) -> bool:
        return self._server is not None

    def _appear(self) -> None:
        """Create the socket; it can be connected to unless the device refuses to be opened."""
        assert self._selector is not None
        self._server = PacketServer(
            self.options.path,
            self._selector,
            MAX_CLIENTS,
            meet=self._meet,
            take=lambda _, report: self._take_output(report),
            part=self._part,
        )
        self._attend(time.monotonic())

    def _vanish(self) -> None:
        """Close every connection and remove the socket, if it is still ours."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def _deliver(self, reports: Sequence[bytes]) -> None:
        if self._server is None:
            return
        for client in tuple(self._server.clients):
            for report in reports:
                client.send(report)
            self._server.flush(client)

    @property
    def _listens_s(self) -> float:
        """Until then the device refuses to be opened."""
        return self._opened_s + self._faults.get("refuse", 0.0)

    def _carrier_due_s(self) -> float:
        refusing = self._server is not None and not self._server.listening
        return self._listens_s if refusing else math.inf

    def _attend(self, now_s: float) -> None:
        if self._server is not None and not self._server.listening and now_s >= self._listens_s:
            self._server.listen()

    def _meet(self, sock: socket.socket) -> _Client:
        self._begin()
        return _Client(sock, keep_oldest=bool(self._faults.get("newest-lost")))

    def _part(self, client: _Client) -> None:
        self._lost_of_gone += client.lost
