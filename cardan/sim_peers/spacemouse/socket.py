"""Serves a simulated 3Dconnexion device on a Unix socket: one raw HID report is one packet."""

from __future__ import annotations

import contextlib
import errno
import logging
import math
import os
import selectors
import socket
import stat
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from cardan.errors import AddressError, ScriptError
from cardan.protocols.connexion import MODELS, model_by_key
from cardan.sim_peers.base import SimulatedPeer, load_script
from cardan.sim_peers.spacemouse.core import ONE_PERIOD_S, SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.hand import SCRIPT_VERBS, SCRIPTS, Hand, ScriptedHand, play
from cardan.sim_peers.spacemouse.keyboard import (
    KEYBOARD_HELP,
    KeyboardHand,
    Terminal,
    status_line,
)

QUEUE_REPORTS = 64
"""Reports kept for a client that does not read: what Linux keeps for a hidraw node."""
MAX_CLIENTS = 8
"""Programs that may have the device open at once."""
STALL_S = ONE_PERIOD_S
"""Motion older than this when the peer comes to run is left out: a late peer makes no burst."""
STATUS_PERIOD_S = 0.1
"""How often the line for the person at the keyboard is drawn."""
_REPORT_ROOM = 4096
_SMALLEST_BUFFER = 1
"""Makes the kernel keep as little as it can (about six reports), so that QUEUE_REPORTS counts."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SpaceMousePeerOptions:
    """What to simulate and where."""

    path: str
    """The socket to create (AF_UNIX, SOCK_SEQPACKET)."""
    model: str = "spacenavigator"
    """Key of the model."""
    script: str = "demo"
    """A built-in script or a file."""
    keyboard: bool = False
    """The terminal's keys move the puck instead of the script."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by the names of `FAULTS`; times count from the start of the script."""
    jitter_lsb: int = 1
    """Noise on every axis while deflected, counts."""
    seed: int = 0
    """Of the noise and of the faults' choices."""
    start_on_connect: bool = True
    """The script starts when the first client connects, not when the peer opens."""


class _Client:
    """One program that has the device open."""

    def __init__(self, sock: socket.socket, *, keep_oldest: bool) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SMALLEST_BUFFER)
        self.sock = sock
        self.lost = 0
        self._keep_oldest = keep_oldest
        self._queue: deque[bytes] = deque()

    @property
    def waiting(self) -> bool:
        return bool(self._queue)

    def send(self, report: bytes) -> None:
        """Queue a report; a full queue loses one."""
        if len(self._queue) == QUEUE_REPORTS:
            self.lost += 1
            if self._keep_oldest:
                return
            self._queue.popleft()
        self._queue.append(report)

    def flush(self) -> None:
        """Pass on what the client has room for. Raises OSError when it is gone."""
        with contextlib.suppress(BlockingIOError):
            while self._queue:
                self.sock.send(self._queue[0])
                self._queue.popleft()


