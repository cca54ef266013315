"""SpaceMouse driver: a thread that reads the device and feeds the core."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

from cardan.common.sockets import absence
from cardan.drivers import base
from cardan.drivers.access import is_path, obstacle, such
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.simulated import OWN
from cardan.drivers.spacemouse.core import SpaceMouseCore
from cardan.drivers.spacemouse.options import SpaceMouseOptions
from cardan.drivers.spacemouse.transports import (
    HidCandidate,
    HidLink,
    SocketTransport,
    Transport,
    hid_transport,
    hid_transports,
)
from cardan.drivers.spacemouse.usb import UsbTransport
from cardan.errors import DeviceAccessError, DeviceNotFoundError, DriverError
from cardan.protocols.connexion.descriptors import full_scale_of
from cardan.protocols.connexion.devices import Model, model_by_key
from cardan.protocols.connexion.reports import (
    BUTTONS_ID,
    KEYS_DOWN_ID,
    ROTATION_ID,
    TRANSLATION_ID,
    encode_led,
)
from cardan.types import DeviceCapabilities, DeviceFeedback

READ_TIMEOUT_S = 0.05
"""Longest wait for a report; meanwhile the reader serves the LED and checks for its end."""

BIND_TIMEOUT_S = 0.004
"""Wait for each interface of a receiver in turn, until one sends."""

MAX_DRAINED = 64
"""Most reports processed in a row before other threads can read the state."""
YIELD_S = 0.0005

MUTE_AFTER_S = 10.0
"""Silence after opening that suggests that another program holds the device."""

USB_HINT = 'hidapi does not show it: transport = "usb" opens it, and takes it from other programs'
"""Advice if only raw USB shows a device; "auto" does not take it from the kernel's driver."""

SPEAKING_IDS = frozenset({TRANSLATION_ID, ROTATION_ID, BUTTONS_ID, KEYS_DOWN_ID})
"""Reports sent only by an interface with a puck behind it."""


