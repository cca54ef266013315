"""Position control: the TCP moves as the hand has moved since the clutch was pressed.

The reference that follows is the one of rate control, with all its limits: each tick asks for the
twist that brings it to its target as fast as it can still stop there. So nothing ever steps, and
a hand that is faster than the limits is caught up with, not overshot.
"""

from __future__ import annotations

import math

from cardan.braking import stopping_speed
from cardan.gateway.mapping import AXES, MappingOptions
from cardan.gateway.reference import ReferenceLimits
from cardan.spatial import (
    add,
    from_euler_zyx,
    from_rotation_vector,
    is_finite,
    limit_norm,
    multiply,
    norm,
    normalized,
    rotate,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import IDENTITY, NEVER_S, Frame, Pose, Quaternion, Twist, Vector3

FOLLOW_TIME_S = 0.04
"""Time constant with which a small distance is closed: ten control cycles of EGM. Shorter, the
noise of a hand sensor shows in the arm; longer, the hand feels it."""

HAND_SPEED_M_S, HAND_SPEED_RAD_S = 3.0, 15.0
"""No hand that guides a robot is faster: what is, is another hand or a sensor's mistake."""

HAND_NOISE_M, HAND_NOISE_RAD = 0.01, 0.1
"""Allowed beside the speed: two reports may come close together."""

LONGEST_GAP_S = 0.1
"""Between two reports; what stamps claim beyond is not believed."""

FARTHEST_M = 10.0
"""No hand is farther from its sensor."""


def is_pose(pose: Pose | None) -> bool:
    """Whether a device's pose can be one: finite, near the device, a unit quaternion."""
    return (
        pose is not None
        and is_finite(pose.position)
        and is_finite(pose.orientation)
        and norm(pose.position) < FARTHEST_M
        and abs(math.hypot(*pose.orientation) - 1.0) < 1e-3
    )


class PositionMapping:
    """Follows one hand from one press of the clutch to its release.

    What the hand does from one report to the next moves the target, so that no turn is too long and
    a target that slips stays where it slipped to.
    """

    def __init__(self, options: MappingOptions, limits: ReferenceLimits) -> None:
        self.options = options
        self._limits = limits
        self._sources: list[tuple[int, float]] = []
        for axis, factor in zip(options.axes, options.scale, strict=True):
            if axis == "fixed":
                self._sources.append((0, 0.0))
            else:
                sign = -1.0 if axis.startswith("-") else 1.0
                self._sources.append((AXES.index(axis.lstrip("-")), sign * factor))
        roll, pitch, yaw = (math.radians(angle) for angle in options.device_rpy_deg)
        self._aligned = from_euler_zyx(roll, pitch, yaw)
        """Turns device axes into those of the mapping's frame."""
        half_yaw = 0.5 * math.radians(options.yaw_deg)
        self._yaw = Quaternion(math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw))
        self._linear_axes = self._angular_axes = IDENTITY
        """Turn the mapping's frame into the base, as it was when the clutch was pressed."""
        self.slips = False
        """Whether the hand was too far ahead at the last look."""
        self._hand: Pose | None = None
        self._hand_s = NEVER_S
        self._target: Pose | None = None

    @property
    def engaged(self) -> bool:
        """True between engage() and release()."""
        return self._hand is not None

    def engage(self, hand: Pose, stamp_s: float, tcp: Pose) -> None:
        """The clutch was pressed: from here on `hand` (device axes) means `tcp` (base axes)."""
        frame = self.options.frame
        self._linear_axes = tcp.orientation if frame is Frame.TOOL else self._yaw
        self._angular_axes = self._yaw if frame is Frame.BASE else tcp.orientation
        self._hand, self._hand_s, self._target = hand, stamp_s, tcp

    def release(self) -> None:
        """The clutch was let go."""
        self._hand = self._target = None
        self.slips = False

    def leaps(self, hand: Pose, stamp_s: float) -> bool:
        """Whether `hand`, measured at `stamp_s`, is too far from where it was to be the same."""
        if self._hand is None:
            return False
        time_s = min(max(0.0, stamp_s - self._hand_s), LONGEST_GAP_S)
        way_m = norm(subtract(hand.position, self._hand.position))
        turn_rad = norm(rotation_between(self._hand.orientation, hand.orientation))
        return (
            way_m > HAND_NOISE_M + HAND_SPEED_M_S * time_s
            or turn_rad > HAND_NOISE_RAD + HAND_SPEED_RAD_S * time_s
        )

    def twist(self, hand: Pose, stamp_s: float, tcp: Pose, dt_s: float) -> Twist:
        """The twist (base axes) that brings the reference at `tcp` to what `hand` wants.

        A hand too far ahead is not chased: the clutch slips, and the target stays near.
        """
        assert self._hand is not None
        assert self._target is not None
        moved = subtract(hand.position, self._hand.position)
        turned = rotation_between(self._hand.orientation, hand.orientation)
        self._hand, self._hand_s = hand, stamp_s
        values = (*rotate(self._aligned, moved), *rotate(self._aligned, turned))
        v = [values[index] * factor for index, factor in self._sources]
        linear = rotate(self._linear_axes, Vector3(v[0], v[1], v[2]))
        angular = rotate(self._angular_axes, Vector3(v[3], v[4], v[5]))
        position = add(self._target.position, linear)
        orientation = multiply(from_rotation_vector(angular), self._target.orientation)
        full_way = subtract(position, tcp.position)
        full_turn = rotation_between(tcp.orientation, orientation)
        way = limit_norm(full_way, self.options.slip_m)
        turn = limit_norm(full_turn, self.options.slip_rad)
        self.slips = way != full_way or turn != full_turn
        self._target = Pose(
            add(tcp.position, way),
            normalized(multiply(from_rotation_vector(turn), tcp.orientation)),
            Frame.BASE,
        )
        limits = self._limits
        return Twist(
            _closing(way, limits.linear_speed_m_s, limits.linear_acceleration_m_s2, dt_s),
            _closing(turn, limits.angular_speed_rad_s, limits.angular_acceleration_rad_s2, dt_s),
            Frame.BASE,
        )


def _closing(way: Vector3, speed: float, acceleration: float, dt_s: float) -> Vector3:
    """The velocity that closes `way` soon, and from which it can still stop at its end."""
    distance = norm(way)
    if distance < 1e-9:
        return Vector3(0.0, 0.0, 0.0)
    fastest = min(speed, distance / FOLLOW_TIME_S, stopping_speed(distance, acceleration, dt_s))
    return scale(way, fastest / distance)
