"""A controller that follows a device's pose, in virtual time, with a robot that may lag.

Every command is checked: no step, and no speed or acceleration beyond the limits.
"""

from __future__ import annotations

import math

from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import MappingOptions, Mode
from cardan.spatial import (
    add,
    from_euler_zyx,
    from_rotation_vector,
    limit_norm,
    multiply,
    norm,
    normalized,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import (
    ZERO3,
    ZERO_TWIST,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Pose,
    PoseCommand,
    RobotLink,
    RobotState,
    Vector3,
)
from tests.controllers import controller_for_device

DT_S = 0.004
LONGEST_PERIOD_S = 0.02
"""Longest period of the robots in the plans, so that no cycle counts as missed."""
START = Pose(Vector3(0.5, 0.0, 0.4), from_euler_zyx(math.pi, 0.0, 0.3))
HAND = Pose(Vector3(0.1, -0.2, 0.3), from_euler_zyx(0.1, 0.2, 0.3))
DEFLECTIONS = (0.3, -0.2, 0.1, 0.0, 0.4, 1.0)
"""Deflections that an Omni reports at rest."""
HAND_SPEED_M_S, HAND_SPEED_RAD_S = 2.0, 8.0
ROUNDING = 1e-6


def displaced(x=0.0, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=0.0, hand=HAND):
    return Pose(
        add(hand.position, Vector3(x, y, z)),
        normalized(multiply(from_rotation_vector(Vector3(rx, ry, rz)), hand.orientation)),
    )


def close(a, b, tolerance=1e-6):
    return all(abs(u - v) <= tolerance for u, v in zip(a, b, strict=True))


class DevicePoseBench:
    """A device that moves to its goal at the speed of a human hand, with buttons, and a robot."""

    def __init__(
        self,
        mode=Mode.POSITION,
        limits=None,
        start=START,
        deflections=DEFLECTIONS,
        filters=(),
        **options,
    ):
        """`options` are further options of the mapping."""
        if not options.get("deadman"):
            options.setdefault("clutch", "button_2")
        self.limits = limits or ReferenceLimits()
        self.core = controller_for_device(
            MappingOptions(mode=mode, **options),
            self.limits,
            Watchdogs(),
            filters,
            period_s=LONGEST_PERIOD_S,
        )
        self.start = start
        self.now_s = 100.0
        self.robot = RobotState(self.now_s, RobotLink.LIVE, 1, 0, DT_S, (0.0,) * 6, (), start, "")
        self.device = DeviceState(self.now_s, DeviceLink.LIVE, deflections, frozenset(), HAND)
        self.device_goal = HAND
        self.events = []
        self.fresh = True
        self.stuck = False
        self.command = None
        self.velocity = None
        """Linear and angular velocity, from the two newest commands."""

    # -- actions of the operator ---------------------------------------------------------------

    def press(self, *names):
        for name in names:
            self.events.append(ButtonEvent(self.now_s, name, True))
        self.device = self.device._replace(buttons=self.device.buttons | set(names))
        return self

    def release(self, *names):
        for name in names:
            self.events.append(ButtonEvent(self.now_s, name, False))
        self.device = self.device._replace(buttons=self.device.buttons - set(names))
        return self

    def tap(self, *names):
        return self.press(*names).run().release(*names).run()

    def send_pose(self, pose):
        self.device_goal = pose
        return self

    def put_device(self, pose):
        self.device_goal = pose
        self.device = self.device._replace(pose=pose)
        return self

    # -- time ----------------------------------------------------------------------------------

    def run(self, seconds=DT_S, dt_s=DT_S):
        for _ in range(max(1, round(seconds / dt_s))):
            self._tick(dt_s)
        return self

    def _tick(self, dt_s):
        self.now_s += dt_s
        self.robot = self.robot._replace(
            stamp_s=self.now_s, sequence=self.robot.sequence + 1, period_s=dt_s
        )
        if self.fresh:
            self._move_device(dt_s)
            self.device = self.device._replace(stamp_s=self.now_s)
        before, followed = self.command, self.core.following
        rested = self.core.at_rest
        events, self.events = self.events, []
        self.command = self.core.tick(self.robot, self.device, events)
        if not isinstance(self.command, PoseCommand):
            self.command = self.velocity = None
            return
        if before is None:
            self._check_first(dt_s)
        else:
            self._check(before.pose, dt_s)
            takes_up = self.core.following and not followed
            if takes_up and rested and self.core.operator.mapping.options.mode is Mode.POSITION:
                assert self.command == before
        if not self.stuck:
            self.robot = self.robot._replace(pose=self.command.pose)

    def _move_device(self, dt_s):
        here = self.device.pose
        if here is None or here == self.device_goal:
            return
        way = subtract(self.device_goal.position, here.position)
        turn = rotation_between(here.orientation, self.device_goal.orientation)
        turn = limit_norm(turn, HAND_SPEED_RAD_S * dt_s)
        pose = Pose(
            add(here.position, limit_norm(way, HAND_SPEED_M_S * dt_s)),
            normalized(multiply(from_rotation_vector(turn), here.orientation)),
        )
        if close(pose.position, self.device_goal.position, 1e-12) and norm(turn) < 1e-12:
            pose = self.device_goal
        self.device = self.device._replace(pose=pose)

    def _check(self, before, dt_s):
        pose, limits = self.command.pose, self.limits
        linear = scale(subtract(pose.position, before.position), 1.0 / dt_s)
        angular = scale(rotation_between(before.orientation, pose.orientation), 1.0 / dt_s)
        assert norm(linear) <= limits.linear_speed_m_s + ROUNDING
        assert norm(angular) <= limits.angular_speed_rad_s + ROUNDING
        was_linear, was_angular = self.velocity or (ZERO3, ZERO3)
        change = norm(subtract(linear, was_linear))
        assert change <= limits.linear_acceleration_m_s2 * dt_s + ROUNDING
        change = norm(subtract(angular, was_angular))
        assert change <= limits.angular_acceleration_rad_s2 * dt_s + ROUNDING
        self.velocity = linear, angular

    def _check_first(self, dt_s):
        """A command after none begins at rest, and may already contain one step of motion."""
        twist, limits = self.command.twist or ZERO_TWIST, self.limits
        assert norm(twist.linear) <= limits.linear_acceleration_m_s2 * dt_s + ROUNDING
        assert norm(twist.angular) <= limits.angular_acceleration_rad_s2 * dt_s + ROUNDING
        self.velocity = twist.linear, twist.angular

    # -- results -------------------------------------------------------------------------------

    @property
    def tcp(self):
        return self.command.pose

    @property
    def moved(self):
        return subtract(self.tcp.position, self.start.position)

    @property
    def turned(self):
        return rotation_between(self.start.orientation, self.tcp.orientation)

    @property
    def message(self):
        return self.core.status().message

    @property
    def mapped_device(self):
        """TCP position to which the controller's map sends the device's position."""
        world = self.core.device_map()
        x = self.device.pose.position
        rows = (world.linear[0:3], world.linear[3:6], world.linear[6:9])
        return Vector3(
            *(sum(a * b for a, b in zip(row, x, strict=True)) + o
              for row, o in zip(rows, world.offset, strict=True))
        )  # fmt: skip
