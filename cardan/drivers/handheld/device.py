"""The drivers of hands that a page of the console shows: phones, headsets' controllers."""

from __future__ import annotations

from typing import Any, ClassVar, TypeVar

from cardan.drivers.handheld.core import HandheldCore, PhoneCore, XrCore
from cardan.drivers.handheld.options import HandheldOptions, PhoneOptions, XrOptions
from cardan.drivers.node_options import SIMULATED
from cardan.drivers.ros2_nodes import RumblingDevice
from cardan.types import DeviceCapabilities

H = TypeVar("H", bound=HandheldCore)


class HandheldDevice(RumblingDevice[H]):
    """A hand that a page of the console shows."""

    options: HandheldOptions
    _gives_inertia = False

    @property
    def capabilities(self) -> DeviceCapabilities:
        """A pose and deflections, whichever the mapping takes; pages vibrate."""
        return DeviceCapabilities(
            gives_pose=True,
            buttons=self._core.labels,
            feedback=frozenset({"rumble"}),
            battery=False,
            gives_inertia=self._gives_inertia,
        )

    @property
    def _feedback_topic(self) -> str:
        return f"{self.options.topic}/feedback"

    def _why_missing(self) -> str:
        return (
            f"no page publishes {self.options.topic}: start `cardan net server console`, and open "
            f"its page on the {self._kind}"
        )

    def _why_gone(self) -> str:
        return "the page was closed, or has lost its connection"


class Phone(HandheldDevice[PhoneCore]):
    """A phone in the hand, by the console's page in its browser."""

    Options: ClassVar[type[PhoneOptions]] = PhoneOptions
    summary = "phones: orientation and touch, by the console's page"
    page = "phone.md"
    peer = "phone"
    simulated = SIMULATED
    gives, suits = "turns, a finger's drag, inertia", "rate, base frame"
    takes_back = "vibration"
    options: PhoneOptions
    _kind = "phone"
    _gives_inertia = True

    def __init__(self, options: PhoneOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = PhoneCore(self.options)


class Xr(HandheldDevice[XrCore]):
    """A headset's controller, or a phone with AR, by the console's page in its browser."""

    Options: ClassVar[type[XrOptions]] = XrOptions
    summary = "headset controllers and phones with AR (WebXR), by the console's page"
    page = "phone.md"
    peer = "xr"
    simulated = SIMULATED
    gives, suits = "pose of the hand, buttons", "position, base frame"
    takes_back = "vibration"
    options: XrOptions
    _kind = "headset"

    def __init__(self, options: XrOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = XrCore(self.options)
