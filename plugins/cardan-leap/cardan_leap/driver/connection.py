"""WebSocket connection to the tracking service: a socket with the protocol of the package
websockets."""

from __future__ import annotations

import contextlib
import logging
import socket
import time

from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed, InvalidState
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.uri import WebSocketURI

from cardan.common.sockets import hang_up
from cardan.errors import DeviceAccessError, DeviceNotFoundError
from cardan_leap.protocol import (
    UNSUPPORTED_VERSION_CLOSE,
    ServiceMessage,
    Version,
    decode_service,
    path_of,
)

MAX_MESSAGE_BYTES = 1 << 20
"""Longest message, bytes; a longer one ends the connection. Frames of two hands have about 20
kB."""

DRAIN_BYTES = 16 << 20
"""Most bytes read before messages are processed, more than a system's receive buffer."""

SEND_TIMEOUT_S = 0.5
_READ_BYTES = 1 << 16

_protocol_log = logging.getLogger(f"{__name__}.websocket")
"""Logger of websockets, which would otherwise log every frame."""
_protocol_log.setLevel(logging.WARNING)


class ServiceClosedError(ConnectionError):
    """The service ended the connection; `code` is the WebSocket close code, 1006 without one."""

    def __init__(self, code: int, words: str) -> None:
        super().__init__(words)
        self.code = code


class Connection:
    """Open connection. Its methods raise OSError (ServiceClosedError among them) once it is
    gone."""

    def __init__(self, host: str, port: int, version: int, deadline_s: float) -> None:
        """Connect and request `version`, until the monotonic time `deadline_s`."""
        self.heard_s = time.monotonic()
        """Time when data were last received."""
        self._messages: list[bytes] = []
        self._parts: list[bytes] = []
        self._socket = socket.create_connection((host, port), _left_s(deadline_s))
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            uri = WebSocketURI(False, host, port, path_of(version), "")
            self._protocol = ClientProtocol(uri, max_size=MAX_MESSAGE_BYTES, logger=_protocol_log)
            self._protocol.send_request(self._protocol.connect())
            self._flush()
            while self._protocol.state is State.CONNECTING:
                self._read(_left_s(deadline_s))
        except BaseException:
            self._socket.close()
            raise

    def fileno(self) -> int:
        """Return the file descriptor for `select`. Messages may be buffered already: call `receive`
        first."""
        return self._socket.fileno()

    def receive(self, timeout_s: float) -> list[bytes]:
        """Return all text messages received, waiting `timeout_s` for the first bytes."""
        if not self._messages:
            self._check()
            with contextlib.suppress(TimeoutError, BlockingIOError):
                count, left = self._read(timeout_s), DRAIN_BYTES
                while count > 0 and left > 0:
                    left -= count
                    count = self._read(0.0)
        messages, self._messages = self._messages, []
        if not messages:
            self._check()
        return messages

    def send(self, text: str) -> None:
        """Send a text message."""
        with _as_os_error():
            self._protocol.send_text(text.encode())
        self._flush()

    def ping(self) -> None:
        """Send a ping."""
        with _as_os_error():
            self._protocol.send_ping(b"")
        self._flush()

    def close(self) -> None:
        """Close the connection, with a close frame if it can be sent at once. Never raises; may be
        called repeatedly."""
        with contextlib.suppress(OSError):
            with _as_os_error():
                self._protocol.send_close(1000)
            self._flush()
        hang_up(self._socket)

    # -- inside --------------------------------------------------------------------------------

    def _read(self, timeout_s: float) -> int:
        """Read once, waiting `timeout_s`; return the number of bytes."""
        self._socket.settimeout(timeout_s)
        data = self._socket.recv(_READ_BYTES)
        self.heard_s = time.monotonic()
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        for event in self._protocol.events_received():
            if isinstance(event, Frame):
                self._take(event)
        # Data to send at this point is an answer: a pong, or the close frame.
        with contextlib.suppress(OSError):
            self._flush()
        if self._protocol.handshake_exc is not None:
            raise ConnectionError(f"the service refused: {self._protocol.handshake_exc}")
        if not data and not self._messages:
            self._check()
            raise ServiceClosedError(1006, "the service closed the connection")
        return len(data)

    def _take(self, frame: Frame) -> None:
        if frame.opcode is Opcode.TEXT:
            self._parts = []
        elif frame.opcode is not Opcode.CONT:
            return
        self._parts.append(bytes(frame.data))
        if frame.fin:
            self._messages.append(b"".join(self._parts))
            self._parts = []

    def _check(self) -> None:
        """Raise if the peer, or a violation of the protocol, has ended the connection."""
        protocol = self._protocol
        if protocol.state in (State.CONNECTING, State.OPEN):
            return
        closed = protocol.close_rcvd
        if closed is not None:
            words = f"the service closed the connection, code {closed.code}"
            raise ServiceClosedError(closed.code, words)
        if protocol.parser_exc is not None and not isinstance(protocol.parser_exc, EOFError):
            raise ConnectionError(f"the service broke the protocol: {protocol.parser_exc}")
        raise ServiceClosedError(1006, "the service closed the connection")

    def _flush(self) -> None:
        self._socket.settimeout(SEND_TIMEOUT_S)
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data)
            else:
                self._socket.shutdown(socket.SHUT_WR)


def connect(
    host: str, port: int, version: int, timeout_s: float
) -> tuple[Connection, Version, list[ServiceMessage]]:
    """Open a connection in the highest version up to `version` that the service supports. Return
    the connection, the version message, and the messages that came with it. Raises
    DeviceNotFoundError if nothing answers, DeviceAccessError if the server is not a tracking
    service.
    """
    url = f"ws://{host}:{port}{path_of(version)}"
    deadline_s = time.monotonic() + timeout_s
    while True:
        try:
            return _try(host, port, version, deadline_s)
        except ServiceClosedError as error:
            if error.code != UNSUPPORTED_VERSION_CLOSE or version <= 1:
                raise DeviceAccessError(f"{url}: {error}") from None
            version -= 1
        except ConnectionRefusedError:
            raise DeviceNotFoundError(
                f"no service at {url}: start the tracking service, and allow web apps in its "
                "control panel"
            ) from None
        except TimeoutError:
            raise DeviceNotFoundError(f"no answer from {url} in {timeout_s:g} s") from None
        except (OSError, UnicodeError) as error:
            raise DeviceAccessError(f"{url}: {error}") from None


def _try(
    host: str, port: int, version: int, deadline_s: float
) -> tuple[Connection, Version, list[ServiceMessage]]:
    connection = Connection(host, port, version, deadline_s)
    try:
        while not (texts := connection.receive(_left_s(deadline_s))):
            pass
        first, *others = map(decode_service, texts)
        if not isinstance(first, Version):
            raise ConnectionError("it answers, but not as a Leap Motion tracking service")
    except BaseException:
        connection.close()
        raise
    return connection, first, others


def _left_s(deadline_s: float) -> float:
    left_s = deadline_s - time.monotonic()
    if left_s <= 0.0:
        raise TimeoutError("timed out")
    return left_s


class _as_os_error(contextlib.AbstractContextManager[None]):  # noqa: N801
    """Context that turns exceptions of websockets about an ended connection into OSError."""

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, (ConnectionClosed, InvalidState)):
            raise ConnectionError("the connection is closed") from None
