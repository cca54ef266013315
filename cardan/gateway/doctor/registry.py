"""Finds checks by name: the built-in table, then installed packages' entry points."""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib.metadata import EntryPoints, entry_points

from cardan.gateway.doctor.base import Check
from cardan.plugins import Finder, Loaded

ENTRY_POINT_GROUP = "cardan.checks"

_HERE = "cardan.gateway.doctor"
BUILT_IN = {
    "packages": f"{_HERE}.installation:Packages",
    "compiled": f"{_HERE}.installation:Compiled",
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
    "faces": f"{_HERE}.faces:Doors",
    "controllers": f"{_HERE}.controllers:Controllers",
    "daemon": f"{_HERE}.daemon:Running",
}
"""Our own checks, in the order in which they are shown. Other packages add theirs by an entry point
of the same form."""


def _installed() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)


# mypy wants a class that can be instantiated; a Finder only compares with it.
_FINDER: Finder[Check] = Finder(Check, "check", BUILT_IN, _installed)  # type: ignore[type-abstract]


def names() -> tuple[str, ...]:
    """Every name of a check that can be loaded: ours in their order, then the others."""
    return (*BUILT_IN, *(name for name in _FINDER.names() if name not in BUILT_IN))


def load(name: str) -> type[Check]:
    """The check called `name`; ConfigurationError names the ones there are."""
    return _FINDER.load(name)


def load_all() -> Loaded[Check]:
    """Every check, and why others cannot be loaded."""
    return _FINDER.load_all()


def using(name: str, key: str) -> AbstractContextManager[None]:
    """What another package's check raises inside is a ConfigurationError of `key`."""
    return _FINDER.using(name, key)
