"""Transports of a device's reports: hidapi's back ends, and a socket for simulated devices.

Raw USB is in :mod:`.usb`.
"""

from __future__ import annotations

import os
import re
import sys
from abc import ABC, abstractmethod
from typing import NamedTuple

from cardan.drivers.access import refusal
from cardan.drivers.hid import HidDevice, load_hid
from cardan.drivers.packet_socket import PacketSocket, open_simulated
from cardan.errors import DeviceAccessError
from cardan.protocols.connexion.devices import CONNEXION, LOGITECH, Model, find_model, is_candidate


class HidCandidate(NamedTuple):
    """A device, or one interface of a receiver, that can be opened."""

    name: str
    vendor_id: int
    product_id: int
    transport: str
    path: str
    obstacle: str = ""
    """Reason why it cannot be opened; empty: none known."""
    serial: str = ""
    model: Model | None = None
    certain: bool = True
    """False: its motion may come on another interface of the same ids (receivers)."""
    interface: int = -1
    """Number of its USB interface, which is the slot of a receiver; -1 if unknown."""
    port: str = ""
    """USB port ("1-2.3"), which stays the same until it is replugged; empty if unknown."""


class HidLink(ABC):
    """An open device. All methods but close() raise OSError once it is gone."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes | None:
        """Return the oldest waiting input report, of its true length; None if none comes in time.

        A `timeout_s` of 0 does not wait.
        """

    @abstractmethod
    def write(self, report: bytes) -> None:
        """Send an output report, its id first."""

    def descriptor(self) -> bytes | None:
        """Return the HID report descriptor, if it can be read."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Release the device. Never raises."""


class Transport(ABC):
    """Finds and opens devices."""

    name: str

    @abstractmethod
    def find(self) -> list[HidCandidate]:
        """Return the devices present now. Raises DriverError if this transport is not available."""

    @abstractmethod
    def open(self, device: HidCandidate) -> HidLink:
        """Open a device that find() returned. Raises DeviceAccessError with advice."""


# ---------------------------------------------------------------------------------------------
# hidapi


class HidTransport(Transport):
    """A back end of the hidapi package: module ``hidraw`` or ``hid`` (libusb on Linux)."""

    def __init__(self, name: str, module_name: str) -> None:
        self.name = name
        self._module_name = module_name

    def find(self) -> list[HidCandidate]:
        """Return candidate HID collections, in the order of the system."""
        module = load_hid(self._module_name)
        found = []
        for vendor_id in (CONNEXION, LOGITECH):
            for info in module.enumerate(vendor_id, 0):
                product_id, usage_page = info["product_id"], info["usage_page"]
                if not is_candidate(vendor_id, product_id, usage_page, info["usage"]):
                    continue
                model = find_model(vendor_id, product_id)
                path = os.fsdecode(info["path"])
                found.append(
                    HidCandidate(
                        name=model.name if model else info.get("product_string") or "unknown model",
                        vendor_id=vendor_id,
                        product_id=product_id,
                        transport=self.name,
                        path=path,
                        serial=info.get("serial_number") or "",
                        model=model,
                        certain=usage_page != 0 and not (model and model.receiver),
                        interface=info.get("interface_number", -1),
                        port=usb_port_of(path),
                    )
                )
        return found

    def open(self, device: HidCandidate) -> HidLink:
        try:
            return _HidapiLink(load_hid(self._module_name), device.path)
        except (OSError, ValueError) as error:
            raise DeviceAccessError(
                f"cannot open {device.name}: {refusal(device.path, error)}"
            ) from None


class _HidapiLink(HidDevice, HidLink):
    """An open HID device as a link."""


_PORT = re.compile(r"(?:^|/)(\d+-[\d.]+):\d+\.\d+(?:/|$)")


def usb_port_of(path: str, *, root: str = "/") -> str:
    """Return the USB port of the device at `path`, a hidraw node or libusb's name; empty if it is
    not on USB.

    `root` is the parent folder of /sys.
    """
    if path.startswith("/dev/hidraw"):
        path = os.path.realpath(os.path.join(root, "sys/class/hidraw", path[5:], "device"))
    ports = _PORT.findall(path)
    return ports[-1] if ports else ""


# ---------------------------------------------------------------------------------------------
# Socket


class SocketTransport(Transport):
    """Unix socket in place of a device: each packet is one raw HID report in either direction."""

    name = "socket"

    def __init__(self, path: str, model: Model | None = None) -> None:
        self._path = path
        self._model = model

    def find(self) -> list[HidCandidate]:
        if not os.path.exists(self._path):
            return []
        model = self._model
        name, vendor_id, product_id = (
            (model.name, model.vendor_id, model.product_id) if model else ("device", 0, 0)
        )
        return [
            HidCandidate(f"simulated {name}", vendor_id, product_id, self.name, self._path,
                        model=model)
        ]  # fmt: skip

    def open(self, device: HidCandidate) -> HidLink:
        return open_simulated(device.name, device.path, HidSocketLink)


class HidSocketLink(PacketSocket, HidLink):
    """A connected packet socket as a device."""

    def read(self, timeout_s: float) -> bytes | None:
        return self.receive(timeout_s)

    def write(self, report: bytes) -> None:
        self.send(report)


_HID_MODULES = {"hidraw": "hidraw", "libusb": "hid"}


def hid_transport(name: str) -> Transport:
    """Return hidapi's back end "hidraw" or "libusb"."""
    return HidTransport(name, _HID_MODULES[name])


def hid_transports() -> tuple[Transport, ...]:
    """Return the transports of real devices on this system, the preferred one first.

    Only hidraw works beside other programs: libusb takes the device from them. On systems other
    than Linux the module ``hid`` is the system's HID interface.
    """
    names = ("hidraw", "libusb") if sys.platform == "linux" else ("libusb",)
    return tuple(hid_transport(name) for name in names)
