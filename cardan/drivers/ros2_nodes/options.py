"""Options of the drivers of nodes that read operator devices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common.bounds import Range
from cardan.common.options import require
from cardan.drivers.node_options import NodeOptions, require_name
from cardan.drivers.shaping import ShapingOptions

STALE_AFTER_S = Range(0.1, 1.0, "s", "a node that is dead moves the arm for so long")
FULL_SCALE = Range(0.01, 1000.0, "", "no node's numbers are larger")
AXIS = Range(-32, 32, "", "no message has more axes")

Six = tuple[int, int, int, int, int, int]
"""Index of the message's axis, from 1, for x, y, z, roll, pitch and yaw; negative: inverted; 0:
none."""

LAYOUTS: dict[str, tuple[Six, Six]] = {
    "spacenav": ((1, 2, 3, 4, 5, 6), (1, 2, 3, 4, 5, 6)),
    "joy_node": ((2, 1, 5, 0, 0, 4), (0, 0, 5, -1, 2, 4)),
    "game_controller": ((2, 1, 4, 0, 0, 3), (0, 0, 4, -1, 2, 3)),
}
"""Axes without and with the shift button held. spacenav_node uses ROS's axes, joy_node a pad's in
Linux's order (Xbox: left stick, left trigger, right stick, ...), game_controller_node its own
order; both have left and up positive."""

SHIFTS = {"spacenav": "", "joy_node": "button-5", "game_controller": "button-10"}
"""Shift button: the right shoulder."""


@dataclass(frozen=True, kw_only=True)
class JoyOptions(NodeOptions, ShapingOptions):
    """Options that both nodes' drivers share."""

    topic: str = "/joy"
    """Topic of sensor_msgs/Joy."""
    name: str = "cardan_device_driver"
    """Name of this driver's node."""
    full_scale: Annotated[float, FULL_SCALE] = 1.0
    """The node's number at full deflection."""
    stale_after_s: Annotated[float, STALE_AFTER_S] = 0.2
    """Silence of the node after which it counts as dead."""
    wait_for_device: bool = False
    """open() succeeds without the node, which is found once it runs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_name("topic", self.topic, self.topic)
        require_name("name", self.name, f"/{self.name}")

    @property
    def mapped(self) -> tuple[Six, Six]:
        """Axes without and with the shift button."""
        return LAYOUTS["spacenav"]

    @property
    def shift_button(self) -> str:
        """Button to hold for the other axes; empty if there is none."""
        return ""


@dataclass(frozen=True, kw_only=True)
class Ros2SpacenavOptions(JoyOptions):
    """Options of :class:`Ros2Spacenav`."""

    topic: str = "/spacenav/joy"
    """sensor_msgs/Joy of spacenav_node: six axes and the buttons in one message."""
    full_scale: Annotated[float, FULL_SCALE] = 0.68
    """The node's number at full deflection: most devices' 350 counts divided by its parameter
    full_scale, 512."""
    stale_after_s: Annotated[float, STALE_AFTER_S] = 0.1
    """Silence of the node after which it counts as dead; at rest it publishes every 30 ms."""


@dataclass(frozen=True, kw_only=True)
class Ros2JoyOptions(JoyOptions):
    """Options of :class:`Ros2Joy`."""

    layout: Literal["joy_node", "game_controller"] = "joy_node"
    """Order of axes, by node: left stick x and y, right stick z and yaw."""
    axes: tuple[Annotated[int, AXIS], ...] = ()
    """Indices of the message's axes for x, y, z, roll, pitch and yaw, from 1; negative: inverted;
    0: none. Empty: by `layout`."""
    shift: str = ""
    """Button to hold for roll and pitch on the left stick; empty: the right shoulder by `layout`,
    or none if `axes` are given."""
    feedback_topic: str = "/joy/set_feedback"
    """Topic of sensor_msgs/JoyFeedback for rumble; empty: no feedback."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.axes) in (0, 6), "axes", self.axes, "six numbers, or none")
        if self.feedback_topic:
            require_name("feedback_topic", self.feedback_topic, self.feedback_topic)

    @property
    def mapped(self) -> tuple[Six, Six]:
        if self.axes:
            x, y, z, roll, pitch, yaw = self.axes
            given = x, y, z, roll, pitch, yaw
            return given, (0, 0, z, -y, x, yaw) if self.shift else given
        return LAYOUTS[self.layout]

    @property
    def shift_button(self) -> str:
        return self.shift or ("" if self.axes else SHIFTS[self.layout])
