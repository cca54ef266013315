"""The driver of a 3D mouse that ROS 2's spacenav_node reads."""

from __future__ import annotations

from typing import ClassVar

from cardan.drivers.node_options import SIMULATED_LISTEN
from cardan.drivers.ros2_nodes import NodeDevice
from cardan.drivers.ros2_nodes.options import Ros2SpacenavOptions
from cardan.drivers.simulated import OWN


class Ros2Spacenav(NodeDevice):
    """A 3D mouse that ROS 2's spacenav_node reads."""

    Options: ClassVar[type[Ros2SpacenavOptions]] = Ros2SpacenavOptions
    summary = "3D mice by ROS 2's spacenav_node"
    page = "ros2-spacenav.md"
    peer = "ros2-device"
    simulated = ({"port": OWN, "zenoh_config": ("",), "listen": (SIMULATED_LISTEN,)},)
    gives, suits = "six deflections, buttons", "rate, base or tool frame"
    options: Ros2SpacenavOptions
    _kind = "3D mouse"
    _node_name = "spacenav_node"
    _touch = "touch the cap and let go once"
