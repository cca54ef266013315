"""Finds filters by name: the built-in table, then the entry points of installed packages."""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points

from cardan.errors import ConfigurationError
from cardan.gateway.filters.base import TwistFilter

ENTRY_POINT_GROUP = "cardan.filters"

BUILT_IN = {
    "proximity": "cardan.gateway.filters.proximity:ProximityFilter",
    "camera": "cardan.gateway.filters.camera:CameraFilter",
}
"""Our own filters. Other packages add theirs by an entry point of the same form."""


def names() -> tuple[str, ...]:
    """Every filter name that can be loaded, sorted."""
    return tuple(sorted({*BUILT_IN, *(p.name for p in entry_points(group=ENTRY_POINT_GROUP))}))


def load(name: str) -> type[TwistFilter]:
    """The filter class called `name`; ConfigurationError names the ones there are."""
    target = BUILT_IN.get(name)
    if target is None:
        for point in entry_points(group=ENTRY_POINT_GROUP):
            if point.name == name:
                target = point.value
                break
        else:
            raise ConfigurationError(
                "filter", f"there is no filter {name!r}; allowed: {', '.join(names())}"
            )
    module, _, attribute = target.partition(":")
    loaded = getattr(importlib.import_module(module), attribute)
    if not (isinstance(loaded, type) and issubclass(loaded, TwistFilter)):
        raise ConfigurationError("filter", f"{target} of filter {name!r} is not a cardan filter")
    return loaded
