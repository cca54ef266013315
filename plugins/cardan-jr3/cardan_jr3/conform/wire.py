"""A CAN interface of Linux, for `cardan.conform.live`."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator

from cardan.conform.transports import TargetWire, Wires
from cardan.errors import AddressError
from cardan_jr3.conform.frames import pack, unpack
from cardan_jr3.protocol import CanFrame

_KERNELS = struct.Struct("=IB3x8s")


class _Can(TargetWire):
    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        sock.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> Iterator[tuple[bytes, str]]:
        while True:
            try:
                data = self._socket.recv(_KERNELS.size)
            except BlockingIOError:
                return
            except OSError:
                self.ended = True
                return
            identifier, size, payload = _KERNELS.unpack(data)
            if not identifier & ~0x7FF:
                yield pack(CanFrame(identifier, payload[:size])), ""

    def write(self, data: bytes) -> None:
        frame = unpack(data)
        if frame is not None:
            payload = frame.data.ljust(8, b"\0")
            with contextlib.suppress(OSError):
                self._socket.send(_KERNELS.pack(frame.arbitration_id, len(frame.data), payload))

    def close(self) -> None:
        self._socket.close()


class CanInterface(Wires):
    """An interface that is up, by its name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def open(self, channel: str) -> TargetWire:
        try:
            sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except (OSError, AttributeError) as error:
            raise AddressError(f"this system has no CAN sockets: {error}") from None
        try:
            sock.bind((self._name,))
        except OSError as error:
            sock.close()
            raise AddressError(
                f"{self._name} cannot be opened: {error.strerror}; `ip link set {self._name} up "
                "type can bitrate 1000000` sets it up"
            ) from None
        return _Can(sock)
