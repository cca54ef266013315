"""Simulated network between two computers: forwards TCP connections with delay and jitter.

TCP delivers all bytes in order. Jitter and pauses thus delay all later data, as on a real network;
a lost packet, which TCP sends again, is such a delay too.
"""

from __future__ import annotations

import contextlib
import logging
import math
import select
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options
from cardan.common.sockets import opened
from cardan.sim_peers.base import FaultSwitch, SimulatedPeer, check_faults
from cardan.sim_peers.command import PeerCommand, listen_option, option
from cardan.sim_peers.delay_line import DelayLine
from cardan.sim_peers.tcp_peer import listen

DELAY_MS = Range(0.0, 1000.0, "ms", "by then a session counts the link as lost")

FAULTS = (
    FaultSwitch(
        "burst",
        "nothing arrives for this time, s, then all at once; every second such span",
        0.2,
        0.001,
        60.0,
    ),
    FaultSwitch.at("cut", "nothing passes any more; connections stay open"),
)

READ_BYTES = 65536
MOST_UNDER_WAY = 1 << 20
"""Most bytes of one direction in transit; at the limit the sender waits."""
CONNECT_WITHIN_S = 1.0
"""Longest wait for the other side."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class SimulatedNetworkOptions(Options):
    """Both ends of the network, and its delay."""

    host: Annotated[str, bounds.LISTEN_HOST] = listen_option("Address for one side's connections")
    port: Annotated[int, bounds.ANY_PORT] = 7450
    """TCP."""
    to_host: Annotated[str, bounds.HOST] = option(
        "127.0.0.1",
        "The other side: connections are passed on to it.",
        name="to",
        metavar="HOST:PORT",
        port_field="to_port",
    )
    to_port: Annotated[int, bounds.PORT] = 7448
    delay_ms: Annotated[float, DELAY_MS] = option(50.0, "Delay of each direction.")
    jitter_ms: Annotated[float, DELAY_MS] = option(
        0.0, "Additional delay up to this, uniformly distributed; the order is kept."
    )
    faults: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0


class DelayedStream(DelayLine):
    """One direction of a connection, in virtual time: chunks of bytes, in order."""

    def __init__(self, options: SimulatedNetworkOptions, seed: int) -> None:
        super().__init__(options.faults, seed)
        self._options = options
        self._latest_s = -math.inf
        self.under_way = 0
        """Bytes sent that have not arrived."""

    def carry(self, report: bytes, sent_s: float) -> None:
        """Accept a chunk; an empty one is the end of the stream."""
        options = self._options
        late_ms = options.delay_ms + self._random.uniform(0.0, options.jitter_ms)
        self._latest_s = max(self._latest_s, sent_s + 1e-3 * late_ms)
        self.under_way += len(report)
        super().carry(report, self._latest_s)

    def arrived(self, now_s: float) -> list[bytes]:
        chunks = super().arrived(now_s)
        self.under_way -= sum(map(len, chunks))
        return chunks


class _Direction:
    """One direction, with its sockets."""

    def __init__(self, source: socket.socket, sink: socket.socket, way: DelayedStream) -> None:
        self.source, self.sink, self.way = source, sink, way
        self.ended = False
        """The source has sent all data."""
        self.done = False
        """All data have been delivered."""
        self._backlog = bytearray()
        """Bytes that the sink does not accept yet."""
        self._closing = False

    @property
    def reads(self) -> bool:
        """True if more data may be in transit."""
        return not self.ended and self.way.under_way + len(self._backlog) < MOST_UNDER_WAY

    @property
    def writes(self) -> bool:
        """True if data wait for the sink."""
        return bool(self._backlog)

    def read(self, now_s: float) -> None:
        """Read from the source. Raises OSError if its connection is lost."""
        try:
            data = self.source.recv(READ_BYTES)
        except BlockingIOError:
            return
        self.ended = not data
        self.way.carry(data, now_s)

    def deliver(self, now_s: float) -> None:
        """Deliver the data that have arrived. Raises OSError if the sink's connection is lost."""
        for chunk in self.way.arrived(now_s):
            self._backlog += chunk
            self._closing |= not chunk
        try:
            while self._backlog:
                del self._backlog[: self.sink.send(self._backlog)]
        except BlockingIOError:
            return
        if self._closing and not self.done:
            self.done = True
            self.sink.shutdown(socket.SHUT_WR)


