"""Bounds of every number in a configuration: drivers, filters and tables, by reflection."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, get_args

import pytest

from cardan.common.bounds import HOST, LISTEN_HOST, Range
from cardan.common.options import check_options, hints
from cardan.common.tables import keys_of, read_table
from cardan.drivers import registry
from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.operator.filters import registry as filter_registry
from cardan.gateway.session.config import SessionConfig
from cardan.sim_peers import registry as peers
from tests.docs_tables import ours
from tests.ranges import spoilt

HUGE = 10**400
"""Too large even for a double-precision number."""
BAD = [1e300, -1e300, math.inf, -math.inf, math.nan, HUGE, -HUGE]

DRIVERS = ours(registry)
FILTERS = ours(filter_registry)


def tables(hint: Any) -> set[type[Any]]:
    """Yield the tables in an annotation, and their nested tables."""
    table = isinstance(hint, type) and dataclasses.is_dataclass(hint)
    inner = hints(hint).values() if table else get_args(hint)
    return {each for within in inner for each in tables(within)} | ({hint} if table else set())


TABLES = sorted(tables(SessionConfig), key=lambda table: table.__name__)
REQUIRED = {
    "robot": {"driver": "sim_arm"},
    "sensor": {"driver": "jr3_can"},
    "model": "ur5",
    "topic": "/right/joint_states",
    "name": "table",
    "driver": "sim_arm",
    "filter": "camera",
    "socket": "force.sock",
    "center_m": [0.0, 0.0, 0.0],
    "point_m": [0.0, 0.0, 0.0],
    "half_sides_m": [1.0, 1.0, 1.0],
    "normal": [0.0, 0.0, 1.0],
    "axis": [0.0, 0.0, 1.0],
    "radius_m": 0.1,
    "stiffness_n_m": 100.0,
    "damping_n_s_m": 1.0,
    "contact": [],
}
"""Required values, by key."""


def numeric(kind: type[Any]) -> dict[str, Any]:
    """Return the annotations of numeric fields, by name."""
    found = hints(kind)
    return {name: found[name] for name in keys_of(kind) if spoilt(found[name], 1.0)}


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
                read_table(kind.Options, {name: value}, "table")


@pytest.mark.parametrize(("table", "name", "hint"), FIELDS)
def test_no_table_takes_a_number_beyond_all_bounds(table, name, hint):
    whole = {
        key: REQUIRED[key]
        for key, field in keys_of(table).items()
        if field.default is field.default_factory is dataclasses.MISSING
    }
    for bad in BAD:
        for value in spoilt(hint, bad):
            with pytest.raises(ConfigurationError) as caught:
                read_table(table, {**whole, name: value})
            assert caught.value.key == name, value


@pytest.mark.parametrize("name", [*DRIVERS, *FILTERS])
def test_defaults_are_in_their_ranges(name):
    kind = {**DRIVERS, **FILTERS}[name]
    options = kind.Options()
    check_options(options)
    plain = {f.name: getattr(options, f.name) for f in dataclasses.fields(options)}
    assert read_table(kind.Options, plain, "table") == options


@pytest.mark.parametrize("name", DRIVERS)
def test_every_number_of_a_driver_has_its_range(name):
    for field, hint in numeric(DRIVERS[name].Options).items():
        assert "Range(" in repr(hint), field


# -- hosts -----------------------------------------------------------------------------------------

PEERS = ours(peers)
HOSTS = [
    pytest.param(options, name, id=f"{key}.{name}")
    for key, options in {
        **{key: kind.Options for key, kind in {**DRIVERS, **FILTERS}.items()},
        **{f"sim {key}": peer.Options for key, peer in PEERS.items()},
    }.items()
    for name, hint in hints(options).items()
    if "host" in name.split("_") or (key, name) == ("sim_arm", "endpoint")
    if not name.endswith("_hz")
]


def test_every_host_is_found():
    assert len(HOSTS) >= 12


@pytest.mark.parametrize(("options", "name"), HOSTS)
def test_no_host_is_an_address_of_many(options, name):
    port = ":6520" if name == "endpoint" else ""
    assert getattr(options(**{name: f"127.0.0.1{port}"}), name)
    for bad in ("224.0.0.1", "239.255.0.1", "255.255.255.255"):
        with pytest.raises(OptionError, match=rf"^{name}: .*{bad}.* no multicast"):
            options(**{name: f"{bad}{port}"})
    if "address or the name of one" in str(hints(options)[name]) or port:
        with pytest.raises(OptionError, match="wildcard"):
            options(**{name: f"0.0.0.0{port}"})


@pytest.mark.parametrize(("options", "name"), HOSTS)
def test_no_host_has_a_port(options, name):
    port = ":6520" if name == "endpoint" else ""
    for bad in ("127.0.0.1:30004", "robot:30004", "[::1]:30004"):
        with pytest.raises(OptionError, match=rf"^{name}: "):
            options(**{name: f"{bad}{port}"})


@pytest.mark.parametrize("host", ["::1", "[::1]", "fe80::1%eth0", "2001:db8::30004", "robot"])
def test_a_host_may_be_an_ipv6_address(host):
    assert host in HOST
    assert host in LISTEN_HOST


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
def test_a_range_has_numbers_alone(bounds, inside, beyond):
    for value in inside:
        assert value in bounds
    for value in beyond:
        assert value not in bounds


def test_ranges_in_words():
    assert str(CLOSED) == "1 to 2 m"
    assert str(OPEN) == "above 0, below 1"
    assert str(Range(0.0, 60.0, "s", "", zero="off")) == "0 (off) to 60 s"
    assert str(Range(0.0, 1.0, "", "", below=True)) == "0 to below 1"
    assert str(Range(1.0, 1e6, "counts", "")) == "1 to 1000000 counts"
    assert str(Range(1.0, math.inf, "s", "")) == "1 s or more"
    assert str(Range(0.0, math.inf, "", "", above=True)) == "above 0"
