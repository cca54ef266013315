"""A simulated arm under ros2_control: joint states, controllers and a description, on the bus."""

from cardan.sim_peers.ros2_arm.controllers import RosArm as RosArm
from cardan.sim_peers.ros2_arm.options import RosArmOptions as RosArmOptions
from cardan.sim_peers.ros2_arm.peer import RosArmPeer as RosArmPeer
