"""Finds drivers by name: the built-in table, then the entry points of installed packages."""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points

from cardan.drivers.base import Driver
from cardan.errors import ConfigurationError

ENTRY_POINT_GROUP = "cardan.drivers"

BUILT_IN = {
    "spacemouse": "cardan.drivers.spacemouse:SpaceMouse",
    "abb_egm": "cardan.drivers.abb_egm:AbbEgm",
    "sim_arm": "cardan.drivers.sim_arm:SimArm",
}
"""Our own drivers. Other packages add theirs by an entry point of the same form."""


def names() -> tuple[str, ...]:
    """Every driver name that can be loaded, sorted."""
    return tuple(sorted({*BUILT_IN, *(p.name for p in entry_points(group=ENTRY_POINT_GROUP))}))


def load(name: str) -> type[Driver]:
    """The driver class called `name`; ConfigurationError names the ones there are."""
    target = BUILT_IN.get(name)
    if target is None:
        for point in entry_points(group=ENTRY_POINT_GROUP):
            if point.name == name:
                target = point.value
                break
        else:
            raise ConfigurationError(
                "driver", f"there is no driver {name!r}; allowed: {', '.join(names())}"
            )
    module, _, attribute = target.partition(":")
    loaded = getattr(importlib.import_module(module), attribute)
    if not (isinstance(loaded, type) and issubclass(loaded, Driver)):
        raise ConfigurationError("driver", f"{target} of driver {name!r} is not a cardan driver")
    return loaded
