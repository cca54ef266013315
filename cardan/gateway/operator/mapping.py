"""Maps the axes, the pose and the buttons of a device to the operator's request.

Pure values in and out: no clock, no hardware. The mappings are those of Łukawski, Victores and
Balaguer 2023, Table 1: rate control in the base frame (SpaceNavigator), which is the default, rate
control in the tool frame (Wiimote), and position control in the base frame (Leap Motion). The
buttons that toggle the clutch and recapture the references are those of the Phantom Omni in
"Bilateral haptic teleoperation", 2026.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter, mul
from typing import Annotated, ClassVar, Literal

from cardan.common import bounds
from cardan.common.bounds import Angle, Angles, Point
from cardan.common.options import Options, require
from cardan.errors import ConfigurationError
from cardan.spatial import from_rpy_deg, rotate
from cardan.types import (
    ZERO3,
    ZERO_TWIST,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Frame,
    Twist,
    Vector3,
)

ENABLE_WITHIN_S = 0.5
"""Oldest press of the enable button that counts: this computer may have stalled."""

AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the device axes and of the twist components they drive, in order."""


class Mode(enum.Enum):
    """Meaning of a device's motion."""

    RATE = "rate"
    """Deflections are velocities."""
    POSITION = "position"
    """The TCP moves by the device's displacement since the clutch was pressed."""
    ABSOLUTE = "absolute"
    """The TCP follows the device's position by a fixed map."""


class Orientation(enum.Enum):
    """Meaning of the device's orientation while its pose is followed."""

    FOLLOW_BASE = "follow-base"
    """The TCP turns about the base's axes as the device has turned about its base's axes since the
    clutch was pressed."""
    FOLLOW_TOOL = "follow-tool"
    """The TCP turns about the tool's axes as the device has turned about its own."""
    FIXED = "fixed"
    """The TCP keeps its orientation."""
    ABSOLUTE = "absolute"
    """The tool has the device's orientation; mode absolute only."""


class GripperAction(enum.Enum):
    """Action of a gripper button when it is pressed."""

    TOGGLE = "toggle"
    CLOSE = "close"
    OPEN = "open"


Speed = Annotated[float, bounds.LINEAR_SPEED_M_S]
TurningSpeed = Annotated[float, bounds.ANGULAR_SPEED_RAD_S]
Factor = Annotated[float, bounds.MOTION_SCALE]
NO_ANGLES = (0.0, 0.0, 0.0)

Source = tuple[int, float]
"""Index of the device's axis that drives a component of the motion, and the gain."""

AXES_IN_WORDS = f"{', '.join(AXES)}, each also with a minus in front"


def _source(axis: str, gain: float) -> Source:
    if axis == "fixed":
        return 0, 0.0
    return AXES.index(axis.removeprefix("-")), -gain if axis.startswith("-") else gain


