"""A session's configuration: the tables of a TOML file, checked as a whole.

A table is the options of its part, if the part has options of its own. Every error names the key,
the fault of the value, and the allowed values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from cardan.common import bounds
from cardan.common.bounds import Angles, Coordinate, Direction
from cardan.common.options import Options, require_each
from cardan.common.places import in_file
from cardan.common.tables import keys_of, read_table, read_toml, resolved
from cardan.drivers.registry import DriverTable
from cardan.errors import ConfigurationError
from cardan.gateway.arm.arrival import ArrivalOptions
from cardan.gateway.arm.states import AuthorityOptions
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.bus.options import NetworkOptions, is_topic
from cardan.gateway.force.tables import (
    FixtureTables,
    ForceTables,
    NetworkForceTable,
    NoForceTable,
    Place,
    RemoteForceTable,
)
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.feedback import FeedbackOptions
from cardan.gateway.operator.filters.registry import FilterTable
from cardan.gateway.operator.mapping import GripperAction, GripperOptions, MappingOptions, Mode
from cardan.gateway.servo.options import Policy, ServoOptions
from cardan.robots import SolidTable
from cardan.spatial import from_rpy_deg
from cardan.types import Pose, Vector3

Part = TypeVar("Part")

LONGEST_STOP_S = 0.5
"""Longest stop without consent: an arm that takes longer moves farther than its operator expects,
at 0.25 m/s over 6 cm."""

LONGEST_ACCEPTED_STOP_S = 2.0
"""Longest stop that an operator can accept: an arm that takes longer is out of control."""


@dataclass(frozen=True, kw_only=True)
class LimitsTable(ReferenceLimits):
    """``[limits]``: bounds of the reference for any request of the operator."""

    i_accept_long_stops: bool = False


@dataclass(frozen=True, kw_only=True)
class ArmTable(ArrivalOptions):
    """``[arm]``: the model by which joints are commanded; without it the robot is sent poses."""

    model: Annotated[str, bounds.ARM_FILE]
    """Name of an arm of the package, or the path of a .toml or .urdf file."""
    policy: Policy = ServoOptions.policy
    tool_xyz_m: Place = (0.0, 0.0, 0.0)
    tool_rpy_deg: Angles = (0.0, 0.0, 0.0)
    speed_share: Annotated[float, bounds.SHARE] = ServoOptions.speed_share
    """Share of the joints' speeds."""
    acceleration_share: Annotated[float, bounds.SHARE] = ServoOptions.acceleration_share
    collisions: bool = True
    """Keep the arm away from itself and from the obstacles."""
    i_accept_links_without_bodies: bool = False
    """Accept obstacles even if some links have no bodies, and do not keep away from them."""
    safety_distance_m: Annotated[float, bounds.SAFETY_DISTANCE_M] = ServoOptions.safety_distance_m
    tcp_tolerance_m: Annotated[float, bounds.TCP_TOLERANCE_M] | None = None
    """Largest difference between the controller's own TCP and the model's at which the arm is
    moved; None: 2 mm if poses are sent, 20 mm if joints are."""

    @property
    def has_no_tool(self) -> bool:
        """True if the TCP is the model's own."""
        return not any((*self.tool_xyz_m, *self.tool_rpy_deg))

    def tool(self) -> Pose:
        """The TCP, relative to the model's own."""
        return Pose(Vector3(*self.tool_xyz_m), from_rpy_deg(self.tool_rpy_deg))


@dataclass(frozen=True, kw_only=True)
class ObstacleTable(SolidTable):
    """Table of ``[[obstacles]]``: a solid body in the arm's base frame."""

    FORMS: ClassVar[Mapping[str, str]] = {**SolidTable.FORMS, "plane": "[normal, offset]"}

    plane: tuple[Direction, Coordinate] | None = None
    """Normal out of the solid, and the distance of the surface along it, m."""


