"""A session's configuration: a TOML file, checked whole before anything is opened.

Every error names the key, what is wrong with the value, and what is allowed.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    StrictInt,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from cardan.arm_model import Capsule, load_arm
from cardan.drivers import registry
from cardan.drivers.base import Driver, OperatorDevice, RobotDriver
from cardan.drivers.haptic import HapticDevice
from cardan.errors import ConfigurationError
from cardan.gateway.engine import Watchdogs
from cardan.gateway.feedback import RUMBLE_SOURCES, FeedbackOptions
from cardan.gateway.filters import registry as filter_registry
from cardan.gateway.filters.base import TwistFilter
from cardan.gateway.force.conditioning import Conditioner, Conditioning
from cardan.gateway.force.fixtures import FixtureSet
from cardan.gateway.force.rendering import ForceRenderer
from cardan.gateway.force.service import RemoteSource
from cardan.gateway.force.sources import (
    ContactSource,
    ForceSource,
    MeasuredSource,
    SensorSource,
)
from cardan.gateway.force.stability import fixture_warning, loop_warning
from cardan.gateway.force.tables import FixtureTable, ForceTable, check_fixtures
from cardan.gateway.mapping import AXES, GripperAction, MappingOptions, Mode, Orientation
from cardan.gateway.position import mirrors
from cardan.gateway.reference import ReferenceLimits
from cardan.gateway.spnav.options import SpnavServerOptions
from cardan.gateway.tables import Bounds, DriverTable, Finite, Point, Positive, Share
from cardan.spatial import from_euler_zyx, norm, scale
from cardan.types import (
    IDENTITY_POSE,
    ZERO3,
    CommandKind,
    Frame,
    Pose,
    RobotCapabilities,
    Vector3,
)

if TYPE_CHECKING:
    from cardan.gateway.kinematics.base import Kinematics
    from cardan.gateway.kinematics.collision import Obstacle
    from cardan.gateway.servo.follower import ArmFollower

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ARM_COMMANDS = frozenset({CommandKind.JOINT, CommandKind.JOINT_VELOCITY, CommandKind.POSE})
"""What a robot must take, one of them, for a session to drive it by the model of its arm."""

LONGEST_DEVICE_AGE_S = 0.5
"""A hand cannot be stale for longer: at 0.25 m/s that is already 12 cm of unwanted motion."""


FREE_JOINTS = 6
"""An arm with more joints has a posture to choose; it is drawn to its home."""

LONGEST_STOP_S = 2.0
"""An arm that needs longer to stop is not under anybody's hand."""

