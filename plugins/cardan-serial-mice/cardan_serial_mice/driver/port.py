"""Open serial port with a device."""

from __future__ import annotations

import errno
import time
from collections import deque
from collections.abc import Callable

from cardan.drivers.serial_port import WAIT_S, SerialPort
from cardan.errors import DeviceAccessError
from cardan.protocols.connexion.devices import Model
from cardan.protocols.connexion.reports import InputReport
from cardan_serial_mice.driver.notices import Notice
from cardan_serial_mice.driver.session import SerialSession, device_model
from cardan_serial_mice.protocol import SerialModel

BAUD = 9600
STOP_BITS = 2
"""Also suits devices of one stop bit."""

Reading = InputReport | Notice
"""A report, or a change of the device's condition."""


class SerialLink:
    """Open serial port with the session of its device."""

    model: Model
    """Model that has answered."""
    period_s: float
    """Period of reports while deflected."""

    def __init__(self, port: SerialPort, session: SerialSession) -> None:
        self._port = port
        self._session = session
        self._waiting: deque[Reading] = deque()

    @classmethod
    def open(cls, path: str, model: SerialModel | None, stopping: Callable[[], bool]) -> SerialLink:
        """Open the port, identify the device (`model` None: any that answers) and start it.

        It takes up to some seconds; `stopping` is polled meanwhile. Raises DeviceAccessError or
        DeviceNotFoundError with instructions.
        """
        port = SerialPort(path, BAUD, stop_bits=STOP_BITS)
        link = cls(port, SerialSession(model, time.monotonic()))
        try:
            link._start(stopping)
        except OSError as error:
            link.close()
            raise DeviceAccessError(f"{path}: {error.strerror or error}") from None
        except BaseException:
            link.close()
            raise
        return link

    def _start(self, stopping: Callable[[], bool]) -> None:
        """Identify the device and start it. Raises OSError if no device answers."""
        session = self._session
        while not session.running:
            self._converse(WAIT_S)
            if not session.running:
                self._waiting.clear()  # Sent before it had its settings.
            if stopping():
                raise OSError(errno.EINTR, "closed while the device was being started")
        assert session.model is not None
        self.model = device_model(session.model)
        self.period_s = session.model.period_s

    def read(self, timeout_s: float) -> Reading | None:
        """Return the oldest waiting report; None on a time-out. Raises OSError once the device is
        gone. A `timeout_s` of 0 does not wait."""
        if not self._waiting:
            self._converse(timeout_s)
        return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Close the port, which cuts the device's power. Never raises."""
        self._port.close()

    def _converse(self, timeout_s: float) -> None:
        """Send due bytes and receive; with a `timeout_s` of 0 only bytes already received.

        Raises OSError.
        """
        session = self._session
        if words := session.send(time.monotonic()):
            self._port.write(words)
        data = self._port.read(wait=timeout_s > 0.0)
        now_s = time.monotonic()
        reports = session.receive(data, now_s) if data else ()
        # A lapse comes first: it invalidates earlier reports.
        self._waiting.extend(session.notices(now_s))
        self._waiting.extend(reports)
        if reason := session.failure(now_s):
            raise OSError(errno.ENODEV, reason)
