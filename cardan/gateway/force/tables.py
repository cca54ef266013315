"""``[force]`` and ``[[fixtures]]`` of a configuration file: one class for each source and shape."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal

from cardan.common import bounds
from cardan.common.bounds import Angles, Direction, Length
from cardan.common.haptics import (
    MAX_FIXTURES,
    Box,
    Cylinder,
    Plane,
    Sphere,
    Spring,
    Viscous,
)
from cardan.common.tables import AtMost, Tag
from cardan.drivers.registry import DriverTable
from cardan.errors import ConfigurationError
from cardan.gateway.force.conditioning import Conditioning
from cardan.gateway.force.fixtures import FixtureTable, matrix_of, outward_of_round, unit
from cardan.gateway.force.sources import ContactTable
from cardan.spatial import dot, from_rpy_deg, subtract
from cardan.types import ZERO3, Vector3

Near = Annotated[float, bounds.NEAR_M]
Place = tuple[Near, Near, Near]
"""Position, m."""

MAX_CONTACTS = 8
FORMER_KEYS = {"centre_m": "center_m"}
FORMER_SENSE = {"sense = 'felt'": "'reaction'"}

# -- [[fixtures]]: geometry in the robot's base frame that pushes the hand -------------------------


@dataclass(frozen=True, kw_only=True)
class StiffFixtureTable(FixtureTable):
    """A fixture that pushes harder the deeper the TCP is in it."""

    stiffness_n_m: Annotated[float, bounds.FIXTURE_STIFFNESS_N_M]
    damping_n_s_m: Annotated[float, bounds.DAMPING_N_S_M] = 0.0

    @property
    def _material(self) -> tuple[float, float, float]:
        return self.stiffness_n_m, self.cap_n, self.damping_n_s_m


@dataclass(frozen=True, kw_only=True)
class _PlacedFixtureTable(StiffFixtureTable):
    """A fixture at the position in the field `_PLACE`, or at the TCP's position at an event."""

    _PLACE: ClassVar[str]
    at: Literal["start", "clutch-in"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (getattr(self, self._PLACE) is None) is (self.at is None):
            raise ConfigurationError(
                self._PLACE,
                'it is needed, or at = "start" or "clutch-in" (where the TCP is then), one of both',
            )

    @property
    def moment(self) -> str:
        return self.at or ""

    def _place(self, tcp: Vector3) -> Vector3:
        return Vector3(*(getattr(self, self._PLACE) or tcp))


@dataclass(frozen=True, kw_only=True)
class SphereTable(StiffFixtureTable):
    """A solid sphere, or a hollow one that encloses the hand."""

    RENAMED: ClassVar = FORMER_KEYS

    shape: Literal["sphere"] = "sphere"
    center_m: Place
    radius_m: Length
    inside: bool = False

    def made(self, tcp: Vector3 = ZERO3) -> Sphere:
        return Sphere(Vector3(*self.center_m), self.radius_m, *self._material, self.inside)


@dataclass(frozen=True, kw_only=True)
class PlaneTable(_PlacedFixtureTable):
    """Solid below a plane."""

    _PLACE = "point_m"
    shape: Literal["plane"] = "plane"
    point_m: Place | None = None
    normal: Direction

    def made(self, tcp: Vector3 = ZERO3) -> Plane:
        return Plane(self._place(tcp), unit(self.normal), *self._material)


@dataclass(frozen=True, kw_only=True)
class BoxTable(StiffFixtureTable):
    """A solid box, or a hollow one that encloses the hand."""

    RENAMED: ClassVar = FORMER_KEYS

    shape: Literal["box"] = "box"
    center_m: Place
    half_sides_m: tuple[Length, Length, Length]
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    inside: bool = False

    def made(self, tcp: Vector3 = ZERO3) -> Box:
        rotation = matrix_of(from_rpy_deg(self.rpy_deg))
        center, sides = Vector3(*self.center_m), Vector3(*self.half_sides_m)
        return Box(center, sides, *self._material, self.inside, rotation)


@dataclass(frozen=True, kw_only=True)
class CylinderTable(StiffFixtureTable):
    """A solid cylinder without ends, or a hollow one that encloses the hand."""

    shape: Literal["cylinder"] = "cylinder"
    point_m: Place
    axis: Direction
    radius_m: Length
    inside: bool = False

    def made(self, tcp: Vector3 = ZERO3) -> Cylinder:
        point, axis = Vector3(*self.point_m), unit(self.axis)
        return Cylinder(point, axis, self.radius_m, *self._material, self.inside)


@dataclass(frozen=True, kw_only=True)
class SpringTable(_PlacedFixtureTable):
    """A spring to a point."""

    _PLACE = "target_m"
    shape: Literal["spring"] = "spring"
    target_m: Place | None = None

    def made(self, tcp: Vector3 = ZERO3) -> Spring:
        return Spring(self._place(tcp), *self._material)


@dataclass(frozen=True, kw_only=True)
class ViscousTable(FixtureTable):
    """Drag against every motion."""

    shape: Literal["viscous"] = "viscous"
    damping_n_s_m: Annotated[float, bounds.DRAG_N_S_M]

    def made(self, tcp: Vector3 = ZERO3) -> Viscous:
        return Viscous(self.damping_n_s_m, self.cap_n)


AnyFixtureTable = Annotated[
    SphereTable | PlaneTable | BoxTable | CylinderTable | SpringTable | ViscousTable, Tag("shape")
]
FixtureTables = Annotated[tuple[AnyFixtureTable, ...], AtMost(MAX_FIXTURES)]


# -- [[force.contact]]: virtual contact surfaces ---------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class PlaneContactTable(ContactTable):
    """A surface that is solid below."""

    shape: Literal["plane"] = "plane"
    point_m: Place
    normal: Direction

    @cached_property
    def _outward(self) -> Vector3:
        return unit(self.normal)

    def depth_at(self, place: Vector3) -> tuple[Vector3, float]:
        return self._outward, dot(subtract(Vector3(*self.point_m), place), self._outward)


@dataclass(frozen=True, kw_only=True)
class SphereContactTable(ContactTable):
    """A solid sphere."""

    RENAMED: ClassVar = FORMER_KEYS

    shape: Literal["sphere"] = "sphere"
    center_m: Place
    radius_m: Length

    def depth_at(self, place: Vector3) -> tuple[Vector3, float]:
        away = subtract(place, Vector3(*self.center_m))
        return outward_of_round(away, self.radius_m)


AnyContactTable = Annotated[PlaneContactTable | SphereContactTable, Tag("shape")]


# -- [force]: source of the force on the device, and its processing --------------------------------


@dataclass(frozen=True, kw_only=True)
class ForceTable(Conditioning):
    """Options of ``[force]`` for any source."""

    max_age_s: Annotated[float, bounds.BLIND_S] = 0.1
    stiffness_n_m: Annotated[float, bounds.HAND_STIFFNESS_N_M] = 0.0
    environment_stiffness_n_m: Annotated[float, bounds.ENVIRONMENT_STIFFNESS_N_M] | None = None
    delay_s: Annotated[float, bounds.LOOP_DELAY_S] = 0.02
    contact_target_n: Annotated[float, bounds.ROBOT_FORCE_N] | None = None


@dataclass(frozen=True, kw_only=True)
class NoForceTable(ForceTable):
    """No force is measured."""

    source: Literal["none"] = "none"


@dataclass(frozen=True, kw_only=True)
class MeasuredForceTable(ForceTable):
    """Force measured by the robot itself."""

    RENAMED: ClassVar = FORMER_SENSE

    source: Literal["measured"] = "measured"
    sense: Literal["exerted", "reaction"] = "exerted"


@dataclass(frozen=True, kw_only=True)
class SensorForceTable(ForceTable):
    """A sensor at the robot's flange."""

    RENAMED: ClassVar = FORMER_SENSE

    source: Literal["sensor"] = "sensor"
    sense: Literal["exerted", "reaction"] = "reaction"
    sensor: DriverTable
    zero_sensor: bool = False


@dataclass(frozen=True, kw_only=True)
class ContactForceTable(ForceTable):
    """Contacts computed from the measured TCP."""

    source: Literal["contact"] = "contact"
    contact: Annotated[tuple[AnyContactTable, ...], AtMost(MAX_CONTACTS)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.contact:
            raise ConfigurationError("contact", 'source = "contact" needs [[force.contact]]')


@dataclass(frozen=True, kw_only=True)
class RemoteForceTable(ForceTable):
    """Force of a force node, a separate process."""

    source: Literal["remote"] = "remote"
    socket: Annotated[str, bounds.SOCKET_PATH, bounds.MEETING]


@dataclass(frozen=True, kw_only=True)
class NetworkForceTable(ForceTable):
    """Force published by programs on the network, for the haptic device of ``[network]``."""

    source: Literal["network"] = "network"


ForceTables = Annotated[
    NoForceTable
    | MeasuredForceTable
    | SensorForceTable
    | ContactForceTable
    | RemoteForceTable
    | NetworkForceTable,
    Tag("source", "none"),
]