@dataclass(frozen=True, kw_only=True)
class NeighborTable(Options):
    """Table of ``[[neighbors]]``: another arm, whose moving bodies this one keeps away from."""

    name: str
    model: Annotated[str, bounds.ARM_FILE]
    """Name of an arm of the package, or the path of a .toml or .urdf file."""
    topic: str
    """Topic of its joint states on the network: "/right/joint_states"."""
    base_xyz_m: tuple[Coordinate, Coordinate, Coordinate] | None = None
    """Base of its model in that of this arm; None: both are arms of one robot, whose description
    has it."""
    base_rpy_deg: Angles = (0.0, 0.0, 0.0)
    acceleration_share: Annotated[float, bounds.SHARE] = ServoOptions.acceleration_share
    """Share of its joints' accelerations, as in its own session's [arm]: determines its stopping
    time."""
    ignore: tuple[tuple[str, str], ...] = ()
    """Pairs that always touch and are not kept apart: a body of this arm and a body of the
    neighbor."""
    max_age_s: Annotated[float, bounds.NEIGHBOR_AGE_S] = 0.15
    """Age of its newest joint states above which this arm brakes and is not moved."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_each(
            self,
            ("name", self.name, 'a name for messages: "right"'),
            ("topic", is_topic(self.topic), 'the name of a topic: "/right/joint_states"'),
            (
                "base_rpy_deg",
                self.base_xyz_m is not None or not any(self.base_rpy_deg),
                "given with base_xyz_m, where the base is",
            ),
        )

    def base(self) -> Pose | None:
        """Pose of the neighbor in this arm's base; None: by the robot's description."""
        if self.base_xyz_m is None:
            return None
        return Pose(Vector3(*self.base_xyz_m), from_rpy_deg(self.base_rpy_deg))


@dataclass(frozen=True, kw_only=True)
class HapticConfig(Options):
    """Tables that ``cardan devices haptic`` reads of a file: no robot is needed."""

    device: DriverTable
    network: NetworkOptions = field(default_factory=NetworkOptions)
    force: ForceTables = field(default_factory=NetworkForceTable)
    """Its `max_age_s` limits the age of published feedback."""


@dataclass(frozen=True, kw_only=True)
class ForceConfig(Options):
    """Tables that ``cardan devices force`` reads of a file: it needs neither device nor robot."""

    force: ForceTables = field(default_factory=NoForceTable)
    fixtures: FixtureTables = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.force, (RemoteForceTable, NetworkForceTable)):
            raise ConfigurationError(
                "force.source",
                f'"{self.force.source}" is the session\'s; the force node has a file of its own, '
                "with the source that it reads",
            )
        if isinstance(self.force, NoForceTable) and not self.fixtures:
            raise ConfigurationError(
                "force", "neither a source nor [[fixtures]]: there is nothing to send"
            )


@dataclass(frozen=True, kw_only=True)
class SessionConfig(Options):
    """A whole configuration file."""

    RENAMED: ClassVar = {"neighbours": "neighbors"}

    device: DriverTable | None = None
    """None: only verbs and streams move the arm."""
    robot: DriverTable
    arm: ArmTable | None = None
    authority: AuthorityOptions = field(default_factory=AuthorityOptions)
    obstacles: tuple[ObstacleTable, ...] = ()
    neighbors: tuple[NeighborTable, ...] = ()
    mapping: MappingOptions = field(default_factory=MappingOptions)
    filters: tuple[FilterTable, ...] = ()
    """Shared control, applied in this order."""
    gripper: GripperOptions = field(default_factory=GripperOptions)
    feedback: FeedbackOptions = field(default_factory=FeedbackOptions)
    limits: LimitsTable = field(default_factory=LimitsTable)
    watchdogs: Watchdogs = field(default_factory=Watchdogs)
    network: NetworkOptions | None = None
    """Shows the arm to ROS 2, and takes commands from there; None: no network."""
    force: ForceTables = field(default_factory=NoForceTable)
    fixtures: FixtureTables = ()
    """Haptic fixtures in the space around the robot."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gives_force and self.mapping.mode is Mode.RATE:
            raise ConfigurationError(
                "fixtures" if self.fixtures else "force",
                'in mode = "rate" no place of the device is one of the TCP; set mapping.mode = '
                '"position" or "absolute"',
            )
        network = self.network
        if isinstance(self.force, NetworkForceTable) and not (
            network is not None and network.device and network.commands
        ):
            raise ConfigurationError(
                "force.source",
                '"network" needs the table [network] with device = true and commands as it is, so '
                "that programs can publish the force",
            )
        if self.mapping.joints and self.arm is None:
            raise ConfigurationError(
                "mapping.joints", "only a session with an [arm] commands joints"
            )
        for around in ("obstacles", "neighbors"):
            if getattr(self, around) and (self.arm is None or not self.arm.collisions):
                raise ConfigurationError(
                    around,
                    "only an arm's model keeps away from them: add [arm] with its model, and leave "
                    "arm.collisions on",
                )
        names = [each.name for each in self.neighbors]
        if len(set(names)) < len(names):
            raise ConfigurationError("neighbors", "two have one name: name each differently")
        if self.neighbors and self.network is None:
            raise ConfigurationError(
                "neighbors", "their joint states come from the network: add the table [network]"
            )
        self._check_buttons()
        self._check_limits()

    @property
    def gives_force(self) -> bool:
        """True if a haptic device is to render force."""
        return bool(self.fixtures) or not isinstance(self.force, NoForceTable)

    def buttons(self) -> list[tuple[str, str]]:
        """Buttons of the operator device with a meaning, after their keys."""
        mapping = self.mapping
        found = [("mapping.deadman", button) for button in mapping.deadman_buttons]
        found += [
            (f"mapping.{key}", getattr(mapping, key))
            for key in ("clutch", "recapture", "enable", "pass_on")
        ]
        found += [(f"gripper.{a.value}", getattr(self.gripper, a.value)) for a in GripperAction]
        return [(key, button) for key, button in found if button]

    def _check_buttons(self) -> None:
        """Refuse buttons with two meanings."""
        buttons = self.buttons()
        for key, button in buttons:
            for other, same in buttons:
                if button == same and key < other:
                    raise ConfigurationError(key, f"{button!r} is the button of {other}, too")

    def _check_limits(self) -> None:
        limits, watchdogs = self.limits, self.watchdogs
        accepted = limits.i_accept_long_stops
        longest_s = LONGEST_ACCEPTED_STOP_S if accepted else LONGEST_STOP_S
        for kind, unit in (("linear", "m"), ("angular", "rad")):
            key = f"{kind}_acceleration_{unit}_s2"
            speed, acceleration = getattr(limits, f"{kind}_speed_{unit}_s"), getattr(limits, key)
            # Rounding of a stop of exactly the longest time is no reason to refuse it.
            if speed > acceleration * longest_s * (1.0 + 1e-9):
                consent = (
                    "no more is allowed"
                    if accepted
                    else "or accept it with i_accept_long_stops = true in [limits], up to "
                    f"{LONGEST_ACCEPTED_STOP_S:g} s"
                )
                raise ConfigurationError(
                    f"limits.{key}",
                    f"stopping from full speed takes {speed / acceleration:.3g} s; "
                    f"it must not take more than {longest_s:g} s: raise the acceleration or lower "
                    f"the speed; {consent}",
                )
            lead = getattr(limits, f"max_lead_{unit}")
            error_limit = getattr(watchdogs, f"following_error_{unit}")
            if lead > error_limit:
                raise ConfigurationError(
                    f"limits.max_lead_{unit}",
                    f"is {lead:g}; it must not be longer than "
                    f"watchdogs.following_error_{unit}, which is {error_limit:g}",
                )


def parse_config(table: Mapping[str, Any], from_file: bool = True) -> SessionConfig:
    """Check a configuration already read; ConfigurationError names the first wrong key.

    Without `from_file` it comes from another program, with settings that files do not have.
    """
    return read_table(SessionConfig, table, from_file=from_file)


def read_part(kind: type[Part], path: Path) -> Part:
    """Read the tables of a file that `kind` has; all others are ignored."""
    keys = keys_of(kind)
    with in_file(path):
        tables = {key: each for key, each in read_toml(path).items() if key in keys}
        return read_table(kind, resolved(kind, tables, path))
