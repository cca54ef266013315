"""Driver of serial devices: a thread that communicates with the device and feeds the core."""

from __future__ import annotations

import os
import threading
import time
from typing import Any, ClassVar

from cardan.common.sockets import absence
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.simulated import OWN
from cardan.errors import DeviceNotFoundError
from cardan.protocols.connexion.devices import Model
from cardan.types import DeviceCapabilities
from cardan_serial_mice.driver.core import SerialMouseCore
from cardan_serial_mice.driver.notices import Doubt, Lapse, Restart
from cardan_serial_mice.driver.options import SpaceMouseSerialOptions
from cardan_serial_mice.driver.port import Reading, SerialLink
from cardan_serial_mice.driver.session import device_model
from cardan_serial_mice.protocol import serial_model_by_key

READ_TIMEOUT_S = 0.05
"""Longest wait for a report; the reader checks in between whether it must end."""

MAX_DRAINED = 64
"""Most reports processed in a row, before other threads can read the state."""


class SpaceMouseSerial(ReadDevice[SerialMouseCore]):
    """A Magellan, Spaceball or SpaceOrb at a serial port as an operator device.

    Its axes are LIVE only after the cap was seen at rest. After unplugging it is reopened
    automatically. A probe of a serial port would disturb other devices; thus there is no discovery,
    and `path` must name the port.
    """

    Options: ClassVar[type[SpaceMouseSerialOptions]] = SpaceMouseSerialOptions
    summary = "serial 3Dconnexion mice: Magellan, Spaceball, SpaceOrb"
    page = "../plugins/cardan-serial-mice/README.md"
    peer = "spacemouse-serial"
    simulated = ({"path": OWN},)
    gives = "six deflections, buttons"
    suits = "rate, base frame"
    options: SpaceMouseSerialOptions
    _kind = "serial SpaceMouse"

    def __init__(self, options: SpaceMouseSerialOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        key = self.options.model
        self._wanted = serial_model_by_key(key) if key else None
        self._model = device_model(self._wanted) if self._wanted else None
        self._core = SerialMouseCore(self.options, self._model)
        self._link: SerialLink | None = None

    def open(self) -> None:
        """Open the device and start the reader; takes up to some seconds, until it has answered.

        Raises DeviceNotFoundError or DeviceAccessError, unless `wait_for_device` is set.
        """
        super().open()

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Capabilities of the device. An empty list of buttons means an unknown model."""
        with self._lock:
            labels = self._core.labels
        return DeviceCapabilities(
            gives_pose=False, buttons=labels, feedback=frozenset(), battery=False
        )

    @property
    def model(self) -> Model | None:
        """Open or last opened model, or that of the options; None: unknown."""
        return self._model

    def rezero(self) -> None:
        """Take the resting position of the cap as zero, until the device is opened again.

        Raises CommandError unless the cap rests.
        """
        with self._lock:
            self._core.rezero(time.monotonic())

    # -- the reader ----------------------------------------------------------------------------

    def _connect(self) -> None:
        path = self.options.path
        if os.name == "posix" and not os.path.exists(path):
            said = absence(path, "serial port")
            raise DeviceNotFoundError(f"{said}: check the adapter and its name")
        link = SerialLink.open(path, self._wanted, self._stop.is_set)
        with self._lock:
            self._link = link
            self._model = link.model
            self._core.on_opened(time.monotonic(), link.model, None, link.period_s)

    def _serve(self, stop: threading.Event) -> None:
        assert self._link is not None
        while not stop.is_set():
            report = self._link.read(READ_TIMEOUT_S)
            for _ in range(MAX_DRAINED):
                if report is None or stop.is_set():
                    break
                self._take(report)
                report = self._link.read(0.0)
            else:
                if report is not None:
                    self._take(report)
            self._notify()

    def _take(self, report: Reading) -> None:
        now_s = time.monotonic()
        with self._lock:
            if isinstance(report, (Doubt, Lapse, Restart)):
                self._core.on_notice(report, now_s)
            else:
                self._core.on_value(report, now_s)

    def _release(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
