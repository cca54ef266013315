"""Options of the drivers of phones and headsets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common.bounds import Range
from cardan.drivers.node_options import NodeOptions, require_name
from cardan.drivers.shaping import ShapingOptions

STALE_AFTER_S = Range(0.1, 0.3, "s", "a page that is dead moves the arm for so long")
FULL_TURN_DEG = Range(5.0, 90.0, "°", "smaller is noise, and no wrist turns further")
FULL_WAY_M = Range(0.01, 0.5, "m", "smaller is noise, and no arm reaches further")
GRIP_DEG = Range(-90.0, 90.0, "°", "beyond it a hand points backwards")


@dataclass(frozen=True, kw_only=True)
class HandheldOptions(NodeOptions, ShapingOptions):
    """Options that the drivers of phones and of headsets share."""

    topic: str = "/hand"
    """cardan_msgs/OperatorFrame, as `cardan net server console` publishes what pages send."""
    name: str = "cardan_device_driver"
    """Name of this driver's node."""
    heading: Literal["asked", "each hold"] = "asked"
    """Robot's x axis in the device's reference. "asked": where it pointed when *Align* was pressed,
    once for each page. "each hold": where it points at the begin of each hold."""
    full_turn_deg: Annotated[float, FULL_TURN_DEG] = 30.0
    """Rotation since the begin of the hold that is a full deflection, in rate mode."""
    stale_after_s: Annotated[float, STALE_AFTER_S] = 0.15
    """Age of the newest frame at which the device counts as lost."""
    wait_for_device: bool = False
    """open() succeeds without a page, which is found once it is there."""

    @property
    def feedback_topic(self) -> str:
        """sensor_msgs/JoyFeedback topic, which the page shows as vibration."""
        return f"{self.topic}/feedback"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_name("topic", self.topic, self.topic)
        require_name("name", self.name, f"/{self.name}")


@dataclass(frozen=True, kw_only=True)
class PhoneOptions(HandheldOptions):
    """Options of :class:`Phone`."""

    topic: str = "/phone"
    """cardan_msgs/OperatorFrame, as `cardan net server console` publishes what pages send."""
    drag_m: Annotated[float, FULL_WAY_M] = 0.1
    """Translation of the device for a drag of the second finger over a third of the screen, in
    position mode."""


@dataclass(frozen=True, kw_only=True)
class XrOptions(HandheldOptions):
    """Options of :class:`Xr`."""

    topic: str = "/xr"
    """cardan_msgs/OperatorFrame, as `cardan net server console` publishes what pages send."""
    part: Literal["right", "left", "viewer"] = "right"
    """Hand that holds the controller; "viewer": the phone or headset itself, such as a phone with
    AR."""
    full_way_m: Annotated[float, FULL_WAY_M] = 0.1
    """Translation since the begin of the hold that is a full deflection, in rate mode."""
    grip_deg: Annotated[float, GRIP_DEG] = 0.0
    """Angle by which the device points below the grip's axis; 45 is the natural grip of most
    controllers."""
