"""The sockets that programs open, sans I/O.

A shell (`cardan.sim_peers.ur_controller.connector`, or a test) takes the requests of programs from
`ProgramSockets`, and passes it the events of the real sockets.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Collection
from typing import Final, NamedTuple

MOST_SOCKETS: Final = 32
MOST_BYTES: Final = 64 * 1024
"""Most bytes of one socket that wait to be read by its program or sent."""


class Opening(NamedTuple):
    """Connection requested by a program."""

    number: int
    host: str
    port: int


class ProgramSocket:
    """Socket of a program, with a unique number."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.open: bool | None = None
        """None: it is being opened."""
        self.unread = bytearray()
        self.unsent = bytearray()


class ProgramSockets:
    """Sockets of the running program, by name."""

    def __init__(
        self, allowed: Collection[str], note: Callable[[str], None], closed: bool = False
    ) -> None:
        """`allowed`: hosts besides this computer. `closed`: none is opened."""
        self._closed = closed
        self._allowed = allowed
        self._note = note
        self._count = 0
        self._named: dict[str, ProgramSocket] = {}
        self._numbered: dict[int, ProgramSocket] = {}
        self._openings: list[Opening] = []
        self._closings: list[int] = []

    # -- called by programs -----------------------------------------------------------------------

    def open(self, host: str, port: int, name: str) -> ProgramSocket | None:
        """Return a socket that is being opened; None if it is refused."""
        self.close(name)
        if not (is_this_computer(host) or host in self._allowed):
            self._note(f"socket {name}: {host} is refused, it needs --allow-connect {host}")
            return None
        if self._closed:
            self._note(f"fault: socket {name} is not opened")
            return None
        if len(self._named) >= MOST_SOCKETS:
            self._note(f"socket {name}: there are {MOST_SOCKETS} already")
            return None
        self._count += 1
        made = ProgramSocket(self._count)
        self._named[name] = self._numbered[made.number] = made
        self._openings.append(Opening(made.number, host, port))
        return made

    def get(self, name: str) -> ProgramSocket | None:
        """Return an open socket, or one with unread bytes."""
        found = self._named.get(name)
        return None if found is None or found.open is None else found

    def close(self, name: str) -> None:
        """Close a socket, if there is one; data sent before is still written."""
        found = self._named.pop(name, None)
        if found is not None and self._numbered.get(found.number) is found:
            self._closings.append(found.number)

    def close_all(self) -> None:
        """Close all sockets at the end of a program."""
        for name in tuple(self._named):
            self.close(name)

    def send(self, name: str, data: bytes) -> bool:
        """Queue data; return False if it is refused."""
        found = self.get(name)
        if found is None or not found.open or len(found.unsent) + len(data) > MOST_BYTES:
            return False
        found.unsent += data
        return True

    # -- called by the shell ----------------------------------------------------------------------

    def openings(self) -> list[Opening]:
        """Return the connections to make; each is returned once."""
        found, self._openings = self._openings, []
        return found

    def outgoing(self) -> list[tuple[int, bytes]]:
        """Return the data to write, by the number of the socket; each is returned once."""
        found = []
        for each in self._numbered.values():
            if each.unsent:
                found.append((each.number, bytes(each.unsent)))
                each.unsent.clear()
        return found

    def closings(self) -> list[int]:
        """Return the sockets to close after `outgoing` was written; each is returned once."""
        found, self._closings = self._closings, []
        for number in found:
            self._numbered.pop(number, None)
        return found

    def takes(self, number: int) -> bool:
        """Return True if there is room for received data."""
        found = self._numbered.get(number)
        return found is not None and len(found.unread) < MOST_BYTES

    def opened(self, number: int) -> None:
        """Mark a socket as connected."""
        found = self._numbered.get(number)
        if found is not None:
            found.open = True

    def data(self, number: int, data: bytes) -> None:
        """Handle the data of one read."""
        found = self._numbered.get(number)
        if found is not None:
            found.unread += data

    def lost(self, number: int, reason: str) -> None:
        """Drop a socket that could not be opened, or was closed by the other end."""
        found = self._numbered.pop(number, None)
        if found is not None:
            if not found.open:
                self._note(f"a socket could not be opened: {reason}")
            found.open = False


def is_this_computer(host: str) -> bool:
    """Return True for a loopback address, or its name."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
