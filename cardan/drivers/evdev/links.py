"""Links to an input device's events: a node of /dev/input, or a socket in its place."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import sys
import time
from abc import ABC, abstractmethod
from collections import deque

from cardan.drivers.packet_socket import PacketSocket
from cardan.protocols.evdev.events import EVENT_BYTES, MalformedPacket
from cardan.protocols.evdev.requests import (
    BY_VALUE,
    EVIOCGID,
    IoctlCall,
    argument_bytes,
    decode_call,
    decode_int,
    encode_call,
)

if sys.platform != "win32":
    import fcntl

READ_BYTES = 64 * EVENT_BYTES
"""Size of every read, bytes: all events that the kernel keeps for a slow reader fit in."""

CALL_TIMEOUT_S = 0.5
"""Timeout of a simulated device's answers about its identity or values, s."""


class EvdevLink(ABC):
    """An open device. All methods but close() raise OSError once it is gone."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes | None:
        """Return waiting events, oldest first; None if none comes in time."""

    @abstractmethod
    def write(self, events: bytes) -> None:
        """Give the device events (EV_FF, EV_LED)."""

    @abstractmethod
    def call(self, request: int, argument: bytes = b"", timeout_s: float = CALL_TIMEOUT_S) -> bytes:
        """Make an ioctl request; return its argument as changed.

        Raises OSError if it is refused. Only a socket waits, for at most `timeout_s`.
        """

    @abstractmethod
    def answers(self, timeout_s: float) -> bool:
        """True if the device is seen to be present within `timeout_s`, while it sends no events."""

    @abstractmethod
    def close(self) -> None:
        """Release the device. Never raises."""


class NodeLink(EvdevLink):
    """A node of /dev/input."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def read(self, timeout_s: float) -> bytes | None:
        ready = self._poll.poll(1000.0 * timeout_s)
        if not ready:
            return None
        if not ready[0][1] & select.POLLIN:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        try:
            return os.read(self._fd, READ_BYTES)
        except BlockingIOError:  # another thread was faster, or the events were discarded
            return None

    def write(self, events: bytes) -> None:
        os.write(self._fd, events)

    def call(self, request: int, argument: bytes = b"", timeout_s: float = CALL_TIMEOUT_S) -> bytes:
        if request in BY_VALUE:
            fcntl.ioctl(self._fd, request, decode_int(argument))
            return argument
        buffer = bytearray(argument.ljust(argument_bytes(request), b"\0"))
        fcntl.ioctl(self._fd, request, buffer, True)
        return bytes(buffer)

    def answers(self, timeout_s: float) -> bool:
        """True: reading reveals a missing device, as far as the kernel knows."""
        return True

    def close(self) -> None:
        with contextlib.suppress(OSError):
            os.close(self._fd)


class EvdevSocketLink(PacketSocket, EvdevLink):
    """Unix socket in place of a node: a packet is one read or write, or one ioctl."""

    def __init__(self, path: str) -> None:
        self._early: deque[bytes] = deque()
        """Packets received while awaiting an answer."""
        self._owed: deque[int] = deque()
        """Requests whose calls have timed out, and whose answers may still come."""
        self._answered = False
        """True if an answer came since the last call of `answers`."""
        super().__init__(path)

    def read(self, timeout_s: float) -> bytes | None:
        if self._early:
            return self._early.popleft()
        end_s = time.monotonic() + timeout_s
        while True:
            packet = self.receive(max(0.0, end_s - time.monotonic()))
            if packet is None or not self._is_late(packet):
                return packet

    def write(self, events: bytes) -> None:
        self.send(events)

    def call(self, request: int, argument: bytes = b"", timeout_s: float = CALL_TIMEOUT_S) -> bytes:
        """Send the request and wait for its answer; events received meanwhile are kept."""
        end_s = time.monotonic() + timeout_s
        packet = encode_call(IoctlCall(request, 0, argument.ljust(argument_bytes(request), b"\0")))
        self.send(packet, timeout_s)
        while (left_s := end_s - time.monotonic()) > 0.0:
            answer = self.receive(left_s)
            if answer is None or self._is_late(answer):
                continue
            call = _call_in(answer)
            if call is None or call.request != request:
                self._early.append(answer)
            elif call.result < 0:
                raise OSError(-call.result, os.strerror(-call.result))
            else:
                return call.argument
        self._owed.append(request)
        raise OSError(errno.ETIMEDOUT, "it does not answer")

    def answers(self, timeout_s: float) -> bool:
        """True if the program behind the socket answers a request."""
        end_s = time.monotonic() + timeout_s
        if not self._answered and EVIOCGID not in self._owed:
            # A single request is enough: requests must not pile up at a program that hangs.
            try:
                self.send(encode_call(IoctlCall(EVIOCGID, 0, bytes(argument_bytes(EVIOCGID)))), 0.0)
            except (TimeoutError, BlockingIOError):
                return False
            self._owed.append(EVIOCGID)
        while not self._answered and (left_s := end_s - time.monotonic()) > 0.0:
            packet = self.receive(left_s)
            if packet is not None and not self._is_late(packet):
                self._early.append(packet)
                break
        answered, self._answered = self._answered, False
        return answered

    def _is_late(self, packet: bytes) -> bool:
        """True if `packet` answers a request whose call has timed out."""
        if not self._owed:
            return False
        call = _call_in(packet)
        if call is None or call.request not in self._owed:
            return False
        # Answers come in the order of the requests: earlier ones will not be answered.
        while self._owed.popleft() != call.request:
            pass
        self._answered = True
        return True


def _call_in(packet: bytes) -> IoctlCall | None:
    """Return the answer to a request that `packet` is; None if it is something else."""
    if len(packet) % EVENT_BYTES == 0:
        return None
    call = decode_call(packet)
    return None if isinstance(call, MalformedPacket) else call
