"""Targets of a page's operator frames: an arm's stream, a driver's topic, a joystick, an IMU."""

from __future__ import annotations

import contextlib
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final

from cardan.bus.network import Handle, NetworkError, PublisherHandle
from cardan.gateway.servers.console.hold_to_run import Grip, Hold, HoldVerdict
from cardan.gateway.servers.console.jog import ArmJog, Wish
from cardan.gateway.servers.publishing import RefusedError
from cardan.protocols.handheld.frames import (
    GamepadFrame,
    JogJoints,
    JogTwist,
    OperatorFrame,
    PhoneFrame,
)
from cardan.protocols.handheld.orientation import from_angles
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import Stamp
from cardan.types import Quaternion, Vector3

FRAME_TYPE: Final = "cardan_msgs/msg/OperatorFrame"
JOY_TYPE: Final = "sensor_msgs/msg/Joy"
IMU_TYPE: Final = "sensor_msgs/msg/Imu"
IMU_FRAME: Final = "phone"
"""Frame of a phone's sensors."""

_NO_VECTOR: Final = Vector3(0.0, 0.0, 0.0)

PAD_ORDER: Final = (
    "south", "east", "west", "north", "back", "guide", "start", "left-stick", "right-stick",
    "left-shoulder", "right-shoulder", "dpad-up", "dpad-down", "dpad-left", "dpad-right",
)  # fmt: skip
"""Buttons in the order of ROS 2's game_controller_node, whose axes are the sticks, left and up
positive, and the triggers."""


class Channel(ABC):
    """Target that a page has opened for its frames."""

    target = ""
    """Name of the arm or the topic."""

    def __init__(self, hold_s: float = math.inf) -> None:
        self.hold = Hold(hold_s)
        self.reported: tuple[Grip, str] | None = None

    @abstractmethod
    def take(self, frame: OperatorFrame, data: bytes, made_s: float | None, now_s: float) -> None:
        """Handle a frame. Raises RefusedError if it is not for this channel."""

    def lapse(self) -> None:  # noqa: B027 - some have nothing to do then
        """Handle the end of a hold that no frame reported."""

    async def close(self) -> None:  # noqa: B027 - as above
        """End the channel."""


class ArmChannel(Channel):
    """Jogs an arm."""

    def __init__(self, jog: ArmJog, hold_s: float) -> None:
        super().__init__(hold_s)
        self.target, self._jog = jog.arm, jog
        jog.open()

    def take(self, frame: OperatorFrame, data: bytes, made_s: float | None, now_s: float) -> None:
        if not isinstance(frame.body, (JogTwist, JogJoints)):
            raise RefusedError(
                f"channel {frame.channel} jogs an arm; {frame.kind} frames go to a "
                "channel that is opened for a device"
            )
        verdict = self.hold.take(frame, made_s, now_s)
        if verdict is HoldVerdict.REST:
            self._jog.rest()
        elif verdict is not HoldVerdict.DROPPED:
            if verdict is HoldVerdict.BEGINS:
                self._jog.begin()
            assert made_s is not None
            self._jog.move(Wish(frame.body, made_s))

    def lapse(self) -> None:
        self._jog.rest()

    async def close(self) -> None:
        await self._jog.close()


class _PublishingChannel(Channel):
    """Publishes frames as messages of a topic."""

    _type: ClassVar[str]
    """Type of the messages."""

    def __init__(
        self, topic: str, publisher: PublisherHandle, feedback: Handle | None = None
    ) -> None:
        """`feedback`: subscription to the driver's feedback for the page; None: there is none."""
        super().__init__()
        self.target = topic
        self._publisher, self._feedback = publisher, feedback
        self._codec = codec_of(self._type)

    def _publish(self, message: Mapping[str, Any]) -> None:
        with contextlib.suppress(NetworkError):
            self._publisher.publish(self._codec.encode(message))

    async def close(self) -> None:
        self._publisher.close()
        if self._feedback is not None:
            self._feedback.close()


class DeviceChannel(_PublishingChannel):
    """Passes frames on to a session's driver, which applies its own checks."""

    _type = FRAME_TYPE

    def take(self, frame: OperatorFrame, data: bytes, made_s: float | None, now_s: float) -> None:
        if isinstance(frame.body, (JogTwist, JogJoints)):
            raise RefusedError(
                f"channel {frame.channel} is opened for a device, and takes no jog frames"
            )
        if self.hold.take(frame, made_s, now_s) is HoldVerdict.DROPPED:
            return
        age_s = 0.0 if made_s is None else max(0.0, now_s - made_s)
        stamp = Stamp.of_ns(time.time_ns())
        header = {"stamp": stamp._asdict(), "frame_id": ""}
        self._publish({"header": header, "age": age_s, "frame": data})


