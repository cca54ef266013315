"""Serves a simulated 3Dconnexion device over USB/IP: attached, it is a USB device to Linux.

On the machine that shall have it, as root::

    modprobe vhci-hcd
    usbip attach -r HOST -b 1-1
"""

from __future__ import annotations

import contextlib
import math
import selectors
import socket
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated

from cardan import bounds
from cardan.bounds import Text
from cardan.errors import AddressError
from cardan.sim_peers.spacemouse.shell import PuckOptions, PuckPeer
from cardan.sim_peers.spacemouse.usb import SpaceMouseUsb
from cardan.sim_peers.usbip import USBIP_PORT, UsbipSession

MAX_CONNECTIONS = 8
_ROOM = 65536

BUS_ID = Text(r"[^\0]+", "a name of 1 to 31 bytes", 31)


@dataclass(frozen=True, kw_only=True)
class UsbipSpaceMousePeerOptions(PuckOptions):
    """What to simulate and where."""

    host: Annotated[str, bounds.HOST] = "127.0.0.1"
    """Address to listen on."""
    port: Annotated[int, bounds.ANY_PORT] = USBIP_PORT
    """TCP port to listen on; 0: any. The tool ``usbip`` expects 3240 unless told otherwise."""
    bus_id: Annotated[str, BUS_ID] = "1-1"
    """What the host calls the device that it attaches, at most 31 bytes."""


class _Connection:
    def __init__(self, sock: socket.socket, session: UsbipSession) -> None:
        self.sock = sock
        self.session = session
        self.unsent = b""


class UsbipSpaceMousePeer(PuckPeer):
    """A simulated device on a TCP port, which one host at a time can attach.

    Unplugging detaches it; plugged in again, it has to be attached again. Raises ScriptError for a
    model, script or fault that does not exist or does not fit.
    """

    unfit_faults: Mapping[str, str] = MappingProxyType(
        {"newest-lost": "the host's kernel keeps the queue, and always loses the newest"}
    )

    def __init__(self, options: UsbipSpaceMousePeerOptions) -> None:
        super().__init__(options)
        self.options = options
        self._usb = SpaceMouseUsb(self.device.model, self._take_output)
        self._listener: socket.socket | None = None
        self._address = (options.host, options.port)
        self._connections: list[_Connection] = []
        self._plugged = False

    @property
    def endpoint(self) -> str:
        """HOST:PORT and the bus id."""
        return f"{self._address[0]}:{self._address[1]} {self.options.bus_id}"

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        return self._address

    @property
    def attached(self) -> bool:
        """Whether a host has imported the device."""
        return any(connection.session.imported for connection in self._connections)

    def close(self) -> None:
        """Detach the device, close every connection, give the terminal back."""
        if self._listener is not None:
            assert self._selector is not None
            for connection in tuple(self._connections):
                self._drop(connection)
            self._selector.unregister(self._listener)
            self._listener.close()
            self._listener = None
        super().close()

    # -- the carrier ---------------------------------------------------------------------------

    @property
    def _there(self) -> bool:
        return self._plugged

    def _appear(self) -> None:
        if self._listener is None:
            self._listen()
        self._plugged = True
        self._attend(time.monotonic())

    def _vanish(self) -> None:
        self._plugged = False
        for connection in tuple(self._connections):
            if connection.session.imported:
                self._drop(connection)
        self._attend(time.monotonic())

    def _deliver(self, reports: Sequence[bytes]) -> None:
        for connection in tuple(self._connections):
            if connection.session.imported:
                for report in reports:
                    connection.session.push(self._usb.endpoint, report)
                self._flush(connection)

    @property
    def _refused_until_s(self) -> float:
        return self._opened_s + self._faults.get("refuse", 0.0)

    def _carrier_due_s(self) -> float:
        return self._refused_until_s if time.monotonic() < self._refused_until_s else math.inf

    def _attend(self, now_s: float) -> None:
        """Say to every connection whether the device is there, and whether it may import it."""
        free = not self.attached and now_s >= self._refused_until_s
        for connection in self._connections:
            connection.session.present = self._plugged
            connection.session.available = free

    # -- connections ---------------------------------------------------------------------------

    def _listen(self) -> None:
        assert self._selector is not None
        host, port = self.options.host, self.options.port
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.setblocking(False)
            listener.bind((host, port))
            listener.listen(MAX_CONNECTIONS)
        except OSError as error:
            listener.close()
            raise AddressError(
                f"cannot listen on {host}:{port}: {error.strerror or error}; "
                "give another port, or end what uses it (usbipd)"
            ) from None
        self._listener = listener
        self._address = listener.getsockname()[:2]
        self._selector.register(listener, selectors.EVENT_READ, self._accept)

    def _accept(self) -> None:
        assert self._selector is not None
        assert self._listener is not None
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return
        if len(self._connections) == MAX_CONNECTIONS:
            sock.close()
            return
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection = _Connection(sock, UsbipSession(self._usb, self.options.bus_id))
        self._connections.append(connection)
        self._selector.register(sock, selectors.EVENT_READ, lambda: self._serve(connection))

    def _serve(self, connection: _Connection) -> None:
        """The host wrote, has room again, or is gone."""
        if connection not in self._connections:
            return
        try:
            data = connection.sock.recv(_ROOM)
        except BlockingIOError:
            self._flush(connection)
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        self._attend(time.monotonic())
        connection.session.receive(data)
        self._flush(connection)
        if connection.session.failed:
            self._drop(connection)
        elif connection.session.polled:
            self._begin()

    def _flush(self, connection: _Connection) -> None:
        assert self._selector is not None
        connection.unsent += connection.session.take_output()
        try:
            with contextlib.suppress(BlockingIOError):
                while connection.unsent:
                    sent = connection.sock.send(connection.unsent)
                    connection.unsent = connection.unsent[sent:]
        except OSError:
            self._drop(connection)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if connection.unsent else 0)
        key = self._selector.get_key(connection.sock)
        if key.events != wanted:
            self._selector.modify(connection.sock, wanted, key.data)

    def _drop(self, connection: _Connection) -> None:
        if connection not in self._connections:
            return
        assert self._selector is not None
        self._selector.unregister(connection.sock)
        connection.sock.close()
        self._connections.remove(connection)
