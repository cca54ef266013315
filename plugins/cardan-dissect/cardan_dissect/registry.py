"""Finds dissectors: the built-in table, then the entry points of installed packages."""

from __future__ import annotations

import logging

from cardan.common.plugins import Finder, entry_points
from cardan_dissect.reader import Dissector

ENTRY_POINT_GROUP = "cardan.dissect"

BUILT_IN = {
    "egm": "cardan_dissect.dissectors.datagrams:Egm",
    "connexion": "cardan_dissect.dissectors.devices:Connexion",
    "joint_stream": "cardan_dissect.dissectors.datagrams:JointStream",
    "simple_message": "cardan_dissect.dissectors.streams:SimpleMessage",
    "rtde": "cardan_dissect.dissectors.streams:Rtde",
}
"""Built-in dissectors. Packets are offered in this order, then to those of other packages by name:
traffic of an EGM port is always EGM's."""


FINDER: Finder[Dissector] = Finder(
    Dissector,  # type: ignore[type-abstract]
    "dissector",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)


def dissectors() -> list[type[Dissector]]:
    """Return all dissectors, in the order in which they are offered packets. A dissector that
    cannot be loaded is skipped, with a warning in the log."""
    found = FINDER.load_all()
    for name, why in found.refused.items():
        logging.getLogger(__name__).warning("dissector %r %s", name, why)
    names = dict.fromkeys((*BUILT_IN, *found.classes))
    return [found.classes[name] for name in names if name in found.classes]
