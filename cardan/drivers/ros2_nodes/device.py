"""What the drivers of devices share whose messages come on the bus: each is a node itself."""

from __future__ import annotations

import threading
import time
from typing import Any, ClassVar, TypeVar

from cardan.bus.node import BusNode, Presence, Publisher, WaitingSubscription
from cardan.drivers.node_options import SIMULATED, NodeOptions
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.ros2_nodes.core import BusCore, JoyCore
from cardan.drivers.ros2_nodes.options import JoyOptions, Ros2JoyOptions, Ros2SpacenavOptions
from cardan.errors import DeviceNotFoundError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.zenoh import PUBLISHER
from cardan.types import DeviceCapabilities, DeviceFeedback

MESSAGES_KEPT = 32
"""Messages that wait for the reader; button edges are in each."""

MEET_S = 1.0
"""Longest wait for the node to be found: a router takes some 0.1 s to tell of it."""

LOOK_S = 0.01
"""How often it is looked for meanwhile."""

WAIT_S = 0.04
"""The reader looks at the end of its work so often."""

RUMBLE_AGAIN_S = 0.2
"""joy_node ends a rumble after a second."""

FEEDBACK_TYPE, RUMBLE = "sensor_msgs/msg/JoyFeedback", 1


C = TypeVar("C", bound=BusCore)


class BusDevice(ReadDevice[C]):
    """A device whose messages come on a topic. Its driver sets `_core` in `__init__`."""

    _bus: BusNode | None = None
    _messages: WaitingSubscription | None = None
    _presence: Presence | None = None

    @property
    def _on_bus(self) -> NodeOptions:
        """How it is on the bus."""
        options: NodeOptions = self.options
        return options

    def _why_missing(self) -> str:
        """What to do where nobody publishes the topic."""
        raise NotImplementedError

    def _why_gone(self) -> str:
        """What has happened where nobody publishes it any more."""
        return f"the node that published {self.options.topic} has ended"

    def _connect(self) -> None:
        options = self.options
        self._bus = bus = BusNode(self._on_bus.bus, options.name)
        bus.open()
        kind = self._core.message_type
        self._messages = bus.waiting_subscription(options.topic, kind, MESSAGES_KEPT)
        self._presence = bus.presence(PUBLISHER, options.topic)
        until_s = time.monotonic() + MEET_S
        while not self._presence.others():
            if time.monotonic() >= until_s:
                raise DeviceNotFoundError(self._why_missing())
            time.sleep(LOOK_S)
        with self._lock:
            self._core.on_opened(time.monotonic())

    def _serve(self, stop: threading.Event) -> None:
        messages, presence = self._messages, self._presence
        assert messages is not None
        assert presence is not None
        while not stop.is_set():
            received = messages.wait(self._wait_s())
            if received is not None:
                with self._lock:
                    self._core.on_received(received, time.monotonic())
                self._notify()
            elif not presence.others():
                raise DeviceNotFoundError(self._why_gone())
            self._attend()

    def _wait_s(self) -> float:
        """Longest time until the next call of `_attend`."""
        return WAIT_S

    def _attend(self) -> None:
        """What the reader does besides."""

    def _release(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()


class RumblingDevice(BusDevice[C]):
    """One that takes sensor_msgs/JoyFeedback on another topic."""

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._rumbler: Publisher | None = None
        self._level = self._shown = 0.0
        self._again_s = 0.0

    @property
    def _feedback_topic(self) -> str:
        """Empty: none."""
        raise NotImplementedError

    def _feedback(self, feedback: DeviceFeedback) -> None:
        self._check_open("feedback()")
        if feedback.rumble is not None:
            self._level = min(1.0, max(0.0, feedback.rumble))

    def _connect(self) -> None:
        super()._connect()
        if self._bus is not None and self._feedback_topic:
            self._rumbler = self._bus.publisher(self._feedback_topic, FEEDBACK_TYPE)

    def _attend(self) -> None:
        level, now_s = self._level, time.monotonic()
        if level == self._shown and (level == 0.0 or now_s < self._again_s):
            return
        self._rumble(level)
        self._shown, self._again_s = level, now_s + RUMBLE_AGAIN_S

    def _rumble(self, level: float) -> None:
        if self._rumbler is not None:
            message = {"type": RUMBLE, "id": 0, "intensity": level}
            self._rumbler.put(codec_of(FEEDBACK_TYPE).encode(message), time.time_ns())

    def _release(self) -> None:
        if self._shown:
            self._rumble(0.0)
        self._rumbler, self._shown = None, 0.0
        super()._release()

    def close(self) -> None:
        """Stop reading and rumbling."""
        super().close()
        self._level = 0.0


class NodeDevice(BusDevice[JoyCore]):
    """A device that a ROS 2 node reads and publishes as sensor_msgs/Joy."""

    options: JoyOptions
    _node_name = ""
    """The stock node."""
    _touch = ""

    def __init__(self, options: JoyOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = JoyCore(self.options, self._touch)

    @property
    def capabilities(self) -> DeviceCapabilities:
        """What the device has; its buttons are known from the node's first message on."""
        with self._lock:
            labels = self._core.labels
        return DeviceCapabilities(
            gives_pose=False, buttons=labels, feedback=frozenset(), battery=False
        )

    def _why_missing(self) -> str:
        return (
            f"nobody publishes {self.options.topic}: start {self._node_name} with "
            "RMW_IMPLEMENTATION=rmw_zenoh_cpp, and ROS 2's router (rmw_zenohd) or the "
            f"one that `router` names ({self._on_bus.bus.router or 'none'})"
        )


class Ros2Spacenav(NodeDevice):
    """A 3D mouse that ROS 2's spacenav_node reads."""

    Options: ClassVar[type[Ros2SpacenavOptions]] = Ros2SpacenavOptions
    summary = "3D mice by ROS 2's spacenav_node"
    page = "ros2-arm.md"
    peer = "ros2-device"
    simulated = SIMULATED
    gives, suits = "six deflections, buttons", "rate, base or tool frame"
    options: Ros2SpacenavOptions
    _kind = "3D mouse"
    _node_name = "spacenav_node"
    _touch = "touch the cap and let go once"


class Ros2Joy(NodeDevice, RumblingDevice[JoyCore]):
    """A gamepad or joystick that ROS 2's joy_node or game_controller_node reads."""

    Options: ClassVar[type[Ros2JoyOptions]] = Ros2JoyOptions
    summary = "gamepads by ROS 2's joy_node or game_controller_node"
    page = "ros2-arm.md"
    peer = "ros2-device"
    simulated = SIMULATED
    gives, suits = "sticks, buttons", "rate, base frame"
    takes_back = "rumble"
    options: Ros2JoyOptions
    _kind = "gamepad"
    _node_name = "joy_node or game_controller_node"
    _touch = "press any button once"

    @property
    def capabilities(self) -> DeviceCapabilities:
        able = super().capabilities
        return able._replace(feedback=frozenset({"rumble"} if self.options.feedback_topic else ()))

    @property
    def _feedback_topic(self) -> str:
        return self.options.feedback_topic
