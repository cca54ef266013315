"""From the axes, the pose and the buttons of a device to what the operator asks of the robot.

Pure values in and out: no clock, no hardware. The mappings are those of Łukawski, Victores and
Balaguer 2023, Table 1: rate control in the base frame (SpaceNavigator), which is the default, rate
control in the tool frame (Wiimote), and position control in the base frame (Leap Motion). The
buttons that toggle the clutch and take the references anew are those of the Phantom Omni in
"Bilateral haptic teleoperation", 2026.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from cardan.spatial import rotate
from cardan.types import (
    ZERO3,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Frame,
    Quaternion,
    Twist,
    Vector3,
)

ENABLE_WITHIN_S = 0.5
"""Older presses of the enable button do not count: this computer may have stood still."""

AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the device axes and of the twist components they drive, in order."""


class Mode(enum.Enum):
    """What a hand's motion means."""

    RATE = "rate"
    """Deflections are velocities."""
    POSITION = "position"
    """What the hand moved since the clutch was pressed, the TCP moves."""
    ABSOLUTE = "absolute"
    """Where the hand is, the TCP goes."""


class Orientation(enum.Enum):
    """What the hand's orientation means, where its pose is followed."""

    FOLLOW_BASE = "follow-base"
    """What the hand turned since the clutch was pressed, about its device's axes, the TCP turns
    about those of the base."""
    FOLLOW_TOOL = "follow-tool"
    """What the hand turned about its own axes, the TCP turns about the tool's."""
    FIXED = "fixed"
    """The TCP keeps its orientation."""
    ABSOLUTE = "absolute"
    """The tool stands as the hand does; mode absolute only."""


class GripperAction(enum.Enum):
    """What a gripper button does when it goes down."""

    TOGGLE = "toggle"
    CLOSE = "close"
    OPEN = "open"


@dataclass(frozen=True, kw_only=True)
class MappingOptions:
    """How a device is turned into a motion of the TCP."""

    mode: Mode = Mode.RATE
    frame: Frame = Frame.BASE
    """Axes the motion is expressed along: the robot's base, the tool, or mixed. In position mode
    the tool's axes are those when the clutch was pressed."""
    linear_speed_m_s: float = 0.1
    """TCP speed at full deflection; rate mode."""
    angular_speed_rad_s: float = 0.4
    """Turning speed at full deflection; rate mode."""
    axes: tuple[str, ...] = AXES
    """Device axis that drives each of x y z rx ry rz: a name, "-name" to turn it round, or
    "fixed" for a component that must not move."""
    scale: tuple[float, ...] = (1.0,) * 6
    """Factor on each component."""
    device_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How the device's axes stand in those of `frame` (roll, pitch, yaw); position and absolute
    mode."""
    orientation: Orientation | None = None
    """What the hand's orientation means. None: in position mode what `frame` says, the hand's turn
    about its device's axes; in absolute mode it is fixed."""
    slip_m: float = 0.15
    """How far the hand may be ahead of the TCP: beyond, the clutch slips in position mode, and the
    TCP goes at the approach speed in absolute mode."""
    slip_rad: float = 0.6
    """The same for its orientation."""
    origin_m: Vector3 = ZERO3
    """Where the TCP is, base frame, when the hand is at `device_centre_m`; absolute mode."""
    device_centre_m: Vector3 = ZERO3
    """A place of the hand, along the device's axes; absolute mode."""
    hand_to_tool_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How the tool's axes stand in the hand's (roll, pitch, yaw); orientation absolute."""
    approach_speed_m_s: float = 0.05
    """Speed at which the TCP goes to where the hand is after the clutch was pressed; absolute
    mode."""
    approach_speed_rad_s: float = 0.3
    """The same for its orientation."""
    yaw_deg: float = 0.0
    """Where the operator faces, seen from above, relative to the robot's x axis."""
    joints: tuple[tuple[str, str], ...] = ()
    """Device axes that drive a joint each, and the joint's name, beside the TCP: the mixture of
    Baklouti et al. 2021, equation 7. "-axis" turns it round."""
    joint_speed_rad_s: float = 0.4
    """Of such a joint at full deflection; m/s for one that slides."""
    deadman: tuple[str, ...] = ()
    """Buttons of which one is held while moving, the clutch in position mode; none, and no
    `clutch` either: deflection alone moves (not beside a person)."""
    clutch: str = ""
    """Button of which each press begins or ends the motion; empty: none. With `deadman` too, both
    are needed."""
    recapture: str = ""
    """Button that makes hand and TCP, each where it is, belong together; position mode."""
    enable: str = ""
    """Button that asks for the robot's drives and program; empty: none."""
    gripper: tuple[tuple[str, GripperAction], ...] = ()
    """Gripper buttons and what each does."""


