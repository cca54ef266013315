"""Finds suites by name: the built-in table, then the entry points of installed packages."""

from __future__ import annotations

from typing import Any

from cardan.common.plugins import Finder, entry_points
from cardan.conform.suite import Suite

ENTRY_POINT_GROUP = "cardan.conform"

BUILT_IN = {
    "3dconnexion": "cardan.conform.connexion.suite:Connexion",
    "egm": "cardan.conform.egm.suite:Egm",
    "egm-driver": "cardan.conform.egm_driver.suite:EgmDriver",
    "motoros": "cardan.conform.motoros.suite:Motoros",
    "motoros-driver": "cardan.conform.motoros_driver.suite:MotorosDriver",
    "ur-rtde": "cardan.conform.ur_rtde.suite:UrRtde",
}
"""Our own. Imported when they are asked for: each brings its simulated peer along. Other packages
add theirs by an entry point of the same form."""


FINDER: Finder[Suite[Any]] = Finder(
    Suite,
    "protocol",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
names, load_all = FINDER.names, FINDER.load_all


def load(name: str) -> Suite[Any]:
    """The suite of that name; ConfigurationError names those there are."""
    return FINDER.load(name)()