class SpaceMousePeer(SimulatedPeer):
    """A simulated device at a socket path, for any number of programs up to `MAX_CLIENTS`.

    All get all reports. Unplugging closes them and removes the socket; replugging brings it back.
    Raises ScriptError for a model, script or fault that does not exist or does not fit.
    """

    def __init__(self, options: SpaceMousePeerOptions) -> None:
        try:
            model = model_by_key(options.model)
        except KeyError:
            raise ScriptError(
                f"there is no model {options.model!r}; "
                f"there are: {', '.join(model.key for model in MODELS)}"
            ) from None
        if options.jitter_lsb < 0:
            raise ScriptError(f"jitter_lsb: {options.jitter_lsb} must not be below 0")
        self.options = options
        self.device = SimulatedSpaceMouse(
            model, faults=options.faults, jitter_lsb=options.jitter_lsb, seed=options.seed
        )
        self._keys: KeyboardHand | None = None
        self._terminal: Terminal | None = None
        self._hand: Hand
        if options.keyboard:
            self._hand = self._keys = KeyboardHand()
            self._terminal = Terminal()
        else:
            self._hand = ScriptedHand(load_script(options.script, SCRIPTS, SCRIPT_VERBS), model)
        self._selector: selectors.BaseSelector | None = None
        self._listener: socket.socket | None = None
        self._identity: tuple[int, int] | None = None
        self._clients: list[_Client] = []
        self._lost_of_gone = 0
        self._opened_s = 0.0
        self._listens_s = 0.0
        self._start_s: float | None = None
        self._played_s = 0.0
        self._led = True
        self._status = ""
        self._status_due_s = math.inf

    @property
    def endpoint(self) -> str:
        """The socket's path."""
        return self.options.path

    @property
    def lost_reports(self) -> int:
        """Reports that clients were too slow for."""
        return self._lost_of_gone + sum(client.lost for client in self._clients)

    def open(self) -> None:
        """Create the socket, AddressError when that cannot be; take the terminal over."""
        if self._selector is not None:
            return
        self._opened_s = time.monotonic()
        self._listens_s = self._opened_s + self.options.faults.get("refuse", 0.0)
        self._selector = selectors.DefaultSelector()
        try:
            self._appear()
            if self._terminal is not None:
                self._terminal.open()
                self._selector.register(self._terminal.fd, selectors.EVENT_READ, self._read_keys)
                print(KEYBOARD_HELP)
                self._status_due_s = self._opened_s
        except BaseException:
            self.close()
            raise
        if self._terminal is not None or not self.options.start_on_connect:
            self._start_s = self._opened_s

    def step(self, until_s: float) -> None:
        """Serve until the monotonic time `until_s`."""
        assert self._selector is not None, "step() before open()"
        while True:
            now_s = time.monotonic()
            self._play(now_s)
            self._show(now_s)
            if now_s >= until_s:
                return
            due_s = min(until_s, self._next_due_s(now_s))
            for key, _ in self._selector.select(max(0.0, due_s - now_s)):
                handle: Callable[[], None] = key.data
                handle()

    def close(self) -> None:
        """Close every connection, remove the socket, give the terminal back."""
        if self._selector is None:
            return
        self._vanish()
        if self._terminal is not None:
            self._terminal.close()
        self._selector.close()
        self._selector = None
        self._start_s = None

    # -- time ----------------------------------------------------------------------------------

    def _device_s(self, now_s: float) -> float:
        return 0.0 if self._start_s is None else now_s - self._start_s

    def _next_due_s(self, now_s: float) -> float:
        refusing = self._listener is not None and not self._listening
        due_s = min(self._status_due_s, self._listens_s if refusing else math.inf)
        if self._start_s is not None:
            next_s = min(self.device.next_due_s, self._hand.next_due_s)
            due_s = min(due_s, self._start_s + next_s)
        return due_s

    def _play(self, now_s: float) -> None:
        if not self._listening and self._listener is not None and now_s >= self._listens_s:
            self._listen()
        if self._start_s is None:
            return
        device_s = now_s - self._start_s
        if device_s - self._played_s > STALL_S:
            resumed_s = device_s - STALL_S
            self._hand.advance(resumed_s, self.device)
            self.device.skip_to(resumed_s)
        self._played_s = device_s
        reports = play(self.device, self._hand, device_s)
        if reports:
            for client in tuple(self._clients):
                for report in reports:
                    client.send(report)
                self._flush(client)
        if self.device.plugged != (self._listener is not None):
            if self.device.plugged:
                self._appear()
            else:
                self._vanish()
        if self.device.led != self._led:
            self._led = self.device.led
            _log.info("LED %s", "on" if self._led else "off")

    # -- the socket ----------------------------------------------------------------------------

    def _appear(self) -> None:
        """Create the socket; it can be connected to unless the device refuses to be opened."""
        path = self.options.path
        _remove_stale(path)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            listener.setblocking(False)
            listener.bind(path)
            info = os.stat(path)
        except OSError as error:
            listener.close()
            raise AddressError(
                f"cannot create the socket {path!r}: {error.strerror or error}; "
                f"give a short path in a directory that can be written"
            ) from None
        self._identity = (info.st_dev, info.st_ino)
        self._listener = listener
        if time.monotonic() >= self._listens_s:
            self._listen()

    @property
    def _listening(self) -> bool:
        return (
            self._listener is not None
            and self._selector is not None
            and self._listener in self._selector.get_map()
        )

    def _listen(self) -> None:
        assert self._listener is not None
        assert self._selector is not None
        self._listener.listen(MAX_CLIENTS)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def _vanish(self) -> None:
        """Close every connection and remove the socket, if it is still ours."""
        for client in tuple(self._clients):
            self._drop(client)
        if self._listener is None:
            return
        if self._listening:
            assert self._selector is not None
            self._selector.unregister(self._listener)
        self._listener.close()
        self._listener = None
        with contextlib.suppress(OSError):
            info = os.stat(self.options.path)
            if (info.st_dev, info.st_ino) == self._identity:
                os.unlink(self.options.path)

    def _accept(self) -> None:
        if self._listener is None or self._selector is None:
            return
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return
        if len(self._clients) == MAX_CLIENTS or _hung_up(sock):
            sock.close()
            return
        client = _Client(sock, keep_oldest=bool(self.options.faults.get("newest-lost")))
        self._clients.append(client)
        self._selector.register(sock, selectors.EVENT_READ, lambda: self._serve(client))
        if self._start_s is None:
            self._start_s = time.monotonic()

    def _serve(self, client: _Client) -> None:
        """The client wrote, has room again, or is gone."""
        if client not in self._clients:
            return
        try:
            report = client.sock.recv(_REPORT_ROOM)
        except BlockingIOError:
            self._flush(client)
            return
        except OSError:
            report = b""
        if report:
            self.device.output(report, self._device_s(time.monotonic()))
            self._flush(client)
        else:
            self._drop(client)

    def _flush(self, client: _Client) -> None:
        assert self._selector is not None
        try:
            client.flush()
        except OSError:
            self._drop(client)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        key = self._selector.get_key(client.sock)
        if key.events != wanted:
            self._selector.modify(client.sock, wanted, key.data)

    def _drop(self, client: _Client) -> None:
        if self._selector is not None:
            self._selector.unregister(client.sock)
        client.sock.close()
        self._clients.remove(client)
        self._lost_of_gone += client.lost

    # -- the keyboard --------------------------------------------------------------------------

    def _read_keys(self) -> None:
        assert self._selector is not None
        assert self._terminal is not None
        assert self._keys is not None
        text = self._terminal.read()
        if text:
            now_s = time.monotonic()
            self._play(now_s)
            self._keys.feed(text, self._device_s(now_s))
        else:
            self._selector.unregister(self._terminal.fd)

    def _show(self, now_s: float) -> None:
        if now_s < self._status_due_s:
            return
        self._status_due_s = now_s + STATUS_PERIOD_S
        status = status_line(self.device)
        if status != self._status:
            self._status = status
            sys.stdout.write(f"\r{status}\x1b[K")
            sys.stdout.flush()


def _hung_up(sock: socket.socket) -> bool:
    """True when whoever connected only looked whether somebody listens (as `_remove_stale`)."""
    try:
        return not sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False
    except OSError:
        return True


def _remove_stale(path: str) -> None:
    """Remove a socket file that nobody listens on. Raises AddressError for anything else."""
    try:
        if not stat.S_ISSOCK(os.lstat(path).st_mode):
            raise AddressError(f"{path!r} exists and is not a socket; give another path")
    except FileNotFoundError:
        return
    except OSError as error:
        raise AddressError(f"cannot use {path!r}: {error.strerror}") from None
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        try:
            result = probe.connect_ex(path)
        except OSError as error:
            raise AddressError(f"cannot use {path!r}: {error}") from None
    if result == errno.ECONNREFUSED:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
    elif result != errno.ENOENT:
        how = os.strerror(result) if result else "it answers"
        raise AddressError(f"another program serves {path!r} ({how}); end it or give another path")
