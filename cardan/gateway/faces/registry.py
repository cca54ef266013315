"""Finds faces by name: the built-in table, then installed packages' entry points."""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib.metadata import EntryPoints, entry_points
from typing import Any

from cardan.gateway.faces.base import Face
from cardan.plugins import Finder, Loaded

ENTRY_POINT_GROUP = "cardan.faces"

BUILT_IN = {
    "console": "cardan.gateway.faces.console.face:Console",
    "metrics": "cardan.gateway.daemon.metrics:Metrics",
    "recorder": "cardan.gateway.recording.face:RecorderFace",
    "rosbridge": "cardan.gateway.faces.rosbridge:Rosbridge",
    "router": "cardan.gateway.faces.router:Router",
}
"""Our own faces. Other packages add theirs by an entry point of the same form."""


def _installed() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)


# mypy wants a class that can be instantiated; a Finder only compares with it.
_FINDER: Finder[Face[Any]] = Finder(Face, "face", BUILT_IN, _installed)  # type: ignore[type-abstract]


def names() -> tuple[str, ...]:
    """Every name of a face that can be loaded, sorted."""
    return _FINDER.names()


def load(name: str) -> type[Face[Any]]:
    """The declaration of the face called `name`; ConfigurationError names the ones there are."""
    return _FINDER.load(name)


def load_all() -> Loaded[Face[Any]]:
    """Every face class, and why others cannot be loaded."""
    return _FINDER.load_all()


def using(name: str, key: str) -> AbstractContextManager[None]:
    """What another package's face raises inside is a ConfigurationError of `key`."""
    return _FINDER.using(name, key)
