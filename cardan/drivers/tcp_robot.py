"""Drivers of controllers with several TCP connections.

:class:`TcpSession` implements the protocol without sockets, clocks and threads; :class:`TcpRobot`
around it has the sockets and the loop.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Generator, Iterable
from typing import Any, ClassVar, Generic, TypeVar

from cardan.common.sockets import hang_up, opened
from cardan.drivers.base import RobotDriver
from cardan.drivers.robot_core import LoopMixin, RobotSession
from cardan.errors import AddressError
from cardan.types import (
    NEVER_S,
    HoldCommand,
    RobotCommand,
    RobotLink,
    RobotState,
)

SHORTEST_BACKOFF_S, LONGEST_BACKOFF_S = 0.25, 2.0
STEADY_S = 5.0
"""Shortest life of a connection that is retried soon after its loss: two programs would otherwise
take a port's only connection from each other forever."""

_RECEIVE_BYTES = 65536
_LONGEST_WAIT_S = 0.05
"""Longest wait on the sockets, and so the longest delay of another thread's request."""
_CONNECT_TIMEOUT_S = 2.0
_LEAVE_S = 1.5
"""Time besides the ramp for the controller's answers to the requests that end motion."""
_BACKLOG_BYTES = 16 * 1024
"""Unsent bytes at which a connection that accepts no more data is closed."""

_SELECT_MAX = 1024
"""Limit of file descriptors in select(); poll() has none, but waits whole milliseconds only."""

_monotonic = time.monotonic

ChannelT = TypeVar("ChannelT", bound=str)
TaskT = TypeVar("TaskT", bound=str)


class ConnectionState:
    """Connection state: whether it is up, since when, and when to retry."""

    def __init__(self) -> None:
        self.up = False
        self.reason = ""
        """Reason why it is down; empty before the first attempt and while it is up."""
        self.retry_s = NEVER_S
        self.since_s: float
        self.count = 0
        """Count of connections made."""
        self._backoff_s = SHORTEST_BACKOFF_S

    def opened(self, now_s: float) -> None:
        """Record a connection."""
        self.up, self.reason, self.since_s = True, "", now_s
        self.count += 1

    def lost(self, reason: str, now_s: float) -> None:
        """Record a broken or failed connection."""
        if self.up and now_s - self.since_s >= STEADY_S:
            self._backoff_s = SHORTEST_BACKOFF_S
        self.up, self.reason = False, reason
        self.retry_s = now_s + self._backoff_s
        self._backoff_s = min(2.0 * self._backoff_s, LONGEST_BACKOFF_S)


class TcpSession(RobotSession, Generic[ChannelT, TaskT]):
    """Protocol session with one robot on one controller, sans I/O.

    The driver connects the channels for which `wants` is true, reports events (`connected`,
    `received`, `disconnected`, `connect_failed`), calls `advance` at `next_s`, sends the items of
    `outgoing` one by one, and closes the channels in `closing`. Each state from `due_state` is
    answered by one `command`. All times are local monotonic, s.
    """

    def __init__(self, channels: Iterable[ChannelT]) -> None:
        self.losses = 0
        """Count of the controller's silences."""
        self._links: dict[ChannelT, ConnectionState] = {
            name: ConnectionState() for name in channels
        }
        self._out: list[tuple[ChannelT, bytes]] = []
        """Messages to send, in order."""
        self._closing: list[ChannelT] = []
        self._said_s = NEVER_S
        """Time and link of the last returned state."""
        self._said_link: RobotLink | None = None

    @property
    @abstractmethod
    def reply_pending(self) -> bool:
        """True if the last returned state takes a command, and has none yet."""

    @property
    @abstractmethod
    def next_s(self) -> float:
        """Latest time of the next call of `advance` and `due_state`."""

    @property
    @abstractmethod
    def left(self) -> bool:
        """True once what `leave` began has ended."""

    @property
    @abstractmethod
    def braking_s(self) -> float:
        """Longest ramp from full speed to rest, s."""

    # -- connections ------------------------------------------------------------------------------

    @abstractmethod
    def wants(self, channel: ChannelT, now_s: float) -> bool:
        """True when `channel` should be connected now."""

    @abstractmethod
    def connected(self, channel: ChannelT, now_s: float) -> None:
        """Record an established connection."""

    def connect_failed(self, channel: ChannelT, reason: str, now_s: float) -> None:
        """Record a failed attempt to connect."""
        self._links[channel].lost(reason, now_s)

    def disconnected(self, channel: ChannelT, reason: str, now_s: float) -> None:
        """Record a connection closed by the other side, or broken."""
        if self._links[channel].up:
            self._out = [item for item in self._out if item[0] != channel]
            self._lost(channel, reason, now_s)

    @abstractmethod
    def _lost(self, channel: ChannelT, reason: str, now_s: float) -> None:
        """Record in `_links` that an established connection is down, and react."""

    def _drop(self, channel: ChannelT, reason: str, now_s: float) -> None:
        """Close a connection that cannot be trusted, or is not needed."""
        if self._links[channel].up:
            self._closing.append(channel)
            self.disconnected(channel, reason, now_s)

    def closing(self) -> list[ChannelT]:
        """Return connections to close now; they count as disconnected already."""
        found = self._closing
        if found:
            self._closing = []
        return found

    def outgoing(self) -> list[tuple[ChannelT, bytes]]:
        """Return the messages to send now, in order; each item needs a send of its own."""
        found = self._out
        if found:
            self._out = []
        return found

    @abstractmethod
    def received(self, channel: ChannelT, data: bytes, now_s: float) -> None:
        """Process bytes from TCP."""

    # -- the control loop -------------------------------------------------------------------------

    @abstractmethod
    def advance(self, now_s: float) -> None:
        """Do what is due."""

    @abstractmethod
    def due_state(self, now_s: float) -> RobotState | None:
        """Return the state to report now; None while nothing is new."""

    @abstractmethod
    def command(self, command: RobotCommand, now_s: float) -> None:
        """Answer the last returned state; no effect if it takes no command.

        Raises CommandError for a kind or shape that the robot cannot take; nothing is sent then.
        """

    @abstractmethod
    def ask(self, task: TaskT, now_s: float) -> None:
        """Execute a task that only the application may request."""

    @abstractmethod
    def leave(self, now_s: float) -> None:
        """Brake, and end the driver's mode and program: the application ends its loop."""


