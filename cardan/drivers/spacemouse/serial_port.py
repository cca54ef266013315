"""The way to a device at a serial port."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections import deque
from collections.abc import Callable
from typing import Any

try:
    from termios import error as TerminalError  # noqa: N812
except ImportError:  # where there are no terminals

    class TerminalError(Exception):  # type: ignore[no-redef]
        """Never raised."""


from cardan.drivers.spacemouse.serial_session import SerialSession, device_model
from cardan.drivers.spacemouse.transports import HidCandidate, Link, Reading, Transport
from cardan.errors import DeviceAccessError, DriverError
from cardan.protocols.connexion_serial import SerialModel

BAUD = 9600
WAIT_S = 0.02
"""Longest wait of a read, so that what is due is sent in time."""


class SerialTransport(Transport):
    """The serial port at `path`, and the device of `model` there; None: detect it.

    `stopping` is asked while a device is being found, which takes up to some seconds.
    """

    name = "serial"

    def __init__(
        self,
        path: str,
        model: SerialModel | None = None,
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self._path = path
        self._model = model
        self._stopping = stopping

    def find(self) -> list[HidCandidate]:
        """The port, if there is one. It is not asked what is there: that would disturb it."""
        if os.name == "posix" and not os.path.exists(self._path):
            return []
        name = self._model.name if self._model else "serial device"
        model = device_model(self._model) if self._model else None
        return [HidCandidate(name, 0, 0, self.name, self._path, model=model)]

    def open(self, device: HidCandidate) -> Link:
        """Open the port, find out what is there and start it."""
        port = _open_port(device.path)
        session = SerialSession(self._model, time.monotonic())
        link = SerialLink(port, session)
        try:
            link.start(self._stopping)
        except OSError as error:
            link.close()
            raise DeviceAccessError(f"{device.path}: {error.strerror or error}") from None
        except BaseException:
            link.close()
            raise
        return link


class SerialLink(Link):
    """An open serial port and the conversation with the device there."""

    def __init__(self, port: Any, session: SerialSession) -> None:
        self._port = port
        self._session = session
        self._waiting: deque[Reading] = deque()

    def start(self, stopping: Callable[[], bool]) -> None:
        """Find out what is there and start it. Raises OSError when nothing answers."""
        session = self._session
        while not session.running:
            self._converse(WAIT_S)
            if not session.running:
                self._waiting.clear()  # from before it had its settings
            if stopping():
                raise OSError(errno.EINTR, "closed while the device was being started")
        assert session.model is not None
        self.model = device_model(session.model)
        self.period_s = session.model.period_s

    def read(self, timeout_s: float) -> Reading | None:
        """The oldest waiting report; None when none comes in time."""
        if not self._waiting:
            self._converse(timeout_s)
        return self._waiting.popleft() if self._waiting else None

    def write(self, report: bytes) -> None:
        """No serial device has anything that an output report sets."""
        raise OSError(errno.ENOTSUP, "a serial device takes no output reports")

    def close(self) -> None:
        """Close the port, which takes the device's power."""
        with contextlib.suppress(OSError, TerminalError):
            self._port.close()

    def _converse(self, timeout_s: float) -> None:
        """Send what is due, and take what comes soon; of a `timeout_s` of 0, what is there.

        Raises OSError.
        """
        session, port = self._session, self._port
        words = session.send(time.monotonic())
        try:
            if words:
                port.write(words)
            waiting = port.in_waiting
            data = port.read(waiting or 1) if waiting or timeout_s > 0.0 else b""
        except (OSError, TerminalError) as error:
            # pyserial's own words for it speak of file descriptors.
            raise OSError(_number_of(error) or errno.ENODEV, "the port is gone") from None
        now_s = time.monotonic()
        reports = session.receive(data, now_s) if data else ()
        # A lapse comes first: what was reported before it is gone.
        self._waiting.extend(session.notices(now_s))
        self._waiting.extend(reports)
        if reason := session.failure(now_s):
            raise OSError(errno.ENODEV, reason)


def _open_port(path: str) -> Any:
    """pyserial's port: powered, ours alone. Raises DriverError."""
    try:
        import serial
    except ImportError as error:
        raise DriverError(
            f"the package pyserial cannot be imported ({error}): pip install pyserial"
        ) from None
    try:
        # 8N2 suits devices of one stop bit, too. RTS and DTR, which power the device, go up.
        # No flow control: CTS is not wired in every cable, and waiting for it would be for ever.
        return serial.Serial(
            path,
            BAUD,
            stopbits=serial.STOPBITS_TWO,
            timeout=WAIT_S,  # set once: pyserial asks the system anew at each change
            write_timeout=0.5,
            exclusive=True if os.name == "posix" else None,
        )
    except (OSError, ValueError, TerminalError) as error:
        raise DeviceAccessError(f"cannot open {path}: {_words(path, error)}") from None


def _number_of(error: Exception) -> int | None:
    """The system's number of an error; a terminal's has it as its first argument only."""
    if isinstance(error, TerminalError) and error.args:
        return int(error.args[0])
    return getattr(error, "errno", None)


def _words(path: str, error: Exception) -> str:
    number = _number_of(error)
    if number is None and error.__context__ is not None and error.__context__.args:
        number = error.__context__.args[0]  # what the terminal's settings were refused for
    if number in (errno.EACCES, errno.EPERM):
        return (
            "no permission: add yourself to the group that owns it (dialout, as a rule), and log "
            "in again"
        )
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it open: spacenavd, a modem manager or another session"
    if number in (errno.ENOTTY, errno.EINVAL):
        return "it is no serial port"
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.EIO):
        return "there is nothing at that port"
    return str(getattr(error, "strerror", None) or error)