MAX_OUTPUT = 39
"""Highest analog output: EGM carries 40 values."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FilterTable(BaseModel):
    """One of ``[[filters]]``: a filter's name; all other keys are that filter's options."""

    model_config = ConfigDict(extra="allow", frozen=True)
    filter: str


_MAPPING_BUTTONS = ("clutch", "recapture", "enable")


class MappingTable(_Table):
    """``[mapping]``"""

    mode: Mode = Mode.RATE
    frame: Frame = Frame.BASE
    linear_speed_m_s: Positive = 0.1
    angular_speed_rad_s: Positive = 0.4
    axes: Annotated[list[str], Field(min_length=6, max_length=6)] = list(AXES)
    scale: Annotated[list[Finite], Field(min_length=6, max_length=6)] = [1.0] * 6
    yaw_deg: Finite = 0.0
    device_rpy_deg: Point = (0.0, 0.0, 0.0)
    orientation: Orientation | None = None
    origin_m: Point | None = None
    device_centre_m: Point = (0.0, 0.0, 0.0)
    hand_to_tool_rpy_deg: Point = (0.0, 0.0, 0.0)
    approach_speed_m_s: Positive = 0.05
    approach_speed_rad_s: Positive = 0.3
    slip_m: Annotated[float, Field(gt=0, le=0.5, strict=True)] = 0.15
    slip_rad: Annotated[float, Field(gt=0, le=1.5, strict=True)] = 0.6
    joints: dict[str, str] = {}
    joint_speed_rad_s: Positive = 0.4
    deadman: str | list[str] = ""
    clutch: str = ""
    recapture: str = ""
    enable: str = ""

    @field_validator("deadman", mode="before")
    @classmethod
    def _buttons(cls, names: object) -> object:
        several = names if isinstance(names, list) else [names]
        if not all(isinstance(name, str) for name in several) or (names != "" and "" in several):
            raise ValueError(f'{names!r} is no button; allowed: a name, or several as ["a", "b"]')
        return names

    @property
    def deadman_buttons(self) -> tuple[str, ...]:
        """The buttons of which one is held."""
        names = [self.deadman] if isinstance(self.deadman, str) else self.deadman
        return tuple(name for name in names if name)

    @model_validator(mode="after")
    def _fits_the_mode(self) -> MappingTable:
        mode = f'mode = "{self.mode.value}"'
        if self.mode is Mode.RATE:
            if any(self.device_rpy_deg):
                raise ValueError(
                    'device_rpy_deg: only mode = "position" and mode = "absolute" turn the '
                    "device's axes"
                )
            if self.orientation is not None:
                raise ValueError(
                    f'orientation: {mode} follows no pose; "fixed" in axes keeps what must not turn'
                )
        else:
            if not self.deadman_buttons and not self.clutch:
                raise ValueError(
                    f"deadman: {mode} needs one, the clutch: what the hand moves while it is "
                    'held, the TCP moves; or a button that begins and ends it, clutch = "..."'
                )
            if self.joints:
                raise ValueError(f"joints: in {mode} no axis drives a joint")
        if self.recapture and self.mode is not Mode.POSITION:
            raise ValueError(f"recapture: {mode} has no references to take anew")
        if self.mode is not Mode.ABSOLUTE:
            for key in ("origin_m", "device_centre_m", "hand_to_tool_rpy_deg"):
                if getattr(self, key) != type(self).model_fields[key].default:
                    raise ValueError(f'{key}: only mode = "absolute" has one')
            if self.orientation is Orientation.ABSOLUTE:
                raise ValueError('orientation: "absolute" is for mode = "absolute" only')
        else:
            self._fits_absolute()
        return self

    def _fits_absolute(self) -> None:
        if self.origin_m is None:
            raise ValueError(
                'origin_m: mode = "absolute" needs it: where the TCP is when the hand is at '
                "device_centre_m"
            )
        if self.frame is not Frame.BASE:
            raise ValueError(
                f'frame: {self.frame.value!r} moves; in mode = "absolute" it is "base"'
            )
        mapped = self.axes[3:] != list(AXES[3:]) or self.scale[3:] != [1.0] * 3
        if self.orientation is Orientation.ABSOLUTE and mapped:
            raise ValueError(
                'orientation: "absolute" takes the hand\'s orientation whole: leave the last three '
                "of axes and scale as they are by themselves"
            )
        if self.orientation is not Orientation.ABSOLUTE and any(self.hand_to_tool_rpy_deg):
            raise ValueError('hand_to_tool_rpy_deg: only orientation = "absolute" has one')

    @field_validator("axes")
    @classmethod
    def _known_axes(cls, axes: list[str]) -> list[str]:
        for axis in axes:
            if axis != "fixed" and axis.removeprefix("-") not in AXES:
                raise ValueError(
                    f"{axis!r} is not an axis; allowed: {', '.join(AXES)}, each also with a "
                    'minus in front, and "fixed"'
                )
        return axes

    @field_validator("joints")
    @classmethod
    def _known_joint_axes(cls, joints: dict[str, str]) -> dict[str, str]:
        for axis in joints:
            if axis.removeprefix("-") not in AXES:
                raise ValueError(
                    f"{axis!r} is not an axis; allowed: {', '.join(AXES)}, each also with a minus "
                    "in front"
                )
        return joints


class GripperTable(_Table):
    """``[gripper]``: buttons, and what travels to the robot's program."""

    toggle: str = ""
    close: str = ""
    open: str = ""
    output: StrictInt | str = "digital"
    """The digital output, or the index of an analog one."""
    closed_value: Finite = 1.0
    open_value: Finite = 0.0

    @field_validator("output", mode="before")
    @classmethod
    def _known_output(cls, output: object) -> object:
        whole = isinstance(output, int) and not isinstance(output, bool)
        if output != "digital" and not (whole and output in range(MAX_OUTPUT + 1)):
            raise ValueError(f'{output!r} is no output; allowed: "digital", or 0 to {MAX_OUTPUT}')
        return output


class FeedbackTable(_Table):
    """``[feedback]``: what the hand is given back, where the device can."""

    led: bool = True
    rumble: list[str] = ["trip", "limit"]
    full_force_n: Positive = 20.0

    @field_validator("rumble")
    @classmethod
    def _known_sources(cls, sources: list[str]) -> list[str]:
        for source in sources:
            if source not in RUMBLE_SOURCES:
                raise ValueError(f"{source!r} is none; allowed: {', '.join(RUMBLE_SOURCES)}")
        return sources


