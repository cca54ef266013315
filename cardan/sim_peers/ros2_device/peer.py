"""Simulated standard node on the bus."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cardan.sim_peers.backends.bus import BusBackend, BusPeerOptions
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import PeerCommand, option
from cardan.sim_peers.device_peer import DevicePeer
from cardan.sim_peers.ros2_device.core import FAULTS, JOY, TOPICS, SimulatedNode, StockNode
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, SCRIPTS, ScriptedPuck

FEEDBACK_TOPIC = "/joy/set_feedback"
RUMBLE = 1

NODE_NAMES = {"spacenav": "spacenav", "joy_node": "joy_node"}
"""Names of the nodes on the bus; any other is a game_controller_node."""


@dataclass(frozen=True, kw_only=True)
class NodePeerOptions(BusPeerOptions):
    """Options of :class:`NodePeer`, beside script, faults and seed."""

    node: StockNode = option("spacenav", "Which stock node.")


def node_on_bus(device: SimulatedNode, options: NodePeerOptions) -> BusBackend:
    """Return the node, which is a Joy publisher."""

    def feel(feedback: Mapping[str, Any]) -> None:
        if feedback["type"] == RUMBLE:
            device.rumble = feedback["intensity"]

    name = NODE_NAMES.get(options.node, "game_controller_node")
    return BusBackend(options, name, (TOPICS[options.node], JOY), FEEDBACK_TOPIC, feel)


class NodePeer(DevicePeer[SimulatedNode, bytes]):
    """Simulated standard node. Raises ScriptError for a script or a fault."""

    def __init__(self, options: NodePeerOptions | None = None) -> None:
        options = NodePeerOptions() if options is None else options
        device = SimulatedNode(options.node, options.faults, options.seed)
        steps = load_script(options.script, SCRIPTS, SCRIPT_VERBS)
        motion = ScriptedPuck(steps, device.model)
        super().__init__(device, motion, node_on_bus(device, options), options)  # type: ignore[arg-type]


class Ros2DeviceCommand(PeerCommand[NodePeerOptions]):
    """ROS 2's spacenav_node, joy_node or game_controller_node with a device (rmw_zenoh)."""

    Options, Peer = NodePeerOptions, NodePeer
    page = "simulated-peers.md"
    example = "--node joy_node --listen 127.0.0.1:7447"
    speaks = "[ROS 2](protocols/ros2.md), Zenoh"
    epilog = "Prints READY and the Zenoh endpoint that others connect to once it serves."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
