"""Serial port of a simulated device: a pseudo-terminal and a link to it."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import os
import select
import selectors
import termios
import tty
from collections.abc import Sequence
from typing import Protocol

from cardan.common.sockets import OWNER_ONLY
from cardan.errors import AddressError
from cardan.sim_peers.backends.base import DeviceBackend, Shell

WATCH_PERIOD_S = 0.01
"""Period of checks whether a host has opened the port: a pseudo-terminal does not report it."""
_READ_ROOM = 4096
_LOCK_ROOM = 4096


class SerialDevice(Protocol):
    """A simulated device that a serial port powers (RTS and DTR)."""

    def power(self, on: bool) -> None:
        """Switch the power: the host has opened the port, or closed it."""

    def receive(self, data: bytes) -> None:
        """Receive bytes from the host."""


class PseudoTerminal(DeviceBackend[bytes]):
    """A serial port at the path `link`: a program that opens it powers the device.

    Unplugging hangs the port up and removes the link; replugging brings both back. A locked file
    beside the link, named with ".lock", distinguishes a link in use from that of a killed peer.
    `device` gets power and the data that programs write; None: a self-powered device without input.
    `mode` names the users who may open the port.
    """

    def __init__(
        self, link: str, device: SerialDevice | None = None, mode: int = OWNER_ONLY
    ) -> None:
        self._link = link
        self._mode = mode
        self._device = device
        self._lock: int | None = None
        self._master: int | None = None
        self._port = ""
        self._host = False
        """A program has the port open."""
        self._watch_s = 0.0
        self.lost_bytes = 0
        """Bytes dropped because the host was too slow."""

    @property
    def endpoint(self) -> str:
        """The path of the link."""
        return self._link

    @property
    def there(self) -> bool:
        """True if the port exists."""
        return self._master is not None

    def open(self, shell: Shell) -> None:
        """Take the link's path. Raises AddressError."""
        super().open(shell)
        self._lock = _take_lock(self._link)
        _remove_stale(self._link, self._lock)

    def appear(self) -> None:
        """Make the pseudo-terminal and its link. Raises AddressError."""
        link = self._link
        assert self._lock is not None
        _remove_stale(link, self._lock)
        master, slave = os.openpty()
        port = os.ttyname(slave)
        # A line discipline would echo the device's reports back to it.
        tty.setraw(slave)
        os.fchmod(slave, self._mode)  # The default mode allows its group to write.
        os.close(slave)
        os.set_blocking(master, False)
        try:
            os.ftruncate(self._lock, 0)
            os.pwrite(self._lock, os.fsencode(port), 0)
            os.symlink(port, link)
        except OSError as error:
            os.close(master)
            raise AddressError(
                f"cannot create the link {link!r}: {error.strerror}; give a path in a directory "
                "that can be written"
            ) from None
        self._master, self._port = master, port
        self._host = False
        self._watch_s = 0.0

    def vanish(self) -> None:
        """Hang up the port and remove its link, if this peer still owns it."""
        if self._master is None:
            return
        self._leave()
        with contextlib.suppress(OSError):
            if os.readlink(self._link) == self._port:
                os.unlink(self._link)
        os.close(self._master)
        self._master = None

    def close(self) -> None:
        """Hang up permanently and release the link's path."""
        self.vanish()
        if self._lock is not None:
            with contextlib.suppress(OSError):
                os.unlink(_lock_path(self._link))
            os.close(self._lock)
            self._lock = None

    def send(self, messages: Sequence[bytes]) -> None:
        """Write to the host, as much as it has room for."""
        for portion in messages:
            if self._master is None or not self._host:
                return
            sent = 0
            with contextlib.suppress(BlockingIOError):
                sent = os.write(self._master, portion)
            self.lost_bytes += len(portion) - sent

    @property
    def due_s(self) -> float:
        """Monotonic time of the next check for a host, s."""
        return math.inf if self._host or self._master is None else self._watch_s

    def run_due(self, now_s: float) -> None:
        """Check whether a host has opened the port."""
        if self._master is not None and not self._host and now_s >= self._watch_s:
            self._watch_s = now_s + WATCH_PERIOD_S
            watch = select.poll()
            watch.register(self._master, select.POLLIN)
            if not any(events & select.POLLHUP for _, events in watch.poll(0)):
                self._meet()

    def _meet(self) -> None:
        """Power the device: a program has opened the port."""
        self._host = True
        self.shell.begin()
        self.shell.catch_up()
        if self._master is None:
            return
        self.shell.selector.register(self._master, selectors.EVENT_READ, self._read)
        if self._device is not None:
            self._device.power(True)

    def _leave(self) -> None:
        """Cut the power and drop all data: the last program has closed the port."""
        if not self._host:
            return
        assert self._master is not None
        self._host = False
        with contextlib.suppress(KeyError):  # The port closed while the device was powered.
            self.shell.selector.unregister(self._master)
        if self._device is not None:
            self._device.power(False)
        with contextlib.suppress(termios.error):
            tty.setraw(self._master)
            termios.tcflush(self._master, termios.TCIOFLUSH)

    def _read(self) -> None:
        """Take the host's data, or notice that it is gone."""
        if self._master is None or not self._host:
            return
        try:
            data = os.read(self._master, _READ_ROOM)
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            data = b""
        self.shell.catch_up()
        if data and self._host and self._device is not None:
            self._device.receive(data)
        elif not data:
            self._leave()


def _lock_path(link: str) -> str:
    return f"{link}.lock"


def _take_lock(link: str) -> int:
    """Lock the file beside `link`, which records the link's target. Raises AddressError."""
    path = _lock_path(link)
    while True:
        try:
            lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, OWNER_ONLY)
        except OSError as error:
            raise AddressError(
                f"cannot create the link {link!r} and {path!r}: {error.strerror}; give a path in "
                "a directory that can be written"
            ) from None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            raise AddressError(
                f"{link!r}: another simulated device is there; give another path"
            ) from None
        port = _port_in(lock)
        if port and not port.startswith("/dev/"):
            os.close(lock)
            raise AddressError(f"{path!r} exists and is not the lock of a link; give another path")
        if os.fstat(lock).st_nlink:
            return lock
        os.close(lock)  # The owner has just removed it.


def _port_in(lock: int) -> str:
    return os.fsdecode(os.pread(lock, _LOCK_ROOM, 0))


def _remove_stale(link: str, lock: int) -> None:
    """Remove a link that an ended peer left. Raises AddressError for anything else."""
    if not os.path.lexists(link):
        return
    if not os.path.islink(link):
        raise AddressError(f"{link!r} exists and is not a link; give another path")
    # It may point to another program's terminal by now.
    if os.path.exists(link) and os.readlink(link) != _port_in(lock):
        raise AddressError(
            f"{link!r} leads to {os.readlink(link)}, and no simulated device made it; give "
            "another path"
        )
    with contextlib.suppress(FileNotFoundError):
        os.unlink(link)
