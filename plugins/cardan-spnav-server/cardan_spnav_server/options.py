"""Options of the spacenavd-compatible socket."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.options import Options, suggestion
from cardan.errors import OptionError
from cardan.protocols.connexion.devices import MODELS
from cardan.protocols.spnav.codes import DEFAULT_SOCKET
from cardan_spnav_server.identity import DeviceIdentity, identity_behind_bus


@dataclass(frozen=True, kw_only=True)
class SpnavServerOptions(Options):
    """Options of the server. Raises OptionError for a value that is not allowed."""

    socket: Annotated[str, bounds.SOCKET_PATH, bounds.MEETING] = DEFAULT_SOCKET
    """Path of the socket to create; programs use this path, or that in SPNAV_SOCKET."""
    access: Literal["owner", "everybody"] = "owner"
    """Users that may connect: the server's own (mode 0600), or all of this machine (0666)."""
    full_scale: Annotated[float, bounds.COUNTS] | None = None
    """Counts that programs get for a full deflection; None: spacenavd's for the device's model, 350
    if that is unknown."""
    name: str = ""
    """Name of the device for programs; empty: its model's, or "Cardan" if that is unknown."""
    model: str = ""
    """Key of the 3Dconnexion model that a session publishes on the bus without its name, such as
    "spacemouse-pro": programs get its identity and spacenavd's numbers of its buttons. Empty: the
    driver's model."""

    def __post_init__(self) -> None:
        super().__post_init__()
        keys = [model.key for model in MODELS]
        if self.model and self.model not in keys:
            near = suggestion(self.model, keys)
            raise OptionError("model", self.model, f"empty or one of {', '.join(keys)}{near}")

    @property
    def identity(self) -> DeviceIdentity | None:
        """Identity for programs by `model`; None: no model is given."""
        return identity_behind_bus(self.model, self.name) if self.model else None
