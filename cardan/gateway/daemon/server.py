"""The daemon's local socket: access control, and bounded output for each client."""

from __future__ import annotations

import contextlib
import grp
import logging
import os
import selectors
import socket
import stat
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from cardan.common.resource_errors import shortage
from cardan.common.sockets import OWNER_ONLY, Advice, UnixSocket, user_of
from cardan.errors import AddressError, ConfigurationError
from cardan.gateway.arm.backlog import BACKLOGGED, Backlog
from cardan.gateway.daemon.control import (
    Ask,
    ControlError,
    LineReader,
    Response,
    decode_ask,
    encode_response,
    refusal,
)
from cardan.gateway.servers.tokens import Role
from cardan.types import NEVER_S

GROUP_TOO: Final = 0o660

MAX_CONNECTIONS: Final = 64
"""Most programs connected at a time; further ones are refused."""

MAX_UNREAD_BYTES: Final = 1 << 20
"""Most bytes that wait for a client that does not read; beyond, it is disconnected."""

READ_BYTES: Final = 1 << 16
"""Most bytes per read of a client."""

TURN_S: Final = 0.01
"""Longest time for the requests of one client in a turn."""

BACKLOG: Final = MAX_CONNECTIONS
"""Most programs that wait for their connection; others would be refused at once."""

SHORTAGE_PAUSE_S: Final = 0.5
"""Pause of accepting connections when no file can be opened for one."""

STOOD_STILL_S: Final = 0.05
"""Excess duration of a poll that shows a pause of this process."""

_log = logging.getLogger(__name__)

_ADVICE = Advice(
    no_socket="set daemon.socket",
    served="is a daemon running already? `cardan daemon ps` shows it; another one needs another "
    "daemon.socket",
    refused="set daemon.socket to a short path in a folder that can be written",
)


_log = logging.getLogger(__name__)


