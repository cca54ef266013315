"""Position control: the TCP moves as the device has moved since the clutch was pressed. It uses the
reference of rate control with all its limits: each tick requests the fastest twist towards the
target from which the reference can still stop there. The command therefore has no steps, and the
TCP catches up with a device that exceeds the limits without overshoot.

This is the "differential control" of the bilateral teleoperation paper of 2026, with its defects
corrected: the scale acts on the displacement, and displacements are along the base's axes, or by
option those of the start TCP.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TypeGuard

from cardan.common.braking import stopping_speed
from cardan.common.haptics import Matrix3, WorldMap
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.gateway.operator.mapping import AXES, MappingOptions, Orientation, Source
from cardan.spatial import (
    add,
    conjugate,
    from_rotation_vector,
    from_rpy_deg,
    is_finite,
    limit_norm,
    multiply,
    norm,
    rotate,
    rotation_between,
    scale,
    subtract,
    to_rotation_vector,
    turned_by,
)
from cardan.types import IDENTITY, NEVER_S, ZERO3, Frame, Pose, Quaternion, Twist, Vector3

FOLLOW_TIME_S = 0.04
"""Time constant for closing a small distance: ten control cycles of EGM. Shorter, the noise of a
pose sensor shows in the arm; longer, the operator notices the delay."""

HAND_SPEED_M_S, HAND_SPEED_RAD_S = 3.0, 15.0
"""Largest plausible speed of a hand: faster is another hand or a fault of the sensor."""

HAND_NOISE_M, HAND_NOISE_RAD = 0.01, 0.1
"""Tolerance added to the distance at that speed: two reports may come close together."""

LONGEST_GAP_S = 0.1
"""Longest time between two reports; a longer one by their stamps counts as this."""

FARTHEST_M = 10.0
"""Largest plausible distance of a hand from its sensor."""


def is_pose(pose: Pose | None) -> TypeGuard[Pose]:
    """Return whether a device's pose is plausible: finite, near the device, a unit quaternion."""
    return (
        pose is not None
        and is_finite(pose.position)
        and is_finite(pose.orientation)
        and norm(pose.position) < FARTHEST_M
        and abs(math.hypot(*pose.orientation) - 1.0) < 1e-3
    )


def resting_pose(reference: Reference) -> Pose:
    """Return the pose of `reference` at rest after the hardest allowed braking. A clutch pressed
    there does not draw the reference back after it braked."""
    pose, limits = reference.pose, reference.limits
    assert pose is not None
    linear, angular = reference.linear, reference.angular
    if linear == ZERO3 and angular == ZERO3:
        return pose
    way = scale(linear, 0.5 * norm(linear) / limits.linear_acceleration_m_s2)
    turn = scale(angular, 0.5 * norm(angular) / limits.angular_acceleration_rad_s2)
    return Pose(
        add(pose.position, way),
        turned_by(pose.orientation, turn),
        Frame.BASE,
    )


def _turning_sources(options: MappingOptions) -> list[Source] | None:
    """Return the rotation among `options.axes`: of gain 1 or -1, nothing fixed, nothing mirrored.

    Components that do not move take the remaining axes, their own if they can. None if there is no
    such rotation: the axes mirror, or one drives several components.
    """
    rows = [
        (index, math.copysign(1.0, gain)) if gain and index < 3 else None
        for index, gain in options.sources[:3]
    ]
    free = [row for row in range(3) if rows[row] is None]
    left = sorted(set(range(3)) - {source[0] for source in rows if source is not None})
    if len(left) != len(free):
        return None
    choices = sorted(
        itertools.permutations(left),
        key=lambda choice: -sum(row == index for row, index in zip(free, choice, strict=True)),
    )
    for signs in ((1.0,) * len(free), (-1.0, *((1.0,) * (len(free) - 1)))):
        for choice in choices:
            filled = dict(zip(free, zip(choice, signs, strict=False), strict=True))
            whole = [filled[row] if source is None else source for row, source in enumerate(rows)]
            swaps = sum(a[0] > b[0] for a, b in itertools.combinations(whole, 2))
            if math.prod(gain for _, gain in whole) * (-1.0) ** swaps > 0.0:
                return whole
    return None


def mirrors(options: MappingOptions) -> bool:
    """Return whether `options.axes` and `.scale` are no rotation for the device's directions: a
    mirror, or one axis that drives several components. Forces cannot be mapped back then."""
    return _turning_sources(options) is None


LEAST_FOLLOWED = 0.001
"""Share of the device's motion below which the TCP does not count as following."""


