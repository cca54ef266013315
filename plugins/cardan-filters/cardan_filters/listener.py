"""Reads a sensor's datagrams from a socket in the control tick, without waiting."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Final, NamedTuple

from cardan.common import bounds
from cardan.common.options import Options, require
from cardan.common.sockets import Advice, UnixSocket, make_runtime_folder, opened, runtime_path
from cardan.types import NEVER_S
from cardan_filters.readings import MAX_DATAGRAM_BYTES, Malformed

MAX_PER_TICK = 8
"""Most datagrams read in a tick, 2000 a second at 250 Hz: bounds the work in a flood."""

HERE: Final = "127.0.0.1"

_CREDENTIALS = struct.Struct("=iII")
"""Linux's struct ucred: process, user, group."""
_ANCILLARY_BYTES = socket.CMSG_SPACE(_CREDENTIALS.size) if hasattr(socket, "CMSG_SPACE") else 0
_ADVICE = Advice(served="does another filter or program listen there? Give another socket")


class Sender(NamedTuple):
    """Sender of a datagram: a process by its number, or an address and port."""

    host: str = ""
    """IP address; empty: a process of this computer, by its Unix socket."""
    number: int = 0

    def __str__(self) -> str:
        if self.host:
            return f"{self.host}:{self.number}"
        return f"process {self.number}" if self.number else "a process"


SOMEBODY: Final = Sender()
"""Sender whose process the system does not name."""


@dataclass(frozen=True, kw_only=True)
class ListenerOptions(Options):
    """Socket at which a filter listens for its sensor: a Unix socket or a UDP port."""

    socket: Annotated[str, bounds.SOCKET_PATH, bounds.MEETING] | None = None
    """Path of the Unix socket, which only programs of the same user can write to; without it and
    without `port`, a socket with the filter's name in the user's runtime folder."""
    port: Annotated[int, bounds.PORT] | None = None
    """UDP port to listen on instead; any program that reaches it is accepted."""
    host: Annotated[str, bounds.IPV4] = HERE
    """Address of the UDP port."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.port is None:
            require(self.host == HERE, "host", self.host, "left out, or given with a UDP port")
        else:
            require(self.socket is None, "socket", self.socket, "left out where port is given")

    def place(self, name: str) -> str | tuple[str, int]:
        """Return the path of the socket, or the address of the UDP port, of the filter `name`."""
        if self.port is not None:
            return self.host, self.port
        return self.socket or runtime_path(f"cardan-{name}.sock")


def shown_place(place: str | tuple[str, int]) -> str:
    """Describe a listener's address."""
    return place if isinstance(place, str) else f"UDP {place[0]}:{place[1]}"


class DatagramListener:
    """Reader of waiting datagrams, each with its sender and a time of reception that is never too
    late. If this computer stalls, a tick may read a datagram long after it arrived. Therefore a
    datagram counts as received when the queue was last seen empty: never later than it was, and
    earlier by no more than a tick. Datagrams of a flood that is never read to its end become stale.
    """

    def __init__(
        self,
        place: str | tuple[str, int],
        take: Callable[[bytes, float, Sender], Malformed | None],
    ) -> None:
        self.place = place
        """Address: the path of a Unix socket, or IP address and UDP port; for port 0 the assigned
        one, once open."""
        self.heard = 0
        """Number of usable datagrams."""
        self.malformed = 0
        self.malformed_reason = ""
        """Fault of the last malformed datagram."""
        self._take = take
        self._bound: UnixSocket | None = None
        self._socket: socket.socket | None = None
        self._empty_s = NEVER_S

    @property
    def is_open(self) -> bool:
        """True between open() and close()."""
        return self._socket is not None

    def open(self) -> None:
        """Listen. Raises AddressError if that is impossible; may be called repeatedly."""
        if self._socket is not None:
            return
        place = self.place
        if isinstance(place, str):
            if os.path.dirname(place) == os.path.dirname(runtime_path("")):
                make_runtime_folder()
            self._bound = UnixSocket(place, socket.SOCK_DGRAM, advice=_ADVICE)
            self._socket = self._bound.sock
            with contextlib.suppress(AttributeError, OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        else:
            host, port = place
            self._socket = opened(
                host,
                port,
                socket.SOCK_DGRAM,
                socket.socket.bind,
                lambda error: (
                    f"cannot listen for a sensor on {host}:{port}: {error.strerror}; does another "
                    "filter or program have this port?"
                ),
            )
            self.place = self._socket.getsockname()
        self._empty_s = NEVER_S

    def close(self) -> None:
        """Stop listening; may be called repeatedly."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._bound is not None:
            self._bound.close()
            self._bound = None

    def drain(self, now_s: float) -> None:
        """Process waiting datagrams, oldest first, at most MAX_PER_TICK. Never waits or raises."""
        if self._socket is None:
            return
        with contextlib.suppress(OSError):  # Mostly BlockingIOError: the queue is empty.
            for _ in range(MAX_PER_TICK):
                data, more, _flags, address = self._socket.recvmsg(
                    MAX_DATAGRAM_BYTES + 1, _ANCILLARY_BYTES if self._bound else 0
                )
                self.take(data, self._empty_s, _sender(more, address))
            return
        self._empty_s = now_s

    def take(self, data: bytes, received_s: float, sender: Sender = SOMEBODY) -> None:
        """Process a datagram of `sender`, received at `received_s`, local monotonic time."""
        wrong = self._take(data, received_s, sender)
        if wrong is None:
            self.heard += 1
        else:
            self.malformed += 1
            self.malformed_reason = wrong.reason

    def diagnosis(self, sensor: str) -> tuple[str, ...]:
        """Return the faults of the datagrams of `sensor`."""
        found = []
        if self.is_open and not self.heard:
            found.append(f"nothing was received from the {sensor} on {shown_place(self.place)} yet")
        if self.malformed:
            found.append(
                f"{self.malformed} datagrams from the {sensor} are malformed, the last one "
                f"because {self.malformed_reason}"
            )
        return tuple(found)


def _sender(ancillary: list[tuple[int, int, bytes]], address: Any) -> Sender:
    """Return the sender of a datagram: the process from the kernel, or address and port."""
    if isinstance(address, tuple):
        return Sender(*address[:2])
    for _level, _kind, data in ancillary:
        if len(data) >= _CREDENTIALS.size:
            return Sender("", _CREDENTIALS.unpack_from(data)[0])
    return SOMEBODY
