"""The session's operator device on the bus, under the names of ROS 2's spacenav_node and joy_node.

Numbers are those of the stock nodes: a full deflection is 1 on `joy`, and 350/512 on `spacenav/*`:
a SpaceMouse's 350 counts over spacenav_node's full_scale. Unlike those nodes it publishes nothing
while the device is not live, after zeros once: a missing device must not look like an operator at
rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cardan.bus.node import BusNode, Publisher
from cardan.protocols.ros2.cdr import MalformedCdr, Template, codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.types import NEUTRAL, NEVER_S, ZERO3, Axes, DeviceLink, DeviceState, Inertia

VECTOR, TWIST, JOY = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Twist", "sensor_msgs/msg/Joy"
IMU = "sensor_msgs/msg/Imu"

SPACENAV_FULL = 350.0 / 512.0

MOVING_PERIOD_S = 0.008
"""Shortest time between messages of a moving device: no SpaceMouse reports faster."""

REST_PERIOD_S = 0.03
"""Time between messages of a device at rest: spacenav_node's zeros."""

JOY_PERIOD_S = 0.05
"""Time between messages on `joy`, unless a button changes: joy_node's autorepeat_rate of 20 Hz."""

RUMBLE_TOPIC, RUMBLE_TYPE, RUMBLE = "joy/set_feedback", "sensor_msgs/msg/JoyFeedback", 1

RUMBLE_ENDS_S = 1.0
"""Time after which a rumble without a new request ends, as joy_node's does."""

IMU_PERIOD_S = 0.004
"""Shortest time between two published measurements: a Wii Remote has 100 a second, bunched by
Bluetooth."""

NS = 1_000_000_000

_EIGHT_ZEROS = (0.0,) * 8


class DeviceTopics:
    """Publishes an operator device. For the loop's thread."""

    def __init__(self, node: BusNode, buttons: Sequence[str], *, inertia: bool = False) -> None:
        """`buttons` in the order of the messages; those that appear later are appended. `inertia`:
        the device has inertial sensors."""
        self._publishers = [
            node.publisher("spacenav/offset", VECTOR),
            node.publisher("spacenav/rot_offset", VECTOR),
            node.publisher("spacenav/twist", TWIST),
        ]
        self._templates = [
            Template(type_name, default_message(type_name)) for type_name in (VECTOR, VECTOR, TWIST)
        ]
        offset, rot_offset, twist = self._templates
        self._offset = offset.slot("x"), offset.slot("y"), offset.slot("z")
        self._rot_offset = rot_offset.slot("x"), rot_offset.slot("y"), rot_offset.slot("z")
        self._linear, self._angular = twist.slot("linear"), twist.slot("angular")
        self._spacenav_joy = _Joy(node.publisher("spacenav/joy", JOY), "spacenav")
        self._joy = _Joy(node.publisher("joy", JOY), "joy")
        self._imu = _Imu(node.publisher("imu/data_raw", IMU)) if inertia else None
        self._buttons = list(buttons)
        self._feedback = node.subscription(RUMBLE_TOPIC, RUMBLE_TYPE, 4)
        self._rumble = 0.0
        self._rumble_s = self._due_s = self._joy_due_s = float("-inf")
        self._stamp_s = 0.0
        self._held: frozenset[str] = frozenset()
        self._silent = True
        """True if the device is not live, and zeros were published for it."""

    def offer(self, device: DeviceState, now_s: float, now_ns: int) -> None:
        """Publish the device's state if it is due."""
        if self._imu is not None and device.inertia is not None:
            self._imu.offer(device.inertia, device.stamp_s, now_s, now_ns)
        live = device.link is DeviceLink.LIVE
        if self._silent and not live:
            return
        changed = device.buttons != self._held
        moved = device.stamp_s != self._stamp_s and any(device.axes)
        wait_s = MOVING_PERIOD_S - REST_PERIOD_S if moved else 0.0
        if live and not changed and now_s < self._due_s + wait_s:
            return
        self._silent, self._stamp_s, self._held = not live, device.stamp_s, device.buttons
        self._due_s = now_s + REST_PERIOD_S
        for label in sorted(device.buttons):
            if label not in self._buttons:
                self._buttons.append(label)
        down = [int(label in device.buttons) for label in self._buttons]
        axes = device.axes if live else NEUTRAL
        self._put_spacenav(Axes(*(SPACENAV_FULL * each for each in axes)), down, now_ns)
        if changed or not live or now_s >= self._joy_due_s:
            self._joy_due_s = now_s + JOY_PERIOD_S
            self._joy.put(axes, down, now_ns)

    def _put_spacenav(self, axes: Axes, buttons: Sequence[int], now_ns: int) -> None:
        for slots, values in ((self._offset, axes[:3]), (self._rot_offset, axes[3:])):
            for slot, value in zip(slots, values, strict=True):
                slot(value)
        self._linear(*axes[:3])
        self._angular(*axes[3:])
        for publisher, template in zip(self._publishers, self._templates, strict=True):
            publisher.put(template.data, now_ns)
        self._spacenav_joy.put(axes, buttons, now_ns)

    def rumble(self, now_s: float) -> float:
        """Return the rumble that the network requests of the device, 0..1."""
        while (received := self._feedback.poll()) is not None:
            message = codec_of(RUMBLE_TYPE).decode(received.data)
            if isinstance(message, MalformedCdr) or message["type"] != RUMBLE:
                continue
            level = message["intensity"]
            if 0.0 <= level <= 1.0:
                self._rumble, self._rumble_s = level, now_s
        return self._rumble if now_s - self._rumble_s < RUMBLE_ENDS_S else 0.0