_Connection = tuple[_Direction, _Direction]


class SimulatedNetworkPeer(SimulatedPeer):
    """Listens on a port, and forwards each connection to another, with delay in both directions."""

    def __init__(self, options: SimulatedNetworkOptions | None = None) -> None:
        self.options = options = SimulatedNetworkOptions() if options is None else options
        check_faults(options.faults, FAULTS)
        self._listening: socket.socket | None = None
        self._connections: list[_Connection] = []
        self._count = 0
        self._cut_s = math.inf

    @property
    def endpoint(self) -> str:
        port = self.options.port
        if self._listening is not None:
            port = int(self._listening.getsockname()[1])
        return f"{self.options.host}:{port}"

    def open(self) -> None:
        if self._listening is not None:
            return
        host, port = self.options.host, self.options.port
        problem = f"cannot listen on {host}:{port}"
        self._listening = opened(host, port, socket.SOCK_STREAM, listen, problem)
        self._cut_s = time.monotonic() + self.options.faults.get("cut", math.inf)

    def close(self) -> None:
        if self._listening is not None:
            self._listening.close()
            self._listening = None
        for connection in self._connections:
            _end(connection)
        self._connections.clear()

    def step(self, until_s: float) -> None:
        listening = self._listening
        if listening is None:
            return
        while (now_s := time.monotonic()) < until_s:
            if now_s >= self._cut_s:
                time.sleep(until_s - now_s)
                return
            directions = [each for connection in self._connections for each in connection]
            due_s = min([until_s, self._cut_s, *(each.way.next_due_s for each in directions)])
            # select() waits to the microsecond; epoll and poll only to the millisecond.
            readable, _, _ = select.select(
                [listening, *(each.source for each in directions if each.reads)],
                [each.sink for each in directions if each.writes],
                [],
                max(0.0, due_s - now_s),
            )
            if listening in readable:
                self._accept(listening)
            for connection in list(self._connections):
                self._serve(connection, readable, time.monotonic())

    def _serve(self, connection: _Connection, readable: list[socket.socket], now_s: float) -> None:
        try:
            for each in connection:
                if each.source in readable:
                    each.read(now_s)
                each.deliver(now_s)
        except OSError:
            ended = True
        else:
            ended = all(each.done for each in connection)
        if ended:
            self._connections.remove(connection)
            _end(connection)

    def _accept(self, listening: socket.socket) -> None:
        try:
            near, _ = listening.accept()
        except OSError:  # The client left before it was accepted, or no file descriptor is free.
            return
        to_host, to_port = self.options.to_host, self.options.to_port
        try:
            far = socket.create_connection((to_host, to_port), CONNECT_WITHIN_S)
        except OSError as error:
            log.warning("%s:%d is not there: %s", to_host, to_port, error.strerror or error)
            near.close()
            return
        for each in (near, far):
            each.setblocking(False)
            with contextlib.suppress(OSError):
                each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        seed = self.options.seed + self._count
        self._count += 2
        there, back = (DelayedStream(self.options, each) for each in (seed, seed + 1))
        self._connections.append((_Direction(near, far, there), _Direction(far, near, back)))


def _end(connection: _Connection) -> None:
    for each in connection:
        each.source.close()


class SimulatedNetworkCommand(PeerCommand[SimulatedNetworkOptions]):
    """A network between two computers: passes TCP connections on, late and unevenly."""

    Options, Peer = SimulatedNetworkOptions, SimulatedNetworkPeer
    page = "simulated-peers.md"
    example = "--to 127.0.0.1:7448 --delay 60 --jitter 20"
    speaks = "nothing of its own: it passes on any protocol on TCP"
    epilog = "Prints READY and the address that one side connects to once it listens."
    faults = FAULTS
