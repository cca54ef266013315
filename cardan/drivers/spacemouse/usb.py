"""Transport by raw USB, for systems without a HID interface."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator
from typing import Any

from cardan.drivers.access import refusal
from cardan.drivers.hid import REPORT_ROOM
from cardan.drivers.spacemouse.transports import HidCandidate, HidLink, Transport
from cardan.errors import DeviceAccessError, DriverError
from cardan.protocols.connexion.devices import CONNEXION, LOGITECH, Model, find_model, is_candidate

_HID_CLASS = 3
_BOOT_PROTOCOLS = (1, 2)
"""Interface protocols of keyboards and mice, which a receiver has beside the puck."""
_INTERRUPT = 3
_ENDPOINT_IN = 0x80

_TIMEOUTS = (errno.ETIMEDOUT, 110, 60, 10060)
"""Error numbers of timeouts in libusb's back ends: Linux, macOS, Windows."""

_SET_REPORT = (0x21, 0x09)
_OUTPUT_REPORT = 0x0200
_GET_DESCRIPTOR = (0x81, 0x06)
_REPORT_DESCRIPTOR = 0x2200
_DESCRIPTOR_ROOM = 1024

_SHORTEST_TIMEOUT_MS = 1
"""Timeout in place of 0, which would wait forever."""


class UsbTransport(Transport):
    """Raw USB by pyusb. While a device is open, no other program gets its reports."""

    name = "usb"

    def find(self) -> list[HidCandidate]:
        """Return the interfaces that may carry motion, in the order of the system."""
        found: list[HidCandidate] = []
        failures = []
        for device in _devices():
            model = find_model(device.idVendor, device.idProduct)
            if model is None or not is_candidate(device.idVendor, device.idProduct, 0, 0):
                continue
            try:
                found += self._found(device, model)
            except OSError as error:
                if error.errno == errno.ENODEV:
                    continue  # It is just being plugged in or out.
                failures.append(
                    f"the {model.name} at {_port_of(device)} cannot be identified "
                    f"({error.strerror or error}): plug it in again"
                )
        if failures and not found:
            raise DeviceAccessError("; ".join(failures))
        return found

    def _found(self, device: Any, model: Model) -> list[HidCandidate]:
        """Return the interfaces of `device`. Raises OSError if its descriptors cannot be read."""
        port = _port_of(device)
        return [
            HidCandidate(
                name=model.name,
                vendor_id=model.vendor_id,
                product_id=model.product_id,
                transport=self.name,
                path=f"{port}:{configuration}.{interface.bInterfaceNumber}",
                serial=_serial_of(device),
                model=model,
                certain=not model.receiver,
                interface=interface.bInterfaceNumber,
                port=port,
            )
            for configuration, interface in _interfaces(device)
        ]

    def open(self, device: HidCandidate) -> HidLink:
        """Take the interface from the kernel's driver and claim it."""
        for usb_device in _devices():
            if _port_of(usb_device) != device.port:
                continue
            try:
                for _, interface in _interfaces(usb_device):
                    if interface.bInterfaceNumber == device.interface:
                        return UsbLink(usb_device, interface)
            except (OSError, NotImplementedError) as error:
                if isinstance(error, OSError) and error.errno == errno.ENODEV:
                    break
                raise DeviceAccessError(
                    f"cannot open {device.name}: {refusal(device.path, error)}"
                ) from None
        raise DeviceAccessError(f"cannot open {device.name}: {device.path} is gone")


class UsbLink(HidLink):
    """A claimed interface."""

    def __init__(self, device: Any, interface: Any) -> None:
        self._device = device
        self._number = interface.bInterfaceNumber
        endpoint = _endpoint_of(interface)
        assert endpoint is not None, "candidates have one"
        self._endpoint = endpoint.bEndpointAddress
        self._detached = False
        self._claimed = False
        try:
            # Only Linux has drivers to detach.
            with contextlib.suppress(NotImplementedError):
                if device.is_kernel_driver_active(self._number):
                    device.detach_kernel_driver(self._number)
                    self._detached = True
            _usb_util().claim_interface(device, self._number)
            self._claimed = True
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float) -> bytes | None:
        """Read one report; a device without one waits for the timeout."""
        timeout_ms = max(_SHORTEST_TIMEOUT_MS, round(1000.0 * timeout_s))
        try:
            report = bytes(self._device.read(self._endpoint, REPORT_ROOM, timeout_ms))
        except OSError as error:
            if error.errno in _TIMEOUTS:
                return None
            raise
        return report or None

    def write(self, report: bytes) -> None:
        """Send an output report by the control endpoint."""
        request_type, request = _SET_REPORT
        self._device.ctrl_transfer(
            request_type, request, _OUTPUT_REPORT | report[0], self._number, report
        )

    def descriptor(self) -> bytes | None:
        """Return the report descriptor, if the device provides it."""
        request_type, request = _GET_DESCRIPTOR
        try:
            return bytes(
                self._device.ctrl_transfer(
                    request_type, request, _REPORT_DESCRIPTOR, self._number, _DESCRIPTOR_ROOM
                )
            )
        except OSError:
            return None

    def close(self) -> None:
        util = _usb_util()
        if self._claimed:
            with contextlib.suppress(OSError):
                util.release_interface(self._device, self._number)
            self._claimed = False
        if self._detached:
            with contextlib.suppress(OSError, NotImplementedError):
                self._device.attach_kernel_driver(self._number)
            self._detached = False
        with contextlib.suppress(OSError):
            util.dispose_resources(self._device)


def _devices() -> list[Any]:
    """Return all devices of the two vendors. Raises DriverError without libusb."""
    try:
        import usb.core
    except ImportError as error:
        raise DriverError(
            f"the package pyusb cannot be imported ({error}): pip install pyusb"
        ) from None
    try:
        return [
            device
            for vendor_id in (CONNEXION, LOGITECH)
            for device in usb.core.find(find_all=True, idVendor=vendor_id)
        ]
    except usb.core.NoBackendError:
        raise DriverError(
            "pyusb finds no libusb: install it (Debian: libusb-1.0-0; macOS: brew install libusb)"
        ) from None
    except OSError as error:
        raise DriverError(f"the USB devices cannot be listed: {error.strerror or error}") from None


def _usb_util() -> Any:
    import usb.util

    return usb.util


def _interfaces(device: Any) -> Iterator[tuple[int, Any]]:
    """Yield the HID interfaces that may carry motion, each with its configuration's number."""
    for configuration in device:
        for interface in configuration:
            if (
                interface.bInterfaceClass == _HID_CLASS
                and interface.bAlternateSetting == 0
                and not (
                    interface.bInterfaceSubClass == 1
                    and interface.bInterfaceProtocol in _BOOT_PROTOCOLS
                )
                and _endpoint_of(interface) is not None
            ):
                yield configuration.bConfigurationValue, interface


def _endpoint_of(interface: Any) -> Any | None:
    """Return the interrupt endpoint of `interface` for reports."""
    for endpoint in interface:
        if endpoint.bEndpointAddress & _ENDPOINT_IN and endpoint.bmAttributes & 3 == _INTERRUPT:
            return endpoint
    return None


def _port_of(device: Any) -> str:
    """Return the port as Linux names it ("1-2.3")."""
    ports = ".".join(map(str, device.port_numbers or (0,)))
    return f"{device.bus}-{ports}"


def _serial_of(device: Any) -> str:
    """Return the serial number, if there is one and it may be read."""
    if not device.iSerialNumber:
        return ""
    with contextlib.suppress(OSError, ValueError, NotImplementedError):
        return str(_usb_util().get_string(device, device.iSerialNumber) or "")
    return ""
