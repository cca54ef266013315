"""Options of the spacenavd-compatible socket."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan import bounds
from cardan.options import Options
from cardan.protocols.spnav import DEFAULT_SOCKET


@dataclass(frozen=True, kw_only=True)
class SpnavServerOptions(Options):
    """Options of the server. Raises OptionError for a value that is not allowed."""

    socket: Annotated[str, bounds.SOCKET_PATH] = DEFAULT_SOCKET
    """Path of the socket to create; programs look there, or where SPNAV_SOCKET says."""
    access: Literal["owner", "everybody"] = "owner"
    """Who may connect: the user who serves (mode 0600), or every user of this machine (0666)."""
    full_scale: Annotated[float, bounds.COUNTS] | None = None
    """Counts that programs get for a full deflection; None: as many as spacenavd gives of the
    device's model, 350 where that is not known."""
    name: str = ""
    """Name of the device that programs are told; empty: its model's, "Cardan" where that is not
    known."""
