"""A gamepad that ROS 2's joy_node or game_controller_node reads."""

from cardan.drivers.ros2_joy.device import Ros2Joy as Ros2Joy
from cardan.drivers.ros2_nodes import Ros2JoyOptions as Ros2JoyOptions
