"""CAN bus on TCP by the socketcand protocol, as far as python-can's client needs it. Raw mode only:
every frame of a client goes to all others and to the local node, in order, without loss. There is
no arbitration and no bit timing."""

from __future__ import annotations

import math
import re
import socket
import time
from collections.abc import Sequence

from cardan.sim_peers.backends.base import Shell
from cardan.sim_peers.backends.server import DeviceServer, StreamClient, bound_to
from cardan_jr3.peer.can import CanBackend, CanNode
from cardan_jr3.protocol import CanFrame

GREETING = b"< hi >"
OK = b"< ok >"
LONGEST_COMMAND = 256
ROOM = 1 << 20
"""Most bytes kept for a client that does not read; beyond it the connection is closed."""
JOIN_S = 0.02
"""Time that frames are held after the last `< ok >`, or until the client has sent something:
python-can reads data that follows immediately as a part of it."""
MAX_CLIENTS = 16
_COMMAND = re.compile(rb"<([^<>]*)>")


class Session:
    """Session of a client: bytes in, replies and frames out. No I/O."""

    def __init__(self) -> None:
        self.opened = False
        self.raw = False
        """True if the client exchanges frames."""
        self.broken = False
        """True after a violation of the protocol: close the connection."""
        self._buffer = b""

    def feed(self, data: bytes) -> tuple[bytes, list[CanFrame]]:
        """Process the client's bytes; return replies, and frames for the bus."""
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
    """Return the line of a frame for a client; `stamp_s` is wall-clock time."""
    width = 3 if frame.arbitration_id <= 0x7FF else 8
    return (
        f"< frame {frame.arbitration_id:0{width}X} {stamp_s:.6f} {frame.data.hex().upper()} >"
    ).encode()


def _frame(words: list[bytes]) -> CanFrame | None:
    """Parse the frame of ``send ID DLC BYTE ...``, all hexadecimal; None: invalid."""
    try:
        arbitration_id, size = int(words[0], 16), int(words[1], 16)
        data = bytes(int(word, 16) for word in words[2:])
    except (ValueError, IndexError):
        return None
    # An identifier of eight digits is one of 29 bits, which no node here has.
    if len(words[0]) != 3 or not 0 <= arbitration_id <= 0x7FF or len(data) != size or size > 8:
        return None
    return CanFrame(arbitration_id, data)


class _Client(StreamClient):
    def __init__(self, sock: socket.socket) -> None:
        super().__init__(sock)
        self.session = Session()
        self.unsent += GREETING
        self.joins_s = math.inf
        """Time until which frames wait."""
        self.held = bytearray()

    def join(self) -> None:
        """Release waiting frames."""
        self.joins_s = math.inf
        self.unsent += self.held
        self.held.clear()


class SocketcandHub(CanBackend):
    """Server of a bus at `host` and `port` (0: any free one), with `node` on it."""

    def __init__(self, node: CanNode, host: str, port: int) -> None:
        super().__init__(node)
        self._host, self._port = host, port

    @property
    def endpoint(self) -> str:
        """Address of the server, HOST:PORT."""
        return f"{self._host}:{self._port}"

    @property
    def clients(self) -> Sequence[_Client]:
        """Number of connected clients."""
        return self._server.clients

    def open(self, shell: Shell) -> None:
        """Listen. Raises AddressError if that is impossible."""
        super().open(shell)
        self._server: DeviceServer[_Client] = DeviceServer(
            shell.selector,
            MAX_CLIENTS,
            meet=_Client,
            take=self._receive,
            part=lambda client: None,
        )
        listener = bound_to(self._host, self._port, "serve socketcand", family=socket.AF_INET)
        self._server.listen_on(listener)
        self._port = int(listener.getsockname()[1])

    def close(self) -> None:
        """Disconnect every client and close the port."""
        self._server.close()

    @property
    def due_s(self) -> float:
        """Return the time at which the next client's frames are released, monotonic s."""
        return min((client.joins_s for client in self.clients), default=math.inf)

    def run_due(self, now_s: float) -> None:
        """Release frames that have waited long enough, and accept new clients."""
        for client in tuple(self.clients):
            if client.joins_s <= now_s:
                client.join()
            if client.waiting:
                self._flush(client)

    def send(self, messages: Sequence[CanFrame]) -> None:
        """Send frames to every client."""
        for frame in messages:
            self._spread(frame)

    def _spread(self, frame: CanFrame, sender: _Client | None = None) -> None:
        """Send a frame to every client but its sender."""
        line = frame_line(frame, time.time())
        for client in tuple(self.clients):
            if client is not sender and client.session.raw:
                (client.held if client.joins_s < math.inf else client.unsent).extend(line)
                self._flush(client)

    def _receive(self, client: _Client, data: bytes) -> None:
        session = client.session
        was_raw = session.raw
        replies, frames = session.feed(data)
        if session.broken:
            self._server.drop(client)
            return
        if was_raw and client.joins_s < math.inf:
            client.join()
        client.unsent += replies
        if session.raw and not was_raw:
            client.joins_s = time.monotonic() + JOIN_S
        for frame in frames:
            self._spread(frame, client)
            self._take(frame)

    def _flush(self, client: _Client) -> None:
        self._server.flush(client)
        if len(client.unsent) + len(client.held) > ROOM:
            self._server.drop(client)
