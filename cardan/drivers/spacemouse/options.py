"""What can be set about the SpaceMouse driver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from cardan.protocols.connexion import MODELS

TRANSPORTS = ("auto", "hidraw", "libusb", "socket")
DEAD_ZONE_SHAPES = ("axis", "radial")
LED_POLICIES = ("keep", "on", "off")
_MODEL_KEYS = ("", *(model.key for model in MODELS))


@dataclass(frozen=True, kw_only=True)
class SpaceMouseOptions:
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
    dead_zone: float = 0.05
    """Share of the full scale that counts as rest, 0 to below 1; the rest is rescaled to 0..1."""
    dead_zone_shape: Literal["axis", "radial"] = "axis"
    """axis: each axis by itself; radial: the lengths of translation and rotation."""
    curve: float = 0.0
    """Response: 0 linear to 1 cubic, which gives fine control near rest."""
    translation: bool = True
    """False: translation is locked at zero."""
    rotation: bool = True
    """False: rotation is locked at zero."""
    dominant_axis: bool = False
    """Only the axis that is deflected most acts."""
    led: Literal["keep", "on", "off"] = "keep"
    """What the LED shows from opening until the gateway says otherwise."""
    wait_for_device: bool = False
    """open() succeeds without a device, which is picked up once it is plugged in."""

    def __post_init__(self) -> None:
        for name, allowed in (
            ("transport", TRANSPORTS),
            ("dead_zone_shape", DEAD_ZONE_SHAPES),
            ("led", LED_POLICIES),
            ("model", _MODEL_KEYS),
        ):
            value = getattr(self, name)
            if value not in allowed:
                words = ", ".join(word for word in allowed if word)
                raise ValueError(f"{name} is {value!r}; allowed: {words}")
        if not 0.0 <= self.dead_zone < 1.0:
            raise ValueError(f"dead_zone is {self.dead_zone!r}; allowed: from 0 to below 1")
        if not 0.0 <= self.curve <= 1.0:
            raise ValueError(f"curve is {self.curve!r}; allowed: from 0 (linear) to 1 (cubic)")
        if self.full_scale is not None and not (
            self.full_scale > 0.0 and math.isfinite(self.full_scale)
        ):
            raise ValueError(
                f"full_scale is {self.full_scale!r}; allowed: a number of counts above 0"
            )
        if self.transport == "socket" and not self.path:
            raise ValueError("path is ''; transport 'socket' needs the path of the socket")