@dataclass(frozen=True, kw_only=True)
class MappingOptions(Options):
    """``[mapping]``: mapping of a device to a motion of the TCP."""

    RENAMED: ClassVar = {
        "device_centre_m": "device_center_m",
        "hand_to_tool_rpy_deg": "device_to_tool_rpy_deg",
    }

    mode: Mode = Mode.RATE
    frame: Frame = Frame.BASE
    """Axes the motion is expressed along: the robot's base, the tool, or mixed. In position mode
    the tool's axes are those when the clutch was pressed."""
    linear_speed_m_s: Speed = 0.1
    """TCP speed at full deflection; rate mode."""
    angular_speed_rad_s: TurningSpeed = 0.4
    """Turning speed at full deflection; rate mode."""
    axes: tuple[str, str, str, str, str, str] = AXES
    """Device axis that drives each of x y z rx ry rz: a name, "-name" for the opposite direction,
    or "fixed" for a component that must not move."""
    scale: tuple[Factor, Factor, Factor, Factor, Factor, Factor] = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    """Factor on each component."""
    yaw_deg: Angle = 0.0
    """Viewing direction of the operator, seen from above, relative to the robot's x axis."""
    device_rpy_deg: Angles = NO_ANGLES
    """Orientation of the device's axes in those of `frame` (roll, pitch, yaw); position and
    absolute mode."""
    orientation: Orientation | None = None
    """Meaning of the device's orientation. None: in position mode by `frame`, its turn about its
    device's axes; in absolute mode fixed."""
    origin_m: Point | None = None
    """TCP position, base frame, when the device is at `device_center_m`; absolute mode."""
    device_center_m: Point = ZERO3
    """Reference position of the device, along the device's axes; absolute mode."""
    device_to_tool_rpy_deg: Angles = NO_ANGLES
    """Orientation of the tool's axes in the device's (roll, pitch, yaw); orientation absolute."""
    approach_speed_m_s: Speed = 0.05
    """Speed of the TCP towards the device's position after the clutch was pressed; absolute
    mode."""
    approach_speed_rad_s: TurningSpeed = 0.3
    """The same for its orientation."""
    slip_m: Annotated[float, bounds.MAX_LEAD_M] = 0.15
    """Largest lead of the device over the TCP: beyond, the clutch slips in position mode, and the
    TCP moves at the approach speed in absolute mode."""
    slip_rad: Annotated[float, bounds.MAX_LEAD_RAD] = 0.6
    """The same for its orientation."""
    joints: Mapping[str, str] = field(default_factory=dict)
    """Device axes that each drive a joint, and the joint's name, beside the TCP: the mixture of
    Baklouti et al. 2021, equation 7. "-axis" reverses it."""
    joint_speed_rad_s: Annotated[float, bounds.JOINT_SPEED_RAD_S] = 0.4
    """Speed of such a joint at full deflection; m/s for one that slides."""
    deadman: str | tuple[str, ...] = ""
    """Dead-man buttons, one of which is held while moving (the clutch in position mode). Without it
    and `clutch`, deflection alone moves (not beside a person)."""
    clutch: str = ""
    """Button whose presses alternately begin and end the motion; empty: none. With `deadman` too,
    both are needed."""
    recapture: str = ""
    """Button that takes the present poses of device and TCP as new references; position mode."""
    enable: str = ""
    """Button that requests the robot's drives and program; empty: none."""
    pass_on: str = ""
    """Button that passes the device on to the next session of a daemon that shares it; empty:
    none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.deadman == "" or "" not in self.deadman_buttons,
            "deadman",
            self.deadman,
            'the name of a button, or several as ["a", "b"]',
        )
        for axis in self.axes:
            require(
                axis == "fixed" or axis.removeprefix("-") in AXES,
                "axes",
                axis,
                f'one of {AXES_IN_WORDS}, or "fixed"',
            )
        for axis in self.joints:
            require(axis.removeprefix("-") in AXES, "joints", axis, f"one of {AXES_IN_WORDS}")
        for key, wrong, message in self._rules():
            if wrong:
                raise ConfigurationError(key, message)

    @cached_property
    def deadman_buttons(self) -> tuple[str, ...]:
        """The dead-man buttons, one of which must be held; empty: none needed."""
        if isinstance(self.deadman, str):
            return (self.deadman,) if self.deadman else ()
        return self.deadman

    @cached_property
    def sources(self) -> tuple[Source, ...]:
        """Source of each of x y z rx ry rz, by `axes` and `scale`."""
        return tuple(map(_source, self.axes, self.scale))

    def _rules(self) -> tuple[tuple[str, object, str], ...]:
        """Conditions by mode: a key, whether it is wrong, and why."""
        mode, only = f'mode = "{self.mode.value}"', 'only mode = "absolute" has one'
        rate, absolute = self.mode is Mode.RATE, self.mode is Mode.ABSOLUTE
        whole = self.orientation is Orientation.ABSOLUTE
        mapped = self.axes[3:] != AXES[3:] or self.scale[3:] != (1.0,) * 3
        return (
            (
                "device_rpy_deg",
                rate and any(self.device_rpy_deg),
                'only mode = "position" and mode = "absolute" turn the device\'s axes',
            ),
            (
                "orientation",
                rate and self.orientation is not None,
                f'{mode} follows no pose; "fixed" in axes keeps what must not turn',
            ),
            (
                "deadman",
                not rate and not self.deadman_buttons and not self.clutch,
                f"{mode} needs one, the clutch: what the device moves while it is held, the TCP "
                'moves; or a button that begins and ends it, clutch = "..."',
            ),
            ("joints", not rate and self.joints, f"in {mode} no axis drives a joint"),
            (
                "recapture",
                self.recapture and self.mode is not Mode.POSITION,
                f"{mode} has no references to reset",
            ),
            ("origin_m", not absolute and self.origin_m is not None, only),
            ("device_center_m", not absolute and self.device_center_m != ZERO3, only),
            ("device_to_tool_rpy_deg", not absolute and any(self.device_to_tool_rpy_deg), only),
            ("orientation", not absolute and whole, '"absolute" is for mode = "absolute" only'),
            (
                "origin_m",
                absolute and self.origin_m is None,
                f"{mode} needs it: where the TCP is when the device is at device_center_m",
            ),
            (
                "frame",
                absolute and self.frame is not Frame.BASE,
                f'{self.frame.value!r} moves; in {mode} it is "base"',
            ),
            (
                "orientation",
                whole and mapped,
                '"absolute" takes the device\'s whole orientation: leave the last three of axes '
                "and scale as they are by themselves",
            ),
            (
                "device_to_tool_rpy_deg",
                not whole and any(self.device_to_tool_rpy_deg),
                'only orientation = "absolute" has one',
            ),
        )


@dataclass(frozen=True, kw_only=True)
class GripperOptions(Options):
    """``[gripper]``: buttons, and the output to the robot's program."""

    toggle: str = ""
    close: str = ""
    open: str = ""
    output: Literal["digital"] | Annotated[int, bounds.ANALOG_OUTPUT] = "digital"
    """The digital output, or the index of an analog output."""
    closed_value: Annotated[float, bounds.OUTPUT_VALUE] = 1.0
    open_value: Annotated[float, bounds.OUTPUT_VALUE] = 0.0

    @property
    def buttons(self) -> dict[str, GripperAction]:
        """Action of each gripper button."""
        named = ((getattr(self, action.value), action) for action in GripperAction)
        return {button: action for button, action in named if button}


