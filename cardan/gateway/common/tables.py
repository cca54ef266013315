"""What the tables of a configuration file have in common: their base, and kinds of numbers."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from cardan.bounds import ANGLE_DEG, COORDINATE_M, DIRECTION, LENGTH_M, Range


def within(bounds: Range) -> Any:
    """What pydantic checks of a number in `bounds`, for ``Annotated[float, within(...)]``."""
    return Field(
        gt=bounds.lowest if bounds.above else None,
        ge=None if bounds.above else bounds.lowest,
        lt=bounds.highest if bounds.below else None,
        le=None if bounds.below else bounds.highest,
        allow_inf_nan=False,
        strict=True,
    )


Length = Annotated[float, within(LENGTH_M)]
Coordinate = Annotated[float, within(COORDINATE_M)]
Angle = Annotated[float, within(ANGLE_DEG)]
Component = Annotated[float, within(DIRECTION)]

Bounds = tuple[Coordinate, Coordinate]
Point = tuple[Coordinate, Coordinate, Coordinate]
Angles = tuple[Angle, Angle, Angle]
Direction = tuple[Component, Component, Component]


class Table(BaseModel):
    """A table of keys that are all known."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class DriverTable(BaseModel):
    """A driver's name; all other keys are that driver's options."""

    model_config = ConfigDict(extra="allow", frozen=True)
    driver: str
