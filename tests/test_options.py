"""Options are checked by their annotations; errors name the key, the value and the allowed
values."""

from __future__ import annotations

import copy
import dataclasses
import enum
import math
import pickle
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple, get_args

import pytest

from cardan.common import bounds
from cardan.common.bounds import LINEAR_SPEED_M_S, Range
from cardan.common.options import (
    Options,
    check_options,
    check_value,
    choices,
    hints,
    refusal,
    require,
    require_each,
)
from cardan.drivers import registry as driver_registry
from cardan.drivers.abb_egm import AbbEgm
from cardan.errors import ConfigurationError, OptionError, shown
from cardan.gateway.operator.filters import registry as filter_registry
from cardan.gateway.operator.mapping import MappingOptions
from cardan.sim_peers import registry as peer_registry
from tests.docs_tables import ours
from tests.ranges import found_in, spoilt

CLOSED = Range(1.0, 2.0, "m", "so it is")


@dataclasses.dataclass
class Plain:
    speed: Annotated[float, LINEAR_SPEED_M_S] = 0.1
    count: Annotated[int, CLOSED] = 1
    corner: tuple[Annotated[float, CLOSED], ...] = ()
    maybe: Annotated[float, CLOSED] | None = None
    free: float = 0.0


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, ""),
        ({"maybe": 1.5, "corner": (1.0, 2.0), "count": 2, "free": math.inf}, ""),
        (
            {"speed": 7.0},
            "speed: 7.0 is not allowed; it must be 0.0001 to 5 m/s: no serial arm's TCP is faster",
        ),
        ({"count": 1.5}, "count: 1.5 is not allowed; it must be 1 to 2 m, whole: so it is"),
        (
            {"corner": (1.0, 3.0)},
            "corner: (1.0, 3.0) is not allowed; it must be 1 to 2 m: so it is",
        ),
        ({"maybe": 0}, "maybe: 0 is not allowed; it must be 1 to 2 m: so it is"),
    ],
)
def test_a_dataclass_is_checked_by_its_annotations(values, words):
    if not words:
        check_options(Plain(**values))
        return
    with pytest.raises(ValueError, match="allowed") as caught:
        check_options(Plain(**values))
    assert str(caught.value).startswith(words)


@dataclasses.dataclass(frozen=True)
class Checked(Options):
    count: Annotated[int, CLOSED] = 1
    either: Annotated[float, CLOSED] | tuple[Annotated[float, CLOSED], ...] = 1.0
    axis: bounds.Direction = (0.0, 0.0, 1.0)


def test_options_are_checked_when_they_are_made():
    assert Checked(count=2).count == 2
    with pytest.raises(OptionError, match=r"^count: 3 is not allowed; it must be 1 to 2 m"):
        Checked(count=3)
    with pytest.raises(OptionError, match=r"it must be 1 to 2 m: so it is$"):
        Checked(either=(1.0, 3.0))
    with pytest.raises(OptionError, match=r"^axis: .* it must be a vector that has a direction$"):
        Checked(axis=(0.0, 1e-10, 0.0))
    with pytest.raises(OptionError, match=r"^axis: .* it must be 3 values$"):
        Checked(axis=(0.0, 0.0))
    with pytest.raises(OptionError, match=r"^axis: .* only its direction counts$"):
        Checked(axis=(0.0, math.nan, 0.0))


class Color(enum.Enum):
    RED = "red"
    BLUE = "blue"


class Point(NamedTuple):
    x: Annotated[float, CLOSED]
    y: float


