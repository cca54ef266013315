"""Statistics line in a server's output for the daemon that runs it.

A server that runs in a terminal prints none.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping

TELLS_VARIABLE = "CARDAN_SERVER_TELLS"
"""The environment variable by which the daemon requests statistics."""

PERIOD_S = 1.0
"""Period of printing figures that have changed."""

ROUND_TRIP = "round_trip_us"
"""Figure with the slowest client's newest round trip of a ping."""

MOST_FIGURES = 64
"""Largest number of figures of a server; others are left out."""

_WORD = "FIGURES "


def is_wanted() -> bool:
    """True if a daemon reads them."""
    return bool(os.environ.get(TELLS_VARIABLE))


def tell(figures: Mapping[str, int]) -> None:
    """Print figures by name: "clients" is the number of connected clients, "round_trip_us" the
    round trip of the slowest; all others only grow."""
    print(_WORD + json.dumps(figures), flush=True)


def figures_of(line: str) -> dict[str, int] | None:
    """Return the figures of a line; None: it is another line."""
    if not line.startswith(_WORD):
        return None
    try:
        table = json.loads(line.removeprefix(_WORD))
    except (ValueError, RecursionError):
        return None
    if not isinstance(table, dict):
        return None
    whole = ((name, value) for name, value in table.items() if type(value) is int)
    return dict(list(whole)[:MOST_FIGURES])
