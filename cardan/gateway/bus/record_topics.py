"""Topics of a session for recorders: its configuration, the loop's inputs and outputs, and the raw
bytes that are exchanged with the device and the robot.

Without a subscriber only the configuration is published.
"""

from __future__ import annotations

import importlib.metadata
import json
import math
import platform
import re
import time
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from cardan import __version__
from cardan.bus.node import BusNode, Publisher
from cardan.drivers.base import Driver, OperatorDevice, RobotDriver
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.cycle_record import RecordedRequest, encode_cycle
from cardan.gateway.arm.loop import Cycle
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.zenoh import LATCHED_QOS

STRING_TYPE = "std_msgs/msg/String"
CONFIGURATION_TOPIC, CONTROLLER_LOG_TOPIC = "~/configuration", "~/controller_log"
RAW_TYPE = "cardan_msgs/msg/RawPacket"

LOOK_PERIOD_S = 0.25
"""Period of checks for a subscriber."""

RETENTION_S = 5.0
"""Time from the first cycle during which cycles are kept for a recorder that was started before the
session: Zenoh takes up to a second to report it, and a record that lacks the first cycles is not
replayed exactly."""

AT_ONCE = 8
"""Most packets, and most kept cycles, that are published in one cycle of the loop."""

MAX_PACKETS = 1024
"""Most packets that wait for the loop; beyond, the newest are dropped."""

HIDDEN = "(not recorded)"
"""Placeholder for secret options."""

_SECRET = re.compile(r"password|passphrase|token|secret|credential", re.IGNORECASE)

_PACKAGES = ("daqp", "eclipse-zenoh", "numpy", "pin")
"""Packages on whose versions results may depend."""


class _Packet(NamedTuple):
    stamp_ns: int
    connection: str
    sent: bool
    data: bytes


class _RawTap:
    """Publishes the raw bytes of one driver."""

    def __init__(self, node: BusNode, name: str, driver: Driver) -> None:
        self.dropped = 0
        self._driver = driver
        self._publisher = node.publisher(f"~/raw/{name}", RAW_TYPE)
        self._codec = codec_of(RAW_TYPE)
        self._packets: deque[_Packet] = deque()

    def look(self) -> None:
        """Begin or end according to the subscribers."""
        if self._publisher.heard:
            self._driver.raw_packet_callback = self._take
        else:
            self.end()

    def end(self) -> None:
        """Stop taking packets."""
        self._driver.raw_packet_callback = None
        self._packets.clear()

    def _take(self, data: bytes, sent: bool, connection: str) -> None:
        if len(self._packets) < MAX_PACKETS:
            self._packets.append(_Packet(time.time_ns(), connection, sent, bytes(data)))
        else:
            self.dropped += 1

    def publish(self, now_ns: int) -> None:
        """Publish captured packets, from the loop's thread."""
        packets = self._packets
        for _ in range(min(len(packets), AT_ONCE)):
            packet = packets.popleft()
            seconds, nanoseconds = divmod(packet.stamp_ns, 10**9)
            message = {
                "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": ""},
                "connection": packet.connection,
                "direction": int(packet.sent),
                "data": packet.data,
            }
            self._publisher.put(self._codec.encode(message), now_ns)


class _ControllerLog:
    """Publishes the inputs and outputs of each cycle of the loop."""

    def __init__(self, node: BusNode, controller: ArmController) -> None:
        self._controller = controller
        self._publisher: Publisher = node.publisher(CONTROLLER_LOG_TOPIC, STRING_TYPE)
        self._codec = codec_of(STRING_TYPE)
        self._requests: deque[tuple[int, RecordedRequest]] = deque()
        self._cycles: deque[str] = deque()
        self._keeps_until_s = math.inf
        self._heard = False
        controller.recorder = self._recorder

    @property
    def on(self) -> bool:
        return self._controller.recorder is not None

    def look(self, now_s: float) -> None:
        """Begin or end according to the subscribers."""
        self._heard = self._publisher.heard
        if self._keeps_until_s == math.inf:
            self._keeps_until_s = now_s + RETENTION_S
        if self._heard or now_s < self._keeps_until_s:
            self._controller.recorder = self._recorder
        else:
            self.end()

    def end(self) -> None:
        """Stop taking cycles."""
        self._controller.recorder = None
        self._requests.clear()
        self._cycles.clear()

    def _recorder(self, ticks: int, name: str, argument: str) -> None:
        self._requests.append((ticks, RecordedRequest(name, argument)))

    def publish(self, cycle: Cycle, now_ns: int) -> None:
        """Publish a cycle, from the loop's thread, or keep it until there is a subscriber."""
        number, requests = self._controller.ticks, self._requests
        before = []
        # Requests since this tick belong to the next one.
        while requests and requests[0][0] < number:
            before.append(requests.popleft()[1])
        self._cycles.append(encode_cycle(number, before, cycle))
        if self._heard:
            self._publish_cycles(AT_ONCE, now_ns)

    def finish(self, now_ns: int) -> None:
        """Publish all kept cycles if there is a subscriber, and end."""
        if self._publisher.heard:
            self._publish_cycles(len(self._cycles), now_ns)
        self.end()

    def _publish_cycles(self, most: int, now_ns: int) -> None:
        for _ in range(min(len(self._cycles), most)):
            text = self._cycles.popleft()
            self._publisher.put(self._codec.encode({"data": text}), now_ns)


class RecordTopics:
    """A session's topics for recorders. For the loop's thread."""

    def __init__(
        self,
        node: BusNode,
        tables: Mapping[str, Any],
        controller: ArmController,
        robot: RobotDriver,
        device: OperatorDevice | None,
    ) -> None:
        """`node` is open. `tables`: the session's configuration."""
        self._configuration = node.publisher(CONFIGURATION_TOPIC, STRING_TYPE, LATCHED_QOS)
        text = json.dumps(_described(tables))
        self._configuration.put(codec_of(STRING_TYPE).encode({"data": text}), time.time_ns())
        self._log = _ControllerLog(node, controller)
        self._raw = [_RawTap(node, "robot", robot)]
        if device is not None:
            self._raw.append(_RawTap(node, "device", device))
        self._look_s = -math.inf

    @property
    def dropped(self) -> int:
        """Count of dropped raw packets."""
        return sum(each.dropped for each in self._raw)

    def cycle(self, cycle: Cycle, now_s: float) -> None:
        """Publish the record of a cycle, after its answer has been sent."""
        if now_s >= self._look_s:
            self._look_s = now_s + LOOK_PERIOD_S
            self._log.look(now_s)
            for raw in self._raw:
                raw.look()
        now_ns = time.time_ns()
        if self._log.on:
            self._log.publish(cycle, now_ns)
        for raw in self._raw:
            raw.publish(now_ns)

    def close(self) -> None:
        """Stop taking data: the bus is about to be left."""
        self._log.finish(time.time_ns())
        for raw in self._raw:
            raw.end()


def _described(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configuration, and further data that results may depend on."""
    versions = {"cardan": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {"versions": versions, "machine": platform.machine(), "tables": _public(tables)}


def _public(value: Any) -> Any:
    """Return `value` without secrets."""
    if isinstance(value, Mapping):
        return {
            key: HIDDEN if each and _SECRET.search(str(key)) else _public(each)
            for key, each in value.items()
        }
    return list(map(_public, value)) if isinstance(value, (list, tuple)) else value
