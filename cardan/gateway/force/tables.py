"""``[force]`` and ``[[fixtures]]`` of a configuration file."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import field_validator, model_validator

from cardan import bounds
from cardan.gateway.common.tables import Angles, Direction, DriverTable, Length, Table, within
from cardan.haptics import MAX_FIXTURES

Near = Annotated[float, within(bounds.NEAR_M)]
Place = tuple[Near, Near, Near]
"""m"""

Stiffness = Annotated[float, within(bounds.FIXTURE_STIFFNESS_N_M)]
Damping = Annotated[float, within(bounds.DAMPING_N_S_M)]

MAX_SOCKET_PATH_BYTES = 107
"""Of a Unix socket on Linux."""

MAX_CONTACTS = 8

SHORTEST_DIRECTION = 1e-9
"""A vector that is shorter has no direction that rounding leaves."""

_NEEDED = {
    "sphere": ("centre_m", "radius_m", "stiffness_n_m"),
    "plane": ("normal", "stiffness_n_m"),
    "box": ("centre_m", "half_sides_m", "stiffness_n_m"),
    "cylinder": ("point_m", "axis", "radius_m", "stiffness_n_m"),
    "spring": ("stiffness_n_m",),
    "viscous": ("damping_n_s_m",),
}
_ALLOWED = {
    "sphere": ("inside",),
    "plane": ("point_m", "at"),
    "box": ("rpy_deg", "inside"),
    "cylinder": ("inside",),
    "spring": ("target_m", "at"),
    "viscous": (),
}
_ALWAYS = ("shape", "cap_n", "damping_n_s_m")
_PLACED = {"plane": "point_m", "spring": "target_m"}
"""The shapes that may begin where the TCP is, and the key that says where else."""


def _one_of_length(direction: Direction | None) -> Direction | None:
    if direction is not None and not math.sqrt(sum(c * c for c in direction)) > SHORTEST_DIRECTION:
        raise ValueError(f"{list(direction)} has no direction")
    return direction


class FixtureTable(Table):
    """One of ``[[fixtures]]``: geometry in the robot's base frame that pushes the hand."""

    shape: Literal["sphere", "plane", "box", "cylinder", "spring", "viscous"]
    centre_m: Place | None = None
    radius_m: Length | None = None
    half_sides_m: tuple[Length, Length, Length] | None = None
    rpy_deg: Angles | None = None
    point_m: Place | None = None
    normal: Direction | None = None
    axis: Direction | None = None
    target_m: Place | None = None
    at: Literal["start", "clutch-in"] | None = None
    stiffness_n_m: Stiffness | None = None
    damping_n_s_m: Damping = 0.0
    cap_n: Annotated[float, within(bounds.HAND_FORCE_N)] = 3.0
    inside: bool = False

    _directions = field_validator("normal", "axis")(_one_of_length)

    @model_validator(mode="after")
    def _fits_the_shape(self) -> FixtureTable:
        needed = _NEEDED[self.shape]
        for key in needed:
            if not getattr(self, key):
                raise ValueError(f'{key}: shape = "{self.shape}" needs it')
        allowed = (*needed, *_ALLOWED[self.shape], *_ALWAYS)
        for key, field in FixtureTable.model_fields.items():
            if key not in allowed and getattr(self, key) != field.default:
                raise ValueError(
                    f'{key}: shape = "{self.shape}" has none; it has: {", ".join(allowed[:-3])}'
                )
        place = _PLACED.get(self.shape)
        if place is not None and (getattr(self, place) is None) is (self.at is None):
            raise ValueError(
                f'{place}: shape = "{self.shape}" needs it, or at = "start" or "clutch-in" (where '
                "the TCP is then), one of both"
            )
        return self


