"""Camera-directed motion: the operator sets the speed of advance, a camera on the tool the
direction.

The published rule (Łukawski, Victores and Balaguer 2023, after Oña et al. 2020): as long as the
operator advances along the camera's axis and the camera sees its target, the motion goes along that
axis only and turns the camera towards the target.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.gateway.operator.filters.base import TwistFilter
from cardan.spatial import dot, from_euler_zyx, rotate, scale
from cardan.types import NEVER_S, ZERO3, Frame, RobotState, Twist, Vector3
from cardan_filters.listener import (
    SOMEBODY,
    DatagramListener,
    ListenerOptions,
    Sender,
    shown_place,
)
from cardan_filters.readings import Malformed, decode_centroid

TARGET_AGE_S = Range(
    0.0, 2.0, "s", "the position of a target seen longer ago is unknown", above=True
)

SMALLEST_ADVANCE_M_S = 1e-9
"""Smallest speed that counts as an advance: less is rounding of a motion across the axis."""

_Angle = Annotated[float, bounds.ANGLE_DEG]


@dataclass(frozen=True, kw_only=True)
class CameraOptions(ListenerOptions):
    """Options of the filter ``camera``."""

    camera_rpy_deg: tuple[_Angle, _Angle, _Angle] = (0.0, 0.0, 0.0)
    """Pose of the camera (x right, y down, z along the view) in the TCP: roll, pitch, yaw,
    Rz·Ry·Rx."""
    gain_rad_s: Annotated[float, bounds.ANGULAR_SPEED_RAD_S] = 0.1
    """Turning speed when the target is at the image's edge."""
    permanence_s: Annotated[float, TARGET_AGE_S] = 0.5
    """Time for which a target is still valid after it was last seen."""


class CameraFilter(TwistFilter):
    """Filter in which a camera directs an advance; without a target the twist is unchanged."""

    Options = CameraOptions

    def __init__(self, options: CameraOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self.listener = DatagramListener(self.options.place("camera"), self._take)
        self._camera = from_euler_zyx(*map(math.radians, self.options.camera_rpy_deg))
        self._axis = rotate(self._camera, Vector3(0.0, 0.0, 1.0))
        """The camera's viewing direction, tool axes."""
        self._turn = ZERO3
        """Turning speed towards the target, rad/s along tool axes."""
        self._seen_s = NEVER_S
        self._sender = SOMEBODY
        self._disputed_s = NEVER_S
        """Time when two senders last saw the target at once: which one to follow is unknown."""
        self._directs = self._disputed = False

    def open(self) -> None:
        """Listen for targets. Raises AddressError if that is not possible."""
        self.listener.open()

    def close(self) -> None:
        """Stop listening and discard the target."""
        self.listener.close()
        self._seen_s = self._disputed_s = NEVER_S
        self._directs = self._disputed = False

    def _take(self, data: bytes, received_s: float, sender: Sender) -> Malformed | None:
        centroid = decode_centroid(data)
        if isinstance(centroid, Malformed):
            return centroid
        # A quarter turn about the camera's axis: a target to the right takes a turn about y.
        across = Vector3(-centroid.y, centroid.x, 0.0)
        self._turn = scale(rotate(self._camera, across), self.options.gain_rad_s)
        if sender != self._sender and received_s - self._seen_s <= self.options.permanence_s:
            self._disputed_s = received_s
        self._seen_s, self._sender = received_s, sender
        return None

    def apply(self, twist: Twist, robot: RobotState) -> Twist:
        """Return `twist`, or its advance along the camera's axis with a turn towards the target."""
        self.listener.drain(robot.stamp_s)
        self._directs = False
        permanence_s = self.options.permanence_s
        self._disputed = robot.stamp_s - self._disputed_s <= permanence_s
        if self._disputed or not robot.stamp_s - self._seen_s <= permanence_s:
            return twist
        axis, turn = self._axis, self._turn
        if twist.frame is not Frame.TOOL:
            if robot.pose is None:
                return twist
            axis = rotate(robot.pose.orientation, axis)
            turn = rotate(robot.pose.orientation, turn)
        advance_m_s = dot(twist.linear, axis)
        if not advance_m_s > SMALLEST_ADVANCE_M_S:
            return twist
        self._directs = True
        return Twist(scale(axis, advance_m_s), turn, twist.frame)

    def status(self) -> str:
        """Tell whether the camera directs the motion, or that two senders report targets."""
        if self._disputed:
            return "two programs send targets: the camera gives no direction"
        return "the camera gives the direction" if self._directs else ""

    def describe(self) -> str:
        """Describe gain, permanence and address."""
        options = self.options
        return (
            f"turns an advance towards the target, up to {options.gain_rad_s:g} rad/s, for "
            f"{options.permanence_s:g} s after it was seen, targets on "
            f"{shown_place(options.place('camera'))}"
        )

    def diagnosis(self) -> tuple[str, ...]:
        """Return the faults of the camera's datagrams."""
        return self.listener.diagnosis("camera")