class LimitsTable(_Table):
    """``[limits]``: what the reference may do, whatever the operator asks."""

    linear_speed_m_s: Positive = 0.25
    linear_acceleration_m_s2: Positive = 1.0
    angular_speed_rad_s: Positive = 1.0
    angular_acceleration_rad_s2: Positive = 4.0
    linear_jerk_m_s3: Positive | None = None
    angular_jerk_rad_s3: Positive | None = None
    leash_m: Positive = 0.05
    leash_rad: Annotated[float, Field(gt=0, le=1.5, strict=True)] = 0.3
    workspace_x_m: Bounds | None = None
    workspace_y_m: Bounds | None = None
    workspace_z_m: Bounds | None = None

    @field_validator("workspace_x_m", "workspace_y_m", "workspace_z_m")
    @classmethod
    def _ordered(cls, bounds: Bounds | None) -> Bounds | None:
        if bounds is not None and bounds[0] >= bounds[1]:
            raise ValueError(f"{bounds[0]} to {bounds[1]} is empty: lower bound first, then upper")
        return bounds


class WatchdogTable(_Table):
    """``[watchdogs]``"""

    device_age_s: Annotated[float, Field(gt=0, le=LONGEST_DEVICE_AGE_S, strict=True)] = 0.1
    following_error_m: Positive = 0.1
    following_error_rad: Positive = 0.6


class ArmTable(_Table):
    """``[arm]``: the model by which joints are commanded; without it the robot is sent poses."""

    model: str
    """One of our arms, or the path of a .toml or .urdf file."""
    policy: Literal["path", "reach"] = "path"
    tool_xyz_m: Point = (0.0, 0.0, 0.0)
    tool_rpy_deg: Point = (0.0, 0.0, 0.0)
    speed_share: Share = 1.0
    """Of the joints' speeds."""
    acceleration_share: Share = 1.0
    collisions: bool = True
    """Whether the arm keeps away from itself and from the obstacles."""
    safety_distance_m: Positive = 0.01

    def tool(self) -> Pose:
        """The TCP in the model's own."""
        x, y, z = (math.radians(angle) for angle in self.tool_rpy_deg)
        return Pose(Vector3(*self.tool_xyz_m), from_euler_zyx(x, y, z))


class ObstacleTable(_Table):
    """One of ``[[obstacles]]``: something solid in the arm's base frame."""

    name: str
    box: tuple[Point, Point] | None = None
    """Lowest and highest corner, m."""
    capsule: tuple[Point, Point, Positive] | None = None
    """Ends and radius, m; the same point twice: a sphere."""
    plane: tuple[Point, Finite] | None = None
    """Normal out of the solid, and how far along it the surface is, m."""

    @model_validator(mode="after")
    def _one_shape(self) -> ObstacleTable:
        given = [n for n in ("box", "capsule", "plane") if getattr(self, n) is not None]
        if len(given) != 1:
            raise ValueError(
                f"{self.name!r} has {' and '.join(given) or 'no shape'}; give one of "
                "box = [corner, corner], capsule = [end, end, radius], plane = [normal, offset]"
            )
        if self.box is not None and not all(a < b for a, b in zip(*self.box, strict=True)):
            raise ValueError(f"box of {self.name!r}: lowest corner first, then the highest")
        if self.plane is not None and norm(Vector3(*self.plane[0])) == 0.0:
            raise ValueError(f"plane of {self.name!r}: its normal has no direction")
        return self


class SpnavTable(_Table):
    """``[spnav]``: the socket for programs that use libspnav, beside the session."""

    socket: str = SpnavServerOptions.socket
    access: Literal["owner", "everybody"] = "owner"
    full_scale: Annotated[float, Field(ge=1.0, allow_inf_nan=False, strict=True)] = 350.0
    name: str = "Cardan"

    @model_validator(mode="after")
    def _can_be_served(self) -> SpnavTable:
        self.server_options()
        return self

    def server_options(self) -> SpnavServerOptions:
        """The server's options."""
        return SpnavServerOptions(**self.model_dump())


