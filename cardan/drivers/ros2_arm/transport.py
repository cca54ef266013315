"""Transports between the driver of ROS 2 arms and the robot's nodes."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

from cardan.bus import transports
from cardan.bus.node import BusNode, Received, gid_of
from cardan.bus.transports import OtherNode
from cardan.drivers.datagram_robot import DatagramTransport
from cardan.drivers.robot_core import WAKE_S
from cardan.drivers.ros2_arm.options import Ros2ArmOptions
from cardan.drivers.ros2_arm.session import COMMAND_TYPES, STATE_TYPE
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.zenoh import LATCHED_QOS, PUBLISHER, SUBSCRIPTION

DESCRIPTION_TYPE = "std_msgs/msg/String"

MAX_STATES = 16
"""Joint states queued; the newest counts."""

DESCRIPTION_TIMEOUT_S = 5.0
"""Longest wait for the robot's description, which is latched for late subscribers."""

LOOK_PERIOD_S = 0.1
"""Period of looking up subscribers on the graph."""


class Ros2Transport(DatagramTransport, Protocol):
    """Transport with access to the graph."""

    def taken(self) -> bool:
        """True if the commands have a subscriber."""

    def publisher(self, gid: bytes) -> str:
        """Return the node whose publisher of joint states has this GID; empty if unknown."""

    def description(self) -> str:
        """Return the robot's URDF; empty if none comes within DESCRIPTION_TIMEOUT_S."""


class NodeTransport(ABC):
    """Transport by a node of its own."""

    def __init__(self, options: Ros2ArmOptions, node: BusNode | OtherNode) -> None:
        """Raises DriverError, ConfigurationError or ExtraMissingError."""
        self._options, self._node = options, node
        node.open()
        try:
            self._states = node.waiting_subscription(options.states_topic, STATE_TYPE, MAX_STATES)
            self._commands = node.publisher(options.topic, COMMAND_TYPES[options.command])
        except BaseException:
            node.close()
            raise
        self._taken = False
        self._look_s = 0.0

    @abstractmethod
    def _found(self) -> bool:
        """True if the graph has a subscriber of the commands."""

    @abstractmethod
    def publisher(self, gid: bytes) -> str:
        """Return the node whose publisher of joint states has this GID; empty if unknown."""

    def now(self) -> float:
        return time.monotonic()

    def send(self, data: bytes | bytearray) -> None:
        self._commands.put(data, time.time_ns())

    def wait(self) -> Sequence[Received]:
        """Wait for the next joint states and return those received."""
        first = self._states.wait(WAKE_S)
        return () if first is None else (first, *self.waiting())

    def waiting(self) -> Sequence[Received]:
        found = []
        while (each := self._states.poll()) is not None:
            found.append(each)
        return found

    def taken(self) -> bool:
        """True if the commands have a subscriber."""
        now_s = self.now()
        if now_s >= self._look_s:
            self._look_s = now_s + LOOK_PERIOD_S
            self._taken = self._found()
        return self._taken

    def description(self) -> str:
        """Return the robot's URDF."""
        codec = codec_of(DESCRIPTION_TYPE)
        latched = self._node.waiting_subscription(
            self._options.description_topic, DESCRIPTION_TYPE, 1, LATCHED_QOS
        )
        try:
            received = latched.wait(DESCRIPTION_TIMEOUT_S)
        finally:
            latched.close()
        message = None if received is None else codec.decode(received.data)
        if message is None or isinstance(message, MalformedCdr):
            return ""
        text: str = message["data"]
        return text

    def close(self) -> None:
        """Leave the network."""
        self._node.close()


class ZenohTransport(NodeTransport):
    """Transport over Zenoh."""

    def __init__(self, options: Ros2ArmOptions) -> None:
        """Raises DriverError, ConfigurationError or ExtraMissingError."""
        node = BusNode(options.bus, options.name)
        super().__init__(options, node)
        self._takers = node.presence(SUBSCRIPTION, options.topic)
        self._publishers = node.presence(PUBLISHER, options.states_topic)

    def _found(self) -> bool:
        return bool(self._takers.others())

    def publisher(self, gid: bytes) -> str:
        domain = self._options.bus.domain
        found = (e.full_node for e in self._publishers.others() if gid_of(e, domain) == gid)
        return next(found, "")


class DdsTransport(NodeTransport):
    """Transport over DDS."""

    def __init__(self, options: Ros2ArmOptions) -> None:
        """Raises DriverError, ConfigurationError or ExtraMissingError."""
        node = transports.load("dds")(options.dds, options.name)
        super().__init__(options, node)
        try:
            self._graph = node.graph_reader()
        except BaseException:
            node.close()
            raise

    def _found(self) -> bool:
        # Read all the time, because unread messages would be kept.
        self._graph.look()
        return self._commands.heard

    def publisher(self, gid: bytes) -> str:
        return self._graph.writer(gid)

    def close(self) -> None:
        self._graph.close()
        super().close()


TRANSPORTS: dict[str, Callable[[Ros2ArmOptions], Ros2Transport]] = {
    "zenoh": ZenohTransport,
    "dds": DdsTransport,
}
"""Transports by the option `transport`."""
