"""The MotoROS driver: sockets around :class:`MotorosSession`."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Generator
from typing import Any

from cardan.drivers.base import Endpoint
from cardan.drivers.motoros.connections import CHANNELS, Channel
from cardan.drivers.motoros.io_client import IoClient
from cardan.drivers.motoros.motion_control import Task
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession
from cardan.drivers.robot_core import LoopingRobot
from cardan.drivers.simulated import LOOPBACK, OWN
from cardan.errors import AddressError, CardanError, NotOpenError
from cardan.protocols.simple_message import ByteOrder
from cardan.sockets import opened
from cardan.types import HoldCommand, RobotCommand, RobotState

_RECEIVE_BYTES = 65536
_LONGEST_WAIT_S = 0.05
"""Longest wait on the sockets, and so the longest delay of another thread's request."""
_CONNECT_TIMEOUT_S = 2.0
_LEAVE_S = 1.5
"""Time beside the ramp for the controller's answers to the requests that end motion."""
_BACKLOG_BYTES = 16 * 1024
"""Unsent bytes at which a connection that takes no more data is given up."""

_SELECT_MAX = 1024
"""select() takes no higher file numbers; poll() would, but waits whole milliseconds only."""

_monotonic = time.monotonic


def _begin_to_connect(sock: socket.socket, address: Any) -> None:
    """Begin to connect to the controller, without waiting for it. Raises OSError."""
    if sock.fileno() >= _SELECT_MAX:
        raise OSError(errno.EMFILE, "this process has too many files open")
    sock.setblocking(False)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    code = sock.connect_ex(address)
    if code not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
        raise OSError(code, os.strerror(code))


class _Link:
    """One socket, from the attempt to connect on."""

    def __init__(self, sock: socket.socket, now_s: float) -> None:
        self.socket = sock
        self.deadline_s = now_s + _CONNECT_TIMEOUT_S
        self.connecting = True
        self.backlog = bytearray()


