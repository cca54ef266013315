"""The simulated stock nodes as ``cardan sim ros2-device`` has them."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.ros2_device.core import FAULTS
from cardan.sim_peers.ros2_device.peer import NodePeer, NodePeerOptions
from cardan.sim_peers.spacemouse.hand import SCRIPT_VERBS, SCRIPTS


class Ros2Device(PeerCommand[NodePeerOptions]):
    """ROS 2's spacenav_node, joy_node or game_controller_node with a device (rmw_zenoh)."""

    Options, Peer = NodePeerOptions, NodePeer
    page = "simulated-devices.md"
    speaks = "[ROS 2](protocols/ros2.md), Zenoh"
    epilog = "Prints READY and the Zenoh endpoint that others connect to once it serves."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
