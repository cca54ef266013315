"""spacenavd driver: a thread that reads the daemon's socket and feeds the core."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import threading
import time
from typing import Any, ClassVar

from cardan.common.sockets import UntrustedServerError, absence, connected, hang_up
from cardan.drivers.base import FoundDevice
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.simulated import OWN
from cardan.drivers.spnav.core import SpnavCore
from cardan.drivers.spnav.options import SpnavOptions
from cardan.errors import DeviceAccessError, DeviceNotFoundError, DriverError
from cardan.protocols.spnav.codes import DEFAULT_SOCKET, LedMode
from cardan.types import DeviceCapabilities, DeviceFeedback, DeviceLink

SOCKET_VARIABLE = "SPNAV_SOCKET"
"""Environment variable with the socket's path, as libspnav reads it."""

READ_TIMEOUT_S = 0.02
"""Longest wait for data; meanwhile the reader serves the LED and checks for its end."""

AGREE_TIMEOUT_S = 1.0
"""Longest wait of open() for the protocol's version and the first answers."""

_CONNECT_TIMEOUT_S = 1.0
_CLOSE_TIMEOUT_S = 0.1
_ROOM_BYTES = 1 << 18
"""Size of a read: more than a socket buffers by default, so each read reaches the newest record."""


class Spnav(ReadDevice[SpnavCore]):
    """A spacenavd socket as an operator device, whichever six-axis device the daemon has.

    Its axes are LIVE only after a motion of zero was seen; see :mod:`.core` for the rules.
    """

    Options: ClassVar[type[SpnavOptions]] = SpnavOptions
    summary = "a running spacenavd"
    page = "spacemouse.md"
    peer = "spacemouse"
    simulated = ({"socket": OWN},)
    gives = "six deflections, buttons"
    takes_back = "light"
    suits = "rate, base frame"
    options: SpnavOptions
    _kind = "spacenavd socket"

    def __init__(self, options: SpnavOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = SpnavCore(self.options)
        self._socket: socket.socket | None = None
        self._led_wanted: bool | None = None

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Return the daemon's socket, if it exists, with the daemon's description."""
        path = socket_path("")
        if not os.path.exists(path):
            return []
        device = cls(SpnavOptions())
        obstacle = ""
        try:
            device._connect()
        except DriverError as error:
            obstacle = str(error)
        device._release()
        state = device._core.state(time.monotonic())
        if not obstacle and state.link is DeviceLink.LOST:
            obstacle = state.reason
        name = "spacenavd"
        if device._core.is_serial:
            name += f" ({device._core.device_name}: better read without it, as spacemouse)"
        elif device._core.device_name:
            name += f" ({device._core.device_name})"
        return [FoundDevice(name, "", "spnav", path, obstacle)]

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Capabilities of the device. No buttons are listed if the daemon does not report them
        (version 0)."""
        with self._lock:
            labels, further = self._core.labels, self._core.further_labels
            has_led = self._core.has_led
        return DeviceCapabilities(
            gives_pose=False,
            buttons=labels,
            feedback=frozenset({"led"} if has_led else ()),
            battery=False,
            further_buttons=further,
        )

    def _feedback(self, feedback: DeviceFeedback) -> None:
        self._check_open("feedback()")
        if feedback.led is not None:
            self._led_wanted = feedback.led

    def _connect(self) -> None:
        self._socket = sock = _connected(socket_path(self.options.socket))
        with self._lock:
            self._core.on_opened(time.monotonic())
        end_s = time.monotonic() + AGREE_TIMEOUT_S
        try:
            while not self._core.settled and time.monotonic() < end_s:
                self._exchange(sock, READ_TIMEOUT_S)
        except OSError as error:
            raise DeviceAccessError(
                f"cannot use the daemon at {socket_path(self.options.socket)}: "
                f"{error.strerror or error}"
            ) from None
        if self._core.refusal:
            raise DeviceAccessError(self._core.refusal)

    def _serve(self, stop: threading.Event) -> None:
        sock = self._socket
        if sock is None:
            raise OSError(errno.ENOTCONN, "not connected")
        shown: bool | None = None
        while not stop.is_set():
            on = self._led_wanted
            if on is not None and on is not shown:
                with self._lock:
                    self._core.set_led(LedMode.ON if on else LedMode.OFF, time.monotonic())
                shown = on
            self._exchange(sock, READ_TIMEOUT_S)
        with self._lock:
            self._core.restore_led(time.monotonic())
        end_s = time.monotonic() + _CLOSE_TIMEOUT_S
        with contextlib.suppress(OSError):
            while not self._core.settled and time.monotonic() < end_s:
                self._exchange(sock, READ_TIMEOUT_S)

    def _release(self) -> None:
        if self._socket is not None:
            hang_up(self._socket)
            self._socket = None

    def _exchange(self, sock: socket.socket, timeout_s: float) -> None:
        """Send pending messages, and process what comes within `timeout_s`. Raises OSError once the
        daemon is gone."""
        with self._lock:
            self._core.on_time(time.monotonic())
            output = self._core.outgoing()
        for piece in output:
            sock.sendall(piece)
        if not select.select([sock], [], [], timeout_s)[0]:
            return
        data = sock.recv(_ROOM_BYTES)
        if not data:
            raise OSError(errno.ENODEV, "the daemon closed the connection")
        now_s = time.monotonic()
        if (callback := self.raw_packet_callback) is not None:
            callback(data, False, "")
        with self._lock:
            self._core.on_bytes(data, now_s)
            output = self._core.outgoing()
            out_of_step = self._core.out_of_step
        self._notify()
        if out_of_step:
            raise OSError(errno.EPROTO, "the daemon sends invalid data")
        for piece in output:
            sock.sendall(piece)


def socket_path(option: str) -> str:
    """Return the path of the socket for the option `option`."""
    return option or os.environ.get(SOCKET_VARIABLE, "") or DEFAULT_SOCKET


def _connected(path: str) -> socket.socket:
    """Connect a socket to the daemon. Raises DriverError with the reason."""
    if not hasattr(socket, "AF_UNIX"):
        raise DeviceAccessError("this system has no Unix sockets, and so no spacenavd")
    try:
        return connected(path, socket.SOCK_STREAM, _CONNECT_TIMEOUT_S)
    except OSError as error:
        raise _refusal(path, error) from None


def _refusal(path: str, error: OSError) -> DriverError:
    """Explain an `error` of connecting, with advice."""
    start = f"start spacenavd, or `cardan devices spnav --socket {path}`"
    if isinstance(error, FileNotFoundError):
        return DeviceNotFoundError(f"{absence(path)}: {start}")
    if isinstance(error, ConnectionRefusedError):
        return DeviceNotFoundError(f"no program serves the socket {path}: {start}")
    if isinstance(error, UntrustedServerError):
        return DeviceAccessError(f"refused the socket {path}: {error.strerror}")
    if isinstance(error, PermissionError):
        return DeviceAccessError(
            f"no permission for the socket {path}: let its owner give access "
            "(`cardan devices spnav` has an option for it)"
        )
    return DeviceAccessError(f"cannot connect to {path}: {error.strerror or error}")
