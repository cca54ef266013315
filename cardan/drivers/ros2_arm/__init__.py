"""Any arm of a ROS 2 system: receives joint states, commands its ros2_control controllers."""

from cardan.drivers.ros2_arm.driver import Ros2Arm as Ros2Arm
from cardan.drivers.ros2_arm.options import Ros2ArmOptions as Ros2ArmOptions
from cardan.drivers.ros2_arm.session import Ros2ArmSession as Ros2ArmSession
