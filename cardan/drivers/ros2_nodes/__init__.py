"""Interpreters of messages from nodes that read operator devices: a 3D mouse, gamepads. Their
drivers are in :mod:`cardan.drivers.bus_devices`."""

from cardan.drivers.ros2_nodes.core import BusCore as BusCore, JoyCore as JoyCore
from cardan.drivers.ros2_nodes.options import (
    Ros2JoyOptions as Ros2JoyOptions,
    Ros2SpacenavOptions as Ros2SpacenavOptions,
)
