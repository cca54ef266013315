"""The simulated ROS 2 arm as nodes on the bus."""

from __future__ import annotations

import logging
import time

from cardan.bus import transports
from cardan.bus.node import BusNode, Publisher, WaitingSubscription
from cardan.bus.transports import OtherNode, OtherPublisher, OtherSubscription
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.zenoh import LATCHED_QOS
from cardan.sim_peers.base import SimulatedPeer
from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.link import FaultyLink
from cardan.sim_peers.ros2_arm.controllers import (
    GRIPPER_SENDER,
    JOINT_STATE,
    SECOND_SENDER,
    TOPICS,
    JointStateMessage,
    RosArm,
)
from cardan.sim_peers.ros2_arm.options import FAULTS, RosArmOptions

log = logging.getLogger(__name__)

NODE = "simulated_arm"
STATES_TOPIC = "/joint_states"
DESCRIPTION_TOPIC, DESCRIPTION_TYPE = "/robot_description", "std_msgs/msg/String"

MAX_COMMANDS = 10
"""ROS 2's default depth."""


class RosArmPeer(SimulatedPeer):
    """Serves a `RosArm`.

    One node in a Zenoh session or a DDS participant represents all nodes, and ends and starts with
    them.
    """

    def __init__(self, options: RosArmOptions | None = None) -> None:
        self.options = options = RosArmOptions() if options is None else options
        self.core = RosArm(options)
        self._node: BusNode | OtherNode | None = None
        self._publishers: dict[int, Publisher | OtherPublisher] = {}
        self._commands: WaitingSubscription | OtherSubscription | None = None
        self._description: Publisher | OtherPublisher | None = None
        """Kept: without a reference it would leave the bus."""
        self._next_s = 0.0
        self._out: FaultyLink[JointStateMessage] | None = None
        self._in: FaultyLink[bytes] | None = None
        if FaultyLink.wanted(options.faults):
            self._out = FaultyLink(options.faults, options.seed + 2)
            self._in = FaultyLink(options.faults, options.seed + 3)

    @property
    def endpoint(self) -> str:
        """Address that other nodes connect to; on DDS the domain."""
        if self.options.transport == "dds":
            return f"dds/{self.options.domain}"
        return self.options.router or f"tcp/{self.options.host}:{self.options.port}"

    def open(self) -> None:
        """Join the bus. Raises DriverError if it cannot, as when a router has the port."""
        if self._node is None:
            self._join()
            self._next_s = time.monotonic()

    def _join(self) -> None:
        node: BusNode | OtherNode
        if self.options.transport == "dds":
            node = transports.load("dds")(self.options.dds, NODE)
        else:
            node = BusNode(self.options.bus, NODE)
        node.open()
        self._node = node
        topic, type_name = TOPICS[self.options.controller]
        if self.core.loaded:
            self._commands = node.waiting_subscription(topic, type_name, MAX_COMMANDS)
        self._publishers = {self.core.sender: node.publisher(STATES_TOPIC, JOINT_STATE)}
        if "gripper" in self.options.faults:
            self._publishers[GRIPPER_SENDER] = node.publisher(STATES_TOPIC, JOINT_STATE)
        if "second-publisher" in self.options.faults:
            self._publishers[SECOND_SENDER] = node.publisher(STATES_TOPIC, JOINT_STATE)
        self._description = node.publisher(DESCRIPTION_TOPIC, DESCRIPTION_TYPE, LATCHED_QOS)
        urdf = codec_of(DESCRIPTION_TYPE).encode({"data": self.core.arm.urdf})
        self._description.put(urdf, time.time_ns())

    def close(self) -> None:
        """Leave the bus."""
        node, self._node, self._commands = self._node, None, None
        if node is not None:
            node.close()

    def step(self, until_s: float) -> None:
        """Serve until the monotonic time `until_s`."""
        while (now_s := time.monotonic()) < until_s:
            if now_s >= self._next_s:
                period_s = self.options.period_s
                missed = int((now_s - self._next_s) / period_s)
                self._next_s += (1 + missed) * period_s
                for state in self.core.cycle(time.time(), missed):
                    if self._out is None:
                        self._publish(state)
                    else:
                        self._out.push(now_s, state)
                self._follow_nodes()
            if self._out is not None:
                for state in self._out.pop(now_s):
                    self._publish(state)
            if self._in is not None:
                for data in self._in.pop(now_s):
                    self.core.receive(data)
            self._wait(min(self._next_s, until_s))

    def _wait(self, until_s: float) -> None:
        """Receive commands until then, or until one has arrived."""
        left_s = max(until_s - time.monotonic(), 0.0)
        if self._commands is None:
            time.sleep(left_s)
            return
        for link in (self._out, self._in):
            due_s = None if link is None else link.next_s()
            if due_s is not None:
                left_s = max(min(left_s, due_s - time.monotonic()), 0.0)
        received = self._commands.wait(left_s)
        if received is None:
            return
        if self._in is None:
            self.core.receive(received.data)
        else:
            self._in.push(time.monotonic(), received.data)

    def _publish(self, state: JointStateMessage) -> None:
        publisher = self._publishers.get(state.sender)
        if publisher is not None and self._node is not None:
            publisher.put_as(state.sequence, state.data, time.time_ns())

    def _follow_nodes(self) -> None:
        """Join or leave the bus with the core's nodes."""
        if not self.core.up:
            if self._node is not None:
                log.info("the nodes end")
                self.close()
        elif self._node is None:
            log.info("the nodes have restarted")
            self._join()
        elif self._commands is not None and not self.core.loaded:
            log.info("the controller is unloaded")
            self._commands.close()
            self._commands = None


class Ros2ArmCommand(PeerCommand[RosArmOptions]):
    """An arm under ros2_control: joint states, a controller, a description (rmw_zenoh or DDS)."""

    Options, Peer = RosArmOptions, RosArmPeer
    page = "simulated-peers.md"
    example = "--robot ur5 --listen 127.0.0.1:7447"
    speaks = "[ROS 2](protocols/ros2.md), Zenoh or DDS, 100 Hz"
    epilog = (
        "Prints READY and the Zenoh endpoint that others connect to, or the DDS domain, once it "
        "serves."
    )
    faults = FAULTS
