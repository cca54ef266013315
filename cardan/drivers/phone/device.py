"""The driver of a phone whose page sends its orientation."""

from __future__ import annotations

from typing import Any, ClassVar

from cardan.drivers.handheld import HandheldDevice, PhoneOptions
from cardan.drivers.handheld.core import PhoneCore
from cardan.drivers.node_options import SIMULATED_LISTEN
from cardan.drivers.simulated import OWN


class Phone(HandheldDevice[PhoneCore]):
    """A phone in the hand, by the console's page in its browser."""

    Options: ClassVar[type[PhoneOptions]] = PhoneOptions
    summary = "phones: orientation and touch, by the console's page"
    page = "phone.md"
    peer = "phone"
    simulated = ({"port": OWN, "zenoh_config": ("",), "listen": (SIMULATED_LISTEN,)},)
    gives, suits = "turns, a finger's drag, inertia", "rate, base frame"
    takes_back = "vibration"
    options: PhoneOptions
    _kind = "phone"
    _gives_inertia = True

    def __init__(self, options: PhoneOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = PhoneCore(self.options)
