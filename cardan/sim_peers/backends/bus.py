"""Simulated device as a node of ROS 2's network: its programs are the subscribers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from cardan.bus.node import BusNode, MatchedEndpoints, Publisher, WaitingSubscription
from cardan.bus.options import BusOptions
from cardan.common import bounds
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.zenoh import SUBSCRIPTION
from cardan.sim_peers.backends.base import DeviceBackend
from cardan.sim_peers.command import listen_option, option
from cardan.sim_peers.device_peer import DevicePeerOptions

FEEDBACK = "sensor_msgs/msg/JoyFeedback"

LOOK_PERIOD_S = 0.05
"""Period of checks for a subscriber."""


@dataclass(frozen=True, kw_only=True)
class BusPeerOptions(DevicePeerOptions):
    """Options of a device on the bus, beside script, faults and seed."""

    host: Annotated[str, bounds.LISTEN_HOST] = listen_option("Where other nodes connect to")
    port: Annotated[int, bounds.ANY_PORT] = 7447
    """TCP port; used by default instead of a router."""
    router: str = option(
        "", "A Zenoh router to find other nodes by (tcp/127.0.0.1:7447).", metavar="ENDPOINT"
    )

    @property
    def bus(self) -> BusOptions:
        """Options to join the bus."""
        return BusOptions(router=self.router, listen=(f"tcp/{self.host}:{self.port}",))

    @property
    def endpoint(self) -> str:
        """Address that other nodes connect to."""
        return self.router or f"tcp/{self.host}:{self.port}"


class BusBackend(DeviceBackend[bytes]):
    """Publishes a device's messages, in CDR, and passes on the haptic feedback of programs."""

    def __init__(
        self,
        options: BusPeerOptions,
        node: str,
        topic: tuple[str, str],
        feedback_topic: str,
        feel: Callable[[Mapping[str, Any]], object],
        message: Callable[[bytes], bytes] = lambda sent: sent,
    ) -> None:
        """`topic`: its name and type. `message` converts the device's reports to published
        messages; `feel` gets each JoyFeedback."""
        self._options, self._name, self._topic = options, node, topic
        self._feedback_topic, self._feel, self._message = feedback_topic, feel, message
        self._node: BusNode | None = None
        self._publisher: Publisher | None = None
        self._feedback: WaitingSubscription | None = None
        self._programs: MatchedEndpoints | None = None
        self._look_s = 0.0

    @property
    def endpoint(self) -> str:
        """Address that other nodes connect to."""
        return self._options.endpoint

    @property
    def there(self) -> bool:
        """True if the node is on the bus."""
        return self._node is not None

    def appear(self) -> None:
        """Start the node. Raises DriverError."""
        node = BusNode(self._options.bus, self._name)
        node.open()
        topic, type_name = self._topic
        self._publisher = node.publisher(topic, type_name)
        self._programs = node.presence(SUBSCRIPTION, topic)
        self._feedback = node.waiting_subscription(self._feedback_topic, FEEDBACK, 4)
        self._node = node

    def vanish(self) -> None:
        """End the node."""
        node, self._node, self._publisher = self._node, None, None
        self._programs = self._feedback = None
        if node is not None:
            node.close()

    def send(self, messages: Sequence[bytes]) -> None:
        """Publish."""
        if self._publisher is not None:
            for sent in messages:
                self._publisher.put(self._message(sent), time.time_ns())

    @property
    def due_s(self) -> float:
        """Time of the next check for programs."""
        return self._look_s

    def run_due(self, now_s: float) -> None:
        """Look for programs, and pass their messages to the device."""
        if now_s < self._look_s:
            return
        self._look_s = now_s + LOOK_PERIOD_S
        if self._programs is not None and self._programs.others():
            self.shell.begin()
        while self._feedback is not None and (received := self._feedback.poll()) is not None:
            feedback = codec_of(FEEDBACK).decode(received.data)
            if not isinstance(feedback, MalformedCdr):
                self._feel(feedback)
