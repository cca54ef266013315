"""A 3D mouse that ROS 2's spacenav_node reads."""

from cardan.drivers.ros2_nodes import Ros2SpacenavOptions as Ros2SpacenavOptions
from cardan.drivers.ros2_spacenav.device import Ros2Spacenav as Ros2Spacenav
