"""Operator devices that nodes of a ROS 2 system read: a 3D mouse, gamepads."""

from cardan.drivers.ros2_nodes.core import BusCore as BusCore, JoyCore as JoyCore
from cardan.drivers.ros2_nodes.device import (
    Ros2Joy as Ros2Joy,
    Ros2Spacenav as Ros2Spacenav,
    RumblingDevice as RumblingDevice,
)
from cardan.drivers.ros2_nodes.options import (
    Ros2JoyOptions as Ros2JoyOptions,
    Ros2SpacenavOptions as Ros2SpacenavOptions,
)