class TwistMapping:
    """Turns device states into target twists and gripper states."""

    def __init__(self, options: MappingOptions) -> None:
        self.options = options
        speeds = (options.linear_speed_m_s,) * 3 + (options.angular_speed_rad_s,) * 3
        self._sources: list[tuple[int, float]] = []
        for axis, factor, speed in zip(options.axes, options.scale, speeds, strict=True):
            if axis == "fixed":
                self._sources.append((0, 0.0))
            else:
                sign = -1.0 if axis.startswith("-") else 1.0
                self._sources.append((AXES.index(axis.lstrip("-")), sign * factor * speed))
        half_yaw = 0.5 * math.radians(options.yaw_deg)
        self._yaw = Quaternion(math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw))
        self._turned = options.yaw_deg != 0.0 and options.frame is not Frame.TOOL
        self._turned_angular = options.frame is Frame.BASE
        self._joints = [
            (
                AXES.index(axis.lstrip("-")),
                joint,
                -options.joint_speed_rad_s if axis.startswith("-") else options.joint_speed_rad_s,
            )
            for axis, joint in options.joints
        ]
        self._gripper_buttons = dict(options.gripper)
        self.gripper_closed = False

    def twist(self, axes: Sequence[float]) -> Twist:
        """The twist asked for by six deflections, along the axes of `options.frame`."""
        v = [axes[index] * gain for index, gain in self._sources]
        linear, angular = Vector3(v[0], v[1], v[2]), Vector3(v[3], v[4], v[5])
        if self._turned:
            linear = rotate(self._yaw, linear)
            angular = rotate(self._yaw, angular) if self._turned_angular else angular
        return Twist(linear, angular, self.options.frame)

    def joint_rates(self, axes: Sequence[float]) -> dict[str, float]:
        """What is asked of joints by name, rad/s or m/s."""
        return {joint: axes[index] * gain for index, joint, gain in self._joints}

    @property
    def drives_joints(self) -> bool:
        """True when some axes drive joints."""
        return bool(self._joints)

    def deadman_held(self, device: DeviceState) -> bool:
        """True while the operator says that motion is wanted."""
        deadman = self.options.deadman
        return not deadman or not device.buttons.isdisjoint(deadman)

    @property
    def follows_pose(self) -> bool:
        """True where the hand's pose moves the TCP, and its deflections mean nothing."""
        return self.options.mode is not Mode.RATE

    def asks_to_enable(
        self, device: DeviceState, events: Iterable[ButtonEvent], now_s: float
    ) -> bool:
        """True when the operator asks for the robot, with nothing deflected and no dead-man held:
        what is made ready must not begin to move. A press that waited is no wish any more."""
        return (
            any(
                event.pressed
                and event.button == self.options.enable
                and now_s - event.stamp_s <= ENABLE_WITHIN_S
                for event in events
            )
            and device.link is DeviceLink.LIVE
            and (self.follows_pose or not any(device.axes))
            and device.buttons.isdisjoint(self.options.deadman)
        )

    def take_gripper(self, events: Iterable[ButtonEvent]) -> bool:
        """Apply the gripper buttons among `events`; True when the gripper changes."""
        before = self.gripper_closed
        for event in events:
            action = self._gripper_buttons.get(event.button) if event.pressed else None
            if action is GripperAction.TOGGLE:
                self.gripper_closed = not self.gripper_closed
            elif action is not None:
                self.gripper_closed = action is GripperAction.CLOSE
        return self.gripper_closed is not before
