"""What can be set about the SpaceMouse driver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from cardan.drivers.shaping import ShapingOptions, check_choice
from cardan.protocols.connexion import MODELS

TRANSPORTS = ("auto", "hidraw", "libusb", "socket")
LED_POLICIES = ("keep", "on", "off")
_MODEL_KEYS = ("", *(model.key for model in MODELS))


@dataclass(frozen=True, kw_only=True)
class SpaceMouseOptions(ShapingOptions):
    """Options of :class:`SpaceMouse`. Raises ValueError for a value that is not allowed."""

    transport: Literal["auto", "hidraw", "libusb", "socket"] = "auto"
    """auto: hidraw, then libusb. socket: a simulated device, one raw HID report per packet."""
    path: str = ""
    """The device's path as ``cardan devices`` lists it, or the socket's; empty: the first found."""
    model: str = ""
    """Key of the model to open ("spacemouse-compact"); for a socket, what is behind it, where
    that matters: labels of its buttons and its full scale. Empty: any."""
    serial: str = ""
    """Serial number of the device to open; most have none. Empty: any."""
    full_scale: float | None = None
    """Counts of a full deflection; None: from the report descriptor, else the model's."""
    led: Literal["keep", "on", "off"] = "keep"
    """What the LED shows from opening until the gateway says otherwise."""
    wait_for_device: bool = False
    """open() succeeds without a device, which is picked up once it is plugged in."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, allowed in (
            ("transport", TRANSPORTS),
            ("led", LED_POLICIES),
            ("model", _MODEL_KEYS),
        ):
            check_choice(name, getattr(self, name), allowed)
        if self.full_scale is not None and not (
            self.full_scale > 0.0 and math.isfinite(self.full_scale)
        ):
            raise ValueError(
                f"full_scale is {self.full_scale!r}; allowed: a number of counts above 0"
            )
        if self.transport == "socket" and not self.path:
            raise ValueError("path is ''; transport 'socket' needs the path of the socket")
