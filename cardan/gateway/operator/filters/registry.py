"""Finds filters by name: by the entry points of installed packages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cardan.common.options import OTHER_KEYS, Options
from cardan.common.plugins import Finder, entry_points
from cardan.gateway.operator.filters.base import TwistFilter

ENTRY_POINT_GROUP = "cardan.filters"

BUILT_IN: dict[str, str] = {}
"""Filters in this package: none; two published ones are in plugins/cardan-filters."""


@dataclass(frozen=True)
class FilterTable(Options):
    """A filter's name; all other keys of the table are that filter's options."""

    filter: str
    options: Mapping[str, Any] = field(default_factory=dict, metadata=OTHER_KEYS)

    @classmethod
    def kind_of_others(cls, table: Mapping[str, Any]) -> Any:
        """Return the options of the table's filter; None if it cannot be loaded."""
        return FINDER.options_of(table.get("filter", ""))


FINDER: Finder[TwistFilter] = Finder(
    TwistFilter,  # type: ignore[type-abstract]
    "filter",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
names, load, load_all, using = FINDER.names, FINDER.load, FINDER.load_all, FINDER.using
