"""What the tables of a configuration file have in common: their base, and kinds of numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Bounds = tuple[Finite, Finite]
Point = tuple[Finite, Finite, Finite]
Share = Annotated[float, Field(gt=0, le=1, strict=True)]


class Table(BaseModel):
    """A table of keys that are all known."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class DriverTable(BaseModel):
    """A driver's name; all other keys are that driver's options."""

    model_config = ConfigDict(extra="allow", frozen=True)
    driver: str
