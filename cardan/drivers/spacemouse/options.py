"""Options of the SpaceMouse driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.options import require, suggestion
from cardan.drivers.shaping import ShapingOptions
from cardan.protocols.connexion.devices import MODELS

_MODEL_KEYS = tuple(model.key for model in MODELS)


@dataclass(frozen=True, kw_only=True)
class MouseOptions(ShapingOptions):
    """Options of all 3Dconnexion devices, whatever their connection. Raises OptionError."""

    full_scale: Annotated[float, bounds.COUNTS] | None = None
    """Counts at full deflection; None: from the report descriptor, or else the model's."""
    wait_for_device: bool = False
    """open() succeeds without a device, which is picked up once it is plugged in."""


@dataclass(frozen=True, kw_only=True)
class SpaceMouseOptions(MouseOptions):
    """Options of :class:`SpaceMouse`. Raises OptionError for a value that is not allowed."""

    transport: Literal["auto", "hidraw", "libusb", "usb", "socket"] = "auto"
    """auto: hidraw, then libusb. usb: raw USB, where there is no HID. socket: a simulated device,
    one raw HID report per packet."""
    path: Annotated[str, bounds.MEETING] = ""
    """Path of the device as ``cardan devices`` lists it, a link to it, or the socket's; empty: the
    first found."""
    model: str = ""
    """Key of the model to open ("spacemouse-compact"); for a socket, the simulated model, for the
    labels of its buttons and its full scale. Empty: any."""
    serial: str = ""
    """Serial number of the device to open (most have none). Empty: any."""
    port: str = ""
    """USB port of the device to open ("1-2.3", as in /sys/bus/usb/devices). Empty: any."""
    slot: Literal["", "0", "1", "2", "3", "4"] = ""
    """Interface of a receiver on which the device sends. Empty: the first that sends."""
    led: Literal["keep", "on", "off"] = "keep"
    """State of the LED from opening until the gateway sets it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        good = not self.model or self.model in _MODEL_KEYS
        near = suggestion(self.model, _MODEL_KEYS)
        require(good, "model", self.model, f"empty or one of {', '.join(_MODEL_KEYS)}{near}")
        if self.transport == "socket":
            way = "for transport 'socket'"
            require(self.path, "path", self.path, f"the path of the socket {way}")
            for name in ("port", "slot"):
                value = getattr(self, name)
                require(not value, name, value, f"empty {way}: its path tells devices apart")
