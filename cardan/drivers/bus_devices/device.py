"""Drivers of devices whose messages come through the bus, from the console's web page or from ROS 2
nodes. Each driver is a node."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from typing import Any, ClassVar, TypeVar

from cardan.bus.node import BusNode, MatchedEndpoints, Publisher, Received, WaitingSubscription
from cardan.drivers.base import OperatorDevice
from cardan.drivers.handheld.core import PhoneCore, XrCore
from cardan.drivers.handheld.options import PhoneOptions, XrOptions
from cardan.drivers.node_options import SIMULATED, NodeOptions
from cardan.drivers.reader_thread import ReaderMixin
from cardan.drivers.ros2_nodes.core import BusCore, JoyCore
from cardan.drivers.ros2_nodes.options import Ros2JoyOptions, Ros2SpacenavOptions
from cardan.errors import DeviceNotFoundError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.zenoh import PUBLISHER
from cardan.types import DeviceCapabilities, DeviceFeedback

MAX_MESSAGES = 32
"""Messages queued for the reader; each has the button edges."""

MEET_S = 1.0
"""Longest wait for the publishing node, s: a router takes some 0.1 s to announce it."""

LOOK_S = 0.01
"""Period of looking for it during that wait, s."""

WAIT_S = 0.04
"""Period of the reader's check whether to stop, s."""

RUMBLE_AGAIN_S = 0.2
"""Repetition period of a rumble, s: joy_node ends a rumble after a second."""

FEEDBACK_TYPE, RUMBLE = "sensor_msgs/msg/JoyFeedback", 1

NO_PAGE = "no page publishes {topic}: start `cardan net server console`, and open its page on the "
PAGE_GONE = "the page was closed, or has lost its connection"
NO_NODE = (
    "no node publishes {topic}: start {node} with RMW_IMPLEMENTATION=rmw_zenoh_cpp, and ROS 2's "
    "router (rmw_zenohd) or the one that `router` names ({router})"
)

C = TypeVar("C", bound=BusCore)


class Rumbler:
    """Rumble on another node's device: sensor_msgs/JoyFeedback, repeated while it lasts."""

    def __init__(self, publisher: Publisher) -> None:
        self.level = 0.0
        """Rumble level to show, 0 to 1."""
        self._publisher = publisher
        self._shown = self._again_s = 0.0

    def run_due(self, now_s: float) -> None:
        """Send what is due."""
        if self.level != self._shown or (self.level and now_s >= self._again_s):
            self._show(self.level)
            self._again_s = now_s + RUMBLE_AGAIN_S

    def end(self) -> None:
        """Stop the rumble."""
        if self._shown:
            self._show(0.0)

    def _show(self, level: float) -> None:
        message = {"type": RUMBLE, "id": 0, "intensity": level}
        self._publisher.put(codec_of(FEEDBACK_TYPE).encode(message), time.time_ns())
        self._shown = level


