"""A session's configuration: what a TOML file may say, checked whole.

Every error names the key, what is wrong with the value, and what is allowed.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    StrictBool,
    StrictInt,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from cardan import bounds
from cardan.errors import ConfigurationError
from cardan.gateway.arm.authority import LEASE_S, AuthorityPolicy
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.common.tables import (
    Angle,
    Angles,
    Bounds,
    Coordinate,
    Direction,
    DriverTable,
    Length,
    Point,
    within,
)
from cardan.gateway.force.tables import (
    SHORTEST_DIRECTION,
    FixtureTable,
    ForceTable,
    Place,
    check_fixtures,
)
from cardan.gateway.hand.feedback import RUMBLE_SOURCES, FeedbackOptions
from cardan.gateway.hand.mapping import AXES, GripperAction, MappingOptions, Mode, Orientation
from cardan.gateway.motion.reference import ReferenceLimits
from cardan.gateway.spnav.options import SpnavServerOptions
from cardan.spatial import from_euler_zyx, norm
from cardan.types import (
    ZERO3,
    Frame,
    Pose,
    Vector3,
)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


LONGEST_STOP_S = 0.5
"""An arm that needs longer to stop goes on for more than its operator expects: at 0.25 m/s it
brakes over 6 cm."""

LONGEST_ACCEPTED_STOP_S = 2.0
"""An arm that needs longer to stop is not under anybody's hand, whatever its operator accepts."""

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
    linear_speed_m_s: Annotated[float, within(bounds.LINEAR_SPEED_M_S)] = 0.1
    angular_speed_rad_s: Annotated[float, within(bounds.ANGULAR_SPEED_RAD_S)] = 0.4
    axes: Annotated[list[str], Field(min_length=6, max_length=6)] = list(AXES)
    scale: Annotated[
        list[Annotated[float, within(bounds.MOTION_SCALE)]], Field(min_length=6, max_length=6)
    ] = [1.0] * 6
    yaw_deg: Angle = 0.0
    device_rpy_deg: Angles = (0.0, 0.0, 0.0)
    orientation: Orientation | None = None
    origin_m: Point | None = None
    device_centre_m: Point = (0.0, 0.0, 0.0)
    hand_to_tool_rpy_deg: Angles = (0.0, 0.0, 0.0)
    approach_speed_m_s: Annotated[float, within(bounds.LINEAR_SPEED_M_S)] = 0.05
    approach_speed_rad_s: Annotated[float, within(bounds.ANGULAR_SPEED_RAD_S)] = 0.3
    slip_m: Annotated[float, within(bounds.LEASH_M)] = 0.15
    slip_rad: Annotated[float, within(bounds.LEASH_RAD)] = 0.6
    joints: dict[str, str] = {}
    joint_speed_rad_s: Annotated[float, within(bounds.JOINT_SPEED_RAD_S)] = 0.4
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
    closed_value: Annotated[float, within(bounds.OUTPUT_VALUE)] = 1.0
    open_value: Annotated[float, within(bounds.OUTPUT_VALUE)] = 0.0

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
    full_force_n: Annotated[float, within(bounds.ROBOT_FORCE_N)] = 20.0

    @field_validator("rumble")
    @classmethod
    def _known_sources(cls, sources: list[str]) -> list[str]:
        for source in sources:
            if source not in RUMBLE_SOURCES:
                raise ValueError(f"{source!r} is none; allowed: {', '.join(RUMBLE_SOURCES)}")
        return sources


class LimitsTable(_Table):
    """``[limits]``: what the reference may do, whatever the operator asks."""

    linear_speed_m_s: Annotated[float, within(bounds.LINEAR_SPEED_M_S)] = 0.25
    linear_acceleration_m_s2: Annotated[float, within(bounds.LINEAR_ACCELERATION_M_S2)] = 1.0
    angular_speed_rad_s: Annotated[float, within(bounds.ANGULAR_SPEED_RAD_S)] = 1.0
    angular_acceleration_rad_s2: Annotated[float, within(bounds.ANGULAR_ACCELERATION_RAD_S2)] = 4.0
    linear_jerk_m_s3: Annotated[float, within(bounds.LINEAR_JERK_M_S3)] | None = None
    angular_jerk_rad_s3: Annotated[float, within(bounds.ANGULAR_JERK_RAD_S3)] | None = None
    i_accept_long_stops: StrictBool = False
    leash_m: Annotated[float, within(bounds.LEASH_M)] = 0.05
    leash_rad: Annotated[float, within(bounds.LEASH_RAD)] = 0.3
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

    device_age_s: Annotated[float, within(bounds.BLIND_S)] = 0.1
    following_error_m: Annotated[float, within(bounds.LEASH_M)] = 0.1
    following_error_rad: Annotated[float, within(bounds.LEASH_RAD)] = 0.6
    recovery: bool = True
    """Whether a command that lost its robot is brought back to it, slowly and within the leash."""


