"""Finds faces by name: the built-in table, then installed packages' entry points."""

from __future__ import annotations

from typing import Any

from cardan.common.plugins import Finder, entry_points
from cardan.gateway.servers.base import Face

ENTRY_POINT_GROUP = "cardan.faces"

BUILT_IN = {
    "console": "cardan.gateway.servers.console.face:Console",
    "metrics": "cardan.gateway.daemon.metrics:Metrics",
    "recorder": "cardan.recording.face:RecorderFace",
    "rosbridge": "cardan.gateway.servers.rosbridge:Rosbridge",
    "router": "cardan.gateway.servers.router:Router",
}
"""Our own faces. Other packages add theirs by an entry point of the same form."""


FINDER: Finder[Face[Any]] = Finder(
    Face,  # type: ignore[type-abstract]
    "face",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
names, load, load_all, using = FINDER.names, FINDER.load, FINDER.load_all, FINDER.using
