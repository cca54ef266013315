"""A CAN bus on TCP: what socketcand serves, as far as python-can's client needs it.

Raw mode only: every frame of one client goes to all others and to the local node, in order, and
none is lost. There is no arbitration and no bit timing.
"""

from __future__ import annotations

import contextlib
import re
import selectors
import socket
import time

from cardan.errors import AddressError
from cardan.protocols.jr3_can import CanFrame

GREETING = b"< hi >"
OK = b"< ok >"
LONGEST_COMMAND = 256
ROOM = 1 << 20
"""Bytes that wait for a client that does not read; one that is further behind is let go."""
JOIN_S = 0.02
"""python-can takes what follows the last `< ok >` at once for a part of it: frames wait so long,
or until the client has sent something."""
MAX_CLIENTS = 16
_CHUNK = 4096
_COMMAND = re.compile(rb"<([^<>]*)>")


class Session:
    """One client's side of the protocol: bytes in, replies and frames out. No I/O."""

    def __init__(self) -> None:
        self.opened = False
        self.raw = False
        """It takes and sends frames."""
        self.broken = False
        """It says what no client says; it is to be let go."""
        self._buffer = b""

    def feed(self, data: bytes) -> tuple[bytes, list[CanFrame]]:
        """Take what the client sent: what to reply, and the frames it sends to the bus."""
        self._buffer += data
        replies, frames = b"", []
        end = 0
        for match in _COMMAND.finditer(self._buffer):
            end = match.end()
            words = match[1].split()
            if words[:1] == [b"send"] and self.raw:
                frame = _frame(words[1:])
                if frame is None:
                    replies += b"< error could not parse the frame >"
                else:
                    frames.append(frame)
            else:
                replies += self._command(words)
        self._buffer = self._buffer[end:]
        self.broken = self.broken or len(self._buffer) > LONGEST_COMMAND
        return replies, frames

    def _command(self, words: list[bytes]) -> bytes:
        if words[:1] == [b"open"] and len(words) == 2 and not self.opened:
            self.opened = True
            return OK
        if words == [b"rawmode"] and self.opened:
            self.raw = True
            return OK
        if words == [b"echo"]:
            return b"< echo >"
        return b"< error unknown command >"


def frame_line(frame: CanFrame, stamp_s: float) -> bytes:
    """How a frame reaches a client; `stamp_s` by the wall clock."""
    width = 3 if frame.arbitration_id <= 0x7FF else 8
    return (
        f"< frame {frame.arbitration_id:0{width}X} {stamp_s:.6f} {frame.data.hex().upper()} >"
    ).encode()


def _frame(words: list[bytes]) -> CanFrame | None:
    """The frame of ``send ID DLC BYTE ...``, all hexadecimal; None: it is none."""
    try:
        arbitration_id, size = int(words[0], 16), int(words[1], 16)
        data = bytes(int(word, 16) for word in words[2:])
    except (ValueError, IndexError):
        return None
    # An identifier of eight digits is one of 29 bits, which no node here has.
    if len(words[0]) != 3 or not 0 <= arbitration_id <= 0x7FF or len(data) != size or size > 8:
        return None
    return CanFrame(arbitration_id, data)


class _Client:
    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.sock = sock
        self.session = Session()
        self.waiting = bytearray()
        self.joins_s = float("inf")
        """Frames wait until then."""
        self.held = bytearray()


class SocketcandHub:
    """Serves the bus at `host` and `port` (0: any free one)."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        self._selector: selectors.BaseSelector | None = None
        self._listener: socket.socket | None = None
        self._clients: list[_Client] = []

    @property
    def endpoint(self) -> str:
        """HOST:PORT."""
        port = self._port if self._listener is None else self._listener.getsockname()[1]
        return f"{self._host}:{port}"

    def open(self) -> None:
        """Listen; AddressError when that cannot be."""
        listener = None
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                self._host, self._port, family=socket.AF_INET, type=socket.SOCK_STREAM
            )[0]
            listener = socket.socket(family, kind, protocol)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(MAX_CLIENTS)
        except (OSError, UnicodeError) as error:
            if listener is not None:
                listener.close()
            raise AddressError(
                f"cannot serve socketcand on {self._host}:{self._port}: {error}"
            ) from None
        listener.setblocking(False)
        self._listener = listener
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ)

    def close(self) -> None:
        """Let go of every client and of the port."""
        for client in tuple(self._clients):
            self._drop(client)
        if self._selector is not None and self._listener is not None:
            self._selector.close()
            self._listener.close()
        self._selector = self._listener = None

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """The frames of all clients, once there are some or after `timeout_s`."""
        selector = self._selector
        assert selector is not None, "receive() before open()"
        joins_s = min((client.joins_s for client in self._clients), default=float("inf"))
        timeout_s = max(0.0, min(timeout_s, joins_s - time.monotonic()))
        frames: list[CanFrame] = []
        for key, events in selector.select(timeout_s):
            if key.fileobj is self._listener:
                self._accept()
            elif key.data in self._clients:
                if events & selectors.EVENT_READ:
                    frames += self._read(key.data)
                if events & selectors.EVENT_WRITE:
                    self._flush(key.data)
        now_s = time.monotonic()
        for client in tuple(self._clients):
            if client.joins_s <= now_s:
                self._join(client)
        return frames

    def send(self, frame: CanFrame, but_not_to: _Client | None = None) -> None:
        """Give `frame` to every client."""
        line = frame_line(frame, time.time())
        for client in tuple(self._clients):
            if client is not but_not_to and client.session.raw:
                if client.joins_s < float("inf"):
                    client.held += line
                else:
                    self._write(client, line)

    def _accept(self) -> None:
        assert self._listener is not None
        assert self._selector is not None
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return
        if len(self._clients) == MAX_CLIENTS:
            sock.close()
            return
        client = _Client(sock)
        self._clients.append(client)
        self._selector.register(sock, selectors.EVENT_READ, client)
        self._write(client, GREETING)

    def _read(self, client: _Client) -> list[CanFrame]:
        try:
            data = client.sock.recv(_CHUNK)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return []
        session = client.session
        was_raw = session.raw
        replies, frames = session.feed(data)
        if session.broken:
            self._drop(client)
            return []
        if was_raw and client.joins_s < float("inf"):
            self._join(client)
        if replies:
            self._write(client, replies)
        if session.raw and not was_raw:
            client.joins_s = time.monotonic() + JOIN_S
        for frame in frames:
            self.send(frame, client)
        return frames

    def _join(self, client: _Client) -> None:
        client.joins_s = float("inf")
        held, client.held = client.held, bytearray()
        if held:
            self._write(client, held)

    def _write(self, client: _Client, data: bytes | bytearray) -> None:
        client.waiting += data
        self._flush(client)

    def _flush(self, client: _Client) -> None:
        assert self._selector is not None
        with contextlib.suppress(BlockingIOError):
            try:
                while client.waiting:
                    del client.waiting[: client.sock.send(client.waiting)]
            except BlockingIOError:
                raise
            except OSError:
                self._drop(client)
                return
        if len(client.waiting) + len(client.held) > ROOM:
            self._drop(client)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        if self._selector.get_key(client.sock).events != wanted:
            self._selector.modify(client.sock, wanted, client)

    def _drop(self, client: _Client) -> None:
        if client not in self._clients:
            return
        self._clients.remove(client)
        if self._selector is not None:
            self._selector.unregister(client.sock)
        client.sock.close()
