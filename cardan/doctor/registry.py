"""Finds checks by name: the built-in table, then installed packages' entry points."""

from __future__ import annotations

from cardan.common.plugins import Finder, entry_points
from cardan.doctor.base import Check

ENTRY_POINT_GROUP = "cardan.checks"

_HERE = "cardan.doctor"
BUILT_IN = {
    "packages": f"{_HERE}.installation:Packages",
    "plug-ins": f"{_HERE}.installation:PlugIns",
    "scheduling": f"{_HERE}.system:Scheduling",
    "memory-lock": f"{_HERE}.system:MemoryLock",
    "governor": f"{_HERE}.system:Governor",
    "clock": f"{_HERE}.system:Clock",
    "load": f"{_HERE}.system:Load",
    "devices": f"{_HERE}.devices:PluggedIn",
    "udev": f"{_HERE}.devices:UdevRules",
    "holders": f"{_HERE}.devices:Holders",
    "files": f"{_HERE}.files:Files",
    "ports": f"{_HERE}.ports:Ports",
    "bus": f"{_HERE}.network:Bus",
    "ros": f"{_HERE}.network:RosEnvironment",
    "servers": f"{_HERE}.servers:ServerAccess",
    "controllers": f"{_HERE}.controllers:Controllers",
    "daemon": f"{_HERE}.daemon:Running",
}
"""Built-in checks, in the order in which they are shown. Other packages add checks by an entry
point of the same form."""


FINDER: Finder[Check] = Finder(
    Check,  # type: ignore[type-abstract]
    "check",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
load, load_all, using = FINDER.load, FINDER.load_all, FINDER.using


def names() -> tuple[str, ...]:
    """Return all names of checks that can be loaded: built-in ones in order, then the others."""
    return (*BUILT_IN, *(name for name in FINDER.names() if name not in BUILT_IN))
