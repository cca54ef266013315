"""Ways to an input device's events: a node of /dev/input, and a socket that stands for one."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import sys
import time
from abc import ABC, abstractmethod
from collections import deque

from cardan.errors import DeviceAccessError
from cardan.protocols.evdev import (
    BY_VALUE,
    EVENT_BYTES,
    Call,
    Malformed,
    argument_bytes,
    decode_call,
    decode_int,
    encode_call,
)

if sys.platform != "win32":
    import fcntl

READ_BYTES = 64 * EVENT_BYTES
"""Asked of every read: as many events as the kernel keeps for a slow reader, at least."""

_CALL_TIMEOUT_S = 0.5
_CONNECT_TIMEOUT_S = 1.0


class Link(ABC):
    """An open device. All methods but close() raise OSError once it is gone."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes | None:
        """Events that wait, oldest first; None when none comes in time."""

    @abstractmethod
    def write(self, events: bytes) -> None:
        """Give the device events (EV_FF, EV_LED)."""

    @abstractmethod
    def call(self, request: int, argument: bytes = b"") -> bytes:
        """Make an ioctl request; its argument as it is after it. OSError when it is refused."""

    @abstractmethod
    def close(self) -> None:
        """Release the device. Never raises."""


class NodeLink(Link):
    """A node of /dev/input."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def read(self, timeout_s: float) -> bytes | None:
        """One read."""
        ready = self._poll.poll(1000.0 * timeout_s)
        if not ready:
            return None
        if not ready[0][1] & select.POLLIN:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        try:
            return os.read(self._fd, READ_BYTES)
        except BlockingIOError:  # another thread was faster, or the events were thrown away
            return None

    def write(self, events: bytes) -> None:
        """One write."""
        os.write(self._fd, events)

    def call(self, request: int, argument: bytes = b"") -> bytes:
        """One ioctl."""
        if request in BY_VALUE:
            fcntl.ioctl(self._fd, request, decode_int(argument))
            return argument
        buffer = bytearray(argument.ljust(argument_bytes(request), b"\0"))
        fcntl.ioctl(self._fd, request, buffer, True)
        return bytes(buffer)

    def close(self) -> None:
        """Close the node; the kernel erases what effects were uploaded through it."""
        with contextlib.suppress(OSError):
            os.close(self._fd)


class SocketLink(Link):
    """A Unix socket that stands for a node: a packet is one read or write, or one ioctl."""

    def __init__(self, path: str) -> None:
        self._early: deque[bytes] = deque()
        """Packets that came while an answer was awaited."""
        self._peer = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._peer.settimeout(_CONNECT_TIMEOUT_S)
            self._peer.connect(path)
        except OSError:
            self._peer.close()
            raise

    def read(self, timeout_s: float) -> bytes | None:
        """One packet; an empty one is the end."""
        if self._early:
            return self._early.popleft()
        return self._receive(timeout_s)

    def write(self, events: bytes) -> None:
        """One packet."""
        self._peer.settimeout(_CALL_TIMEOUT_S)
        self._peer.send(events)

    def call(self, request: int, argument: bytes = b"") -> bytes:
        """Send the request and wait for its answer; events that come meanwhile are kept."""
        self.write(encode_call(Call(request, 0, argument.ljust(argument_bytes(request), b"\0"))))
        end_s = time.monotonic() + _CALL_TIMEOUT_S
        while (left_s := end_s - time.monotonic()) > 0.0:
            packet = self._receive(left_s)
            if packet is None:
                continue
            answer = None if len(packet) % EVENT_BYTES == 0 else decode_call(packet)
            if answer is None or isinstance(answer, Malformed) or answer.request != request:
                self._early.append(packet)
            elif answer.result < 0:
                raise OSError(-answer.result, os.strerror(-answer.result))
            else:
                return answer.argument
        raise OSError(errno.ETIMEDOUT, "it does not answer")

    def close(self) -> None:
        """Close the socket."""
        self._peer.close()

    def _receive(self, timeout_s: float) -> bytes | None:
        self._peer.settimeout(timeout_s)
        try:
            packet = self._peer.recv(READ_BYTES)
        except (TimeoutError, BlockingIOError):
            return None
        if not packet:
            raise OSError(errno.ENODEV, "unplugged")
        return packet


def open_socket(path: str, name: str) -> Link:
    """Connect to a simulated device called `name`. Raises DeviceAccessError."""
    if not hasattr(socket, "AF_UNIX"):
        raise DeviceAccessError("this system has no Unix sockets: use another transport")
    try:
        return SocketLink(path)
    except OSError as error:
        raise DeviceAccessError(
            f"cannot open {name} at {path}: {error.strerror or error}; "
            "is its simulated device running?"
        ) from None
