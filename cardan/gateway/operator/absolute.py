"""Absolute control: the TCP follows the device's position by a fixed map. Pressing the clutch moves
the TCP there, at an approach speed until it has arrived; from then on it follows as in position
control."""

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
"""Distance to its target at which the TCP has arrived in any case; earlier if it would move no
faster than the approach speed anyway."""

BEYOND_WALL_M = 0.0005
"""Largest distance of a target beyond the workspace's edge: enough for the reference to report the
edge, and too little to slow it along the edge."""


class AbsoluteMapping(DevicePoseMapping):
    """Follows the device's pose by a fixed map between the positions of device and TCP."""

    def __init__(self, options: MappingOptions, limits: ReferenceLimits) -> None:
        super().__init__(options, limits)
        self._orientation = options.orientation or Orientation.FIXED
        self._origin = Vector3(*(options.origin_m or ZERO3))
        self._device_center = Vector3(*options.device_center_m)
        self._tool_in_device = from_rpy_deg(options.device_to_tool_rpy_deg)
        self.arrived = False
        """True once the TCP has reached the device since the clutch press, until it is too far
        away."""
        self.outside = False
        """True if the device was outside the workspace at the last call."""

    @property
    def remark(self) -> str:
        """Reason why the TCP is not at the device's position."""
        if self.outside:
            return "the device is outside the workspace: the TCP stays at its edge"
        return "" if self.arrived else "the TCP is on its way to where the device is"

    def release(self) -> None:
        """End following: the clutch was released."""
        super().release()
        self.arrived = self.outside = False

    def twist(self, device: Pose, stamp_s: float, tcp: Pose, dt_s: float) -> Twist:
        """Return the twist (base axes) that brings the reference at `tcp` to the position of
        `device`."""
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
        """Return the position in the workspace that is nearest to `position`."""
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
