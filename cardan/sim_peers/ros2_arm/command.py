"""The simulated ROS 2 arm as ``cardan sim ros2-arm`` has it."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.ros2_arm.options import FAULTS, RosArmOptions
from cardan.sim_peers.ros2_arm.peer import RosArmPeer


class Ros2Arm(PeerCommand[RosArmOptions]):
    """An arm under ros2_control: joint states, a controller, a description (rmw_zenoh or DDS)."""

    Options, Peer = RosArmOptions, RosArmPeer
    page = "simulated-peers.md"
    speaks = "[ROS 2](protocols/ros2.md), Zenoh or DDS, 100 Hz"
    epilog = (
        "Prints READY and the Zenoh endpoint that others connect to, or the DDS domain, once it "
        "serves."
    )
    faults = FAULTS
