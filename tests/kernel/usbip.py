"""Debian's usbip and the kernel's virtual USB bus."""

from __future__ import annotations

import subprocess
from pathlib import Path

from tests.kernel.waiting import wait_for

DEVICE = Path("/sys/bus/usb/devices/1-1")


def usbip(endpoint: str, command: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Debian's usbip against the server at `endpoint`."""
    host, port = endpoint.split()[0].split(":")
    whole = ["usbip", "--tcp-port", port, command, "-r", host, *words]
    return subprocess.run(whole, capture_output=True, text=True, timeout=30)


def attach(endpoint: str) -> Path:
    """Attach the device once it is plugged in, and wait until the kernel has configured it; return
    its folder below /sys."""
    wait_for(lambda: usbip(endpoint, "attach", "-b", "1-1").returncode == 0, poll_s=0.1)
    wait_for((DEVICE / "1-1:1.0").exists)
    return DEVICE


def is_unplugged() -> bool:
    """True if no device is attached any more."""
    return not DEVICE.exists()
