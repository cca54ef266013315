"""Registry of suites by name: a built-in table, then entry points of installed packages."""

from __future__ import annotations

from typing import Any

from cardan.common.plugins import Finder, entry_points
from cardan.conform.suite import Suite

ENTRY_POINT_GROUP = "cardan.conform"

BUILT_IN = {
    "3dconnexion": "cardan.conform.connexion.suite:ConnexionSuite",
    "egm": "cardan.conform.egm.suite:EgmSuite",
    "egm-driver": "cardan.conform.egm_driver.suite:EgmDriverSuite",
    "motoros": "cardan.conform.motoros.suite:MotorosSuite",
    "motoros-driver": "cardan.conform.motoros_driver.suite:MotorosDriverSuite",
    "ur-rtde": "cardan.conform.ur_rtde.suite:UrRtdeSuite",
}
"""Suites of this package, imported on demand because each brings its simulated peer. Other packages
add theirs by an entry point of the same form."""


FINDER: Finder[Suite[Any]] = Finder(
    Suite,
    "protocol",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
names, load_all = FINDER.names, FINDER.load_all


def load(name: str) -> Suite[Any]:
    """Return the suite of that name. Raises ConfigurationError, which lists the known names."""
    return FINDER.load(name)()
