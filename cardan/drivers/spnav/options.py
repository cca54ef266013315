"""Options of the spacenavd driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.drivers.shaping import ShapingOptions

STALE_AFTER_S = bounds.Range(
    0.1,
    1.0,
    "s",
    "the slowest devices report each 0.06 s, and a device that is dead moves the arm for so long",
)


@dataclass(frozen=True, kw_only=True)
class SpnavOptions(ShapingOptions):
    """Options of :class:`Spnav`. Raises OptionError for a value that is not allowed."""

    socket: Annotated[str, bounds.MEETING] = ""
    """Path of the socket; empty: SPNAV_SOCKET, or else /var/run/spnav.sock."""
    full_scale: Annotated[float, bounds.COUNTS] | None = None
    """Counts at full deflection; None: the usual value of the daemon's device, 350 or 500."""
    stale_after_s: Annotated[float, STALE_AFTER_S] = 0.1
    """Silence of a deflected device after which it counts as dead, s. The default suits every
    device read in the usual way; serial devices held steadily need more, and the arm continues for
    that long when the device dies."""
    wait_for_device: bool = False
    """open() succeeds without the daemon, which is found once it runs."""
