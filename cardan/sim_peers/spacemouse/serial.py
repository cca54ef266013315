"""Serves a simulated serial device on a pseudo-terminal, with a link to it at a path of choice."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import select
import selectors
import termios
import time
import tty
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from cardan.errors import AddressError, ScriptError
from cardan.protocols.connexion_serial import SERIAL_MODELS, serial_model_by_key
from cardan.sim_peers.spacemouse.serial_core import simulated_serial_puck
from cardan.sim_peers.spacemouse.shell import HandPeer

WATCH_PERIOD_S = 0.01
"""How soon it shows that a host has opened the port: a pseudo-terminal does not tell."""
_READ_ROOM = 4096


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
    jitter_lsb: int = 1
    """Noise on every deflected axis, counts."""
    seed: int = 0
    """Of the noise and of the faults' choices."""
    start_on_connect: bool = True
    """The script starts when a program first opens the port, not when the peer opens."""
    boot_s: float | None = None
    """From power, which the open port gives, to the first command that the device hears; None: as
    long as one of its kind takes."""


class SerialSpaceMousePeer(HandPeer):
    """A simulated serial device at a pseudo-terminal.

    A program that opens the port powers the device, closing it takes the power. Unplugging hangs
    the port up and removes the link; replugging brings both back. Raises ScriptError for a model,
    script or fault that does not exist or does not fit.
    """

    def __init__(self, options: SerialSpaceMousePeerOptions) -> None:
        try:
            model = serial_model_by_key(options.model)
        except KeyError:
            raise ScriptError(
                f"there is no serial model {options.model!r}; "
                f"there are: {', '.join(model.key for model in SERIAL_MODELS)}"
            ) from None
        if options.jitter_lsb < 0:
            raise ScriptError(f"jitter_lsb: {options.jitter_lsb} must not be below 0")
        if options.boot_s is not None and not 0.0 <= options.boot_s < math.inf:
            raise ScriptError(f"boot_s: {options.boot_s} must be a time in s, not below 0")
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

    # -- the port ------------------------------------------------------------------------------

    @property
    def _there(self) -> bool:
        return self._master is not None or self._waiting

    def _appear(self) -> None:
        """Make the pseudo-terminal and its link. Raises AddressError."""
        link = self.options.link
        _remove_stale(link)
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
        if self._master is not None and not self._host and now_s >= self._watch_s:
            self._watch_s = now_s + WATCH_PERIOD_S
            watch = select.poll()
            watch.register(self._master, select.POLLIN)
            if not any(events & select.POLLHUP for _, events in watch.poll(0)):
                self._meet()

    def _meet(self) -> None:
        """A program has opened the port: the device has power."""
        assert self._selector is not None
        assert self._master is not None
        self._host = True
        self._begin()
        self._play(time.monotonic())
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
        self._play(time.monotonic())
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


def _remove_stale(link: str) -> None:
    """Remove a link to a port that is no more. Raises AddressError for anything else."""
    if not os.path.lexists(link):
        return
    if not os.path.islink(link):
        raise AddressError(f"{link!r} exists and is not a link; give another path")
    if os.path.exists(link):
        raise AddressError(
            f"{link!r} leads to {os.readlink(link)}: another simulated device is there, or a real "
            "one; give another path"
        )
    with contextlib.suppress(FileNotFoundError):
        os.unlink(link)
