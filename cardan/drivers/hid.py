"""Import of hidapi's modules, which another package may shadow, and an open HID device."""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
from types import ModuleType

from cardan.errors import DriverError


def load_hid(module_name: str) -> ModuleType:
    """Return hidapi's module. Raises DriverError if it is missing or shadowed by another
    package."""
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise DriverError(
            f"module {module_name!r} of the package hidapi cannot be imported ({error}): "
            "pip install hidapi"
        ) from None
    if not hasattr(module, "device") or not hasattr(module, "enumerate"):
        other = " (the package `hid`, a different one)" if hasattr(module, "Device") else ""
        raise DriverError(
            f"module {module_name!r} is not that of the package hidapi{other}: "
            "pip uninstall hid, then pip install --force-reinstall hidapi"
        )
    return module


REPORT_ROOM = 64
"""Size of every read, bytes: a smaller one would truncate reports."""


class HidDevice:
    """An open HID device. All methods but close() raise OSError once it is gone."""

    def __init__(self, module: ModuleType, path: str) -> None:
        """Raises OSError or ValueError, mostly without a reason."""
        self._handle = module.device()
        self._handle.open_path(os.fsencode(path))
        self._handle.set_nonblocking(1)

    def read(self, timeout_s: float) -> bytes | None:
        """Return the oldest waiting input report, of its true length; None if none comes in
        time."""
        try:
            if timeout_s > 0.0:
                report = self._handle.read(REPORT_ROOM, max(1, round(1000.0 * timeout_s)))
            else:
                report = self._handle.read(REPORT_ROOM)
        except ValueError as error:  # hidapi's error for a closed device
            raise OSError(errno.ENODEV, str(error)) from None
        return bytes(report) if report else None

    def write(self, report: bytes) -> None:
        """Send an output report, its id first."""
        if self._handle.write(report) < 0:
            raise OSError(errno.EIO, f"write error: {self._handle.error()}")

    def descriptor(self) -> bytes | None:
        """Report descriptor, if it can be read."""
        try:
            return bytes(self._handle.get_report_descriptor())
        except (OSError, ValueError, AttributeError):  # hidapi before 0.14 has no such function
            return None

    def close(self) -> None:
        """Release the device. Never raises."""
        with contextlib.suppress(OSError, ValueError):
            self._handle.close()
