"""Serves a simulated serial device on a pseudo-terminal, with a link to it at a path of choice."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import os
import select
import selectors
import termios
import time
import tty
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from cardan import bounds
from cardan.errors import AddressError, OptionError
from cardan.options import check_options
from cardan.protocols.connexion_serial import SERIAL_MODELS, serial_model_by_key
from cardan.sim_peers.spacemouse.hand import Hand, Puck
from cardan.sim_peers.spacemouse.serial_core import simulated_serial_puck
from cardan.sim_peers.spacemouse.shell import HeldPuckPeer

WATCH_PERIOD_S = 0.01
"""How soon it shows that a host has opened the port: a pseudo-terminal does not tell."""
SCRIPT_DELAY_S = 1.0
"""From the host's start of the device to the script's: the host is to find the cap at rest."""
_READ_ROOM = 4096
_LOCK_ROOM = 4096


@dataclass(frozen=True, kw_only=True)
class SerialSpaceMousePeerOptions:
    """What to simulate and where."""

    link: str
    """The path of the serial port: a symbolic link to a pseudo-terminal."""
    model: str = "magellan"
    """Key of the model."""
    script: str = "demo"
    """A built-in script or a file."""
    keyboard: bool = False
    """The terminal's keys move the cap instead of the script."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by the names of `SERIAL_FAULTS`; times count from the start of the script."""
    jitter_lsb: Annotated[int, bounds.NOISE_COUNTS] = 1
    """Noise on every deflected axis, counts."""
    seed: int = 0
    """Of the noise and of the faults' choices."""
    start_on_connect: bool = True
    """The script starts `SCRIPT_DELAY_S` after a program has first started the device, not when the
    peer opens."""
    boot_s: Annotated[float, bounds.NOT_NEGATIVE] | None = None
    """From power, which the open port gives, to the first command that the device hears; None: as
    long as one of its kind takes."""

    def __post_init__(self) -> None:
        check_options(self)


class _WaitingHand:
    """A hand that does nothing before `begin_s`, and whose own time counts from there."""

    def __init__(self, hand: Hand) -> None:
        self._hand = hand
        self.begin_s = math.inf

    @property
    def next_due_s(self) -> float:
        """When `advance` has something to do next."""
        return self.begin_s + self._hand.next_due_s

    def advance(self, now_s: float, device: Puck) -> None:
        """Do to `device` what is due until `now_s`."""
        if now_s >= self.begin_s:
            own_s, due_s = now_s - self.begin_s, self._hand.next_due_s
            # The sum may be due while the difference, by its rounding, is not.
            self._hand.advance(max(own_s, due_s) if now_s >= self.next_due_s else own_s, device)