class BusMixin(ReaderMixin[C]):
    """Reader of a device whose messages come on a topic."""

    _bus: BusNode | None = None
    _messages: WaitingSubscription | None = None
    _presence: MatchedEndpoints | None = None
    _rumbler: Rumbler | None = None
    _level = 0.0
    """Requested level of the rumble, 0 to 1."""

    _missing: ClassVar[str] = ""
    """Advice when `{topic}` has no publisher on the `{router}`."""
    _gone: ClassVar[str] = "the node that published {topic} has ended"
    """Cause when the topic has lost its publisher."""
    _gives_pose = _gives_inertia = False

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = self._make_core()

    @abstractmethod
    def _make_core(self) -> C:
        """Make the interpreter of its messages, from `self.options`."""

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Capabilities of the device; buttons are those known so far."""
        with self._lock:
            labels = self._core.labels
        return DeviceCapabilities(
            gives_pose=self._gives_pose,
            buttons=labels,
            feedback=frozenset({"rumble"} if self._feedback_topic else ()),
            battery=False,
            gives_inertia=self._gives_inertia,
        )

    @property
    def _on_bus(self) -> NodeOptions:
        """Options of its bus connection."""
        options: NodeOptions = self.options
        return options

    @property
    def _feedback_topic(self) -> str:
        """Topic of its rumble; empty if none."""
        topic: str = getattr(self.options, "feedback_topic", "")
        return topic

    def _in_words(self, text: str) -> str:
        router = self._on_bus.bus.router or "none"
        return text.format(topic=self.options.topic, router=router)

    def _why_missing(self) -> str:
        return self._in_words(self._missing)

    def _why_gone(self) -> str:
        return self._in_words(self._gone)

    def _feedback(self, feedback: DeviceFeedback) -> None:
        self._check_open("feedback()")
        if feedback.rumble is not None:
            self._level = min(1.0, max(0.0, feedback.rumble))

    def _connect(self) -> None:
        options = self.options
        self._bus = bus = BusNode(self._on_bus.bus, options.name)
        bus.open()
        kind = self._core.message_type
        self._messages = bus.waiting_subscription(options.topic, kind, MAX_MESSAGES)
        self._presence = bus.presence(PUBLISHER, options.topic)
        until_s = time.monotonic() + MEET_S
        while not self._presence.others():
            if time.monotonic() >= until_s:
                raise DeviceNotFoundError(self._why_missing())
            time.sleep(LOOK_S)
        messages = self._messages
        with self._lock:
            self._core.on_opened(time.monotonic())
            messages.handler = self._on_received
            while (received := messages.poll()) is not None:
                self._core.on_received(received, time.monotonic())
        if self._feedback_topic:
            self._rumbler = Rumbler(bus.publisher(self._feedback_topic, FEEDBACK_TYPE))

    def _serve(self, stop: threading.Event) -> None:
        messages, presence = self._messages, self._presence
        assert messages is not None
        assert presence is not None
        while not stop.is_set():
            self._await_message(messages, self._wait_s())
            if not presence.others():
                raise DeviceNotFoundError(self._why_gone())
            self._attend()

    def _await_message(self, messages: WaitingSubscription, timeout_s: float) -> None:
        # A message that arrived while the handler was set is still queued.
        if (received := messages.wait(timeout_s)) is not None:
            self._on_received(received)

    def _on_received(self, received: Received) -> None:
        """Process a message, in a thread of the bus."""
        with self._lock:
            self._core.on_received(received, time.monotonic())
        self._notify()

    def _wait_s(self) -> float:
        """Longest time until the next call of `_attend`."""
        return WAIT_S

    def _attend(self) -> None:
        """Do the reader's periodic work."""
        if self._rumbler is not None:
            self._rumbler.level = self._level
            self._rumbler.run_due(time.monotonic())

    def _release(self) -> None:
        rumbler, self._rumbler = self._rumbler, None
        bus, self._bus = self._bus, None
        if rumbler is not None:
            rumbler.end()
        if bus is not None:
            bus.close()

    def close(self) -> None:
        super().close()
        self._level = 0.0


# -- devices that the console's page reads ----


class Phone(BusMixin[PhoneCore], OperatorDevice):
    """A hand-held phone, by the console's page in its browser."""

    Options: ClassVar[type[PhoneOptions]] = PhoneOptions
    summary = "phones: orientation and touch, by the console's page"
    page = "phone.md"
    peer = "phone"
    simulated = SIMULATED
    gives, suits = "turns, a finger's drag, inertia", "rate, base frame"
    takes_back = "vibration"
    options: PhoneOptions
    _kind = "phone"
    _missing = NO_PAGE + _kind
    _gone = PAGE_GONE
    _gives_pose = _gives_inertia = True

    def _make_core(self) -> PhoneCore:
        return PhoneCore(self.options)


class Xr(BusMixin[XrCore], OperatorDevice):
    """A headset's controller, or a phone with AR, by the console's page in its browser."""

    Options: ClassVar[type[XrOptions]] = XrOptions
    summary = "headset controllers and phones with AR (WebXR), by the console's page"
    page = "phone.md"
    peer = "xr"
    simulated = SIMULATED
    gives, suits = "pose, buttons", "position, base frame"
    takes_back = "vibration"
    options: XrOptions
    _kind = "headset"
    _missing = NO_PAGE + _kind
    _gone = PAGE_GONE
    _gives_pose = True

    def _make_core(self) -> XrCore:
        return XrCore(self.options)


# -- devices that ROS 2 nodes read, and publish as sensor_msgs/Joy ----


class Ros2Spacenav(BusMixin[JoyCore], OperatorDevice):
    """A 3D mouse that ROS 2's spacenav_node reads."""

    Options: ClassVar[type[Ros2SpacenavOptions]] = Ros2SpacenavOptions
    summary = "3D mice by ROS 2's spacenav_node"
    page = "ros2-arm.md"
    peer = "ros2-device"
    simulated = SIMULATED
    gives, suits = "six deflections, buttons", "rate, base or tool frame"
    options: Ros2SpacenavOptions
    _kind = "3D mouse"
    _missing = NO_NODE.replace("{node}", "spacenav_node")

    def _make_core(self) -> JoyCore:
        return JoyCore(self.options, "touch the cap and let go once")


class Ros2Joy(BusMixin[JoyCore], OperatorDevice):
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
    _missing = NO_NODE.replace("{node}", "joy_node or game_controller_node")

    def _make_core(self) -> JoyCore:
        return JoyCore(self.options, "press any button once")
