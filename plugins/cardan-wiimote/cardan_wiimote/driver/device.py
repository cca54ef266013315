"""The Wii Remote driver: a thread that reads the remote and feeds the core."""

from __future__ import annotations

import contextlib
import errno
import threading
import time
from typing import Any, ClassVar

from cardan.drivers.access import is_path, such
from cardan.drivers.base import FoundDevice
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.simulated import OWN
from cardan.errors import DeviceAccessError, DeviceNotFoundError, DriverError
from cardan.types import DeviceCapabilities, DeviceFeedback
from cardan_wiimote.driver.core import KERNEL_DRIVER, Identity, WiimoteCore
from cardan_wiimote.driver.options import WiimoteOptions
from cardan_wiimote.driver.transports import (
    Found,
    HidrawTransport,
    L2capTransport,
    Link,
    SocketTransport,
    Transport,
)
from cardan_wiimote.protocol import Rumble, encode_output

READ_TIMEOUT_S = 0.01
"""Longest wait for a report, which delays a motor pulse; reports arrive at this rate."""

BURST_REPORTS = 64
"""Most reports processed before the motor is updated."""

_MOTOR_OFF = encode_output(Rumble())


class Wiimote(ReadDevice[WiimoteCore]):
    """A Wii Remote as an operator device: tilt, buttons, Nunchuk, MotionPlus, rumble.

    Its axes are zero unless a clutch button is held, and LIVE only after none was; see :mod:`.core`
    for the rules and :mod:`.roles` for the mapping of motions. After a loss the same remote, and no
    other, is reopened automatically. `backend` replaces the transport.
    """

    Options: ClassVar[type[WiimoteOptions]] = WiimoteOptions
    summary = "Wii Remotes"
    page = "../plugins/cardan-wiimote/README.md"
    peer = "wiimote"
    simulated = ({"transport": ("socket",), "path": OWN},)
    gives = "tilt, buttons, MotionPlus, Nunchuk"
    takes_back = "lights, rumble"
    suits = "rate, tool frame"
    udev_matches = (
        "# Both generations.",
        'SUBSYSTEM=="hidraw", KERNELS=="0005:057E:0306.*"',
        'SUBSYSTEM=="hidraw", KERNELS=="0005:057E:0330.*"',
        "# Behind an adapter on USB, such as a DolphinBar.",
        'SUBSYSTEM=="hidraw", KERNELS=="0003:057E:0306.*"',
        'SUBSYSTEM=="hidraw", KERNELS=="0003:057E:0330.*"',
    )
    options: WiimoteOptions
    _kind = "Wii Remote"

    def __init__(
        self,
        options: WiimoteOptions | None = None,
        *,
        backend: Transport | None = None,
        **keywords: Any,
    ) -> None:
        super().__init__(options, **keywords)
        self._core = WiimoteCore(self.options)
        self._transport = backend or _transport(self.options)
        self._remote: Link | None = None
        self._remembered: Found | None = None
        """Remote opened first, until close(): another operator's remote does not replace it."""

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Return the remotes that the system has connected; opens none."""
        try:
            remotes = HidrawTransport().find()
        except (DriverError, OSError) as error:
            return [FoundDevice("Wii Remotes", "", "hidapi", "", str(error))]
        return [
            FoundDevice(
                remote.name, remote.address, remote.transport, remote.path, _caution(remote)
            )
            for remote in remotes
        ]

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Capabilities of a remote; c and z are a Nunchuk's, which may be plugged in later."""
        with self._lock:
            labels = self._core.labels
        return DeviceCapabilities(
            gives_pose=False,
            buttons=labels,
            feedback=frozenset({"led", "rumble"}),
            battery=True,
            gives_inertia=True,
        )

    def _feedback(self, feedback: DeviceFeedback) -> None:
        self._check_open("feedback()")
        with self._lock:
            if feedback.led is not None:
                self._core.set_led(feedback.led)
            if feedback.rumble is not None:
                self._core.set_rumble(feedback.rumble, time.monotonic())

    def open(self) -> None:
        """Open a remote and start the reader.

        Raises DeviceNotFoundError or DeviceAccessError, unless `wait_for_device` is set.
        """
        if not self._opened:
            self._remembered = None
        super().open()

    # -- the reader ----------------------------------------------------------------------------

    def _connect(self) -> None:
        remembered = self._remembered
        refusals = []
        others = []
        for remote in self._transport.find():
            if remembered is None or not _is_same(remote, remembered):
                if not self._is_meant(remote):
                    continue
                if remembered is not None:
                    others.append(remote)
                    continue
            try:
                link = self._transport.open(remote, self._stop.is_set)
            except DeviceAccessError as error:
                refusals.append(str(error))
                continue
            try:  # Some adapters list absent remotes, which accept no report.
                link.write(_MOTOR_OFF)
            except OSError as error:
                link.close()
                words = f"{remote.name} at {remote.path} takes no report: {error}"
                if remote.transport == SocketTransport.name:
                    words += "; another program holds it"
                refusals.append(words)
                continue
            identity = Identity(
                remote.name,
                remote.address,
                remote.transport,
                remote.kernel_driver,
                remote.late_model,
            )
            self._remembered = remote
            with self._lock:
                self._remote = link
                self._core.on_opened(time.monotonic(), identity)
            return
        if refusals:
            raise DeviceAccessError("; ".join(refusals))
        if remembered is not None and remembered.transport != SocketTransport.name:
            raise DeviceNotFoundError(_gone(remembered, others))
        raise DeviceNotFoundError(self._not_found())

    def _serve(self, stop: threading.Event) -> None:
        link = self._remote
        assert link is not None
        while not stop.is_set():
            now_s = time.monotonic()
            with self._lock:
                reports = self._core.outgoing(now_s)
                failure = self._core.failure(now_s)
            for report in reports:
                link.write(report)
                if (callback := self.raw_packet_callback) is not None:
                    callback(report, True, "")
            if failure:
                raise OSError(errno.ETIMEDOUT, failure)
            received = link.read(READ_TIMEOUT_S)
            for _ in range(BURST_REPORTS):
                if received is None:
                    break
                now_s = time.monotonic()
                if (callback := self.raw_packet_callback) is not None:
                    callback(received, False, "")
                with self._lock:
                    self._core.on_report(received, now_s)
                received = link.read(0.0)
            self._notify()
        with self._lock:
            reports = self._core.final_reports()
        for report in reports:
            link.write(report)

    def _release(self) -> None:
        link, self._remote = self._remote, None
        if link is not None:
            with contextlib.suppress(OSError):
                link.write(_MOTOR_OFF)
            link.close()

    def _is_meant(self, remote: Found) -> bool:
        options = self.options
        return is_path(options.path, remote.path) and (
            "" in (options.address, remote.address) or options.address.upper() == remote.address
        )

    def _not_found(self) -> str:
        options = self.options
        if options.transport == "socket":
            return (
                f"there is no simulated remote in {options.path!r} (psm11, psm13): start "
                "`cardan sim wiimote --l2cap` first"
            )
        wanted = such(options, "path", "address")
        return (
            f"no Wii Remote{wanted} is connected: pair it once (red sync button), then press one "
            "of its buttons; `cardan devices` lists the devices found"
        )


def _caution(remote: Found) -> str:
    """Return why `remote` cannot be opened or, if it can, the problems to expect."""
    if remote.obstacle:
        return remote.obstacle
    words = []
    if remote.kernel_driver:
        words.append(KERNEL_DRIVER)
    if remote.late_model:
        words.append(
            "pair it with the red sync button: a -TR remote that was woken with 1 and 2 drops the "
            "link"
        )
    return f"ready, but {'; '.join(words)}" if words else ""


def _is_same(remote: Found, remembered: Found) -> bool:
    """Compare by address, because the system gives a returned remote another path."""
    if remembered.address:
        return remote.address == remembered.address
    return remote.path == remembered.path


def _gone(remembered: Found, others: list[Found]) -> str:
    words = f"the remote {_label(remembered)} is gone: press one of its buttons"
    if others:
        words += (
            f"; {_label(others[0])} is there, but is another one: to use that, close the device "
            "and open it again"
        )
    return words


def _label(remote: Found) -> str:
    return remote.address or remote.path


def _transport(options: WiimoteOptions) -> Transport:
    if options.transport == "socket":
        return SocketTransport(options.path)
    if options.transport == "l2cap":
        return L2capTransport(options.address)
    return HidrawTransport()
