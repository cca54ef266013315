"""Standard ROS 2 nodes with a simulated operator device: spacenav_node, joy_node."""

from cardan.sim_peers.ros2_device.core import SimulatedNode as SimulatedNode
from cardan.sim_peers.ros2_device.peer import (
    NodePeer as NodePeer,
    NodePeerOptions as NodePeerOptions,
)