class TwistMapping:
    """Turns device states into target twists and gripper states."""

    def __init__(self, options: MappingOptions, gripper: GripperOptions | None = None) -> None:
        self.options = options
        speeds = (options.linear_speed_m_s,) * 3 + (options.angular_speed_rad_s,) * 3
        self._sources = itemgetter(*(index for index, _ in options.sources))
        self._gains = [gain * each for (_, gain), each in zip(options.sources, speeds, strict=True)]
        self._yaw = from_rpy_deg((0.0, 0.0, options.yaw_deg))
        self._turned = options.yaw_deg != 0.0 and options.frame is not Frame.TOOL
        self._turned_angular = options.frame is Frame.BASE
        self._joints = [
            (*_source(axis, options.joint_speed_rad_s), joint)
            for axis, joint in options.joints.items()
        ]
        self.drives_joints = bool(self._joints)
        """True if some axes drive joints."""
        self.follows_pose = options.mode is not Mode.RATE
        """True if the device's pose moves the TCP, and its deflections mean nothing."""
        self._last: tuple[Sequence[float] | None, Twist] = None, ZERO_TWIST
        """Deflections of the last twist, which stay the same object between two reports."""
        self._gripper_buttons = (gripper or GripperOptions()).buttons
        self.gripper_closed = False

    def twist(self, axes: Sequence[float]) -> Twist:
        """Return the twist of six deflections, along the axes of `options.frame`."""
        last, twist = self._last
        if axes is last and type(axes) is tuple:
            return twist
        x, y, z, rx, ry, rz = map(mul, self._sources(axes), self._gains)
        linear = tuple.__new__(Vector3, (x, y, z))
        angular = tuple.__new__(Vector3, (rx, ry, rz))
        if self._turned:
            linear = rotate(self._yaw, linear)
            angular = rotate(self._yaw, angular) if self._turned_angular else angular
        twist = tuple.__new__(Twist, (linear, angular, self.options.frame))
        self._last = axes, twist
        return twist

    def joint_rates(self, axes: Sequence[float]) -> dict[str, float]:
        """Return the wanted speeds of joints by name, rad/s or m/s."""
        return {joint: axes[index] * gain for index, gain, joint in self._joints}

    def passes_on(self, events: Iterable[ButtonEvent]) -> bool:
        """Return whether the operator passes the device on to the next session."""
        button = self.options.pass_on
        return any(event.pressed and event.button == button for event in events)

    def presses_enable(self, events: Iterable[ButtonEvent], now_s: float) -> bool:
        """Return whether the operator presses the enable button. An old press does not count."""
        return any(
            event.pressed
            and event.button == self.options.enable
            and now_s - event.stamp_s <= ENABLE_WITHIN_S
            for event in events
        )

    def not_at_rest(self, device: DeviceState) -> str:
        """Return why a press of the enable button is refused: a robot that was just enabled must
        not begin to move. Empty with a live device, no deflection and no dead-man held."""
        if device.link is not DeviceLink.LIVE:
            return f"the device is {device.link.value}"
        if held := sorted(device.buttons.intersection(self.options.deadman_buttons)):
            return f"{held[0]!r} is held"
        if not self.follows_pose and any(device.axes):
            return "the device is deflected"
        return ""

    def take_gripper(self, events: Iterable[ButtonEvent]) -> bool:
        """Apply the gripper buttons among `events`; return whether the gripper changes."""
        before = self.gripper_closed
        for event in events:
            action = self._gripper_buttons.get(event.button) if event.pressed else None
            if action is GripperAction.TOGGLE:
                self.gripper_closed = not self.gripper_closed
            elif action is not None:
                self.gripper_closed = action is GripperAction.CLOSE
        return self.gripper_closed is not before
