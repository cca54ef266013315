"""The session's socket for a force node: a Unix socket, polled once in each cycle."""

from __future__ import annotations

import contextlib
import socket

from cardan.common.haptics import WorldMap
from cardan.common.sockets import Advice, UnixSocket
from cardan.gateway.force.lease import Lease
from cardan.gateway.force.link import (
    MAX_PACKET_BYTES,
    ForceMessage,
    RefusalMessage,
    StateMessage,
    decode,
    encode_refusal,
    encode_state,
)
from cardan.gateway.force.sources import ForceSource, Reading
from cardan.types import NEVER_S, Frame, Pose, RobotLink, RobotState

ACCEPT_PERIOD_S = 0.05
"""Period of accepting new connections."""

TAKEN_AT_MOST = 16
"""Most packets of a node that are read in one cycle."""

SEND_BUFFER_BYTES = 4096
"""Buffer for a few states: a node that was asleep gets new ones soon; the session never blocks."""

_BACKLOG = 4
_ADVICE = Advice(
    no_socket="give another path in force.socket",
    served="end that session, or give another path in force.socket",
    refused="give force.socket a short path in a directory that can be written",
)


class RemoteSource(ForceSource):
    """Forces of a node in another process, which gets the robot's state in every cycle."""

    needs_tcp = True
    rests_at_zero = True
    shaped = True

    def __init__(self, path: str, max_age_s: float) -> None:
        self._path = path
        self.lease = Lease(max_age_s)
        self.unreadable = 0
        """Count of malformed packets."""
        self._offered: UnixSocket | None = None
        self._node: socket.socket | None = None
        self._number = self._nodes = 0
        """The connected node's number, and the count of nodes so far."""
        self._sequence = 0
        self._accept_s = NEVER_S
        self.reason = "no force node is connected"

    def open(self) -> None:
        """Create the socket. Raises AddressError if that fails."""
        offered = UnixSocket(self._path, socket.SOCK_SEQPACKET, advice=_ADVICE)
        offered.sock.listen(_BACKLOG)
        self._offered = offered

    def close(self) -> None:
        """Disconnect the node and remove the socket."""
        self._drop()
        offered, self._offered = self._offered, None
        if offered is not None:
            offered.close()

    def publish(
        self, state: RobotState, tcp: Pose | None, world: WorldMap | None, now_s: float
    ) -> None:
        """Send the robot's state to the node, if its buffer has room."""
        if now_s - self._accept_s >= ACCEPT_PERIOD_S:
            self._accept_s = now_s
            self._accept(now_s)
        node = self._node
        if node is None or state.link is not RobotLink.LIVE:
            return
        self._sequence += 1
        message = StateMessage(self._sequence, state.stamp_s, state.ready, tcp, state.wrench, world)
        try:
            node.send(encode_state(message))
        except BlockingIOError:
            pass  # The node does not read; later it gets a few old states, then new ones.
        except OSError:
            self._drop()

    def read(self, state: RobotState, tcp: Pose | None) -> Reading | None:
        """The node's newest force, along the base's axes."""
        self._receive(state.stamp_s)
        newest = self.lease.newest
        if newest is None:
            self.reason = (
                "no force node is connected" if self._node is None else "the force node is silent"
            )
            return None
        self.reason = ""
        return Reading(newest.stamp_s, newest.force, Frame.BASE)

    def diagnosis(self) -> tuple[str, ...]:
        """Why there is no force; drops and refusals."""
        words = list(super().diagnosis())
        lease = self.lease
        if lease.refused:
            words.append(f"{lease.refused} force nodes refused: another one was connected")
        if lease.dropped:
            words.append(f"{lease.dropped} forces of a node dropped: stale, or out of order")
        if self.unreadable:
            words.append(f"{self.unreadable} packets to the force socket were malformed")
        return tuple(words)

    def _accept(self, now_s: float) -> None:
        if self._offered is None:
            return
        try:
            node, _ = self._offered.sock.accept()
        except OSError:
            return
        node.setblocking(False)
        self._nodes += 1
        why_not = self.lease.ask(self._nodes, now_s)
        if why_not:
            with contextlib.suppress(OSError):
                node.send(encode_refusal(RefusalMessage(why_not)))
            node.close()
            return
        if self._node is not None:
            self._node.close()
        self._number = self._nodes
        with contextlib.suppress(OSError):
            node.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._node = node

    def _receive(self, now_s: float) -> None:
        node = self._node
        if node is None:
            return
        for _ in range(TAKEN_AT_MOST):
            try:
                packet = node.recv(MAX_PACKET_BYTES)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if not packet:
                self._drop()
                return
            message = decode(packet)
            if isinstance(message, ForceMessage):
                self.lease.take(self._number, message, now_s)
            else:
                self.unreadable += 1

    def _drop(self) -> None:
        node, self._node = self._node, None
        if node is not None:
            node.close()
            self.lease.leave(self._number)
