"""Interpreter of a node's Joy messages, without any I/O and in the caller's time.

Nodes publish continuously: spacenav_node every 30 ms at rest, joy_node at its autorepeat_rate of 20
Hz. Silence is therefore always a fault. But spacenav_node publishes zeros without a device, too,
and joy_node repeats the last values, whether or not the device still reports:

- After opening or a loss the axes are zero (NEEDS_NEUTRAL) until the device was moved, or a button
  pressed, and then was seen at rest: zeros alone are no operator.
- A node that falls silent is STALE; one whose liveliness token is gone is LOST.
- Of two nodes that publish the same topic, the first one heard counts, while it sends.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from cardan.bus.node import Received
from cardan.drivers.core import DeviceCore
from cardan.drivers.ros2_nodes.options import JoyOptions, Six
from cardan.drivers.shaping import Deflections, Shaper
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.names import dds_type
from cardan.types import NEUTRAL, NEVER_S, Axes, DeviceLink

JOY_TYPE = "sensor_msgs/msg/Joy"

LARGEST = 1e3
"""Largest plausible number of a node."""

MOST_BUTTONS = 64

LEAST_REST = 0.02
"""Deflection that counts as rest whatever the dead zone."""

MOST_BYTES = 1 << 18
"""Longest message, bytes. The arm's loop waits while it is decoded, which takes seconds for 8
MB."""

SETTLE_S = 0.016
"""Time after a silence in which rest does not count: messages may have been queued."""


class BusCore(DeviceCore):
    """State of a device whose messages come on a topic. Times are monotonic, s."""

    message_type: ClassVar[str]

    _counters: ClassVar[Mapping[str, str]] = {
        "silences": "silences of the node",
        "late": "duplicate or late messages, ignored",
        "others": "messages of a second node on the same topic, ignored: end one of the two",
    }

    def __init__(self) -> None:
        super().__init__()
        self._codec, self._dds_type = codec_of(self.message_type), dds_type(self.message_type)
        self._sender = b""
        self._sequence, self._source_ns = -1, -1
        self._last_s = NEVER_S
        """Time of opening, or of the last new message, s."""

    @property
    @abstractmethod
    def labels(self) -> tuple[str, ...]:
        """Names of the buttons, as far as known."""

    @abstractmethod
    def on_opened(self, now_s: float) -> None:
        """Start after the sender was found (again)."""

    def _forget_sender(self, now_s: float) -> None:
        self._sender, self._sequence, self._source_ns = b"", -1, -1
        self._last_s = now_s

    def on_received(self, received: Received, now_s: float) -> None:
        """Process a message. Never raises."""
        if not self._open:
            return
        self._watch(now_s)
        if received.key.split("/")[-2:-1] != [self._dds_type]:
            self._on_malformed(f"of another type than {self.message_type}")
            return
        if not self._is_next(received):
            return
        if len(received.data) > MOST_BYTES:
            self._on_malformed(f"of more than {MOST_BYTES} bytes")
            return
        self._on_data(received.data, now_s)

    @abstractmethod
    def _on_data(self, data: bytes, now_s: float) -> None:
        """Process a new message of the sender that counts."""

    def _decoded(self, data: bytes) -> Message | None:
        message = self._codec.decode(data)
        if isinstance(message, MalformedCdr):
            self._on_malformed("that are malformed")
            return None
        return message

    def _is_next(self, received: Received) -> bool:
        """True for a new message of the node that counts."""
        attachment = received.attachment
        if attachment is None:
            self._on_malformed("without the attachment that nodes of ROS 2 have")
            return False
        if attachment.gid != self._sender:
            if self._sender and self._link is not DeviceLink.STALE:
                self._counts["others"] += 1
                return False
            self._sender, self._sequence, self._source_ns = attachment.gid, -1, -1
            self._on_other_sender()
        if not attachment.follows(self._sequence, self._source_ns):
            self._counts["late"] += 1
            return False
        self._sequence, self._source_ns = attachment.sequence, attachment.source_ns
        return True

    def _on_other_sender(self) -> None:
        """Prepare for messages of another sender."""


class JoyCore(BusCore):
    """State of the device behind one node."""

    message_type = JOY_TYPE

    def __init__(self, options: JoyOptions, touch: str) -> None:
        """Set `touch`, the instruction by which the operator shows that there is a device."""
        super().__init__()
        self._options = options
        self._touch = touch
        self._shaper = Shaper(options)
        self._plain, self._shifted = options.mapped
        self._values: tuple[float, ...] = ()
        """Axes of the newest message, -1..1."""
        self._first: tuple[float, ...] | None = None
        """Axes of the first message since the device was opened."""
        self._touched = False
        self._button_count = 0

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"button-{number}" for number in range(self._button_count))

    def on_opened(self, now_s: float) -> None:
        self._on_other_sender()
        self._forget_sender(now_s)
        self._begin(f"not seen at rest yet: {self._touch}", now_s)

    def _on_other_sender(self) -> None:
        self._touched, self._first = False, None

    def _on_data(self, data: bytes, now_s: float) -> None:
        if (message := self._decoded(data)) is None:
            return
        given, buttons = message["axes"], message["buttons"]
        scale = self._options.full_scale
        if not all(abs(value) <= LARGEST for value in given):
            self._on_malformed("with axes that are not numbers")
            return
        if max(map(abs, (*self._plain, *self._shifted))) > len(given):
            self._on_malformed(f"with {len(given)} axes: fewer than are mapped")
            return
        axes = tuple([max(-1.0, min(1.0, v / scale)) for v in given])
        self._take(axes, buttons[:MOST_BUTTONS], now_s)

    def _take(self, values: tuple[float, ...], buttons: list[int], now_s: float) -> None:
        if self._link is DeviceLink.STALE:
            self._resume("the node fell silent: let go of the device once", SETTLE_S, now_s)
        self._heard, self._stamp_s, self._last_s = True, now_s, now_s
        self._button_count = len(buttons)
        self._values = values
        self._buttons.set([f"button-{i}" for i, down in enumerate(buttons) if down], now_s)
        # Axes that are never zero, such as triggers, prove no operator; changes do.
        self._first = self._first or values
        at_rest = not any(self._strongly(self._raw(axes)) for axes in (self._plain, self._shifted))
        if not at_rest or any(buttons) or self._changed(values):
            self._touched = True
        if (
            self._link is DeviceLink.NEEDS_NEUTRAL
            and self._touched
            and at_rest
            and now_s >= self._ignore_rest_until_s
        ):
            self._link = DeviceLink.LIVE
        self._cached = None

    def _changed(self, values: tuple[float, ...]) -> bool:
        first = self._first or values
        pairs = zip(first, values, strict=False)
        return len(first) == len(values) and any(abs(a - b) > LEAST_REST for a, b in pairs)

    def _strongly(self, axes: Deflections) -> bool:
        dead = max(self._options.dead_zone, LEAST_REST)
        return any(abs(each) > dead for each in axes)

    def _raw(self, mapped: Six) -> Deflections:
        values = self._values

        def of(number: int) -> float:
            if not number:
                return 0.0
            value = values[abs(number) - 1]
            return value if number > 0 else -value

        x, y, z, roll, pitch, yaw = mapped
        return of(x), of(y), of(z), of(roll), of(pitch), of(yaw)

    def _watch(self, now_s: float) -> None:
        stale_s = self._options.stale_after_s
        silent = now_s - self._last_s > stale_s
        if self._open and silent and self._link is not DeviceLink.STALE:
            self._fall_silent(
                f"no message for {stale_s:g} s: is the device plugged in, and does its node "
                "publish at rest, too (joy_node: autorepeat_rate)?",
                now_s,
            )

    def _drop_input(self, now_s: float) -> None:
        self._values = ()

    def _axes(self, now_s: float) -> Axes:
        if not self._values:
            return NEUTRAL
        shifted = self._options.shift_button in self._buttons.held
        return self._shaper(self._raw(self._shifted if shifted else self._plain))
