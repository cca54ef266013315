"""The neighbors of a session's arm: subscribes to their joint states, and sets their bodies in the
controller. All methods are for the loop's thread."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.bus.node import BusNode, Received, Subscription
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.neighbors import NS, NeighborWatch
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.names import dds_type

STATE_TYPE = "sensor_msgs/msg/JointState"

MESSAGES_AT_ONCE = 4
"""Most messages read of a neighbor in one cycle, the newest: a flood costs no deadline."""


MAX_BYTES = 8192
"""Longest message that is decoded: that of 150 joints. The loop waits meanwhile, 7 ms for the
worst of this length."""


class ArmNeighbors:
    """All neighbors of one arm."""

    def __init__(
        self, watches: Sequence[NeighborWatch], controller: ArmController, period_s: float
    ) -> None:
        """`period_s` is the robot's."""
        self._watches = watches
        self._controller, self._period_s = controller, period_s
        self._codec, self._dds_type = codec_of(STATE_TYPE), dds_type(STATE_TYPE)
        self._subscriptions: list[Subscription] = []

    def open(self, node: BusNode) -> None:
        """Subscribe. Raises InterfaceError or RosNameError."""
        self._subscriptions = [
            node.subscription(each.topic, STATE_TYPE, MESSAGES_AT_ONCE) for each in self._watches
        ]
        for watch, subscription in zip(self._watches, self._subscriptions, strict=True):
            watch.topic = subscription.entity.name  # A relative name belongs to the session.

    def hear(self, now_s: float, now_ns: int) -> None:
        """Take messages that have arrived."""
        for watch, subscription in zip(self._watches, self._subscriptions, strict=True):
            for _ in range(MESSAGES_AT_ONCE):
                received = subscription.poll()
                if received is None:
                    break
                self.take(watch, received, now_s, now_ns)

    def take(self, watch: NeighborWatch, received: Received, now_s: float, now_ns: int) -> None:
        """Take one message."""
        if received.key.split("/")[-2:-1] != [self._dds_type]:
            watch.refuse(f"messages of another type than {STATE_TYPE}")
            return
        if len(received.data) > MAX_BYTES:
            watch.refuse(f"messages of more than {MAX_BYTES} bytes")
            return
        message = self._codec.decode(received.data)
        if isinstance(message, MalformedCdr):
            watch.refuse(f"messages that are not {STATE_TYPE}", f": {message.reason}")
            return
        stamp = message["header"]["stamp"]
        watch.take(
            message["name"],
            message["position"],
            message["velocity"],
            stamp["sec"] * NS + stamp["nanosec"],
            now_s,
            now_ns,
            b"" if received.attachment is None else received.attachment.gid,
        )

    def turn(self, now_s: float) -> str:
        """Place the bodies for the next cycle. Return why the arm must not be moved; empty if all
        neighbors are known."""
        faults = []
        for index, watch in enumerate(self._watches):
            faults.append(watch.fault(now_s))
            if (age_s := watch.age_s(now_s)) < math.inf:
                ways_m = watch.bodies.ways_m(watch.speeds_m_s, age_s + self._period_s)
                self._controller.place_neighbor(index, watch.joints, ways_m)
        return "; ".join(filter(None, faults))

    def diagnosis(self) -> list[str]:
        """Refused reports of neighbors, as text."""
        return [
            f"the neighbor {watch.bodies.name}: refused {count} {reason}"
            for watch in self._watches
            for reason, count in watch.refused.items()
        ]
