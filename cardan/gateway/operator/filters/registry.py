"""Finds filters by name: the built-in table, then the entry points of installed packages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cardan.common.options import OTHER_KEYS, Options
from cardan.common.plugins import Finder, entry_points
from cardan.gateway.operator.filters.base import TwistFilter

ENTRY_POINT_GROUP = "cardan.filters"

BUILT_IN = {
    "proximity": "cardan.gateway.operator.filters.proximity:ProximityFilter",
    "camera": "cardan.gateway.operator.filters.camera:CameraFilter",
}
"""Our own filters. Other packages add theirs by an entry point of the same form."""


@dataclass(frozen=True)
class FilterTable(Options):
    """A filter's name; all other keys of the table are that filter's options."""

    filter: str
    options: Mapping[str, Any] = field(default_factory=dict, metadata=OTHER_KEYS)

    @classmethod
    def kind_of_others(cls, table: Mapping[str, Any]) -> Any:
        """The options of the table's filter; None where that cannot be loaded."""
        return FINDER.options_of(table.get("filter", ""))


FINDER: Finder[TwistFilter] = Finder(
    TwistFilter,  # type: ignore[type-abstract]
    "filter",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
names, load, load_all, using = FINDER.names, FINDER.load, FINDER.load_all, FINDER.using