class ContactTable(Table):
    """One of ``[[force.contact]]``: a virtual contact surface."""

    shape: Literal["plane", "sphere"]
    point_m: Place | None = None
    normal: Direction | None = None
    centre_m: Place | None = None
    radius_m: Length | None = None
    stiffness_n_m: Annotated[float, within(bounds.ENVIRONMENT_STIFFNESS_N_M)]
    damping_n_s_m: Damping = 0.0
    friction: Annotated[float, within(bounds.FRICTION)] = 0.0

    _direction = field_validator("normal")(_one_of_length)

    @model_validator(mode="after")
    def _fits_the_shape(self) -> ContactTable:
        keys = {"plane": ("point_m", "normal"), "sphere": ("centre_m", "radius_m")}
        for shape, needed in keys.items():
            for key in needed:
                if (getattr(self, key) is not None) is not (shape == self.shape):
                    says = "needs it" if shape == self.shape else "has none"
                    raise ValueError(f'{key}: shape = "{self.shape}" {says}')
        return self


class ForceTable(Table):
    """``[force]``: where the force comes from that the hand feels, and how it gets there."""

    source: Literal["none", "measured", "sensor", "contact", "remote"] = "none"
    sense: Literal["exerted", "felt"] | None = None
    scale: Annotated[float, within(bounds.FORCE_SCALE)] = 0.02
    deadband_n: Annotated[float, within(bounds.DEADBAND_N)] = 0.1
    cutoff_hz: Annotated[float, within(bounds.FORCE_CUTOFF_HZ)] = 40.0
    tare: bool = True
    max_age_s: Annotated[float, within(bounds.BLIND_S)] = 0.1
    stiffness_n_m: Annotated[float, within(bounds.HAND_STIFFNESS_N_M)] = 0.0
    environment_stiffness_n_m: Annotated[float, within(bounds.ENVIRONMENT_STIFFNESS_N_M)] | None = (
        None
    )
    delay_s: Annotated[float, within(bounds.LOOP_DELAY_S)] = 0.02
    contact_target_n: Annotated[float, within(bounds.ROBOT_FORCE_N)] | None = None
    sensor: DriverTable | None = None
    zero_sensor: bool = False
    contact: tuple[ContactTable, ...] = ()
    socket: str = ""

    @field_validator("contact", mode="before")
    @classmethod
    def _array_of_tables(cls, tables: object) -> object:
        if not isinstance(tables, (list, tuple)):
            raise ValueError("one table for each of them, under the heading [[force.contact]]")
        return tables

    @field_validator("contact")
    @classmethod
    def _not_too_many(cls, tables: tuple[ContactTable, ...]) -> tuple[ContactTable, ...]:
        if len(tables) > MAX_CONTACTS:
            raise ValueError(f"{len(tables)} are too many; allowed: at most {MAX_CONTACTS}")
        return tables

    @field_validator("socket")
    @classmethod
    def _short_enough(cls, path: str) -> str:
        if len(path.encode()) > MAX_SOCKET_PATH_BYTES or "\0" in path:
            raise ValueError(f"a path of at most {MAX_SOCKET_PATH_BYTES} bytes")
        return path

    @model_validator(mode="after")
    def _fits_the_source(self) -> ForceTable:
        for key, source in (("sensor", "sensor"), ("contact", "contact"), ("socket", "remote")):
            if bool(getattr(self, key)) is not (self.source == source):
                heading = {"sensor": "[force.sensor]", "contact": "[[force.contact]]"}.get(key, key)
                if self.source == source:
                    raise ValueError(f'{key}: source = "{source}" needs {heading}')
                raise ValueError(f'{key}: source = "{self.source}" has no use for {heading}')
        if self.zero_sensor and self.source != "sensor":
            raise ValueError('zero_sensor: only source = "sensor" has one')
        if self.sense is not None and self.source not in ("measured", "sensor"):
            raise ValueError('sense: only source = "measured" and source = "sensor" have one')
        return self


def check_fixtures(tables: tuple[FixtureTable, ...]) -> tuple[FixtureTable, ...]:
    """`tables`, if there is room for so many. Raises ValueError."""
    if len(tables) > MAX_FIXTURES:
        raise ValueError(f"{len(tables)} are too many; allowed: at most {MAX_FIXTURES}")
    return tables