class AuthorityTable(_Table):
    """``[authority]``: who may move the arm, and who may take it from whom."""

    policy: AuthorityPolicy = AuthorityPolicy.HAND
    named: str = ""
    """The source that may have it, where `policy` is "named"."""
    lease_s: Annotated[float, within(bounds.AUTHORITY_LEASE_S)] = LEASE_S
    """For which a source that does not renew keeps it."""

    @model_validator(mode="after")
    def _names_whom(self) -> AuthorityTable:
        if (self.policy is AuthorityPolicy.NAMED) is not bool(self.named):
            raise ValueError(
                'named: policy = "named" needs the source that it is for ("hand", "verbs", or the '
                "owner of a stream); no other policy has one"
            )
        return self


class ArmTable(_Table):
    """``[arm]``: the model by which joints are commanded; without it the robot is sent poses."""

    model: str
    """One of our arms, or the path of a .toml or .urdf file."""
    policy: Literal["path", "reach"] = "path"
    tool_xyz_m: Place = (0.0, 0.0, 0.0)
    tool_rpy_deg: Angles = (0.0, 0.0, 0.0)
    speed_share: Annotated[float, within(bounds.SHARE)] = 1.0
    """Of the joints' speeds."""
    acceleration_share: Annotated[float, within(bounds.SHARE)] = 1.0
    collisions: bool = True
    """Whether the arm keeps away from itself and from the obstacles."""
    safety_distance_m: Annotated[float, within(bounds.SAFETY_DISTANCE_M)] = 0.01
    tcp_tolerance_m: Annotated[float, within(bounds.TCP_TOLERANCE_M)] | None = None
    """Most that the controller's own TCP may differ from the model's before the arm is not moved;
    None: 2 mm where poses are sent, 20 mm where joints are."""

    def tool(self) -> Pose:
        """The TCP in the model's own."""
        x, y, z = (math.radians(angle) for angle in self.tool_rpy_deg)
        return Pose(Vector3(*self.tool_xyz_m), from_euler_zyx(x, y, z))


class ObstacleTable(_Table):
    """One of ``[[obstacles]]``: something solid in the arm's base frame."""

    name: str
    box: tuple[Point, Point] | None = None
    """Lowest and highest corner, m."""
    capsule: tuple[Point, Point, Length] | None = None
    """Ends and radius, m; the same point twice: a sphere."""
    plane: tuple[Direction, Coordinate] | None = None
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
        if self.plane is not None and norm(Vector3(*self.plane[0])) <= SHORTEST_DIRECTION:
            raise ValueError(f"plane of {self.name!r}: its normal has no direction")
        return self


class SpnavTable(_Table):
    """``[spnav]``: the socket for programs that use libspnav, beside the session."""

    socket: str = SpnavServerOptions.socket
    access: Literal["owner", "everybody"] = "owner"
    full_scale: Annotated[float, within(bounds.COUNTS)] | None = None
    name: str = ""

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

    device: DriverTable | None = None
    """None: only verbs and streams move the arm."""
    robot: DriverTable
    arm: ArmTable | None = None
    authority: AuthorityTable = AuthorityTable()
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
        longest_s = LONGEST_ACCEPTED_STOP_S if table.i_accept_long_stops else LONGEST_STOP_S
        for key, speed, acceleration in (
            (
                "linear_acceleration_m_s2",
                table.linear_speed_m_s,
                table.linear_acceleration_m_s2,
            ),
            (
                "angular_acceleration_rad_s2",
                table.angular_speed_rad_s,
                table.angular_acceleration_rad_s2,
            ),
        ):
            # What rounding adds to a stop of exactly the longest time is no reason to refuse it.
            if speed > acceleration * longest_s * (1.0 + 1e-9):
                consent = (
                    "no more is allowed"
                    if table.i_accept_long_stops
                    else "or accept it with i_accept_long_stops = true in [limits], up to "
                    f"{LONGEST_ACCEPTED_STOP_S:g} s"
                )
                raise ValueError(
                    f"limits.{key}: stopping from full speed takes {speed / acceleration:.3g} s; "
                    f"it must not take more than {longest_s:g} s: raise the acceleration or lower "
                    f"the speed; {consent}"
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


def suggestion(word: str, allowed: list[str]) -> str:
    """The nearest of `allowed`, as the end of a sentence; empty when none is near."""
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


def translate(error: ValidationError, prefix: tuple[str, ...] = ()) -> ConfigurationError:
    """Our words for the first thing that pydantic found; keys begin with `prefix`."""
    first = error.errors(include_url=False)[0]
    location = first["loc"]
    key = ".".join((*prefix, *(str(part) for part in location)))
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        allowed = _allowed_keys(location[:-1])
        message = f"there is no such key; allowed: {', '.join(allowed)}" + suggestion(
            str(location[-1]), allowed
        )
    elif first["type"] == "missing":
        message = "is missing"
    elif first["type"] != "value_error":
        message = f"{message}; found {first['input']!r}"
    more = error.error_count() - 1
    return ConfigurationError(key, message + (f" (and {more} more)" if more else ""))


def parse_config(table: Mapping[str, Any]) -> SessionConfig:
    """Check a configuration already read; ConfigurationError names the first wrong key."""
    try:
        return SessionConfig.model_validate(table)
    except ValidationError as error:
        raise translate(error) from None


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a file. Raises ConfigurationError."""
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise ConfigurationError("", f"cannot read {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigurationError("", f"{path} is not TOML: {error}") from None
