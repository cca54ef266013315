"""The simulated controller on a real UDP socket."""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import time

from cardan.errors import AddressError
from cardan.sim_peers.base import SimulatedPeer
from cardan.sim_peers.egm_controller.controller import EgmController
from cardan.sim_peers.egm_controller.options import EgmControllerOptions
from cardan.sim_peers.link import FaultyLink

_LARGEST_DATAGRAM = 65535
_DRAIN_AT_MOST = 256
"""Datagrams taken from the socket at once: a flood must not keep the cycle from its schedule."""

log = logging.getLogger(__name__)


class EgmControllerPeer(SimulatedPeer):
    """Serves an `EgmController` as the real one does: as the client of the PC.

    The socket has an ephemeral local port and is connected to the PC's address, so answers from
    anywhere else are not heard. Cycles follow an absolute schedule; after a stall they go on from
    the schedule, without a burst.
    """

    def __init__(self, options: EgmControllerOptions | None = None) -> None:
        self.options = options = EgmControllerOptions() if options is None else options
        self.core = EgmController(options, wall_start_s=time.time())
        faulty = FaultyLink.wanted(options.faults)
        self._to_pc = FaultyLink(options.faults, options.seed + 2, True) if faulty else None
        self._from_pc = FaultyLink(options.faults, options.seed + 3) if faulty else None
        self._socket: socket.socket | None = None
        self._next_s = 0.0
        self._port_changes = 0
        self._logged = 0

    @property
    def endpoint(self) -> str:
        return f"{self.options.pc_host}:{self.options.pc_port}"

    @property
    def local_port(self) -> int | None:
        """The ephemeral port that datagrams come from now; None while closed."""
        return None if self._socket is None else int(self._socket.getsockname()[1])

    def open(self) -> None:
        if self._socket is None:
            self._socket = self._connect()
            self._next_s = time.monotonic()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def step(self, until_s: float) -> None:
        while (now_s := time.monotonic()) < until_s:
            self._take_in(now_s)
            if now_s >= self._next_s:
                self._cycle(now_s)
            if self._to_pc is not None:
                for data in self._to_pc.pop(now_s):
                    self._send(data)
            self._wait(until_s)

    def _connect(self) -> socket.socket:
        host, port = self.options.pc_host, self.options.pc_port
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, port, type=socket.SOCK_DGRAM
            )[0]
            connection = socket.socket(family, kind, protocol)
        except (OSError, UnicodeError) as error:
            raise AddressError(f"cannot send to {host}:{port}: {error}") from None
        try:
            connection.connect(address)
        except OSError as error:
            connection.close()
            raise AddressError(f"cannot send to {host}:{port}: {error}") from None
        connection.setblocking(False)
        return connection

    def _cycle(self, now_s: float) -> None:
        period_s = self.options.period_s
        late_cycles = int((now_s - self._next_s) / period_s)
        scheduled_s = self._next_s + late_cycles * period_s
        self._next_s = scheduled_s + period_s
        data = self.core.cycle(scheduled_s)
        if self.core.port_changes != self._port_changes:
            self._port_changes = self.core.port_changes
            self.close()
            self._socket = self._connect()
        if data is not None:
            if self._to_pc is None:
                self._send(data)
            else:
                self._to_pc.push(now_s, data)
        for event in self.core.events[self._logged :]:
            log.info("event %s: %s", event.code or "-", event.text)
        self._logged = len(self.core.events)

    def _take_in(self, now_s: float) -> None:
        connection = self._socket
        for _ in range(_DRAIN_AT_MOST if connection is not None else 0):
            assert connection is not None
            try:
                data = connection.recv(_LARGEST_DATAGRAM)
            except BlockingIOError:
                break
            except OSError:
                self.core.sending_failed()
                continue
            self.core.sending_worked()
            if self._from_pc is None:
                self.core.receive(data)
            else:
                self._from_pc.push(now_s, data)
        if self._from_pc is not None:
            for data in self._from_pc.pop(now_s):
                self.core.receive(data)

    def _send(self, data: bytes) -> None:
        if self._socket is None:
            return
        try:
            self._socket.send(data)
        except BlockingIOError:
            return
        except OSError:
            # Linux reports an earlier refusal here and sends nothing; a controller sends on.
            self.core.sending_failed()
            with contextlib.suppress(OSError):
                self._socket.send(data)

    def _wait(self, until_s: float) -> None:
        """Until something comes in, or the next thing is due."""
        wake_s = min(self._next_s, until_s)
        for link in (self._to_pc, self._from_pc):
            if link is not None and (due_s := link.next_s()) is not None:
                wake_s = min(wake_s, due_s)
        timeout_s = wake_s - time.monotonic()
        if timeout_s > 0.0 and self._socket is not None:
            select.select([self._socket], [], [], timeout_s)