@pytest.mark.parametrize(
    ("hint", "good", "bad", "allowed"),
    [
        (bool, [True, False], [0, 1, "true", None], "true or false"),
        (int, [0, -1, 10**400], [1.0, True, "x", None], "a whole number"),
        (int, [], ["1", " 6510 "], "a whole number, without quotes"),
        (float, [0, 1.5, math.inf, 10**300], [True, "x", None, math.nan, 10**400], "a number"),
        (float, [], ["1", "-.5e-3"], "a number, without quotes"),
        (float, [], ["0.1 m/s", "5m/s2"], "a number, without quotes and unit"),
        (str, ["", "x"], [1, None, b"", True], "a text, in quotes"),
        (str, [], ["\0", "a\0b"], "a text without a NUL"),
        (Literal["a", "b"], ["a", "b"], ["c", "", None, 1], "one of a, b"),
        (Literal["", "0"], ["", "0"], ["1", 0], 'one of "", 0'),
        (Literal[2, 6], [2, 6], [3, "2", 2.0], "one of 2, 6"),
        (Literal[1], [1], [True], "one of 1"),
        (Color, list(Color), ["red", None], "one of red, blue"),
        (int | None, [None, 1], ["x", 1.0], "a whole number"),
        (int | str, [1, "x"], [None, 1.0], "a whole number or a text, in quotes"),
        (tuple[int, int], [(1, 2), [1, 2]], [(1,), (1, 2, 3)], "2 values"),
        (tuple[int, ...], [(), (1, 2, 3)], [(1, "x")], "a whole number"),
        (tuple[int, ...], [()], [1, "12", None], "several values"),
        (Point, [Point(1.0, 0.0), (2.0, 3.0)], [Point(0.0, 0.0)], "1 to 2 m: so it is"),
        (Point, [], [(1.0,)], "2 values"),
        (Mapping[str, float], [{}, {"a": 1.0}], [None, (), 1], "values by name"),
        (Mapping[str, float], [], [{"a": "x"}], "a number"),
        (Mapping[str, float], [], [{1: 1.0}], "a text, in quotes"),
        (Plain, [Plain()], [None, {}, Color.RED], "of type Plain"),
        (Annotated[int, "a note"], [1], ["x"], "a whole number"),
        (Annotated[str, bounds.IPV4], ["127.0.0.1"], ["", "x", "1.2.3", 5], str(bounds.IPV4)),
        (Any, [None, 1, "x"], [], ""),
        (list[int], [None, [], ["x"]], [], ""),
        (tuple, [(), (1,)], [[], None], "of type tuple"),
    ],
)
def test_what_an_annotation_allows(hint, good, bad, allowed):
    for value in good:
        assert refusal(hint, value) == "", value
    for value in bad:
        assert refusal(hint, value) == allowed, value


SHARED = ["0.0.0.0", "0", "224.0.0.1", "224.1", "239.255.255.255", "255.255.255.255", "0xffffffff"]
"""Addresses that belong to no single computer."""


@pytest.mark.parametrize(
    ("form", "good", "bad"),
    [
        (
            bounds.IPV4,
            ["0.0.0.0", "192.168.125.1", "223.255.255.255", "240.0.0.1"],
            [
                "255.255.255.255",
                "224.0.0.1",
                "239.1.2.3",
                "256.0.0.1",
                "1.2.3.04",
                "1.2.3.4.5",
                "1.2.3.4 ",
                "::1",
                "localhost",
                "１.2.3.4",
            ],
        ),
        (
            bounds.HOST,
            ["localhost", "10.0.0.1", "::1", "[::1]", "fe80::1%eth0", "müller", "224-0-0-1"],
            ["", "a b", "a\n", "a\0", "\x7f", "::", "[::]", "ff02::1", "::ffff:224.0.0.1", *SHARED],
        ),
        (bounds.HOST_OR_IPV4, ["localhost", "10.0.0.1"], ["", "::1", "a b", "host:80", *SHARED]),
        (
            bounds.LISTEN_HOST,
            ["localhost", "10.0.0.1", "::1", "0.0.0.0", "0", "::"],
            ["", "255.255.255.255", "224.0.0.1", "ff02::1"],
        ),
        (
            bounds.LISTEN_HOST_OR_IPV4,
            ["localhost", "10.0.0.1", "0.0.0.0"],
            ["::", "255.255.255.255", "224.0.0.1", "host:80"],
        ),
        (
            bounds.SOCKET_PATH,
            ["x" * 107, "ü" * 53],
            ["", "x" * 108, "ü" * 54, "x\0", "\ud800" * 36],
        ),
    ],
)
def test_forms_of_texts(form, good, bad):
    assert [text for text in good if text not in form] == []
    assert [text for text in bad if text in form] == []
    assert None not in form


