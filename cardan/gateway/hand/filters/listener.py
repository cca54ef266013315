"""Reads a sensor's datagrams from a UDP port in the control tick, without waiting."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable

from cardan.errors import AddressError
from cardan.gateway.hand.filters.readings import MAX_DATAGRAM_BYTES, Malformed
from cardan.types import NEVER_S

MAX_PER_TICK = 8
"""Datagrams read in one tick, 2000 a second at 250 Hz: bounds the work that a flood makes."""


class DatagramListener:
    """Passes on each waiting datagram, with a time of reception that is never too late.

    The tick that reads a datagram may come long after it arrived, when this computer stalled. So a
    datagram counts as received when the queue was last seen empty: never later than it was, and
    earlier by no more than a tick. Datagrams of a flood that is never read to its end grow stale.
    """

    def __init__(
        self, host: str, port: int, take: Callable[[bytes, float], Malformed | None]
    ) -> None:
        self.address = (host, port)
        """Where it listens; with port 0 the port that it got, once open."""
        self.heard = 0
        """Datagrams that could be used."""
        self.malformed = 0
        self.malformed_reason = ""
        """What was wrong with the last malformed one."""
        self._take = take
        self._socket: socket.socket | None = None
        self._empty_s = NEVER_S

    @property
    def is_open(self) -> bool:
        """True between open() and close()."""
        return self._socket is not None

    def open(self) -> None:
        """Listen. Raises AddressError when the port cannot be had; opening twice is fine."""
        if self._socket is not None:
            return
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            opened.bind(self.address)
        except OSError as error:
            opened.close()
            host, port = self.address
            raise AddressError(
                f"cannot listen for a sensor on {host}:{port}: {error.strerror}; does another "
                "filter or program have this port?"
            ) from None
        self.address = opened.getsockname()
        self._socket, self._empty_s = opened, NEVER_S

    def close(self) -> None:
        """Stop listening; closing twice is fine."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def drain(self, now_s: float) -> None:
        """Take what has arrived, oldest first, at most MAX_PER_TICK. Never waits or raises."""
        if self._socket is None:
            return
        with contextlib.suppress(OSError):  # BlockingIOError above all: the queue is empty.
            for _ in range(MAX_PER_TICK):
                data = self._socket.recv(MAX_DATAGRAM_BYTES + 1)
                self.take(data, self._empty_s)
            return
        self._empty_s = now_s

    def take(self, data: bytes, received_s: float) -> None:
        """Take one datagram received at `received_s`, local monotonic time."""
        wrong = self._take(data, received_s)
        if wrong is None:
            self.heard += 1
        else:
            self.malformed += 1
            self.malformed_reason = wrong.reason

    def diagnosis(self, sensor: str) -> tuple[str, ...]:
        """What is wrong with the datagrams of `sensor`."""
        found = []
        host, port = self.address
        if self.is_open and not self.heard:
            found.append(f"nothing was heard from the {sensor} on {host}:{port} yet")
        if self.malformed:
            found.append(
                f"{self.malformed} datagrams from the {sensor} are malformed, the last one "
                f"because {self.malformed_reason}"
            )
        return tuple(found)
