"""The way to a device at a serial port."""

from __future__ import annotations

import errno
import os
import time
from collections import deque
from collections.abc import Callable

from cardan.drivers.serial_port import WAIT_S, SerialPort
from cardan.drivers.spacemouse.serial_session import SerialSession, device_model
from cardan.drivers.spacemouse.transports import HidCandidate, Link, Reading, Transport
from cardan.errors import DeviceAccessError
from cardan.protocols.connexion_serial import SerialModel

BAUD = 9600
STOP_BITS = 2
"""Suits devices of one stop bit, too."""


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
        port = SerialPort(device.path, BAUD, stop_bits=STOP_BITS)
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

    def __init__(self, port: SerialPort, session: SerialSession) -> None:
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
        self._port.close()

    def _converse(self, timeout_s: float) -> None:
        """Send what is due, and take what comes soon; of a `timeout_s` of 0, what is there.

        Raises OSError.
        """
        session = self._session
        if words := session.send(time.monotonic()):
            self._port.write(words)
        data = self._port.read(wait=timeout_s > 0.0)
        now_s = time.monotonic()
        reports = session.receive(data, now_s) if data else ()
        # A lapse comes first: what was reported before it is gone.
        self._waiting.extend(session.notices(now_s))
        self._waiting.extend(reports)
        if reason := session.failure(now_s):
            raise OSError(errno.ENODEV, reason)
