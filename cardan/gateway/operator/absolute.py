"""Absolute control: the TCP goes where the device is.

Each position of the device stands for one position of the TCP. Pressing the clutch moves the TCP
there, at an approach speed until it has arrived; from then on it follows as in position control.
"""

from __future__ import annotations

from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import MappingOptions, Orientation
from cardan.gateway.operator.position import FOLLOW_TIME_S, DevicePoseMapping
from cardan.spatial import (
    add,
    from_rpy_deg,
    multiply,
    norm,
    normalized,
    rotation_between,
    subtract,
)
from cardan.types import ZERO3, Frame, Pose, Quaternion, Twist, Vector3

ARRIVED_M, ARRIVED_RAD = 0.001, 0.01
"""Distance to its target at which the TCP has arrived in any case. It has arrived before where it
would go no faster than at the approach speed anyway."""

BEYOND_WALL_M = 0.0005
"""How far beyond the workspace's edge a target may be: enough for the reference to report that it
is held there, and too little to slow it along the edge."""


class AbsoluteMapping(DevicePoseMapping):
    """The TCP goes where the device is, by a fixed map between their positions."""

    def __init__(self, options: MappingOptions, limits: ReferenceLimits) -> None:
        super().__init__(options, limits)
        self._orientation = options.orientation or Orientation.FIXED
        self._origin = Vector3(*(options.origin_m or ZERO3))
        self._device_center = Vector3(*options.device_center_m)
        self._tool_in_device = from_rpy_deg(options.device_to_tool_rpy_deg)
        self.arrived = False
        """Whether the TCP has reached the device since the clutch press, or it was too far."""
        self.outside = False
        """Whether the device was outside the workspace at the last call."""

    @property
    def remark(self) -> str:
        """Reason why the TCP is not where the device is."""
        if self.outside:
            return "the device is outside the workspace: the TCP stays at its edge"
        return "" if self.arrived else "the TCP is on its way to where the device is"

    def release(self) -> None:
        """The clutch was released."""
        super().release()
        self.arrived = self.outside = False

    def twist(self, device: Pose, stamp_s: float, tcp: Pose, dt_s: float) -> Twist:
        """The twist (base axes) that brings the reference at `tcp` to where `device` is."""
        assert self._target is not None
        wanted = add(self._map_offset(), self._mapped(device.position))
        position = self._inside(wanted)
        orientation = normalized(self._wanted_orientation(device, self._target.orientation))
        self._target = Pose(position, orientation, Frame.BASE)
        self._device, self._device_s = device, stamp_s
        way = subtract(position, tcp.position)
        turn = rotation_between(tcp.orientation, orientation)
        options, limits = self.options, self.limits
        way_m, turn_rad = norm(way), norm(turn)
        near_m = max(ARRIVED_M, options.approach_speed_m_s * FOLLOW_TIME_S)
        near_rad = max(ARRIVED_RAD, options.approach_speed_rad_s * FOLLOW_TIME_S)
        if way_m <= near_m and turn_rad <= near_rad:
            self.arrived = True
        elif way_m > options.slip_m or turn_rad > options.slip_rad:
            self.arrived = False
        speed, turning = limits.linear_speed_m_s, limits.angular_speed_rad_s
        if not self.arrived:
            speed = min(speed, options.approach_speed_m_s)
            turning = min(turning, options.approach_speed_rad_s)
        return self._closing(way, turn, speed, turning, dt_s)

    def _wanted_orientation(self, device: Pose, now: Quaternion) -> Quaternion:
        if self._orientation is Orientation.FIXED:
            return now
        if self._orientation is not Orientation.ABSOLUTE:
            return self._turned(self._moved(device), now)
        in_base = multiply(multiply(self._yaw, self._aligned), device.orientation)
        return multiply(in_base, self._tool_in_device)

    def _inside(self, position: Vector3) -> Vector3:
        """The position in the workspace that is nearest to `position`."""
        held = []
        for value, bounds in zip(position, self.limits.workspace_m, strict=True):
            if bounds is not None:
                value = min(max(value, bounds[0] - BEYOND_WALL_M), bounds[1] + BEYOND_WALL_M)
            held.append(value)
        inside = Vector3(*held)
        self.outside = inside != position
        return inside

    def _map_offset(self) -> Vector3:
        return subtract(self._origin, self._mapped(self._device_center))