class SerialSpaceMousePeer(HeldPuckPeer):
    """A simulated serial device at a pseudo-terminal.

    A program that opens the port powers the device, closing it takes the power. Unplugging hangs
    the port up and removes the link; replugging brings both back. A locked file beside the link,
    its name with ".lock", tells a link in use from one that a killed peer left. Raises ScriptError
    for a model, script or fault that does not exist or does not fit.
    """

    def __init__(self, options: SerialSpaceMousePeerOptions) -> None:
        try:
            model = serial_model_by_key(options.model)
        except KeyError:
            allowed = f"one of {', '.join(model.key for model in SERIAL_MODELS)}"
            raise OptionError("model", options.model, allowed) from None
        self.options = options
        self.device = self.puck = simulated_serial_puck(
            model,
            faults=options.faults,
            jitter_lsb=options.jitter_lsb,
            seed=options.seed,
            boot_s=options.boot_s,
        )
        super().__init__(
            self.puck,
            script=options.script,
            keyboard=options.keyboard,
            faults=options.faults,
            start_on_connect=options.start_on_connect,
        )
        self._wait: _WaitingHand | None = None
        """The hand that still waits for a host."""
        if options.start_on_connect and not options.keyboard:
            self._hand = self._wait = _WaitingHand(self._hand)
            self.puck.faults_from_s = math.inf
        self._lock: int | None = None
        self._master: int | None = None
        self._port = ""
        self._waiting = False
        """The port is refused for now."""
        self._host = False
        """A program has the port open."""
        self._watch_s = 0.0
        self.lost_bytes = 0
        """Bytes that the host was too slow for."""

    @property
    def endpoint(self) -> str:
        """The path of the link."""
        return self.options.link

    def open(self) -> None:
        """Make the port and its link; take the terminal over. Raises a CardanError."""
        if self._lock is None:
            self._lock = _take_lock(self.options.link)
        super().open()

    def close(self) -> None:
        """Unplug the device for good, give the terminal back."""
        super().close()
        if self._lock is not None:
            with contextlib.suppress(OSError):
                os.unlink(_lock_path(self.options.link))
            os.close(self._lock)
            self._lock = None

    # -- the port ------------------------------------------------------------------------------

    @property
    def _there(self) -> bool:
        return self._master is not None or self._waiting

    def _appear(self) -> None:
        """Make the pseudo-terminal and its link. Raises AddressError."""
        link = self.options.link
        assert self._lock is not None
        _remove_stale(link, self._lock)
        self._waiting = time.monotonic() < self._opened_s + self._faults.get("refuse", 0.0)
        if self._waiting:
            return
        master, slave = os.openpty()
        port = os.ttyname(slave)
        # A line discipline would echo what the device says back to it.
        tty.setraw(slave)
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

    def _vanish(self) -> None:
        """Hang the port up and remove its link, if it is still ours."""
        self._waiting = False
        if self._master is None:
            return
        self._leave()
        with contextlib.suppress(OSError):
            if os.readlink(self.options.link) == self._port:
                os.unlink(self.options.link)
        os.close(self._master)
        self._master = None

    def _carrier_due_s(self) -> float:
        if self._waiting:
            return self._opened_s + self._faults["refuse"]
        return math.inf if self._host or self._master is None else self._watch_s

    def _attend(self, now_s: float) -> None:
        if self._waiting and now_s >= self._carrier_due_s():
            self._appear()
        if self._wait is not None and self.puck.host_began:
            self._wait.begin_s = self._device_s(now_s) + SCRIPT_DELAY_S
            self.puck.faults_from_s = self._wait.begin_s
            self._wait = None
        if self._master is not None and not self._host and now_s >= self._watch_s:
            self._watch_s = now_s + WATCH_PERIOD_S
            watch = select.poll()
            watch.register(self._master, select.POLLIN)
            if not any(events & select.POLLHUP for _, events in watch.poll(0)):
                self._meet()

    def _catch_up(self) -> None:
        """Bring the device to the present, even if it has nothing to do there."""
        now_s = time.monotonic()
        self._play(now_s)
        self._deliver(self.puck.reports(self._device_s(now_s)))

    def _meet(self) -> None:
        """A program has opened the port: the device has power."""
        assert self._selector is not None
        assert self._master is not None
        self._host = True
        self._begin()
        self._catch_up()
        if self._master is None:
            return
        self._selector.register(self._master, selectors.EVENT_READ, self._read)
        self.puck.power(True)

    def _leave(self) -> None:
        """The last program has closed the port: no more power, and nothing is kept for the next."""
        if not self._host:
            return
        assert self._selector is not None
        assert self._master is not None
        self._host = False
        self._selector.unregister(self._master)
        self.puck.power(False)
        with contextlib.suppress(termios.error):
            tty.setraw(self._master)
            termios.tcflush(self._master, termios.TCIOFLUSH)

    def _read(self) -> None:
        """The host has sent something, or is gone."""
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
        self._catch_up()
        if data and self._host:
            self.puck.receive(data)
        elif not data:
            self._leave()

    def _deliver(self, reports: Sequence[bytes]) -> None:
        for portion in reports:
            if self._master is None or not self._host:
                return
            sent = 0
            with contextlib.suppress(BlockingIOError):
                sent = os.write(self._master, portion)
            self.lost_bytes += len(portion) - sent


def _lock_path(link: str) -> str:
    return f"{link}.lock"


def _take_lock(link: str) -> int:
    """Lock the file beside `link`, which tells where the link leads. Raises AddressError."""
    path = _lock_path(link)
    while True:
        try:
            lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
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
        told = _port_in(lock)
        if told and not told.startswith("/dev/"):
            os.close(lock)
            raise AddressError(f"{path!r} exists and is no lock of a link; give another path")
        if os.fstat(lock).st_nlink:
            return lock
        os.close(lock)  # its owner has just removed it


def _port_in(lock: int) -> str:
    return os.fsdecode(os.pread(lock, _LOCK_ROOM, 0))


def _remove_stale(link: str, lock: int) -> None:
    """Remove a link that a peer left which is no more. Raises AddressError for anything else."""
    if not os.path.lexists(link):
        return
    if not os.path.islink(link):
        raise AddressError(f"{link!r} exists and is not a link; give another path")
    # What it leads to may be somebody else's terminal by now.
    if os.path.exists(link) and os.readlink(link) != _port_in(lock):
        raise AddressError(
            f"{link!r} leads to {os.readlink(link)}, and no simulated device made it; give "
            "another path"
        )
    with contextlib.suppress(FileNotFoundError):
        os.unlink(link)
