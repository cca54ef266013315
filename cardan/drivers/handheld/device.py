"""The drivers' part that is on the bus."""

from __future__ import annotations

from typing import TypeVar

from cardan.drivers.handheld.core import HandheldCore
from cardan.drivers.handheld.options import HandheldOptions
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
            f"no page publishes {self.options.topic}: start `cardan face console`, and open its "
            f"page on the {self._kind}"
        )

    def _why_gone(self) -> str:
        return "the page was closed, or has lost its connection"
