"""The driver of a gamepad that ROS 2's joy_node or game_controller_node reads."""

from __future__ import annotations

from typing import ClassVar

from cardan.drivers.node_options import SIMULATED_LISTEN
from cardan.drivers.ros2_nodes import JoyCore, NodeDevice, RumblingDevice
from cardan.drivers.ros2_nodes.options import Ros2JoyOptions
from cardan.drivers.simulated import OWN
from cardan.types import DeviceCapabilities


class Ros2Joy(NodeDevice, RumblingDevice[JoyCore]):
    """A gamepad or joystick that ROS 2's joy_node or game_controller_node reads."""

    Options: ClassVar[type[Ros2JoyOptions]] = Ros2JoyOptions
    summary = "gamepads by ROS 2's joy_node or game_controller_node"
    page = "ros2-joy.md"
    peer = "ros2-device"
    simulated = ({"port": OWN, "zenoh_config": ("",), "listen": (SIMULATED_LISTEN,)},)
    gives, suits = "sticks, buttons", "rate, base frame"
    takes_back = "rumble"
    options: Ros2JoyOptions
    _kind = "gamepad"
    _node_name = "joy_node or game_controller_node"
    _touch = "press any button once"

    @property
    def capabilities(self) -> DeviceCapabilities:
        able = super().capabilities
        return able._replace(feedback=frozenset({"rumble"} if self.options.feedback_topic else ()))

    @property
    def _feedback_topic(self) -> str:
        return self.options.feedback_topic
