"""Finds faces by name: the built-in table, then installed packages' entry points."""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib.metadata import EntryPoints, entry_points
from typing import Any

from cardan.gateway.faces.base import Face
from cardan.plugins import Finder, Loaded, not_installed

ENTRY_POINT_GROUP = "cardan.faces"

BUILT_IN = {
    "console": "cardan.gateway.faces.console.face:Console",
    "dds": "cardan.gateway.faces.dds:Dds",
    "metrics": "cardan.gateway.daemon.metrics:Metrics",
    "recorder": "cardan.gateway.recording.face:RecorderFace",
    "rosbridge": "cardan.gateway.faces.rosbridge:Rosbridge",
    "router": "cardan.gateway.faces.router:Router",
}
"""Our own faces. Other packages add theirs by an entry point of the same form."""

IN_SOURCE_TREE = {"foxglove": "plugins/cardan-foxglove"}
"""Faces of distributions that only the source tree has, and the folders of those."""


def _installed() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)


# mypy wants a class that can be instantiated; a Finder only compares with it.
_FINDER: Finder[Face[Any]] = Finder(Face, "face", BUILT_IN, _installed)  # type: ignore[type-abstract]


def names() -> tuple[str, ...]:
    """Every name of a face that can be loaded, sorted."""
    return _FINDER.names()


def load(name: str) -> type[Face[Any]]:
    """The declaration of the face called `name`; ConfigurationError names the ones there are, or
    says what installs it."""
    folder = IN_SOURCE_TREE.get(name)
    if folder is not None and name not in names():
        raise not_installed("face", repr(name), folder)
    return _FINDER.load(name)


def load_all() -> Loaded[Face[Any]]:
    """Every face class, and why others cannot be loaded."""
    return _FINDER.load_all()


def using(name: str, key: str) -> AbstractContextManager[None]:
    """What another package's face raises inside is a ConfigurationError of `key`."""
    return _FINDER.using(name, key)
