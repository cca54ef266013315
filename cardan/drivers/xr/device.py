"""The driver of a hand, or of a phone with AR, whose page sends its pose."""

from __future__ import annotations

from typing import Any, ClassVar

from cardan.drivers.handheld import HandheldDevice, XrOptions
from cardan.drivers.handheld.core import XrCore
from cardan.drivers.node_options import SIMULATED_LISTEN
from cardan.drivers.simulated import OWN


class Xr(HandheldDevice[XrCore]):
    """A headset's controller, or a phone with AR, by the console's page in its browser."""

    Options: ClassVar[type[XrOptions]] = XrOptions
    summary = "headset controllers and phones with AR (WebXR), by the console's page"
    page = "xr.md"
    peer = "xr"
    simulated = ({"port": OWN, "zenoh_config": ("",), "listen": (SIMULATED_LISTEN,)},)
    gives, suits = "pose of the hand, buttons", "position, base frame"
    takes_back = "vibration"
    options: XrOptions
    _kind = "headset"

    def __init__(self, options: XrOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = XrCore(self.options)
