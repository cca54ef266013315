"""Finds filters by name: the built-in table, then the entry points of installed packages."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from importlib.metadata import EntryPoints, entry_points
from typing import Any

from cardan.gateway.hand.filters.base import TwistFilter
from cardan.options import Options
from cardan.plugins import Finder, Loaded
from cardan.tables import OTHER_KEYS

ENTRY_POINT_GROUP = "cardan.filters"

BUILT_IN = {
    "proximity": "cardan.gateway.hand.filters.proximity:ProximityFilter",
    "camera": "cardan.gateway.hand.filters.camera:CameraFilter",
}
"""Our own filters. Other packages add theirs by an entry point of the same form."""


@dataclass(frozen=True)
class FilterTable(Options):
    """A filter's name; all other keys of the table are that filter's options."""

    filter: str
    options: Mapping[str, Any] = field(default_factory=dict, metadata=OTHER_KEYS)


def _installed() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)


# mypy wants a class that can be instantiated; a Finder only compares with it.
_FINDER: Finder[TwistFilter] = Finder(TwistFilter, "filter", BUILT_IN, _installed)  # type: ignore[type-abstract]


def names() -> tuple[str, ...]:
    """Every filter name that can be loaded, sorted."""
    return _FINDER.names()


def load(name: str) -> type[TwistFilter]:
    """The filter class called `name`; ConfigurationError names the ones there are."""
    return _FINDER.load(name)


def load_all() -> Loaded[TwistFilter]:
    """Every filter class, and why others cannot be loaded."""
    return _FINDER.load_all()


def using(name: str, key: str) -> AbstractContextManager[None]:
    """What another package's filter raises inside is a ConfigurationError of `key`."""
    return _FINDER.using(name, key)