class SpaceMouse(ReadDevice[SpaceMouseCore]):
    """A 3Dconnexion six-axis device (SpaceMouse, SpaceNavigator and kin) as an operator device.

    Its axes are LIVE only after the cap was seen at rest; see :mod:`.core` for the rules. An
    unplugged device is reopened automatically. `transports` replaces the default transports.
    """

    Options: ClassVar[type[SpaceMouseOptions]] = SpaceMouseOptions
    summary = "3Dconnexion mice: USB, receivers"
    page = "spacemouse.md"
    peer = "spacemouse"
    simulated = ({"transport": ("socket",), "path": OWN},)
    gives = "six deflections, buttons"
    takes_back = "light"
    suits = "rate, base frame"
    udev_matches = (
        'SUBSYSTEM=="hidraw", ATTRS{idVendor}=="256f"',
        'SUBSYSTEM=="hidraw", ATTRS{idVendor}=="046d", ATTRS{idProduct}=="c6[0-4]?"',
        'SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", ATTR{idVendor}=="256f"',
        'SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", ATTR{idVendor}=="046d", '
        'ATTR{idProduct}=="c6[0-4]?"',
        "# By Bluetooth there is no idVendor.",
        'SUBSYSTEM=="hidraw", KERNELS=="0005:256F:*"',
    )
    options: SpaceMouseOptions
    _kind = "SpaceMouse"

    def __init__(
        self,
        options: SpaceMouseOptions | None = None,
        *,
        transports: Sequence[Transport] | None = None,
        **keywords: Any,
    ) -> None:
        super().__init__(options, **keywords)
        options = self.options
        self._model: Model | None = None
        if options.model:
            self._model = model_by_key(options.model)
        self._core = SpaceMouseCore(options, self._model)
        self._transports = tuple(self._usual_transports() if transports is None else transports)
        self._links: list[HidLink] = []
        self._opened_s = 0.0
        self._led_wanted: bool | None = None
        self._led_shown: bool | None = None
        self._led_failures = 0

    @classmethod
    def find(cls) -> list[base.FoundDevice]:
        """Return the HID devices that are plugged in, or if hidapi shows none, those of raw USB."""
        rows = []
        try:
            found = list_devices()
        except (DriverError, OSError) as error:
            found = []
            rows.append(_unlisted("hidapi", error))
        if not found:
            try:
                found = _usb_devices()
            except DeviceAccessError as error:
                rows.append(_unlisted(UsbTransport.name, error))
            except (DriverError, OSError):  # libusb is often missing, and rarely needed.
                pass
        rows += [
            base.FoundDevice(
                name=device.name + _place(device),
                identity=f"{device.vendor_id:04x}:{device.product_id:04x}",
                transport=device.transport,
                path=device.path,
                obstacle=device.obstacle,
            )
            for device in found
        ]
        return rows

    # -- the interface -------------------------------------------------------------------------

    def open(self) -> None:
        """Open the device and start to read it.

        Raises DeviceNotFoundError or DeviceAccessError, unless `wait_for_device` is set.
        """
        if not self._opened:
            self._led_wanted = {"keep": None, "on": True, "off": False}[self.options.led]
        super().open()

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Capabilities of the device. No buttons are listed if the model is unknown."""
        with self._lock:
            labels = self._core.labels
        model = self._model
        return DeviceCapabilities(
            gives_pose=False,
            buttons=labels,
            feedback=frozenset({"led"} if self._may_have_led else ()),
            battery=model is not None and model.battery,
        )

    @property
    def model(self) -> Model | None:
        """Model that is open, was open last, or is set by the options; None if unknown."""
        return self._model

    def rezero(self) -> None:
        """Set the zero to the cap's resting position, until the device is opened again.

        Raises CommandError unless the cap rests.
        """
        with self._lock:
            self._core.rezero(time.monotonic())

    def diagnosis(self) -> tuple[str, ...]:
        words = [*super().diagnosis()]
        now_s = time.monotonic()
        with self._lock:
            heard = self._core.heard
        if self._links and not heard and now_s - self._opened_s > MUTE_AFTER_S:
            words.append(
                f"nothing received in {now_s - self._opened_s:.0f} s: touch the cap; if it stays "
                "silent, another program has seized it (3DxWare), or its radio is off"
            )
        if self._led_failures:
            words.append(f"{self._led_failures} times the LED could not be set")
        return tuple(words)

    def _feedback(self, feedback: DeviceFeedback) -> None:
        self._check_open("feedback()")
        if feedback.led is not None:
            self._led_wanted = feedback.led

    @property
    def _may_have_led(self) -> bool:
        return self._model is None or self._model.led

    # -- finding and opening -------------------------------------------------------------------

    def _usual_transports(self) -> tuple[Transport, ...]:
        options = self.options
        if options.transport == "auto":
            return hid_transports()
        if options.transport == "socket":
            return (SocketTransport(options.path, self._model),)
        if options.transport == "usb":
            return (UsbTransport(),)
        return (hid_transport(options.transport),)

    def _connect(self) -> None:
        refusals: list[str] = []
        missing: list[str] = []
        for transport in self._transports:
            try:
                found = [device for device in transport.find() if self._is_meant(device)]
            except DriverError as error:
                missing.append(str(error))
                continue
            for group in _groups(found):
                if self._open_group(transport, group, refusals):
                    return
        if not refusals and len(missing) == len(self._transports):
            refusals = missing
        if refusals:
            raise DeviceAccessError("; ".join(dict.fromkeys(refusals)))
        raise DeviceNotFoundError(self._not_found())

    def _open_group(
        self, transport: Transport, group: Sequence[HidCandidate], refusals: list[str]
    ) -> bool:
        links = []
        for device in group:
            try:
                links.append(transport.open(device))
            except DeviceAccessError as error:
                refusals.append(str(error))
        if not links:
            return False
        descriptor = links[0].descriptor()
        model = group[0].model
        self._opened_s = now_s = time.monotonic()
        with self._lock:
            self._links = links
            self._model = model
            self._core.on_opened(
                now_s,
                model,
                full_scale_of(descriptor) if descriptor else None,
            )
        self._led_shown = None
        return True

    def _is_meant(self, device: HidCandidate) -> bool:
        options = self.options
        key = device.model.key if device.model else ""
        return (
            is_path(options.path, device.path)
            and options.serial in ("", device.serial)
            and options.port in ("", device.port)
            and options.slot in ("", str(device.interface))
            and options.model in ("", key)
        )

    def _not_found(self) -> str:
        options = self.options
        if options.transport == "socket":
            return f"{absence(options.path)}: start the simulated device first"
        wanted = such(options, "path", "model", "serial", "port", "slot")
        return f"no 3Dconnexion device{wanted} is plugged in; `cardan devices` lists all found"

    # -- the reader ----------------------------------------------------------------------------

    def _serve(self, stop: threading.Event) -> None:
        while not stop.is_set():
            if len(self._links) > 1:
                self._bind()
                continue
            link = self._links[0]
            self._show_led(link)
            report = link.read(READ_TIMEOUT_S)
            for _ in range(MAX_DRAINED):
                if report is None or stop.is_set():
                    break
                self._take(report)
                report = link.read(0.0)
            else:
                if report is not None:
                    self._take(report)
                stop.wait(YIELD_S)
            self._notify()
        if len(self._links) == 1:
            self._show_led(self._links[0])

    def _bind(self) -> None:
        """Listen to several interfaces; keep the one that sends reports."""
        for link in tuple(self._links):
            try:
                report = link.read(BIND_TIMEOUT_S)
            except OSError:
                if len(self._links) == 1:
                    raise
                self._links.remove(link)
                link.close()
                continue
            if report and report[0] in SPEAKING_IDS:
                for other in self._links:
                    if other is not link:
                        other.close()
                self._links[:] = [link]
                self._take(report)
                self._notify()
                return

    def _take(self, report: bytes) -> None:
        now_s = time.monotonic()
        if (callback := self.raw_packet_callback) is not None:
            callback(report, False, "")
        with self._lock:
            self._core.on_report(report, now_s)

    def _show_led(self, link: HidLink) -> None:
        """Set the LED as requested; a Compact's can be switched off only after it was switched
        on."""
        on = self._led_wanted
        if on is None or on is self._led_shown or not self._may_have_led:
            return
        try:
            if not on and not self._led_shown:
                link.write(encode_led(True))
            link.write(encode_led(on))
        except OSError:
            # Reading tells the state of the link; a device without an LED refuses, too.
            self._led_failures += 1
        self._led_shown = on

    def _release(self) -> None:
        for link in self._links:
            link.close()
        self._links = []


def list_devices(transports: Sequence[Transport] | None = None) -> list[HidCandidate]:
    """Return the devices that are plugged in, each with any obstacle to opening it.

    Tries `transports` (hidapi's back ends) in turn until one finds some. Raises DriverError if none
    of them is available.
    """
    failures: list[DriverError] = []
    transports = hid_transports() if transports is None else transports
    for transport in transports:
        try:
            found = transport.find()
        except DriverError as error:
            failures.append(error)
            continue
        if found:
            return [device._replace(obstacle=obstacle(device.path)) for device in found]
    if len(failures) == len(transports):
        raise failures[0]
    return []


def _usb_devices() -> list[HidCandidate]:
    """Return the devices of raw USB, each with the option that opens it. Raises DriverError."""
    return [
        device._replace(obstacle="; ".join(filter(None, (obstacle(device.path), USB_HINT))))
        for device in UsbTransport().find()
    ]


def _unlisted(transport: str, error: Exception) -> base.FoundDevice:
    """Return the row that explains why this transport shows no devices."""
    return base.FoundDevice("3Dconnexion devices", "", transport, "", obstacle=str(error))


def _place(device: HidCandidate) -> str:
    """Describe the port and slot of a device, as in its options."""
    words = [f"port {device.port}"] if device.port else []
    if device.model is not None and device.model.receiver and device.interface >= 0:
        words.append(f"slot {device.interface}")
    return f" ({', '.join(words)})" if words else ""


def _groups(found: Iterable[HidCandidate]) -> list[list[HidCandidate]]:
    """Group the interfaces of one receiver; other devices are groups of one."""
    groups: dict[tuple[object, ...], list[HidCandidate]] = {}
    for device in found:
        ids = (device.vendor_id, device.product_id, device.serial)
        key = (*ids, device.path) if device.certain else ids
        groups.setdefault(key, []).append(device)
    return list(groups.values())
