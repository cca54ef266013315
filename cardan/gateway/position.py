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
    conjugate,
    from_euler_zyx,
    from_rotation_vector,
    limit_norm,
    multiply,
    norm,
    normalized,
    rotate,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import Frame, Pose, Quaternion, Twist, Vector3

FOLLOW_TIME_S = 0.04
"""Time constant with which a small distance is closed: ten control cycles of EGM. Shorter, the
noise of a hand sensor shows in the arm; longer, the hand feels it."""


class PositionMapping:
    """Follows one hand from one press of the clutch to its release."""

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
        self._hand: Pose | None = None
        self._start: Pose | None = None

    @property
    def engaged(self) -> bool:
        """True between engage() and release()."""
        return self._hand is not None

    def engage(self, hand: Pose, tcp: Pose) -> None:
        """The clutch was pressed: from here on `hand` (device axes) means `tcp` (base axes)."""
        self._hand, self._start = hand, tcp

    def release(self) -> None:
        """The clutch was let go."""
        self._hand = self._start = None

    def target(self, hand: Pose) -> Pose:
        """Where `hand` wants the TCP, base axes. Only while engaged."""
        assert self._hand is not None
        assert self._start is not None
        moved = rotate(self._aligned, subtract(hand.position, self._hand.position))
        turned = rotate(self._aligned, rotation_between(self._hand.orientation, hand.orientation))
        values = (*moved, *turned)
        v = [values[index] * factor for index, factor in self._sources]
        linear, angular = Vector3(v[0], v[1], v[2]), Vector3(v[3], v[4], v[5])
        frame, start = self.options.frame, self._start
        linear = rotate(start.orientation if frame is Frame.TOOL else self._yaw, linear)
        angular = rotate(self._yaw if frame is Frame.BASE else start.orientation, angular)
        return Pose(
            add(start.position, linear),
            normalized(multiply(from_rotation_vector(angular), start.orientation)),
            Frame.BASE,
        )

    def twist(self, hand: Pose, tcp: Pose, dt_s: float) -> Twist:
        """The twist (base axes) that brings the reference at `tcp` to what `hand` wants.

        A hand too far ahead is not chased: the clutch slips, and its start goes along.
        """
        assert self._start is not None
        target = self.target(hand)
        way = subtract(target.position, tcp.position)
        turn = rotation_between(tcp.orientation, target.orientation)
        held, held_turn = (
            limit_norm(way, self.options.slip_m),
            limit_norm(turn, self.options.slip_rad),
        )
        if held != way or held_turn != turn:
            back = subtract(held, way)
            wanted = multiply(from_rotation_vector(held_turn), tcp.orientation)
            undo = multiply(wanted, conjugate(target.orientation))
            self._start = Pose(
                add(self._start.position, back),
                normalized(multiply(undo, self._start.orientation)),
                Frame.BASE,
            )
        limits = self._limits
        return Twist(
            _closing(held, limits.linear_speed_m_s, limits.linear_acceleration_m_s2, dt_s),
            _closing(
                held_turn, limits.angular_speed_rad_s, limits.angular_acceleration_rad_s2, dt_s
            ),
            Frame.BASE,
        )


def _closing(way: Vector3, speed: float, acceleration: float, dt_s: float) -> Vector3:
    """The velocity that closes `way` soon, and from which it can still stop at its end."""
    distance = norm(way)
    if distance < 1e-9:
        return Vector3(0.0, 0.0, 0.0)
    fastest = min(speed, distance / FOLLOW_TIME_S, stopping_speed(distance, acceleration, dt_s))
    return scale(way, fastest / distance)
