"""Displacement of the device since the begin of the hold, and its plausibility."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from cardan.protocols.handheld.orientation import heading_rad
from cardan.spatial import (
    conjugate,
    from_rotation_vector,
    multiply,
    norm,
    rotate,
    rotation_between,
    same_hemisphere,
    subtract,
)
from cardan.types import IDENTITY, Quaternion, Vector3

JUMP_M: Final = 0.05
JUMP_RAD: Final = math.radians(35.0)
"""Largest step between two frames that is no tracking jump, as in teleop 0.1.5."""

HAND_M_S: Final = 3.0
HAND_RAD_S: Final = 20.0
"""Fastest plausible motion. A jump is above both limits: lost frames make steps long, but not
fast."""


class PoseSample(NamedTuple):
    """Pose of a device at a time."""

    time_s: float
    """Time of the measurement, by the measuring clock."""
    orientation: Quaternion
    position: Vector3 | None = None
    """Position, m; None if not measured."""


def jump(before: PoseSample, now: PoseSample) -> str:
    """Explain a position jump from `before` to `now`; empty if the step is possible."""
    dt_s = max(now.time_s - before.time_s, 0.0)
    angle = norm(rotation_between(before.orientation, now.orientation))
    if angle > JUMP_RAD and angle > HAND_RAD_S * dt_s:
        return f"its orientation jumped by {math.degrees(angle):.0f}°"
    if before.position is None or now.position is None:
        return ""
    way = norm(subtract(now.position, before.position))
    if way > JUMP_M and way > HAND_M_S * dt_s:
        return f"its position jumped by {1e2 * way:.0f} cm"
    return ""


def elsewhere(before: PoseSample, now: PoseSample) -> bool:
    """True if `now` is another place than `before`, whatever the time between."""
    angle = norm(rotation_between(before.orientation, now.orientation))
    if angle > JUMP_RAD:
        return True
    if before.position is None or now.position is None:
        return False
    return norm(subtract(now.position, before.position)) > JUMP_M


class Held:
    """Displacement of the device since the begin of the hold. The rotation continues beyond half a
    turn without a jump."""

    def __init__(self, began: PoseSample) -> None:
        self._began = began
        self._last = IDENTITY

    def turn(self, now: PoseSample) -> Vector3:
        """Rotation vector along the axes of the reference, rad."""
        q = multiply(now.orientation, conjugate(self._began.orientation))
        q = self._last = same_hemisphere(q, self._last)
        sine = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z)
        if sine < 1e-9:
            return Vector3(2.0 * q.x, 2.0 * q.y, 2.0 * q.z)
        factor = 2.0 * math.atan2(sine, q.w) / sine
        return Vector3(q.x * factor, q.y * factor, q.z * factor)

    def way(self, now: PoseSample) -> Vector3:
        """Translation, m; zero if not measured."""
        if now.position is None or self._began.position is None:
            return Vector3(0.0, 0.0, 0.0)
        return subtract(now.position, self._began.position)


class Yaw:
    """Angle between a reference, whose heading is arbitrary, and the robot's x axis."""

    def __init__(self, yaw_rad: float = 0.0) -> None:
        self.yaw_rad = yaw_rad
        """Yaw of the robot's x axis in the reference."""
        half = -0.5 * yaw_rad
        self._back = Quaternion(math.cos(half), 0.0, 0.0, math.sin(half))

    @classmethod
    def of_phone(cls, q: Quaternion) -> Yaw:
        """Align by a phone that points along the robot's x axis."""
        return cls(heading_rad(q))

    @classmethod
    def of_xr(cls, q: Quaternion) -> Yaw:
        """Align by a controller that points along it; `q` is along our axes."""
        forward = rotate(q, Vector3(1.0, 0.0, 0.0))
        return cls(math.atan2(forward.y, forward.x))

    def vector(self, v: Vector3) -> Vector3:
        """Convert a vector to the robot's axes."""
        return rotate(self._back, v)

    def orientation(self, q: Quaternion) -> Quaternion:
        """Convert an orientation to the robot's axes."""
        return multiply(self._back, q)


def drag_on_screen(right: float, up: float, quarters: int) -> Vector3:
    """Convert a finger's displacement on the upright screen to the phone's own axes."""
    x, y = ((right, up), (up, -right), (-right, -up), (-up, right))[quarters]
    return Vector3(x, y, 0.0)


def pitched(q: Quaternion, angle_rad: float) -> Quaternion:
    """Pitch `q` about its own axes, nose up: a controller's grip does not point where the device
    does."""
    return multiply(q, from_rotation_vector(Vector3(0.0, -angle_rad, 0.0)))