def test_choices_are_those_of_a_literal_or_an_enum():
    assert choices(Literal["a", "b"]) == ("a", "b")
    assert choices(Color) == (Color.RED, Color.BLUE)
    assert choices(int) == ()
    assert hints(Plain)["free"] is float


def test_require_names_key_value_and_what_is_allowed():
    require(True, "key", 1, "anything")
    require_each(Plain(), ("count", True, "1"), ("free", [0], ""))
    with pytest.raises(OptionError) as caught:
        require("", "key", 1, "2 or 3")
    error = caught.value
    assert (error.key, error.value, error.allowed) == ("key", 1, "2 or 3")
    assert str(error) == "key: 1 is not allowed; it must be 2 or 3"
    with pytest.raises(OptionError, match="count: 1 is not allowed; it must be 7"):
        require_each(Plain(), ("free", True, ""), ("count", False, "7"), ("speed", False, ""))


def test_an_error_below_a_table_stays_what_it_is():
    error = OptionError("key", 1, "2").below("robot")
    assert isinstance(error, OptionError)
    assert isinstance(error, ValueError)
    assert (error.key, error.value) == ("robot.key", 1)
    assert str(error) == "robot.key: 1 is not allowed; it must be 2"
    assert str(ConfigurationError("", "is odd").below("robot")) == "robot: is odd"
    assert str(ConfigurationError("a", "is odd").below("")) == "a: is odd"


# -- all registered options ------------------------------------------------------------------------


def with_inside(options: type[Any]) -> list[type[Any]]:
    """Yield a dataclass of options, and the dataclasses in its fields."""
    return [options, *(hint for hint in hints(options).values() if dataclasses.is_dataclass(hint))]


def kinds() -> Iterator[tuple[str, type[Any]]]:
    """Return the options of every driver, filter and simulated peer, including nested
    dataclasses."""
    for registry in (driver_registry, filter_registry, peer_registry):
        for name, each in ours(registry).items():
            for kind in with_inside(each.Options):
                yield f"{registry.__name__.split('.')[1]}-{name}-{kind.__name__}", kind


FIELDS = [
    pytest.param(kind, field.name, id=f"{name}.{field.name}")
    for name, kind in kinds()
    for field in dataclasses.fields(kind)
]


def bad_values(kind: type[Any], name: str) -> Iterator[Any]:
    """Yield values of a wrong type, an unknown choice, and numbers out of range."""
    hint = hints(kind)[name]
    yield object()
    yield b"bytes"
    if any(map(choices, (hint, *get_args(hint)))):
        yield "no such choice"
    yield from spoilt(hint, math.nan)
    allowed = {each for each, _ in found_in(hint)}
    if len(allowed) == 1:  # else a number may be out of one range and in another
        (only,) = allowed
        for end in (only.lowest - 1.0, 2.0 * only.highest + 1.0):
            if math.isfinite(end):
                yield from spoilt(hint, end)


def test_all_of_them_are_found():
    assert len(FIELDS) > 300


@pytest.mark.parametrize(("kind", "name"), FIELDS)
def test_every_bad_option_names_its_key(kind, name):
    for bad in bad_values(kind, name):
        with pytest.raises(OptionError, match="is not allowed; it must be") as caught:
            kind(**{name: bad})
        assert caught.value.key == name
        assert caught.value.value is bad
        assert caught.value.allowed


def test_one_value_is_checked_likewise():
    check_value("number", 1.0, Annotated[float, CLOSED])
    with pytest.raises(OptionError, match="number: 3 is not allowed; it must be 1 to 2 m"):
        check_value("number", 3, Annotated[float, CLOSED])


# -- storage of given values -----------------------------------------------------------------------


ORIGIN = Point(1.0, 0.0)


@dataclasses.dataclass(frozen=True)
class Keeping(Options):
    corner: tuple[Annotated[float, CLOSED], ...] = ()
    point: Point = ORIGIN
    pairs: tuple[tuple[int, int], ...] = ()
    either: str | tuple[str, ...] = ""
    maybe: Annotated[tuple[float, float], bounds.Directed()] | None = None
    names: Mapping[str, tuple[int, ...]] = dataclasses.field(default_factory=dict)
    path: Annotated[str, bounds.SOCKET_PATH] = "here"