def unfollowed(options: MappingOptions) -> tuple[str, ...]:
    """Return those of x, y, z of the TCP that the device does not move, along the mapping's
    axes."""
    return tuple(
        axis
        for axis, (index, gain) in zip(AXES, options.sources[:3], strict=False)
        if index > 2 or abs(gain) < LEAST_FOLLOWED
    )


class DevicePoseMapping(ABC):
    """Follows the device's pose from one press of the clutch to its release."""

    def __init__(self, options: MappingOptions, limits: ReferenceLimits) -> None:
        self.options = options
        self.limits = limits
        self._sources = options.sources
        self._turning_sources = _turning_sources(options)
        self._aligned = from_rpy_deg(options.device_rpy_deg)
        """Turns device axes into those of the mapping's frame."""
        self._yaw = from_rpy_deg((0.0, 0.0, options.yaw_deg))
        self._linear_axes = self._angular_axes = IDENTITY
        """Rotations from the mapping's frame to the base at the press of the clutch."""
        self._orientation = options.orientation
        self._device: Pose | None = None
        self._device_s = NEVER_S
        self._target: Pose | None = None
        self._linear_map = self._rotation_map = WorldMap().linear

    @property
    def engaged(self) -> bool:
        """True between engage() and release()."""
        return self._device is not None

    @property
    @abstractmethod
    def remark(self) -> str:
        """Return a message about the last call for the operator; empty: all is well."""

    def engage(self, device: Pose, stamp_s: float, tcp: Pose) -> None:
        """Begin at a press of the clutch: from here on the TCP, commanded to be at `tcp` (base
        axes), follows `device` (device axes). A second call without release() starts again."""
        frame = self.options.frame
        follows_base = self._orientation is Orientation.FOLLOW_BASE
        self._linear_axes = tcp.orientation if frame is Frame.TOOL else self._yaw
        self._angular_axes = self._yaw if frame is Frame.BASE or follows_base else tcp.orientation
        self._device, self._device_s, self._target = device, stamp_s, tcp
        self._linear_map = self._matrix(self._sources)
        if self._turning_sources is not None:
            self._rotation_map = self._matrix(self._turning_sources)

    def release(self) -> None:
        """End following: the clutch was released."""
        self._device = self._target = None

    def jumps(self, device: Pose, stamp_s: float) -> bool:
        """Return whether `device`, measured at `stamp_s`, is implausibly far from the previous
        pose."""
        if self._device is None:
            return False
        time_s = min(max(0.0, stamp_s - self._device_s), LONGEST_GAP_S)
        way_m = norm(subtract(device.position, self._device.position))
        turn_rad = norm(rotation_between(self._device.orientation, device.orientation))
        return way_m > HAND_NOISE_M + HAND_SPEED_M_S * time_s or (
            self._orientation is not Orientation.FIXED
            and turn_rad > HAND_NOISE_RAD + HAND_SPEED_RAD_S * time_s
        )

    def _closing(
        self, way: Vector3, turn: Vector3, speed_m_s: float, speed_rad_s: float, dt_s: float
    ) -> Twist:
        """Return the twist that closes `way` and `turn`, at most at these speeds."""
        limits = self.limits
        return Twist(
            _closing_velocity(way, speed_m_s, limits.linear_acceleration_m_s2, dt_s),
            _closing_velocity(turn, speed_rad_s, limits.angular_acceleration_rad_s2, dt_s),
            Frame.BASE,
        )

    @abstractmethod
    def twist(self, device: Pose, stamp_s: float, tcp: Pose, dt_s: float) -> Twist:
        """Return the twist (base axes) that brings the reference at `tcp` to the target of
        `device`."""

    def world_map(self) -> WorldMap | None:
        """Map from the device's position to the commanded position of the TCP at present.

        Along an axis on which the device is beyond the workspace, it gives the workspace's edge,
        whatever the device does. None while released, and for axes that mirror.
        """
        if self._device is None or self._turning_sources is None:
            return None
        world = WorldMap(self._linear_map, self._map_offset(), self._rotation_map)
        place = add(self._mapped(self._device.position), world.offset)
        for axis, bounds in enumerate(self.limits.workspace_m):
            if bounds is not None and not bounds[0] <= place[axis] <= bounds[1]:
                world = _held(world, axis, min(max(place[axis], bounds[0]), bounds[1]))
        return world

    @abstractmethod
    def _map_offset(self) -> Vector3:
        """Return the offset of the map, beside its linear part."""

    def _moved(self, device: Pose) -> Sequence[float]:
        """Return the device's motion since the last call: a displacement and a rotation vector,
        both along the axes of the mapping's frame (the rotation about its own if the tool follows).
        """
        assert self._device is not None
        before, after = self._device.orientation, device.orientation
        way = subtract(device.position, self._device.position)
        if self._orientation is Orientation.FOLLOW_TOOL:
            turn = to_rotation_vector(multiply(conjugate(before), after))
        else:
            turn = rotation_between(before, after)
        return (*rotate(self._aligned, way), *rotate(self._aligned, turn))

    def _to_base(self, moved: Sequence[float], sources: Sequence[Source]) -> Vector3:
        """Return the displacement of the TCP, base axes, for a motion of the device."""
        (i, a), (j, b), (k, c) = sources[:3]
        return rotate(self._linear_axes, Vector3(moved[i] * a, moved[j] * b, moved[k] * c))

    def _turned(self, moved: Sequence[float], orientation: Quaternion) -> Quaternion:
        """Return the target's `orientation`, turned by the motion of the device."""
        kind = self._orientation
        if kind is Orientation.FIXED:
            return orientation
        (i, a), (j, b), (k, c) = self._sources[3:]
        turn = Vector3(moved[i] * a, moved[j] * b, moved[k] * c)
        if kind is Orientation.FOLLOW_TOOL:
            return multiply(orientation, from_rotation_vector(turn))
        return multiply(from_rotation_vector(rotate(self._angular_axes, turn)), orientation)

    def _matrix(self, sources: Sequence[Source]) -> Matrix3:
        """Return the matrix of `_to_base` for positions of the device."""
        x, y, z = (
            self._to_base((*rotate(self._aligned, unit), *ZERO3), sources)
            for unit in (Vector3(1.0, 0.0, 0.0), Vector3(0.0, 1.0, 0.0), Vector3(0.0, 0.0, 1.0))
        )
        return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])

    def _mapped(self, way: Vector3) -> Vector3:
        """Map `way` of the device through the linear map."""
        a, b, c, d, e, f, g, h, i = self._linear_map
        x, y, z = way
        return Vector3(a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)