class JoyChannel(_PublishingChannel):
    """Publishes a pad in the form of game_controller_node, for the driver ros2_joy."""

    _type = JOY_TYPE

    def take(self, frame: OperatorFrame, data: bytes, made_s: float | None, now_s: float) -> None:
        pad = frame.body
        if not isinstance(pad, GamepadFrame):
            raise RefusedError(f"channel {frame.channel} is opened for a pad, not for {frame.kind}")
        # A pad holds no control of the page: all its frames must be recent.
        verdict = self.hold.take(frame._replace(hold=True), made_s, now_s)
        self.hold.grip, self.hold.why = Grip.FREE, "" if frame.visible else "the page is hidden"
        if verdict is HoldVerdict.DROPPED or not frame.visible:
            return
        stamp = Stamp.of_ns(time.time_ns())
        down = frame.held_buttons
        sticks = pad.left_right, pad.left_down, pad.right_right, pad.right_down
        message = {
            "header": {"stamp": stamp._asdict(), "frame_id": ""},
            "axes": [*(0.0 - each for each in sticks), pad.left_trigger, pad.right_trigger],
            "buttons": [int(name in down) for name in PAD_ORDER],
        }
        self._publish(message)


class ImuChannel(_PublishingChannel):
    """Publishes a phone's sensors as an inertial measurement unit: REP-145, in the phone's own axes
    (x right, y to the top edge, z out of the screen)."""

    _type = IMU_TYPE

    def take(self, frame: OperatorFrame, data: bytes, made_s: float | None, now_s: float) -> None:
        phone = frame.body
        if not isinstance(phone, PhoneFrame):
            raise RefusedError(
                f"channel {frame.channel} is opened for a phone's sensors, not for {frame.kind}"
            )
        # Nothing is held, and nothing moves by it: only its age counts.
        verdict = self.hold.take(frame._replace(hold=True), made_s, now_s)
        # A hidden page gets no sensor events: its readings are old ones.
        self.hold.grip, self.hold.why = Grip.FREE, "" if frame.visible else "the page is hidden"
        measured = phone.angles_deg, phone.rates_rad_s, phone.acceleration_m_s2
        if verdict is HoldVerdict.DROPPED or not frame.visible or not any(measured):
            return
        age_ns = 0 if made_s is None else round(1e9 * max(0.0, now_s - made_s))
        stamp = Stamp.of_ns(time.time_ns() - age_ns)
        self._publish(imu_message(stamp, phone))


def imu_message(stamp: Stamp, phone: PhoneFrame) -> dict[str, Any]:
    """Make a ``sensor_msgs/msg/Imu``; quantities that the phone does not measure have a covariance
    that begins with -1."""
    angles, rates = phone.angles_deg, phone.rates_rad_s
    force = phone.acceleration_m_s2
    turned = Quaternion(1.0, 0.0, 0.0, 0.0) if angles is None else from_angles(*angles)
    return {
        "header": {"stamp": stamp._asdict(), "frame_id": IMU_FRAME},
        "orientation": turned._asdict(),
        "orientation_covariance": _covariance(angles),
        "angular_velocity": (rates or _NO_VECTOR)._asdict(),
        "angular_velocity_covariance": _covariance(rates),
        "linear_acceleration": (force or _NO_VECTOR)._asdict(),
        "linear_acceleration_covariance": _covariance(force),
    }


def _covariance(measured: object) -> list[float]:
    """Return the covariance of measured quantities, unknown: all zeros, by the message's
    definition."""
    return [0.0 if measured is not None else -1.0, *[0.0] * 8]


class SharedPublisher:
    """Publisher of a topic for all channels of a page: drivers tell pages apart by it."""

    def __init__(self, publisher: PublisherHandle, unused: Callable[[], object]) -> None:
        """`unused()` is called when the last one closes it."""
        self.publish = publisher.publish
        self._publisher, self._unused = publisher, unused
        self._users = 0

    def used(self) -> SharedPublisher:
        """Return the publisher for one more user, which closes it once."""
        self._users += 1
        return self

    def close(self) -> None:
        """Release it for one user."""
        self._users -= 1
        if self._users == 0:
            self._unused()
            self._publisher.close()
