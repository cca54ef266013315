"""The simulated arm on a real UDP socket."""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import time
from typing import Any

from cardan.errors import AddressError
from cardan.protocols.joint_stream import MAX_DATAGRAM_BYTES
from cardan.sim_peers.arm.controller import SimulatedArm
from cardan.sim_peers.arm.options import SimulatedArmOptions
from cardan.sim_peers.base import SimulatedPeer

_DRAIN_AT_MOST = 256
"""Datagrams taken from the socket at once: a flood must not keep the cycle from its schedule."""

log = logging.getLogger(__name__)


class SimulatedArmPeer(SimulatedPeer):
    """Serves a `SimulatedArm`: it listens, and sends states to the client that commands it.

    Cycles follow an absolute schedule; after a stall they go on from the schedule, without a
    burst. Sessions count from the wall clock, so that they go up over restarts of this program.
    """

    def __init__(self, options: SimulatedArmOptions | None = None) -> None:
        self.options = options = SimulatedArmOptions() if options is None else options
        self.core = SimulatedArm(options, session=int(time.time()) & 0xFFFFFFFF)
        self._socket: socket.socket | None = None
        self._next_s = 0.0
        self._reason = ""

    @property
    def endpoint(self) -> str:
        port = self.options.port if self._socket is None else self._socket.getsockname()[1]
        return f"{self.options.host}:{port}"

    def open(self) -> None:
        if self._socket is not None:
            return
        host, port = self.options.host, self.options.port
        listener = None
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, port, family=socket.AF_INET, type=socket.SOCK_DGRAM
            )[0]
            listener = socket.socket(family, kind, protocol)
            listener.bind(address)
        except (OSError, UnicodeError) as error:
            if listener is not None:
                listener.close()
            raise AddressError(f"cannot listen on {host}:{port}: {error}") from None
        listener.setblocking(False)
        self._socket = listener
        self._next_s = time.monotonic()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def step(self, until_s: float) -> None:
        listener = self._socket
        if listener is None:
            return
        while (now_s := time.monotonic()) < until_s:
            self._take_in(listener)
            if now_s >= self._next_s:
                self._cycle(listener, now_s)
            timeout_s = min(self._next_s, until_s) - time.monotonic()
            if timeout_s > 0.0:
                select.select([listener], [], [], timeout_s)

    def _take_in(self, listener: socket.socket) -> None:
        for _ in range(_DRAIN_AT_MOST):
            try:
                data, source = listener.recvfrom(MAX_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                return
            except OSError:  # an earlier state found nobody
                continue
            self.core.receive(data, time.monotonic(), source)

    def _cycle(self, listener: socket.socket, now_s: float) -> None:
        period_s = self.options.period_s
        self._next_s += (1 + int((now_s - self._next_s) / period_s)) * period_s
        client: Any = self.core.client
        for data in self.core.cycle(now_s):
            if client is not None:
                with contextlib.suppress(OSError):
                    listener.sendto(data, client)
        if self.core.hold_reason != self._reason:
            self._reason = self.core.hold_reason
            log.info("%s", self._reason or "ready")
