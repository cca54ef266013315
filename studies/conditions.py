"""Conditions of a measurement: machine, versions, and load."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform

from cardan import __version__

PACKAGES = (
    "numpy", "pin", "coal", "daqp", "eclipse-zenoh", "cyclonedds", "websockets", "matplotlib",
)  # fmt: skip
"""Packages whose versions may change a figure."""

NONE = "not installed"


def machine() -> dict[str, str]:
    """Describe this machine, without its name."""
    memory = ""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        pages, size = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
        memory = f"{pages * size / 2**30:.1f} GiB"
    return {
        "processor": _processor(),
        "processors": str(os.cpu_count() or 0),
        "memory": memory,
        "architecture": platform.machine(),
        "kernel": f"{platform.system()} {platform.release()}",
    }


def _processor() -> str:
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            name, _, value = line.partition(":")
            if name.strip() in ("model name", "Model"):
                return value.strip()
    return platform.processor() or "unknown"


def versions() -> dict[str, str]:
    """Return the versions of Cardan, Python, the C library and the installed packages."""
    found = {
        "cardan": __version__,
        "python": platform.python_version(),
        "C library": " ".join(platform.libc_ver()).strip() or "unknown",
    }
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = NONE
    return found


def load() -> float:
    """Return the load average: mean number of runnable processes in the last minute."""
    return os.getloadavg()[0]