def _held(world: WorldMap, axis: int, at_m: float) -> WorldMap:
    """Return `world` with all its results at `at_m` along the base's `axis`."""
    linear, offset = list(world.linear), list(world.offset)
    linear[3 * axis : 3 * axis + 3] = ZERO3
    offset[axis] = at_m
    a, b, c, d, e, f, g, h, i = linear
    return WorldMap((a, b, c, d, e, f, g, h, i), Vector3(*offset), world.rotation)


class PositionMapping(DevicePoseMapping):
    """Moves the TCP as the device has moved since the clutch was pressed. Each motion of the device
    between two reports moves the target, so that no rotation is too long and a target that slips
    keeps its new place."""

    def __init__(self, options: MappingOptions, limits: ReferenceLimits) -> None:
        super().__init__(options, limits)
        self.slips = False
        """True if the device was too far ahead at the last call."""

    @property
    def remark(self) -> str:
        """Return a message for the operator if the clutch slips."""
        return "the device is too far ahead of the TCP: the clutch slips" if self.slips else ""

    def release(self) -> None:
        """End following: the clutch was released."""
        super().release()
        self.slips = False

    def twist(self, device: Pose, stamp_s: float, tcp: Pose, dt_s: float) -> Twist:
        """Return the twist (base axes) that brings the reference at `tcp` to the target of
        `device`. The target does not follow a device too far ahead: the clutch slips."""
        assert self._target is not None
        moved = self._moved(device)
        position = add(self._target.position, self._to_base(moved, self._sources))
        orientation = self._turned(moved, self._target.orientation)
        self._device, self._device_s = device, stamp_s
        full_way = subtract(position, tcp.position)
        full_turn = rotation_between(tcp.orientation, orientation)
        way = limit_norm(full_way, self.options.slip_m)
        turn = limit_norm(full_turn, self.options.slip_rad)
        self.slips = way != full_way or turn != full_turn
        self._target = Pose(
            add(tcp.position, way),
            turned_by(tcp.orientation, turn),
            Frame.BASE,
        )
        limits = self.limits
        return self._closing(way, turn, limits.linear_speed_m_s, limits.angular_speed_rad_s, dt_s)

    def _map_offset(self) -> Vector3:
        assert self._device is not None
        assert self._target is not None
        return subtract(self._target.position, self._mapped(self._device.position))


def _closing_velocity(way: Vector3, speed: float, acceleration: float, dt_s: float) -> Vector3:
    """Return the velocity that closes `way` quickly, and from which it can still stop at its
    end."""
    distance = norm(way)
    if distance < 1e-9:
        return ZERO3
    fastest = min(speed, distance / FOLLOW_TIME_S, stopping_speed(distance, acceleration, dt_s))
    return scale(way, fastest / distance)