class Motoros(LoopingRobot[MotorosSession]):
    """A Yaskawa Motoman controller that runs MotoROS (1.9), over its TCP ports.

    One thread does it all: `cycles` waits on the sockets, `send` answers. Motion starts only on
    `enable()` (or once, with the option enable = "at-start"); after anything that ended it,
    `enable()` is needed again. A state that the application does not answer is answered with a
    hold; leaving the loop and `close` brake the robot along a ramp.

    The driver moves one control group and needs none of the messages for several (2016, 2017,
    2041). Inputs, outputs and registers are behind `io`.
    """

    Options = MotorosOptions
    summary = "Motoman robots over MotoROS"
    page = "motoman.md"
    peer = "motoman-gp8"
    simulated = ({"host": LOOPBACK, "motion_port": OWN, "state_port": OWN, "io_port": OWN},)
    options: MotorosOptions
    title = "the MotoROS driver"

    def __init__(self, options: MotorosOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._session = MotorosSession(self.options)
        self._links: dict[Channel, _Link] = {}
        self._address = ""
        self._tasks: deque[Task] = deque()
        self._io: IoClient | None = None
        self._io_lock = threading.Lock()
        self._record_failure = ""

    # -- opening and closing ----------------------------------------------------------------------

    def _acquire(self) -> None:
        options = self.options
        try:
            found = socket.getaddrinfo(
                options.host, options.motion_port, family=socket.AF_INET, type=socket.SOCK_STREAM
            )
        except (OSError, UnicodeError) as error:
            raise AddressError(f"host {options.host}: {error}") from None
        self._address = str(found[0][4][0])
        self._session = MotorosSession(options)
        self._links = {}
        self._tasks.clear()
        self._record_failure = ""

    def _release(self) -> None:
        for channel in tuple(self._links):
            self._cut(channel)
        with self._io_lock:
            io, self._io = self._io, None
        if io is not None:
            with contextlib.suppress(Exception):
                io.close()
        try:
            self._session.control.record.write()
        except CardanError as error:
            self._record_failure = str(error)

    def _now_s(self) -> float:
        return _monotonic()

    def _leave_within_s(self) -> float:
        return _LONGEST_WAIT_S + _LEAVE_S + self._session.control.braking_s

    # -- the control loop -------------------------------------------------------------------------

    def _states(self, loop: int) -> Generator[RobotState, None, None]:
        session = self._session
        if self._loop != loop:
            return
        with self._looping(loop):
            while self._loop == loop:
                self._turn(session, _monotonic())
                state = session.due_state(_monotonic())
                if state is None:
                    self._wait(session, _LONGEST_WAIT_S)
                    continue
                yield state
                if session.control.owes_answer and self._loop == loop:
                    self.send(HoldCommand())

    def _turn(self, session: MotorosSession, now_s: float) -> None:
        """Do what is due."""
        while self._tasks:
            session.ask(self._tasks.popleft(), now_s)
        for channel in CHANNELS:
            if channel not in self._links and session.wants(channel, now_s):
                self._connect(session, channel, now_s)
        session.advance(now_s)
        self._flush(session)

    def _wait(self, session: MotorosSession, longest_s: float) -> None:
        """Wait until something comes or is due, and take what came."""
        links = self._links
        timeout_s = min(max(session.next_s - _monotonic(), 0.0), longest_s)
        reads = [link.socket for link in links.values() if not link.connecting]
        writes = [link.socket for link in links.values() if link.connecting or link.backlog]
        try:
            readable, writable, _ = select.select(reads, writes, [], timeout_s)
        except (OSError, ValueError):  # a socket was closed, or its number is too high
            readable, writable = reads, writes
        now_s = _monotonic()
        for channel, link in tuple(links.items()):
            if link.connecting:
                if link.socket in writable or now_s >= link.deadline_s:
                    self._finish_connecting(session, channel, link, now_s)
            elif link.socket in readable:
                self._receive(session, channel, link)
        self._flush(session)

    def send(self, command: RobotCommand) -> None:
        """Answer the state last yielded; without effect where that takes no command."""
        session = self._require_open()
        session.command(command, _monotonic())
        self._flush(session)

    def _leave(self) -> None:
        """Brake, leave the controller's mode, and wait for its answer; never for long."""
        session = self._session
        deadline_s = _monotonic() + _LEAVE_S + session.control.braking_s
        session.leave(_monotonic())
        self._flush(session)
        while not session.control.left and (left_s := deadline_s - _monotonic()) > 0.0:
            session.advance(_monotonic())
            session.due_state(_monotonic())
            self._flush(session)
            if not session.control.left:
                self._wait(session, min(left_s, _LONGEST_WAIT_S))

    # -- sockets ----------------------------------------------------------------------------------

    def _connect(self, session: MotorosSession, channel: Channel, now_s: float) -> None:
        options = self.options
        port = options.motion_port if channel == "motion" else options.state_port
        try:
            sock = opened(
                self._address,
                port,
                socket.SOCK_STREAM,
                _begin_to_connect,
                lambda error: error.strerror or str(error),
            )
        except AddressError as error:
            session.connect_failed(channel, str(error), now_s)
            return
        self._links[channel] = _Link(sock, now_s)

    def _finish_connecting(
        self, session: MotorosSession, channel: Channel, link: _Link, now_s: float
    ) -> None:
        code = link.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code == 0 and now_s < link.deadline_s:
            link.connecting = False
            session.connected(channel, now_s)
            return
        self._cut(channel)
        reason = os.strerror(code) if code else f"no answer for {_CONNECT_TIMEOUT_S:g} s"
        session.connect_failed(channel, reason, now_s)

    def _receive(self, session: MotorosSession, channel: Channel, link: _Link) -> None:
        try:
            data = link.socket.recv(_RECEIVE_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(session, channel, error.strerror or str(error))
            return
        if data:
            if (tap := self.tap) is not None:
                tap(data, False, channel)
            session.received(channel, data, _monotonic())
        else:
            self._lost(session, channel, "the controller closed it")

    def _flush(self, session: MotorosSession) -> None:
        """Send what is to be sent: each message by a send of its own, as MotoROS needs it."""
        for channel in session.closing():
            self._cut(channel)
        for channel, link in tuple(self._links.items()):
            if link.backlog and not link.connecting:
                self._push(session, channel, link)
        for channel, data in session.outgoing():
            to = self._links.get(channel)
            if to is None:
                continue
            if (tap := self.tap) is not None:
                tap(data, True, channel)
            if to.backlog:
                to.backlog += data
            else:
                try:
                    sent = to.socket.send(data)
                except BlockingIOError:
                    sent = 0
                except OSError as error:
                    self._lost(session, channel, error.strerror or str(error))
                    continue
                to.backlog += data[sent:]
            if len(to.backlog) > _BACKLOG_BYTES:
                self._lost(session, channel, "the controller takes nothing any more")

    def _push(self, session: MotorosSession, channel: Channel, link: _Link) -> None:
        try:
            del link.backlog[: link.socket.send(link.backlog)]
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(session, channel, error.strerror or str(error))

    def _lost(self, session: MotorosSession, channel: Channel, reason: str) -> None:
        self._cut(channel)
        session.disconnected(channel, reason, _monotonic())

    def _cut(self, channel: Channel) -> None:
        link = self._links.pop(channel, None)
        if link is not None:
            link.socket.close()

    # -- requests of the application --------------------------------------------------------------

    def enable(self) -> None:
        """Start motion (START_VEL_MODE or START_TRAJ_MODE), which also resets alarms and switches
        servos on. Done by the loop; the states' `hold_reason` says whether it worked."""
        self._tasks.append("enable")

    def disable(self) -> None:
        """Brake along a ramp, then leave the controller's mode. Done by the loop."""
        self._tasks.append("disable")

    def stop(self) -> None:
        """STOP_MOTION, without a ramp of ours: a trajectory stops dead, velocity mode ramps down at
        the controller's own acceleration. Done by the loop, after a reply that is awaited; no
        substitute for an emergency stop."""
        self._tasks.append("stop")

    def reset_alarm(self) -> None:
        """Reset alarm and error. Done by the loop, as the two below."""
        self._tasks.append("reset alarm")

    def servo_on(self) -> None:
        """Switch the servos on; nothing moves."""
        self._tasks.append("servo on")

    def servo_off(self) -> None:
        """Brake along a ramp, then switch the servos off."""
        self._tasks.append("servo off")

    @property
    def enabled(self) -> bool:
        """True while commands move the robot, or would if they came."""
        return self._open and self._session.enabled

    @property
    def io(self) -> IoClient:
        """Inputs, outputs and registers, on a connection of their own; its calls wait for replies.

        Raises NotOpenError while the byte order of the controller is not known: before its first
        state, unless the option `byte_order` tells.
        """
        session = self._require_open()
        with self._io_lock:
            if self._io is None:
                order = session.feed.byte_order
                if order is None:
                    raise NotOpenError(
                        "the controller's byte order is not known yet: wait for its first state, "
                        "or set byte_order"
                    )
                options = self.options
                self._io = IoClient(
                    self._address,
                    options.io_port,
                    "big" if order is ByteOrder.BIG else "little",
                    options.request_timeout_s,
                )
            return self._io

    # -- diagnosis --------------------------------------------------------------------------------

    def endpoints(self) -> tuple[Endpoint, ...]:
        """The state port, which serves several clients; the motion port serves one."""
        return (Endpoint("tcp", self.options.host, self.options.state_port),)

    def metrics(self) -> dict[str, float]:
        return self._session.metrics(_monotonic())

    def protocol_errors(self) -> dict[str, int]:
        return self._session.protocol_errors()

    def diagnosis(self) -> tuple[str, ...]:
        return (*super().diagnosis(), *((self._record_failure,) if self._record_failure else ()))