TcpSessionT = TypeVar("TcpSessionT", bound=TcpSession[Any, Any])


def _begin_to_connect(sock: socket.socket, address: Any) -> None:
    """Begin to connect to the controller, without waiting. Raises OSError."""
    if sock.fileno() >= _SELECT_MAX:
        raise OSError(errno.EMFILE, "this process has too many files open")
    sock.setblocking(False)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    code = sock.connect_ex(address)
    if code not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
        raise OSError(code, os.strerror(code))


class TcpConnection:
    """Socket from the attempt to connect on."""

    def __init__(self, sock: socket.socket, now_s: float) -> None:
        self.socket = sock
        self.deadline_s = now_s + _CONNECT_TIMEOUT_S
        self.connecting = True
        self.backlog = bytearray()


class TcpRobot(LoopMixin[TcpSessionT], RobotDriver, Generic[TcpSessionT, ChannelT, TaskT]):
    """Driver of a controller with several TCP ports, in a single thread: `cycles` waits on the
    sockets, `send` answers.

    If the application does not answer a state, the driver answers with a hold; leaving the loop and
    `close` brake the robot along a ramp. A driver defines `channels`, `_make_session` and `_port`.
    """

    channels: ClassVar[tuple[Any, ...]]
    """Channels in the order of connecting."""

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._session = self._make_session()
        self._links: dict[ChannelT, TcpConnection] = {}
        self._behind = False
        """True while a connection has not accepted all data."""
        self._address = ""
        self._tasks: deque[TaskT] = deque()

    @abstractmethod
    def _make_session(self) -> TcpSessionT:
        """Make a new session from `self.options`."""

    @abstractmethod
    def _port(self, channel: ChannelT) -> int:
        """Return the port of a channel."""

    # -- opening and closing ----------------------------------------------------------------------

    def _acquire(self) -> None:
        host = self.options.host
        try:
            found = socket.getaddrinfo(host, None, family=socket.AF_INET, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            raise AddressError(f"host {host}: {error}") from None
        self._address = str(found[0][4][0])
        self._session = self._make_session()
        self._links = {}
        self._tasks.clear()

    def _release(self) -> None:
        for channel in tuple(self._links):
            self._cut(channel)

    def _forget(self) -> None:
        links, self._links = self._links, {}
        for link in links.values():
            link.socket.close()

    def _now_s(self) -> float:
        return _monotonic()

    def _leave_within_s(self) -> float:
        return _LONGEST_WAIT_S + _LEAVE_S + self._session.braking_s

    # -- the control loop -------------------------------------------------------------------------

    def _states(self, loop: int) -> Generator[RobotState, None, None]:
        session = self._session
        if self._loop != loop:
            return
        with self._looping(loop):
            while self._loop == loop:
                # Only this state is due between an answer and the next state.
                self._turn(session, _monotonic())
                self._wait(session, _LONGEST_WAIT_S)
                now_s = _monotonic()
                session.advance(now_s)
                state = session.due_state(now_s)
                if not session.reply_pending:  # Otherwise sent with the answer.
                    self._flush(session)
                if state is not None:
                    yield state
                    if self._loop != loop:
                        return
                    if session.reply_pending:
                        self.send(HoldCommand())

    def _turn(self, session: TcpSessionT, now_s: float) -> None:
        """Execute requests, connect, and send the resulting messages."""
        while self._tasks:
            session.ask(self._tasks.popleft(), now_s)
        for channel in self.channels:
            if channel not in self._links and session.wants(channel, now_s):
                self._connect(session, channel, now_s)
        self._flush(session)

    def _wait(self, session: TcpSessionT, longest_s: float) -> None:
        """Wait until data or a deadline comes, and process the data; answers are sent with what is
        due."""
        links = self._links
        timeout_s = min(max(session.next_s - _monotonic(), 0.0), longest_s)
        reads: list[socket.socket] = []
        writes: list[socket.socket] = []
        for link in links.values():
            if not link.connecting:
                reads.append(link.socket)
            if link.connecting or link.backlog:
                writes.append(link.socket)
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

    def send(self, command: RobotCommand) -> None:
        session = self._require_open()
        session.command(command, _monotonic())
        self._flush(session)

    def _leave(self) -> None:
        session = self._session
        deadline_s = _monotonic() + _LEAVE_S + session.braking_s
        session.leave(_monotonic())
        self._flush(session)
        while not session.left and (left_s := deadline_s - _monotonic()) > 0.0:
            self._wait(session, min(left_s, _LONGEST_WAIT_S))
            session.advance(_monotonic())
            session.due_state(_monotonic())
            self._flush(session)

    # -- sockets ----------------------------------------------------------------------------------

    def _connect(self, session: TcpSessionT, channel: ChannelT, now_s: float) -> None:
        try:
            sock = opened(
                self._address,
                self._port(channel),
                socket.SOCK_STREAM,
                _begin_to_connect,
                lambda error: error.strerror or str(error),
            )
        except AddressError as error:
            session.connect_failed(channel, str(error), now_s)
            return
        self._links[channel] = TcpConnection(sock, now_s)

    def _finish_connecting(
        self, session: TcpSessionT, channel: ChannelT, link: TcpConnection, now_s: float
    ) -> None:
        code = link.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code == 0 and now_s < link.deadline_s:
            link.connecting = False
            session.connected(channel, now_s)
            return
        self._cut(channel)
        reason = os.strerror(code) if code else f"no answer for {_CONNECT_TIMEOUT_S:g} s"
        session.connect_failed(channel, reason, now_s)

    def _receive(self, session: TcpSessionT, channel: ChannelT, link: TcpConnection) -> None:
        try:
            data = link.socket.recv(_RECEIVE_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(session, channel, error.strerror or str(error))
            return
        if data:
            if (callback := self.raw_packet_callback) is not None:
                callback(data, False, channel)
            session.received(channel, data, _monotonic())
        else:
            self._lost(session, channel, "the controller closed it")

    def _flush(self, session: TcpSessionT) -> None:
        """Send pending messages, each by a send of its own, as MotoROS needs it."""
        for channel in session.closing():
            self._cut(channel)
        if self._behind:
            self._catch_up(session)
        for channel, data in session.outgoing():
            to = self._links.get(channel)
            if to is None:
                continue
            if (callback := self.raw_packet_callback) is not None:
                callback(data, True, channel)
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
                if sent == len(data):
                    continue
                to.backlog += data[sent:]
            self._behind = True
            if len(to.backlog) > _BACKLOG_BYTES:
                self._lost(session, channel, "the controller accepts no more data")

    def _catch_up(self, session: TcpSessionT) -> None:
        """Send more of the data that a connection did not accept at once."""
        for channel, link in tuple(self._links.items()):
            if link.backlog and not link.connecting:
                self._push(session, channel, link)
        self._behind = any(link.backlog for link in self._links.values())

    def _push(self, session: TcpSessionT, channel: ChannelT, link: TcpConnection) -> None:
        try:
            del link.backlog[: link.socket.send(link.backlog)]
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(session, channel, error.strerror or str(error))

    def _lost(self, session: TcpSessionT, channel: ChannelT, reason: str) -> None:
        self._cut(channel)
        session.disconnected(channel, reason, _monotonic())

    def _cut(self, channel: ChannelT) -> None:
        link = self._links.pop(channel, None)
        if link is not None:
            hang_up(link.socket)

    # -- requests of the application --------------------------------------------------------------

    def _ask(self, task: TaskT) -> None:
        """Queue a task for the loop."""
        self._tasks.append(task)
