"""What can be set about the spacenavd driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cardan import bounds
from cardan.drivers.shaping import ShapingOptions


@dataclass(frozen=True, kw_only=True)
class SpnavOptions(ShapingOptions):
    """Options of :class:`Spnav`. Raises OptionError for a value that is not allowed."""

    socket: str = ""
    """Path of the socket; empty: what SPNAV_SOCKET says, else /var/run/spnav.sock."""
    full_scale: Annotated[float, bounds.COUNTS] | None = None
    """Counts of a full deflection; None: what the daemon's device usually gives, 350 or 500."""
    wait_for_device: bool = False
    """open() succeeds without the daemon, which is found once it runs."""
