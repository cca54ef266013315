"""Wires to a real target, for `cardan.conform.live`: sockets, device files."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import socket
from abc import ABC, abstractmethod
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any

from cardan.common.sockets import ask_for_stamps, opened, waiting, waiting_stamped
from cardan.errors import AddressError, ConfigurationError, DeviceAccessError

LARGEST_READ = 65535
CONNECT_S = 5.0
WAITING_CLIENTS = 8


class TargetWire(ABC):
    """An open wire. `ended` once the other side has closed it."""

    ended = False
    identity = ""
    """Vendor and product as 046d:c626, if the system knows them."""
    late_s = 0.0
    """Time between arrival and reading of the last data, by the kernel's stamp; 0 without one."""

    @abstractmethod
    def fileno(self) -> int:
        """File descriptor for `select`."""

    @abstractmethod
    def read(self) -> Iterator[tuple[bytes, str]]:
        """Yield the pending data, each with its source address. Never raises."""

    def arrivals(self) -> Iterator[tuple[str, TargetWire]]:
        """Accept clients of a listening port: yield channel name and wire of each. Never raises."""
        return iter(())

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send. Unsendable data are lost: a silent other side is a finding."""

    @abstractmethod
    def close(self) -> None:
        """Close the wire. Never raises."""


class Wires(ABC):
    """The wires of one target, by their channels."""

    @abstractmethod
    def open(self, channel: str) -> TargetWire:
        """Open a wire. Raises AddressError or DeviceAccessError, which say what to do."""

    def close(self) -> None:  # noqa: B027
        """Release the resources that the wires share, after all are closed. Never raises."""


class _SocketWire(TargetWire):
    """A wire that is a socket."""

    def __init__(self, of: socket.socket) -> None:
        self._socket = of

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()


class _Udp(_SocketWire):
    """A UDP socket with the kernel's receive time stamps. It is connected to one address, or
    `listens` at a port of ours and then sends to the source of the last datagram."""

    def __init__(self, host: str, port: int, listens: bool) -> None:
        join = socket.socket.bind if listens else socket.socket.connect
        problem = f"cannot {'listen on' if listens else 'send to'} {host}:{port}"
        super().__init__(opened(host, port, socket.SOCK_DGRAM, join, problem))
        self._stamped = ask_for_stamps(self._socket)
        self._listens = listens
        self._peer: Any = None if listens else (host, port)

    def read(self) -> Iterator[tuple[bytes, str]]:
        unstamped = ((*each, 0.0) for each in waiting(self._socket, LARGEST_READ))
        stamped = waiting_stamped(self._socket, LARGEST_READ) if self._stamped else unstamped
        for data, source, self.late_s in stamped:
            if self._listens:
                self._peer = source
            yield data, f"{self._peer[0]}:{self._peer[1]}"

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            if not self._listens:
                self._socket.send(data)
            elif self._peer is not None:
                self._socket.sendto(data, self._peer)


class _Ending(TargetWire):
    """A wire that ends with an empty read."""

    @abstractmethod
    def _next(self) -> bytes:
        """Read pending data without waiting. Raises OSError."""

    def read(self) -> Iterator[tuple[bytes, str]]:
        while not self.ended:
            try:
                data = self._next()
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self.ended = True
                return
            yield data, ""


class StreamWire(_SocketWire, _Ending):
    """A connected stream socket."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__(connection)
        connection.setblocking(False)

    def _next(self) -> bytes:
        return self._socket.recv(LARGEST_READ)

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendall(data)


class FileWire(_Ending):
    """A device file whose every read is one report, or a serial line's bytes."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        os.set_blocking(descriptor, False)

    def fileno(self) -> int:
        return self._descriptor

    def _next(self) -> bytes:
        return os.read(self._descriptor, LARGEST_READ)

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._descriptor, data)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            os.close(self._descriptor)


class UdpPort(Wires):
    """A UDP address of the target, or a port of ours that `listens` to a client."""

    def __init__(self, host: str, port: int, listens: bool) -> None:
        self._place = host, port, listens

    def open(self, channel: str) -> TargetWire:
        return _Udp(*self._place)


class _TcpListener(_SocketWire):
    """A listening TCP port of the suite. Each client is a wire of its own: "motion 2" is the second
    client of any port."""

    def __init__(self, host: str, port: int, channel: str, numbers: Iterator[int]) -> None:
        problem = f"cannot listen on {host}:{port}"
        super().__init__(opened(host, port, socket.SOCK_STREAM, _listen, problem))
        self._channel, self._numbers = channel, numbers

    def read(self) -> Iterator[tuple[bytes, str]]:
        return iter(())

    def arrivals(self) -> Iterator[tuple[str, TargetWire]]:
        while True:
            try:
                connection, _ = self._socket.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            except OSError:  # no client, or gone before it was accepted
                return
            yield f"{self._channel} {next(self._numbers)}", StreamWire(connection)

    def write(self, data: bytes) -> None:
        """Do nothing: each client has a wire of its own."""


def _listen(sock: socket.socket, address: Any) -> None:
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(address)
    sock.listen(WAITING_CLIENTS)


class TcpPorts(Wires):
    """Ports of a host, each a named channel; those in `ours` listen at `home` for a client."""

    def __init__(
        self, host: str, ports: dict[str, int], ours: Container[str] = (), home: str = ""
    ) -> None:
        self._host, self._ports, self._ours, self._home = host, ports, ours, home
        self._numbers = itertools.count(1)

    def open(self, channel: str) -> TargetWire:
        host, port = self._host, self._ports[channel]
        if channel in self._ours:
            return _TcpListener(self._home, port, channel, self._numbers)
        try:
            found = socket.create_connection((host, port), CONNECT_S)
            found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except (OSError, UnicodeError) as error:
            raise AddressError(f"cannot connect to {host}:{port}: {error}") from None
        return StreamWire(found)


class DeviceFile(Wires):
    """A device node that is read report by report, as /dev/hidraw0."""

    def __init__(self, path: str) -> None:
        self._path = path

    def open(self, channel: str) -> TargetWire:
        try:
            descriptor = os.open(self._path, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError as error:
            raise DeviceAccessError(
                f"{self._path} cannot be opened: {error.strerror}; `cardan doctor` says why"
            ) from None
        wire = FileWire(descriptor)
        wire.identity = _hid_identity(self._path)
        return wire


def _hid_identity(path: str) -> str:
    """Return vendor and product of a hidraw node from the kernel's uevent; empty: unknown."""
    uevent = Path("/sys/class/hidraw") / Path(path).name / "device" / "uevent"
    try:
        text = uevent.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
    found = re.search(r"^HID_ID=[0-9A-F]+:([0-9A-F]{8}):([0-9A-F]{8})$", text, re.MULTILINE)
    return "" if found is None else ":".join(each[4:].lower() for each in found.groups())


def host_and_port(target: str, key: str, port: int) -> tuple[str, int]:
    """Parse HOST, HOST:PORT or :PORT in `target`. Raises ConfigurationError."""
    host, colon, digits = target.rpartition(":")
    if not colon:
        return target, port
    if not digits.isdigit() or not 0 < int(digits) < 65536:
        raise ConfigurationError(key, f"{target!r} has no port of 1 to 65535 after its colon")
    return host, int(digits)
