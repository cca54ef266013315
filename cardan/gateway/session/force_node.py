"""The force node: a process of its own that computes forces from a session's robot states.

As in the paper of 2026, one node drives the robot, another renders force. Fixtures are evaluated
here on the robot's measured TCP, in each of its cycles, which is why stiff ones oscillate: a
session's own ``[[fixtures]]`` are evaluated by the haptic device at 1 kHz. The session filters the
node's forces and drops stale ones, and the device bounds the rest.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time

from cardan.common.realtime import ask_for_real_time
from cardan.common.serving import interruptible
from cardan.common.sockets import absence, connected
from cardan.common.text_sanitizer import printable
from cardan.errors import AddressError, DriverError
from cardan.gateway.force.fixtures import FixtureSet, fixture_force
from cardan.gateway.force.link import (
    MAX_PACKET_BYTES,
    ForceMessage,
    RefusalMessage,
    StateMessage,
    decode,
    encode_force,
)
from cardan.gateway.force.sources import ForceSource, PointVelocity
from cardan.gateway.session.config import ForceConfig
from cardan.gateway.session.force_assembly import make_conditioner, make_source
from cardan.spatial import add, norm
from cardan.types import ZERO3

CONNECT_WITHIN_S = 10.0
"""Longest wait for a session's socket: both may be started at once."""

RETRY_S = 0.1

LOOK_S = 0.2
"""Period at which an idle node checks whether it must end."""

SAY_S = 5.0
"""Shortest time between two messages of the node."""

REST_M_S = 0.005
"""Speed below which a TCP is at rest, for the tare."""


class ForceNode:
    """The node without its socket: takes a state, returns a force."""

    def __init__(self, config: ForceConfig, source: ForceSource | None) -> None:
        self._fixtures = FixtureSet(config.fixtures)
        self._source = source
        self._conditioner = make_conditioner(config.force, source)
        self._max_age_s = config.force.max_age_s
        self._velocity = PointVelocity()
        self._sequence = 0
        self._started = self._engaged = False

    @property
    def reason(self) -> str:
        """Reason why no measured force is sent; empty when it is, or none is configured."""
        if self._source is None:
            return ""
        return self._source.reason or self._conditioner.reason

    def force(self, message: StateMessage) -> ForceMessage:
        """Return the force for the robot's state."""
        pose, force, stamp_s = message.pose, ZERO3, message.stamp_s
        velocity = ZERO3
        if pose is not None:
            velocity = self._velocity.update(pose.position, stamp_s)
            if message.ready and not self._started:
                self._started = True
                self._fixtures.place("start", pose.position)
            if message.world is not None and not self._engaged:
                self._fixtures.place("clutch-in", pose.position)
            for fixture in self._fixtures.fixtures:
                force = add(force, fixture_force(fixture, pose.position, velocity))
        self._engaged = message.world is not None
        if self._source is not None:
            reading = self._source.read(message.robot_state(), pose)
            at_rest = not self._engaged and norm(velocity) < REST_M_S
            filtered = self._conditioner.filtered
            if (
                reading is not None
                and self._conditioner.add(reading, at_rest, pose)
                and stamp_s - filtered.stamp_s <= self._max_age_s
            ):
                force = add(force, filtered.value)
                stamp_s = min(stamp_s, filtered.stamp_s)
        self._sequence += 1
        return ForceMessage(self._sequence, stamp_s, force)


def run_force_node(config: ForceConfig, path: str, seconds: float | None = None) -> int:
    """Serve the session that offers `path` until it ends, `seconds` are over, SIGINT or SIGTERM.

    Prints READY and the path once it is connected; returns the number of forces sent. Raises
    AddressError when no session offers the socket, DriverError when the sensor cannot be opened or
    the session refuses this node.
    """
    end_s = float("inf") if seconds is None else time.monotonic() + seconds
    with contextlib.ExitStack() as opened:
        ended = opened.enter_context(interruptible())
        source = make_source(config.force)
        if source is not None:
            opened.enter_context(source)
        session = opened.enter_context(_connect(path, ended, end_s))
        # A socket with a timeout would wait even in a call that must not.
        session.setblocking(False)
        ask_for_real_time()
        print(f"READY {path}", flush=True)
        return _serve(session, ForceNode(config, source), ended, end_s)


def _serve(session: socket.socket, node: ForceNode, ended: threading.Event, end_s: float) -> int:
    sent, said, say_s = 0, "", 0.0
    while not ended.is_set() and (now_s := time.monotonic()) < end_s:
        if not select.select([session], [], [], LOOK_S)[0]:
            continue
        try:
            packet = _newest(session)
        except OSError:
            packet = b""
        if not packet:
            print("the session has ended", flush=True)
            break
        message = decode(packet)
        if isinstance(message, RefusalMessage):
            raise DriverError(f"the session refuses this node: {message.reason}")
        if not isinstance(message, StateMessage):
            continue
        try:
            session.send(encode_force(node.force(message)))
            sent += 1
        except BlockingIOError:
            pass  # The session has stalled: this force would be too old by then.
        except OSError:
            continue  # The session has ended, or refuses: the next packet says which.
        if node.reason != said and now_s >= say_s:
            said, say_s = node.reason, now_s + SAY_S
            print(printable(said) or "the measured force is there", flush=True)
    return sent


def _newest(session: socket.socket) -> bytes:
    """Return the last of the waiting packets; empty when the session has ended."""
    packet = session.recv(MAX_PACKET_BYTES)
    while packet:
        try:
            newer = session.recv(MAX_PACKET_BYTES)
        except OSError:
            return packet
        if not newer:
            # The last packet counts: it may be the reason.
            return packet if isinstance(decode(packet), RefusalMessage) else b""
        packet = newer
    return packet


def _connect(path: str, ended: threading.Event, end_s: float) -> socket.socket:
    give_up_s = min(end_s, time.monotonic() + CONNECT_WITHIN_S)
    while True:
        try:
            return connected(path, socket.SOCK_SEQPACKET, CONNECT_WITHIN_S)
        except OSError as error:
            if ended.wait(RETRY_S) or time.monotonic() >= give_up_s:
                raise AddressError(
                    f"no session offers {path}: {absence(path) or error.strerror}; start one with "
                    f'[force] source = "remote" and socket = "{path}"'
                ) from None
