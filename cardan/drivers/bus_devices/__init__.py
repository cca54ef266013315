"""Operator devices whose messages come on the bus: phones, headsets, and what ROS 2 nodes read."""

from cardan.drivers.bus_devices.device import (
    Phone as Phone,
    Ros2Joy as Ros2Joy,
    Ros2Spacenav as Ros2Spacenav,
    Xr as Xr,
)