class _Imu:
    """A topic of inertial measurements, by REP 145: raw, without an orientation."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        message = default_message(IMU)
        message["header"]["frame_id"] = "imu"
        unknown = [-1.0] + [0.0] * 8  # sensor_msgs/Imu: the orientation is not estimated.
        message["orientation_covariance"] = unknown
        template = Template(IMU, message)
        self._data = template.data
        self._stamp = template.slot("header.stamp")
        self._rates = template.slot("angular_velocity")
        self._no_rates = template.slot("angular_velocity_covariance")
        self._acceleration = template.slot("linear_acceleration")
        self._stamp_s = NEVER_S

    def offer(self, inertia: Inertia, stamp_s: float, now_s: float, now_ns: int) -> None:
        """Publish it unless it was published already; `stamp_s`: time of measurement."""
        if stamp_s - self._stamp_s < IMU_PERIOD_S:
            return
        self._stamp_s = stamp_s
        rates = inertia.rates
        self._rates(*(rates or ZERO3))
        self._no_rates(-1.0 if rates is None else 0.0, *_EIGHT_ZEROS)
        self._acceleration(*inertia.acceleration)
        measured_ns = now_ns - int((now_s - stamp_s) * NS)
        self._stamp(measured_ns // NS, measured_ns % NS)
        self._publisher.put(self._data, now_ns)


class _Joy:
    """A topic of Joy messages with six axes."""

    def __init__(self, publisher: Publisher, frame: str) -> None:
        self._publisher, self._frame = publisher, frame
        self._count = -1
        self._data = bytearray()
        self._slots: list[Callable[..., None]] = []

    def put(self, axes: Axes, buttons: Sequence[int], now_ns: int) -> None:
        if len(buttons) != self._count:
            self._count = len(buttons)
            message = default_message(JOY)
            message["header"]["frame_id"] = self._frame
            message |= {"axes": [0.0] * 6, "buttons": [0] * self._count}
            template = Template(JOY, message)
            names = ("header.stamp", "axes", "buttons")[: 3 if buttons else 2]
            self._data, self._slots = template.data, [template.slot(name) for name in names]
        stamp, set_axes, *set_buttons = self._slots
        stamp(now_ns // NS, now_ns % NS)
        set_axes(*axes)
        for each in set_buttons:
            each(*buttons)
        self._publisher.put(self._data, now_ns)