def test_nobody_changes_options_that_were_checked():
    corner, point, pair, names = [1.0, 2.0], [1.5, 2.0], [1, 2], {"a": [1]}
    options = Keeping(corner=corner, point=point, pairs=[pair], maybe=[1.0, 0.0], names=names)
    for each in (corner, point, pair, names["a"]):
        each[0] = math.nan
    names["b"] = ["x"]
    assert options.corner == (1.0, 2.0)
    assert options.point == Point(1.5, 2.0)
    assert type(options.point) is Point
    assert options.pairs == ((1, 2),)
    assert options.maybe == (1.0, 0.0)
    assert options.names == {"a": (1,)}
    with pytest.raises(TypeError):
        options.names["a"] = ()


def test_lists_and_tuples_make_the_same_options():
    given = Keeping(corner=[1.0], either=["a"], point=(1.0, 2.0), names={"a": (1,)})
    same = Keeping(corner=(1.0,), either=("a",), point=Point(1.0, 2.0), names={"a": [1]})
    assert given == same
    assert hash(given) == hash(same)
    assert Keeping() == Keeping(corner=[])


def test_options_with_a_mapping_are_copied_and_pickled():
    options = Keeping(names={"a": [1]}, corner=[1.0])
    for copied in (
        copy.deepcopy(options),
        pickle.loads(pickle.dumps(options)),
        dataclasses.replace(options),
        Keeping(**dataclasses.asdict(options)),
    ):
        assert copied == options
    assert repr(options.names) == "{'a': (1,)}"


def test_a_tuple_that_needs_no_change_stays_itself():
    corner, point = (1.0, 2.0), Point(1.0, 2.0)
    options = Keeping(corner=corner, point=point)
    assert options.corner is corner
    assert options.point is point


def test_a_path_is_its_text(tmp_path):
    assert Keeping(path=tmp_path).path == str(tmp_path)
    assert Keeping(either=tmp_path).either == str(tmp_path)
    with pytest.raises(OptionError, match=r"path: .* is not allowed"):
        Keeping(path=tmp_path / ("x" * 200))


def test_a_list_that_is_refused_is_the_value_of_the_error():
    bad = [1.0, 3.0]
    with pytest.raises(OptionError, match=r"corner: \[1.0, 3.0\] is not allowed") as caught:
        Keeping(corner=bad)
    assert caught.value.value is bad


def test_limits_cannot_be_taken_from_under_a_robot():
    lower = [0.0, 0.0, 0.0]
    robot = AbbEgm(workspace_lower_m=lower, workspace_upper_m=[1.0, 1.0, 1.0])
    lower[2] = math.nan
    assert robot.options.workspace_lower_m == (0.0, 0.0, 0.0)
    assert MappingOptions(device_center_m=[0.0, 0.0, 0.0]) == MappingOptions()


# -- values in messages ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value",
    [
        10**6000,
        [10**6000],
        [[0.0] * 200_000] * 3,
        "x" * 100_000,
        {str(i): i for i in range(100_000)},
        Point(10**6000, 0.0),
        "\x1b]0;owned\x07",
        "\ud800",
    ],
    ids=lambda value: type(value).__name__,
)
def test_every_value_is_shown_in_a_short_line(value):
    text = str(OptionError("key", value, "less"))
    assert len(text) < 400
    assert text.isprintable()


def test_a_value_whose_repr_fails_is_named_by_its_type():
    class Odd:
        def __repr__(self):
            raise RuntimeError

    assert re.fullmatch("<Odd.*>", shown(Odd()))
    assert shown(7) == "7"
    assert shown(-(2**255)) == str(-(2**255))
    assert shown(10**100) == "<a whole number of 333 bits>"


def test_keys_and_words_cannot_command_a_terminal():
    error = ConfigurationError("a\x1b[2J" + "k" * 1000, "is\nodd \x9b31m m/s²")
    assert str(error).startswith("a\\x1b[2Jk")
    assert str(error).endswith("...: is\nodd \\x9b31m m/s²")
    assert len(str(error)) < 400
    assert error.key.startswith("a\x1b[2J")
    assert error.below("t").message == error.message
