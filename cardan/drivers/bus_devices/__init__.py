"""Operator devices read through the bus: phones, headsets, and devices of ROS 2 nodes."""

from cardan.drivers.bus_devices.device import (
    Phone as Phone,
    Ros2Joy as Ros2Joy,
    Ros2Spacenav as Ros2Spacenav,
    Xr as Xr,
)
