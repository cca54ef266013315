"""No number of a configuration is unbounded: drivers, filters and tables, by reflection."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, Any, get_type_hints

import pytest
from pydantic import BaseModel, ValidationError

from cardan.bounds import Range
from cardan.drivers import registry
from cardan.errors import ConfigurationError
from cardan.gateway.common.tables import within
from cardan.gateway.force import tables as force_tables
from cardan.gateway.hand.filters import registry as filter_registry
from cardan.gateway.session import config
from cardan.gateway.session.assembly import driver_options
from cardan.options import check_options
from tests.ranges import spoilt

HUGE = 10**400
"""Too large even for a double."""
BAD = [1e300, -1e300, math.inf, -math.inf, math.nan, HUGE, -HUGE]

DRIVERS = {name: registry.load(name) for name in sorted(registry.BUILT_IN)}
FILTERS = {name: filter_registry.load(name) for name in sorted(filter_registry.BUILT_IN)}
TABLES = sorted(
    {
        table
        for module in (config, force_tables)
        for table in vars(module).values()
        if isinstance(table, type) and issubclass(table, BaseModel) and table is not BaseModel
    },
    key=lambda table: table.__name__,
)


def numeric(kind: type[Any]) -> dict[str, Any]:
    """The annotations of the fields that hold numbers, by name."""
    hints = get_type_hints(kind, include_extras=True)
    names = (
        kind.model_fields
        if issubclass(kind, BaseModel)
        else [field.name for field in dataclasses.fields(kind)]
    )
    return {name: hints[name] for name in names if spoilt(hints[name], 1.0)}


OPTIONS = [
    pytest.param(kind, name, hint, id=f"{key}.{name}")
    for key, kind in {**DRIVERS, **FILTERS}.items()
    for name, hint in numeric(kind.Options).items()
]
FIELDS = [
    pytest.param(table, name, hint, id=f"{table.__name__}.{name}")
    for table in TABLES
    for name, hint in numeric(table).items()
]


def test_the_reflection_finds_them():
    assert len(OPTIONS) > 100
    assert len(FIELDS) > 50


@pytest.mark.parametrize(("kind", "name", "hint"), OPTIONS)
def test_no_option_takes_a_number_beyond_all_bounds(kind, name, hint):
    for bad in BAD:
        for value in spoilt(hint, bad):
            with pytest.raises(ValueError, match=name):
                kind.Options(**{name: value})
            with pytest.raises(ConfigurationError, match=name):
                driver_options(kind, {name: value}, "table")


@pytest.mark.parametrize(("table", "name", "hint"), FIELDS)
def test_no_table_takes_a_number_beyond_all_bounds(table, name, hint):
    for bad in BAD:
        for value in spoilt(hint, bad):
            with pytest.raises(ValidationError) as caught:
                table.model_validate({name: value})
            assert name in {error["loc"][0] for error in caught.value.errors()}, value


@pytest.mark.parametrize("name", [*DRIVERS, *FILTERS])
def test_defaults_are_in_their_ranges(name):
    kind = {**DRIVERS, **FILTERS}[name]
    options = kind.Options()
    check_options(options)
    plain = {f.name: getattr(options, f.name) for f in dataclasses.fields(options)}
    assert driver_options(kind, plain, "table") == options


@pytest.mark.parametrize("name", DRIVERS)
def test_every_number_of_a_driver_has_its_range(name):
    for field, hint in numeric(DRIVERS[name].Options).items():
        assert "Range(" in repr(hint), field


# -- ranges ----------------------------------------------------------------------------------------

CLOSED = Range(1.0, 2.0, "m", "so it is")
OPEN = Range(0.0, 1.0, "", "so it is", above=True, below=True)


@pytest.mark.parametrize(
    ("bounds", "inside", "beyond"),
    [
        (CLOSED, [1.0, 1, 1.5, 2.0, 2], [0.999, 2.001, math.nan, math.inf, HUGE, True, "1", None]),
        (OPEN, [5e-324, 0.5], [0.0, 0, 1.0, 1, -1.0, math.nan]),
    ],
)
def test_a_range_and_pydantic_agree(bounds, inside, beyond):
    class Table(BaseModel):
        number: Annotated[float, within(bounds)]

    for value in inside:
        assert value in bounds
        Table(number=value)
    for value in beyond:
        assert value not in bounds
        with pytest.raises(ValidationError):
            Table(number=value)


def test_ranges_in_words():
    assert str(CLOSED) == "1 to 2 m"
    assert str(OPEN) == "above 0, below 1"
    assert str(Range(0.0, 60.0, "s", "", zero="off")) == "0 (off) to 60 s"
    assert str(Range(0.0, 1.0, "", "", below=True)) == "0 to below 1"
    assert str(Range(1.0, 1e6, "counts", "")) == "1 to 1000000 counts"
    assert str(Range(1.0, math.inf, "s", "")) == "1 s or more"
    assert str(Range(0.0, math.inf, "", "", above=True)) == "above 0"
