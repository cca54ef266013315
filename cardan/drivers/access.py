"""Reasons why a plugged-in device cannot be opened, with advice."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from cardan.common.files import text_or_empty

UDEV_HINT = "install the udev rules (`cardan devices udev` prints them) and plug it in again"

USB_DEVICES = Path("/sys/bus/usb/devices")

_LIBUSB_PATH = re.compile(r"(?P<port>\d+-[\d.]+):\d+\.\d+")
_OLD_LIBUSB_PATH = re.compile(r"(?P<bus>[0-9a-f]{4}):(?P<device>[0-9a-f]{4}):[0-9a-f]{2}")


def is_path(given: str, path: str) -> bool:
    """True if `given` is the device's `path`, a udev link to it, or empty (any device)."""
    return given in ("", path) or os.path.realpath(given) == os.path.realpath(path)


def obstacle(path: str, *, hint: str = UDEV_HINT, root: Path = Path("/")) -> str:
    """Return why the device at `path` (of the HID back end) cannot be opened; empty if it can.

    Opens its node, since the HID library gives no reasons. `hint` tells how to get the permission;
    `root` is the parent folder of /dev and /sys.
    """
    if not sys.platform.startswith("linux"):
        return ""
    node = _node(path, root)
    if node is None:
        return ""
    try:
        os.close(os.open(node, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC))
    except OSError as error:
        return open_error(str(node), error, hint)
    return ""


def open_error(node: str, error: OSError, hint: str = UDEV_HINT) -> str:
    """Explain why opening `node` failed; `hint` tells how to get the permission."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"no permission for {node}: {hint}"
    if error.errno == errno.EBUSY:
        return f"another program holds {node}: end it"
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return f"{node} is gone: plug it in again"
    return f"{node}: {error.strerror or error}"


def refusal(path: str, error: object) -> str:
    """Explain why opening the device at `path` failed with `error`."""
    words = obstacle(path)
    if words:
        return words
    if sys.platform == "darwin":
        hint = "3DxWare may have seized it: quit 3DconnexionHelper, and allow Input Monitoring"
    else:
        hint = "another program may hold it: spacenavd, 3DxWare or another session"
    return f"{path}: {error}; {hint}"


def such(options: object, *names: str) -> str:
    """Describe the options among `names` that are set, such as " with path 'x'"; empty if none
    is."""
    wanted = [f"{name} {value!r}" for name in names if (value := getattr(options, name))]
    return f" with {' and '.join(wanted)}" if wanted else ""


class UsbDevice(NamedTuple):
    """A USB device of this computer."""

    vendor_id: str
    """Vendor number in four hexadecimal digits; likewise the product number."""
    product_id: str
    name: str
    """Product name that it reports; may be empty."""
    folder: Path
    """Its folder in /sys."""


def usb_devices() -> Iterator[UsbDevice]:
    """Yield the USB devices plugged into this machine (Linux). Never raises."""
    for vendor in sorted(USB_DEVICES.glob("*/idVendor")):
        vendor_id, product_id, name = (
            text_or_empty(vendor.with_name(part)) for part in ("idVendor", "idProduct", "product")
        )
        if vendor_id and product_id:
            yield UsbDevice(vendor_id, product_id, name, vendor.parent)


def _node(path: str, root: Path) -> Path | None:
    """The device node behind a path of hidapi's hidraw or libusb back end."""
    if path.startswith("/dev/"):
        return root / path[1:]
    bus = device = None
    if match := _LIBUSB_PATH.fullmatch(path):
        port = root / "sys/bus/usb/devices" / match["port"]
        with contextlib.suppress(OSError, ValueError):
            bus = int((port / "busnum").read_text())
            device = int((port / "devnum").read_text())
    elif match := _OLD_LIBUSB_PATH.fullmatch(path):
        bus, device = int(match["bus"], 16), int(match["device"], 16)
    if bus is None or device is None:
        return None
    return root / f"dev/bus/usb/{bus:03d}/{device:03d}"