class ServedConfig(BaseModel):
    """What ``cardan spnav`` reads of a file: no robot is needed."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    device: DriverTable
    spnav: SpnavTable = SpnavTable()


class ForceConfig(BaseModel):
    """What ``cardan force`` reads of a file: neither device nor robot is needed."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    force: ForceTable = ForceTable()
    fixtures: tuple[FixtureTable, ...] = ()

    @model_validator(mode="after")
    def _gives_force(self) -> ForceConfig:
        if self.force.source == "remote":
            raise ValueError(
                'force.source: "remote" is the session\'s; the force node has a file of its own, '
                "with the source that it reads"
            )
        if self.force.source == "none" and not self.fixtures:
            raise ValueError("force: neither a source nor [[fixtures]]: there is nothing to send")
        return self


class SessionConfig(_Table):
    """A whole configuration file."""

    device: DriverTable
    robot: DriverTable
    arm: ArmTable | None = None
    obstacles: tuple[ObstacleTable, ...] = ()
    mapping: MappingTable = MappingTable()
    filters: tuple[FilterTable, ...] = ()
    """Shared control, applied in this order."""
    gripper: GripperTable = GripperTable()
    feedback: FeedbackTable = FeedbackTable()
    limits: LimitsTable = LimitsTable()
    watchdogs: WatchdogTable = WatchdogTable()
    spnav: SpnavTable | None = None
    force: ForceTable | None = None
    fixtures: tuple[FixtureTable, ...] = ()
    """What the hand feels of the space around the robot."""

    @field_validator("filters", "obstacles", "fixtures", mode="before")
    @classmethod
    def _array_of_tables(cls, tables: object, info: ValidationInfo) -> object:
        if not isinstance(tables, (list, tuple)):
            name = info.field_name
            raise ValueError(f"one table for each of them, under the heading [[{name}]]")
        return tables

    @field_validator("fixtures")
    @classmethod
    def _room_for_all(cls, tables: tuple[FixtureTable, ...]) -> tuple[FixtureTable, ...]:
        return check_fixtures(tables)

    @property
    def gives_force(self) -> bool:
        """Whether the hand is to feel anything."""
        return bool(self.fixtures) or (self.force is not None and self.force.source != "none")

    @model_validator(mode="after")
    def _force_follows_a_hand(self) -> SessionConfig:
        if self.gives_force and self.mapping.mode is Mode.RATE:
            raise ValueError(
                f'{"fixtures" if self.fixtures else "force"}: in mode = "rate" no place of the '
                'hand is one of the TCP; set mapping.mode = "position" or "absolute"'
            )
        return self

    @model_validator(mode="after")
    def _joints_need_an_arm(self) -> SessionConfig:
        if self.mapping.joints and self.arm is None:
            raise ValueError("mapping.joints: only a session with an [arm] commands joints")
        return self

    @model_validator(mode="after")
    def _obstacles_need_an_arm(self) -> SessionConfig:
        if self.obstacles and (self.arm is None or not self.arm.collisions):
            raise ValueError(
                "obstacles: only an arm's model keeps away from them: add [arm] with its model, "
                "and leave arm.collisions on"
            )
        return self

    @model_validator(mode="after")
    def _one_meaning_a_button(self) -> SessionConfig:
        buttons = [("mapping.deadman", button) for button in self.mapping.deadman_buttons]
        buttons += [(f"mapping.{n}", getattr(self.mapping, n)) for n in _MAPPING_BUTTONS]
        buttons += [(f"gripper.{a.value}", getattr(self.gripper, a.value)) for a in GripperAction]
        for key, button in buttons:
            for other, same in buttons:
                if button and button == same and key < other:
                    raise ValueError(f"{key} and {other} are the same button, {button!r}")
        return self

    @model_validator(mode="after")
    def _stops_soon(self) -> SessionConfig:
        table = self.limits
        for kind, time_s in (
            ("linear", table.linear_speed_m_s / table.linear_acceleration_m_s2),
            ("angular", table.angular_speed_rad_s / table.angular_acceleration_rad_s2),
        ):
            if time_s > LONGEST_STOP_S:
                raise ValueError(
                    f"limits.{kind}_acceleration: stopping from full speed takes {time_s:.3g} s; "
                    f"it must not take more than {LONGEST_STOP_S:g} s"
                )
        return self

    @model_validator(mode="after")
    def _leash_trips_first(self) -> SessionConfig:
        for unit in ("m", "rad"):
            leash = getattr(self.limits, f"leash_{unit}")
            error = getattr(self.watchdogs, f"following_error_{unit}")
            if leash > error:
                raise ValueError(
                    f"limits.leash_{unit} is {leash:g}; it must not be longer than "
                    f"watchdogs.following_error_{unit}, which is {error:g}"
                )
        return self

    def mapping_options(self) -> MappingOptions:
        """The mapping's options."""
        table, gripper = self.mapping, self.gripper
        return MappingOptions(
            mode=table.mode,
            frame=table.frame,
            linear_speed_m_s=table.linear_speed_m_s,
            angular_speed_rad_s=table.angular_speed_rad_s,
            axes=tuple(table.axes),
            scale=tuple(table.scale),
            yaw_deg=table.yaw_deg,
            device_rpy_deg=table.device_rpy_deg,
            orientation=table.orientation,
            origin_m=ZERO3 if table.origin_m is None else Vector3(*table.origin_m),
            device_centre_m=Vector3(*table.device_centre_m),
            hand_to_tool_rpy_deg=table.hand_to_tool_rpy_deg,
            approach_speed_m_s=table.approach_speed_m_s,
            approach_speed_rad_s=table.approach_speed_rad_s,
            slip_m=table.slip_m,
            slip_rad=table.slip_rad,
            joints=tuple(table.joints.items()),
            joint_speed_rad_s=table.joint_speed_rad_s,
            deadman=table.deadman_buttons,
            clutch=table.clutch,
            recapture=table.recapture,
            enable=table.enable,
            gripper=tuple(
                (getattr(gripper, action.value), action)
                for action in GripperAction
                if getattr(gripper, action.value)
            ),
        )

    def feedback_options(self) -> FeedbackOptions:
        """What the hand is told."""
        table = self.feedback
        return FeedbackOptions(
            led=table.led, rumble=tuple(table.rumble), full_force_n=table.full_force_n
        )

    def reference_limits(self) -> ReferenceLimits:
        """The reference's limits."""
        table = self.limits
        return ReferenceLimits(
            linear_speed_m_s=table.linear_speed_m_s,
            linear_acceleration_m_s2=table.linear_acceleration_m_s2,
            angular_speed_rad_s=table.angular_speed_rad_s,
            angular_acceleration_rad_s2=table.angular_acceleration_rad_s2,
            linear_jerk_m_s3=table.linear_jerk_m_s3,
            angular_jerk_rad_s3=table.angular_jerk_rad_s3,
            leash_m=table.leash_m,
            leash_rad=table.leash_rad,
            workspace_m=(table.workspace_x_m, table.workspace_y_m, table.workspace_z_m),
        )

    def watchdog_limits(self) -> Watchdogs:
        """The watchdogs' limits."""
        return Watchdogs(**self.watchdogs.model_dump())


