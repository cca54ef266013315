"""Operator devices that nodes of a ROS 2 system read: what their drivers share."""

from cardan.drivers.ros2_nodes.core import BusCore as BusCore, JoyCore as JoyCore
from cardan.drivers.ros2_nodes.device import (
    NodeDevice as NodeDevice,
    RumblingDevice as RumblingDevice,
)
from cardan.drivers.ros2_nodes.options import (
    JoyOptions as JoyOptions,
    Ros2JoyOptions as Ros2JoyOptions,
    Ros2SpacenavOptions as Ros2SpacenavOptions,
)