class ControlConnection:
    """A client of the daemon."""

    def __init__(self, sock: socket.socket, role: Role = Role.ADMIN) -> None:
        self.sock, self.role = sock, role
        self.reader = LineReader()
        self.gone: list[Callable[[], None]] = []
        """Called when it has disconnected."""
        self.asked: deque[bytes] = deque()
        """Lines that wait for their turn; nothing is read meanwhile."""
        self.empty_s = self.since_s = time.monotonic()
        """Last time at which no data of it waited to be read; and the same when `asked` was read:
        its lines arrived later."""
        self.heard_s = self.empty_s
        """Time of the last data."""
        self.backlog = Backlog()
        self._unsent = bytearray()
        self.open = True

    def tell(self, *responses: Response) -> None:
        """Send responses. Never waits; a client that does not read is disconnected. An answer may
        exceed MAX_UNREAD_BYTES."""
        if not self.open:
            return
        if len(self._unsent) > MAX_UNREAD_BYTES:
            self.flush()
            if len(self._unsent) > MAX_UNREAD_BYTES:
                self.open = False
                return
        for each in responses:
            self._unsent += encode_response(each)
        self.flush()

    @property
    def silent_s(self) -> float:
        """Time for which certainly nothing has arrived; a pause of this process does not count."""
        return self.empty_s - self.heard_s

    @property
    def waits(self) -> bool:
        """True if data waits to be sent."""
        return bool(self._unsent)

    def flush(self) -> None:
        """Send as much as its socket takes."""
        try:
            while self._unsent:
                del self._unsent[: self.sock.send(self._unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self.open = False


class ControlServer:
    """Serves the control protocol. For one thread."""

    def __init__(
        self,
        path: str,
        group: str,
        handle: Callable[[Ask, ControlConnection], Any | None],
        group_role: Role = Role.OPERATOR,
    ) -> None:
        """`handle` carries out a request and answers its connection; `group_role`: role of the
        group's members. Raises AddressError if the path cannot be used, and ConfigurationError for
        an unknown group."""
        number = _group_number(group)
        mode = OWNER_ONLY if number is None else GROUP_TOO
        self._socket = UnixSocket(path, socket.SOCK_STREAM, OWNER_ONLY, _ADVICE)
        try:
            if number is not None:
                os.chown(path, -1, number)
                os.chmod(path, mode)
                _warn_of_folder(path, group, number)
            self._socket.sock.listen(BACKLOG)
        except OSError as error:
            self._socket.close()
            raise AddressError(
                f"cannot give {path!r} to the group {group!r}: {error.strerror}; are you a member?"
            ) from None
        self.path = self._socket.path
        self._handle, self._group_role = handle, group_role
        self._connections: dict[int, ControlConnection] = {}
        self._listening = True
        self._listen_s = NEVER_S
        """Time at which it accepts connections again, after a shortage."""
        self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket.sock, selectors.EVENT_READ)
        self._selector.register(self._wake_read, selectors.EVENT_READ)

    def wake(self) -> None:
        """End `poll` early. From any thread, or a signal handler."""
        with contextlib.suppress(OSError):
            os.write(self._wake_write, b"x")

    def poll(self, timeout_s: float) -> None:
        """Serve requests, for `timeout_s` at most."""
        if not self._listening and time.monotonic() >= self._listen_s:
            self._listening = True
            self._selector.register(self._socket.sock, selectors.EVENT_READ)
        asked = any(each.asked for each in self._connections.values())
        began_s = time.monotonic()
        found = self._selector.select(0.0 if asked else timeout_s)
        now_s = time.monotonic()
        # After a process stalled, epoll reports no events though there are some, if the time
        # is up by then: nothing was there when it began to look.
        empty_s = began_s if now_s - began_s > timeout_s + STOOD_STILL_S else now_s
        self._note_empty(
            {key.fd for key, events in found if events & selectors.EVENT_READ}, empty_s
        )
        for key, events in found:
            if key.fileobj is self._socket.sock:
                self._accept()
            elif key.fd == self._wake_read:
                with contextlib.suppress(BlockingIOError):
                    os.read(self._wake_read, 4096)
            elif (connection := self._connections.get(key.fd)) is not None:
                if events & selectors.EVENT_WRITE:
                    connection.flush()
                if events & selectors.EVENT_READ and not connection.asked:
                    self._read(connection)
        for connection in list(self._connections.values()):
            self._answer_some(connection)
            self._look_at(connection)

    def _note_empty(self, readable: set[int], now_s: float) -> None:
        for number, connection in self._connections.items():
            # Connections with lines that wait for their turn were not checked.
            if number not in readable and not connection.asked:
                connection.empty_s = now_s

    def _accept(self) -> None:
        """Accept all waiting connections, up to the limit."""
        for _ in range(BACKLOG):
            try:
                sock, _ = self._socket.sock.accept()
            except OSError as error:
                if words := shortage(error):
                    # The client stays in the queue, and would be reported again at once, for ever.
                    _log.warning("programs that ask wait: %s", words)
                    self._selector.unregister(self._socket.sock)
                    self._listening = False
                    self._listen_s = time.monotonic() + SHORTAGE_PAUSE_S
                return
            self._welcome(sock)

    def _welcome(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        connection = ControlConnection(sock, self._role_of(sock))
        if len(self._connections) >= MAX_CONNECTIONS:
            words = f"{MAX_CONNECTIONS} programs are connected to the daemon already"
            connection.tell(Response(None, "error", words))
            sock.close()
            return
        self._connections[sock.fileno()] = connection
        self._selector.register(sock, selectors.EVENT_READ)

    def _role_of(self, sock: socket.socket) -> Role:
        """Return the role of the client's user, known from the kernel; if unknown, the group's
        role."""
        owners = (0, os.geteuid())
        return Role.ADMIN if user_of(sock) in owners else self._group_role

    def _read(self, connection: ControlConnection) -> None:
        try:
            data = connection.sock.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        connection.since_s, now_s = connection.empty_s, time.monotonic()
        connection.heard_s = now_s
        if len(data) < READ_BYTES:
            connection.empty_s = now_s
        if not data:
            connection.open = False
            return
        if connection.backlog.lasts(now_s - connection.since_s, now_s):
            _log.warning("a program that sends more than can be handled is disconnected")
            connection.tell(Response(None, "error", BACKLOGGED))
            connection.open = False
            return
        try:
            connection.asked.extend(connection.reader.take(data))
        except ControlError as error:
            connection.tell(Response(error.request, "error", str(error)))
            connection.open = False

    def _answer_some(self, connection: ControlConnection) -> None:
        """Answer for TURN_S at most, so that a client with many requests does not delay others."""
        end_s = time.monotonic() + TURN_S
        while connection.open and connection.asked:
            self._answer(connection.asked.popleft(), connection)
            if time.monotonic() >= end_s:
                break

    def _answer(self, line: bytes, connection: ControlConnection) -> None:
        try:
            ask = decode_ask(line)
        except ControlError as error:
            connection.tell(Response(error.request, "error", str(error)))
            return
        if why := refusal(ask, connection.role):
            connection.tell(Response(ask.id, "error", why))
            return
        self._handle(ask, connection)

    def _look_at(self, connection: ControlConnection) -> None:
        if not connection.open:
            del self._connections[connection.sock.fileno()]
            with contextlib.suppress(KeyError):  # It was not checked while its turn was due.
                self._selector.unregister(connection.sock)
            connection.sock.close()
            for call in connection.gone:
                call()
            return
        reading = 0 if connection.asked else selectors.EVENT_READ
        events = reading | (selectors.EVENT_WRITE if connection.waits else 0)
        key = self._selector.get_map().get(connection.sock)
        if not events:
            if key is not None:
                self._selector.unregister(connection.sock)
        elif key is None:
            self._selector.register(connection.sock, events)
        elif key.events != events:
            self._selector.modify(connection.sock, events)

    def close(self) -> None:
        """Disconnect all clients and remove the socket. Never raises; idempotent."""
        for connection in self._connections.values():
            connection.sock.close()
        self._connections.clear()
        self._selector.close()
        self._socket.close()
        for each in (self._wake_read, self._wake_write):
            with contextlib.suppress(OSError):
                os.close(each)
        self._wake_read = self._wake_write = -1


def _group_number(group: str) -> int | None:
    if not group:
        return None
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        raise ConfigurationError(
            "daemon.group", f"there is no group {group!r} on this computer"
        ) from None


def _warn_of_folder(path: str, group: str, number: int) -> None:
    """Warn if the group's members cannot enter the socket's folder, which a user's runtime folder,
    the default, does not allow."""
    folder = os.path.dirname(os.path.abspath(path))
    found = os.stat(folder)
    enters = stat.S_IXGRP if found.st_gid == number else stat.S_IXOTH
    if not found.st_mode & enters:
        _log.warning(
            "members of the group %s cannot enter %s, where the socket is: set daemon.socket to a "
            "path in a folder that they can",
            *(group, folder),
        )