def _suggestion(word: str, allowed: list[str]) -> str:
    near = difflib.get_close_matches(word, allowed, 1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _allowed_keys(path: tuple[str | int, ...]) -> list[str]:
    model: type[BaseModel] = SessionConfig
    for part in path:
        if isinstance(part, str):
            model = _table_of(model.model_fields[part].annotation)
    return list(model.model_fields)


def _table_of(annotation: Any) -> type[BaseModel]:
    """The table behind an annotation: its own class, one that may be None, one of many."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(_table_of(each) for each in get_args(annotation) if each is not type(None))


def _translate(error: ValidationError, prefix: tuple[str, ...] = ()) -> ConfigurationError:
    first = error.errors(include_url=False)[0]
    location = first["loc"]
    key = ".".join((*prefix, *(str(part) for part in location)))
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        allowed = _allowed_keys(location[:-1])
        message = f"there is no such key; allowed: {', '.join(allowed)}" + _suggestion(
            str(location[-1]), allowed
        )
    elif first["type"] == "missing":
        message = "is missing"
    elif first["type"] != "value_error":
        message = f"{message}; found {first['input']!r}"
    more = error.error_count() - 1
    return ConfigurationError(key, message + (f" (and {more} more)" if more else ""))


def driver_options(driver: type[Driver], table: Mapping[str, Any], key: str) -> Any:
    """The driver's Options made from a table, or a ConfigurationError that names the key."""
    fields = {f.name: f for f in dataclasses.fields(driver.Options) if f.init}
    for name in table:
        if name not in fields:
            raise ConfigurationError(
                f"{key}.{name}",
                f"there is no such key; allowed: {', '.join(fields)}"
                + _suggestion(name, list(fields)),
            )
    try:
        return TypeAdapter(driver.Options).validate_python(dict(table))
    except ValidationError as error:
        wrong = _translate(error, (key,))
        name, _, rest = str(wrong).removeprefix(f"{key}: ").partition(" ")
        if wrong.key == key and name.rstrip(":") in fields:
            rest = rest if name.endswith(":") else f"{name} {rest}"
            raise ConfigurationError(f"{key}.{name.rstrip(':')}", rest) from None
        raise wrong from None


def make_driver(table: DriverTable, key: str) -> Driver:
    """The driver of a table, not opened yet; errors name `key`."""
    try:
        driver = registry.load(table.driver)
    except ConfigurationError as error:
        raise ConfigurationError(f"{key}.driver", str(error).removeprefix("driver: ")) from None
    return driver(driver_options(driver, table.model_extra or {}, key))


def make_device(config: SessionConfig | ServedConfig) -> OperatorDevice:
    """The operator device that is configured, not opened yet."""
    device = make_driver(config.device, "device")
    if not isinstance(device, OperatorDevice):
        raise ConfigurationError(
            "device.driver", f"{config.device.driver!r} is not an operator device"
        )
    return device


def check_mode(mapping: MappingTable, device: OperatorDevice) -> None:
    """Raise ConfigurationError when the device does not measure what the mapping wants."""
    able = device.capabilities
    if mapping.mode is Mode.RATE and not able.gives_axes:
        raise ConfigurationError(
            "mapping.mode", 'this device measures the hand\'s pose: set mode = "position"'
        )
    if mapping.mode is not Mode.RATE and not able.gives_pose:
        raise ConfigurationError(
            "mapping.mode", 'this device measures deflections: set mode = "rate"'
        )


def make_robot(config: SessionConfig) -> RobotDriver:
    """The robot of a session, not opened yet."""
    robot = make_driver(config.robot, "robot")
    if not isinstance(robot, RobotDriver):
        raise ConfigurationError("robot.driver", f"{config.robot.driver!r} is not a robot")
    kinds = ", ".join(sorted(kind.value for kind in robot.capabilities.commands))
    if config.arm is None and CommandKind.POSE not in robot.capabilities.commands:
        raise ConfigurationError(
            "robot",
            f"as configured it takes {kinds}; without an [arm] table, which names the arm's model, "
            "a session needs it to take poses",
        )
    if config.arm is not None and not ARM_COMMANDS & robot.capabilities.commands:
        raise ConfigurationError(
            "robot",
            f"as configured it takes {kinds}; a session with an [arm] needs one of "
            + ", ".join(sorted(kind.value for kind in ARM_COMMANDS)),
        )
    _check_speeds(config.limits, robot.capabilities)
    return robot


def make_filters(config: SessionConfig) -> tuple[TwistFilter, ...]:
    """The filters of a session in their order, not opened yet."""
    made = []
    for index, table in enumerate(config.filters):
        key = f"filters.{index}"
        try:
            kind = filter_registry.load(table.filter)
        except ConfigurationError as error:
            reason = str(error).removeprefix("filter: ")
            raise ConfigurationError(f"{key}.filter", reason) from None
        made.append(kind(driver_options(kind, table.model_extra or {}, key)))
        made[-1].name = table.filter
    return tuple(made)


def make_arm(config: SessionConfig, robot: RobotDriver) -> ArmFollower | None:
    """The arm's share of a session; None without an ``[arm]`` table.

    Where the robot's driver has limits of its own, the stricter of both hold. Pinocchio is only
    imported here: sessions without an arm's model start without it.
    """
    table = config.arm
    if table is None:
        return None
    from cardan.gateway.kinematics.arm import ArmKinematics
    from cardan.gateway.kinematics.collision import CollisionModel
    from cardan.gateway.kinematics.soft_neck import SOFT_NECKS, SoftNeck, load_soft_neck
    from cardan.gateway.servo.follower import ArmFollower
    from cardan.gateway.servo.servo import Policy, Servo, ServoOptions

    kinematics: Kinematics
    collision, posture = None, None
    try:
        if table.model in SOFT_NECKS:
            kinematics, weights = SoftNeck(load_soft_neck(table.model)), SoftNeck.TASK
            if table.tool() != IDENTITY_POSE or config.obstacles:
                raise ConfigurationError("", f"{table.model} takes neither tool nor obstacles")
        else:
            model = load_arm(table.model)
            kinematics = arm = ArmKinematics(model, table.tool())
            weights = model.task.weights
            if table.collisions:
                collision = CollisionModel(arm, [_obstacle(each) for each in config.obstacles])
            if len(model.joints) > FREE_JOINTS:
                posture = np.array(model.home)
    except ConfigurationError as error:
        raise ConfigurationError("arm.model", str(error)) from None
    able = robot.capabilities
    if able.joints != kinematics.joints:
        raise ConfigurationError(
            "arm.model",
            f"{table.model!r} has {kinematics.joints} joints, the robot as configured "
            f"{able.joints}",
        )
    _check_joints(config, kinematics.names)
    _take_limits(kinematics, able)
    options = ServoOptions(
        policy=Policy(table.policy),
        speed_share=table.speed_share,
        acceleration_share=table.acceleration_share,
        safety_distance_m=table.safety_distance_m,
    )
    servo = Servo(kinematics, collision, options, weights)
    servo.posture = posture
    return ArmFollower(servo, able.commands, able.lag_s)


def _check_joints(config: SessionConfig, names: tuple[str, ...]) -> None:
    mapping = config.mapping
    for axis, joint in mapping.joints.items():
        if joint not in names:
            raise ConfigurationError(
                f"mapping.joints.{axis}",
                f"there is no joint {joint!r}; allowed: {', '.join(names)}"
                + _suggestion(joint, list(names)),
            )
        index = AXES.index(axis.removeprefix("-"))
        if any(source.removeprefix("-") == AXES[index] for source in mapping.axes):
            raise ConfigurationError(
                f"mapping.joints.{axis}",
                f"the axis drives {AXES[index]} as well: name it in mapping.axes no more, "
                'with "fixed" in its place',
            )


def make_source(table: ForceTable) -> ForceSource | None:
    """The source of a measured force, not opened yet; None where there is none."""
    felt = table.sense == "felt" if table.sense is not None else table.source == "sensor"
    if table.source == "measured":
        return MeasuredSource(felt=felt)
    if table.source == "contact":
        return ContactSource(table.contact)
    if table.source == "remote":
        return RemoteSource(table.socket, table.max_age_s)
    if table.sensor is None:
        return None
    sensor = make_driver(table.sensor, "force.sensor")
    if not isinstance(sensor, OperatorDevice):
        raise ConfigurationError(
            "force.sensor.driver", f"{table.sensor.driver!r} is a robot, not a sensor"
        )
    if table.zero_sensor and not hasattr(sensor, "zero"):
        raise ConfigurationError(
            "force.zero_sensor", f"{table.sensor.driver!r} takes no zero: leave it out"
        )
    return SensorSource(sensor, felt=felt, zero=table.zero_sensor)


def make_conditioner(table: ForceTable, source: ForceSource | None) -> Conditioner:
    """What makes of the source's readings a force for the hand."""
    options = Conditioning(
        scale=table.scale,
        deadband_n=table.deadband_n,
        cutoff_hz=table.cutoff_hz,
        tare=table.tare,
    )
    if source is None:
        return Conditioner(options)
    return Conditioner(options, rests_at_zero=source.rests_at_zero, shaped=source.shaped)


def make_force(
    config: SessionConfig, device: OperatorDevice, robot: RobotDriver
) -> ForceRenderer | None:
    """The force's share of a session, nothing opened yet; None for a device without force."""
    if not isinstance(device, HapticDevice):
        if config.gives_force:
            raise ConfigurationError(
                "fixtures" if config.fixtures else "force.source",
                f"{config.device.driver!r} gives no force back to the hand; leave [force] and "
                "[[fixtures]] out, or choose a haptic device",
            )
        return None
    if config.gives_force and mirrors(config.mapping_options()):
        raise ConfigurationError(
            "mapping.axes",
            "these axes and signs are no rotation (a mirror, or one axis twice): a force has no "
            "way back through them",
        )
    table = config.force or ForceTable()
    source = make_source(table)
    return ForceRenderer(
        device,
        FixtureSet(config.fixtures),
        source,
        make_conditioner(table, source),
        rendering=config.gives_force,
        max_age_s=table.max_age_s,
        stiffness_n_m=table.stiffness_n_m,
        contact_target_n=table.contact_target_n,
        warnings=_force_warnings(config, table, device, robot),
    )


def _force_warnings(
    config: SessionConfig, table: ForceTable, device: HapticDevice, robot: RobotDriver
) -> tuple[str, ...]:
    """What the numbers alone say against a force that the hand can hold."""
    if not config.gives_force:
        return ()
    mapping, period_s = config.mapping, robot.capabilities.period_s
    factors = zip(mapping.axes[:3], mapping.scale[:3], strict=True)
    motion_scale = max(0.0 if axis == "fixed" else abs(factor) for axis, factor in factors)
    words = []
    hold_s = getattr(device.options, "hold_s", math.inf)
    if 2.0 * period_s > hold_s:
        words.append(
            f"the robot reports every {period_s * 1e3:g} ms, and the device lets go of the force "
            f"after {hold_s * 1e3:g} ms: set device.hold_s to two periods or more"
        )
    words += [
        fixture_warning(index, motion_scale, each.stiffness_n_m)
        for index, each in enumerate(config.fixtures)
        if each.stiffness_n_m is not None
    ]
    if table.source != "none" and table.environment_stiffness_n_m is not None:
        words.append(
            loop_warning(
                motion_scale=motion_scale,
                force_scale=1.0 if table.source == "remote" else table.scale,
                environment_stiffness_n_m=table.environment_stiffness_n_m,
                device_damping_n_s_m=getattr(device.options, "damping_n_s_m", 0.0),
                period_s=period_s,
                delay_s=table.delay_s,
                cutoff_hz=table.cutoff_hz,
            )
        )
    return tuple(filter(None, words))


def _take_limits(kinematics: Kinematics, robot: RobotCapabilities) -> None:
    limits = robot.limits
    if limits is None:
        return
    np.maximum(kinematics.lower, limits.lower, out=kinematics.lower)
    np.minimum(kinematics.upper, limits.upper, out=kinematics.upper)
    np.minimum(kinematics.velocity, limits.velocity, out=kinematics.velocity)
    np.minimum(kinematics.acceleration, limits.acceleration, out=kinematics.acceleration)


def _obstacle(table: ObstacleTable) -> Obstacle:
    from cardan.gateway.kinematics.collision import HalfSpace, Obstacle, box_obstacle

    if table.box is not None:
        return box_obstacle(table.name, Vector3(*table.box[0]), Vector3(*table.box[1]))
    if table.capsule is not None:
        start, end, radius = table.capsule
        return Obstacle(table.name, Capsule(Vector3(*start), Vector3(*end), radius))
    assert table.plane is not None
    normal = Vector3(*table.plane[0])
    unit = scale(normal, 1.0 / norm(normal))
    return Obstacle(table.name, HalfSpace(unit, table.plane[1]))


def _check_speeds(limits: LimitsTable, robot: RobotCapabilities) -> None:
    """A reference that is faster than its robot runs into the leash; better to say so."""
    for name, asked, most in (
        ("linear_speed_m_s", limits.linear_speed_m_s, robot.linear_speed_m_s),
        ("angular_speed_rad_s", limits.angular_speed_rad_s, robot.angular_speed_rad_s),
    ):
        if most is not None and asked > most:
            raise ConfigurationError(
                f"limits.{name}",
                f"{asked:g} is more than the robot's driver lets out ({most:g}): lower it, or "
                "raise the driver's own limit in [robot]",
            )


def parse_config(table: Mapping[str, Any]) -> SessionConfig:
    """Check a configuration already read; ConfigurationError names the first wrong key."""
    try:
        return SessionConfig.model_validate(table)
    except ValidationError as error:
        raise _translate(error) from None


def load_served(path: Path) -> ServedConfig:
    """Read and check what ``cardan spnav`` needs of a file: ``[device]`` and ``[spnav]``."""
    try:
        config = ServedConfig.model_validate(_read(path))
    except ValidationError as error:
        raise _translate(error) from None
    make_device(config)
    return config


def load_force(path: Path) -> ForceConfig:
    """Read and check what ``cardan force`` needs of a file: ``[force]`` and ``[[fixtures]]``."""
    try:
        config = ForceConfig.model_validate(_read(path))
    except ValidationError as error:
        raise _translate(error) from None
    make_source(config.force)
    return config


def load_config(path: Path) -> SessionConfig:
    """Read and check a configuration file, the options of drivers and filters included."""
    config = parse_config(_read(path))
    device, robot = make_device(config), make_robot(config)
    check_mode(config.mapping, device)
    make_arm(config, robot)
    make_filters(config)
    make_force(config, device, robot)
    return config


def _read(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise ConfigurationError("", f"cannot read {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigurationError("", f"{path} is not TOML: {error}") from None
