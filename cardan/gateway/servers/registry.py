"""Finds servers by name: the built-in table, then installed packages' entry points."""

from __future__ import annotations

from typing import Any

from cardan.common.plugins import Finder, entry_points
from cardan.gateway.servers.base import Server

ENTRY_POINT_GROUP = "cardan.servers"

BUILT_IN = {
    "console": "cardan.gateway.servers.console.server:Console",
    "metrics": "cardan.gateway.daemon.metrics:Metrics",
    "recorder": "cardan.recording.server:RecorderServer",
    "rosbridge": "cardan.gateway.servers.rosbridge:Rosbridge",
    "router": "cardan.gateway.servers.router:Router",
}
"""Built-in servers. Other packages add theirs by an entry point of the same form."""


FINDER: Finder[Server[Any]] = Finder(
    Server,  # type: ignore[type-abstract]
    "server",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
names, load, load_all, using = FINDER.names, FINDER.load, FINDER.load_all, FINDER.using
