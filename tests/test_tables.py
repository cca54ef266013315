"""Tables are converted to options; errors name the whole key and the allowed values."""

from __future__ import annotations

import dataclasses
import enum
import json
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime, time, timezone
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import CODE_ONLY, Options, require
from cardan.common.tables import (
    AtMost,
    Tag,
    as_table,
    keys_of,
    parse_toml,
    read_table,
    read_toml,
    resolved,
)
from cardan.drivers.registry import DriverTable
from cardan.errors import ConfigurationError, OptionError

LENGTH_M = Range(0.0, 10.0, "m", "no table is longer", above=True)


class Color(enum.Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True, kw_only=True)
class Ball:
    shape: Literal["ball"] = "ball"
    radius_m: Annotated[float, LENGTH_M]


@dataclass(frozen=True, kw_only=True)
class Cube:
    shape: Literal["cube"] = "cube"
    side_m: Annotated[float, LENGTH_M] = 1.0
    color: Color = Color.RED


Body = Annotated[Ball | Cube, Tag("shape")]


@dataclass(frozen=True, kw_only=True)
class Scene(Options):
    name: str
    size_m: tuple[Annotated[float, LENGTH_M], Annotated[float, LENGTH_M]] = (1.0, 1.0)
    bodies: Annotated[tuple[Body, ...], AtMost(3)] = ()
    best: Annotated[Ball | Cube, Tag("shape", "cube")] = field(default_factory=Cube)
    driver: DriverTable | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    buttons: str | tuple[str, ...] = ""
    count: int | Literal["all"] = "all"
    made_s: float = field(default=5.0, metadata=CODE_ONLY)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.size_m[0] >= self.size_m[1], "size_m", self.size_m, "longer than wide")


WHOLE = {
    "name": "cell",
    "size_m": [2, 1.5],
    "bodies": [{"shape": "ball", "radius_m": 1}, {"shape": "cube", "color": "blue"}],
    "best": {"side_m": 2.0},
    "driver": {"driver": "camera", "port": 5, "rate": [1, 2]},
    "labels": {"x": "left"},
    "buttons": ["a", "b"],
    "count": 3,
}


def test_a_table_becomes_the_options_and_they_the_table():
    scene = read_table(Scene, WHOLE)
    assert scene.size_m == (2.0, 1.5)
    assert type(scene.size_m[0]) is float
    assert scene.bodies == (Ball(radius_m=1.0), Cube(color=Color.BLUE))
    assert scene.best == Cube(side_m=2.0)
    assert scene.driver == DriverTable("camera", {"port": 5, "rate": [1, 2]})
    assert (scene.labels, scene.buttons, scene.count) == ({"x": "left"}, ("a", "b"), 3)
    assert scene.made_s == 5.0
    assert read_table(Scene, as_table(scene)) == scene
    assert "made_s" not in as_table(scene)
    assert as_table(scene)["bodies"][1] == {"shape": "cube", "side_m": 1.0, "color": "blue"}


def test_what_is_left_out_has_its_default():
    scene = read_table(Scene, {"name": "cell", "driver": None})
    assert scene == Scene(name="cell")
    assert "made_s" not in keys_of(Scene)


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        ({"nam": "x"}, "nam", "there is no such key; did you mean 'name'? Allowed: name, s"),
        ({"bodys": []}, "bodys", "did you mean 'bodies'?"),
        ({"made_s": 1.0}, "made_s", "there is no such key"),
        ({"name": 5}, "name", "5 is not allowed; it must be a text, in quotes"),
        ({"name": date(2026, 3, 1)}, "name", "the date 2026-03-01 is not allowed; it must be a"),
        ({"count": time(7, 32)}, "count", "the time 07:32:00 is not allowed; it must be a whole"),
        (
            {"size_m": [datetime(2026, 3, 1, 7, 32, tzinfo=timezone.utc), 1]},
            "size_m",
            "the date and time 2026-03-01 07:32:00+00:00",
        ),
        ({"best": date(2026, 3, 1)}, "best", "the date 2026-03-01 is not a table"),
        ({"name": None}, "name", "None is not allowed"),
        ({"size_m": [1, 2]}, "size_m", "(1.0, 2.0) is not allowed; it must be longer than wide"),
        ({"size_m": [1]}, "size_m", "2 values"),
        ({"size_m": 1}, "size_m", "2 values"),
        ({"size_m": [1, True]}, "size_m", "above 0, at most 10 m: no table is longer"),
        ({"size_m": [10**400, 1]}, "size_m", "above 0, at most 10 m: no table is longer"),
        ({"size_m": ["1", 1]}, "size_m", "above 0, at most 10 m: no table is longer"),
        ({"count": 1.5}, "count", "a whole number or one of all"),
        ({"count": "al"}, "count", "did you mean 'all'?"),
        ({"labels": {"x": 1}}, "labels", "a text"),
        ({"buttons": ["a", 1]}, "buttons", "a text"),
        ({"driver": {"port": 1}}, "driver.driver", "is missing"),
        ({"driver": "camera"}, "driver", "'camera' is not a table"),
        ({"best": 1}, "best", "1 is not a table"),
        ({"best": {"shape": "ball"}}, "best.radius_m", 'is missing: shape = "ball" needs it'),
        ({"bodies": {}}, "bodies", "one table for each of them, under the heading [["),
        ({"bodies": 1}, "bodies", "1 is not allowed; it must be several values"),
        ({"bodies": [1]}, "bodies.0", "1 is not a table"),
        ({"bodies": [{}]}, "bodies.0.shape", "is missing"),
        (
            {"bodies": [{"shape": "bal"}]},
            "bodies.0.shape",
            "ball, cube; did you mean 'ball'",
        ),
        ({"bodies": [{"shape": []}]}, "bodies.0.shape", "[] is not allowed; it must be one of"),
        (
            {"bodies": [WHOLE["bodies"][1], {**WHOLE["bodies"][0], "side_m": 1.0}]},
            "bodies.1.side_m",
            'there is no such key with shape = "ball"; allowed: shape, radius_m',
        ),
        (
            {"bodies": [{"shape": "cube", "color": "blu"}]},
            "bodies.0.color",
            "'blu' is not allowed; it must be one of red, blue; did you mean 'blue'?",
        ),
        ({"bodies": [{"shape": "cube"}] * 4}, "bodies", "4 are too many; allowed: at most 3"),
    ],
)
def test_errors_name_the_whole_key(change, key, words):
    for below in ("", "cells.1"):
        with pytest.raises(ConfigurationError) as caught:
            read_table(Scene, {**WHOLE, **change}, below)
        assert caught.value.key == (f"{below}.{key}" if below else key)
        assert words in str(caught.value)


def test_all_errors_are_reported_a_line_each():
    table = {"nam": "x", "count": 1.5, "bodies": [{"shape": "ball"}]}
    with pytest.raises(ConfigurationError, match=r"^cell\.nam: ") as caught:
        read_table(Scene, table, "cell")
    keys = [each.partition(": ")[0] for each in str(caught.value).splitlines()]
    assert keys == ["cell.nam", "cell.name", "cell.bodies.0.radius_m", "cell.count"]
    assert "\n" not in caught.value.message
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)


def test_of_very_many_errors_the_rest_is_counted():
    with pytest.raises(ConfigurationError) as caught:
        read_table(Scene, {"name": "x", **{f"key_{number}": 0 for number in range(14)}})
    lines = str(caught.value).splitlines()
    assert len(lines) == 10
    assert not any("more)" in each for each in lines[:9])
    assert lines[9].startswith("key_9: ")
    assert lines[9].endswith(" (and 4 more)")


def test_an_error_of_one_option_keeps_its_value():
    with pytest.raises(OptionError) as caught:
        read_table(Scene, {**WHOLE, "count": 1.5})
    assert caught.value.value == 1.5


@dataclass
class Foreign:
    speed: float = field(default=1.0, metadata={"unit": "m/s"})

    def __post_init__(self) -> None:
        if self.speed > 1.0:
            raise ValueError("too fast")


def test_options_of_another_package_may_raise_a_value_error():
    with pytest.raises(ConfigurationError, match=r"^device: too fast$"):
        read_table(Foreign, {"speed": 2.0}, "device")


@pytest.mark.parametrize("table", [None, 1, "x", [], [{}]])
def test_what_is_no_table_is_refused(table: Any):
    with pytest.raises(ConfigurationError, match="is not a table"):
        read_table(Scene, table, "scene")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "cannot read .*own.toml: No such file"),
        (b"\xff", "cannot read .*own.toml: line 1 is not UTF-8; save it as UTF-8$"),
        ("a = 1\r\n# Größe\r\n".encode("latin-1"), "own.toml: line 2 is not UTF-8; save it as"),
        (b"\xef\xbb\xbfa = 1\rb = '\xe4'", "own.toml: line 2 is not UTF-8; save it as UTF-8$"),
        (b"a = ", "own.toml:1:5: is not TOML: "),
        (b"a = " + b"[" * 5000, "own.toml: is nested too deeply$"),
    ],
)
def test_a_file_that_holds_no_tables_is_named(tmp_path: Path, content: bytes | None, words: str):
    path = tmp_path / "own.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=words):
        read_toml(path)
    with pytest.raises(ConfigurationError, match=r"cannot read .*null"):
        read_toml(tmp_path / "\0.toml")


def test_what_only_code_sets_travels_between_programs_and_not_from_a_file():
    scene = read_table(Scene, WHOLE)
    changed = dataclasses.replace(scene, made_s=0.25)
    table = as_table(changed, from_file=False)
    assert table["made_s"] == 0.25
    assert read_table(Scene, json.loads(json.dumps(table)), from_file=False) == changed
    with pytest.raises(ConfigurationError, match="made_s: there is no such key"):
        read_table(Scene, table)


def test_what_travels_is_plain():
    table = DriverTable("camera", {"path": Path("/dev/x"), "color": Color.RED, "at": (1, [2])})
    plain = {"driver": "camera", "path": "/dev/x", "color": "red", "at": [1, [2]]}
    assert as_table(table) == plain
    assert json.loads(json.dumps(plain)) == plain


@pytest.mark.parametrize("number", ["9" * 6000, "0x" + "f" * 9000, f"[{'9, ' * 200_000}]"])
def test_no_number_is_too_long_for_an_error_in_words(tmp_path, number):
    path = tmp_path / "long.toml"
    path.write_text(f"name = {number}\n")
    with pytest.raises(ConfigurationError) as caught:
        read_table(Scene, read_toml(path))
    assert len(str(caught.value)) < 400 + len(str(path))
    with pytest.raises(ConfigurationError) as caught:
        read_table(Scene, {**read_toml(path), "best": 10**6000})
    assert len(str(caught.value)) < 400 + len(str(path))


def test_of_several_unknown_keys_of_a_table_the_allowed_ones_are_reported_once():
    bodies = [{"shape": "ball", "radius_m": 1.0, "a": 1, "sides": 2, "radius": 2}]
    with pytest.raises(ConfigurationError) as caught:
        read_table(Scene, {**WHOLE, "zz": 1, "nam": 2, "bodies": bodies})
    listed = ", ".join(keys_of(Scene))
    assert str(caught.value).splitlines() == [
        f"zz: there is no such key; allowed: {listed}",
        "nam: there is no such key; did you mean 'name'?",
        'bodies.0.a: there is no such key with shape = "ball"; allowed: shape, radius_m',
        'bodies.0.sides: there is no such key with shape = "ball"',
        "bodies.0.radius: there is no such key with shape = \"ball\"; did you mean 'radius_m'?",
    ]


def test_a_key_cannot_command_a_terminal(tmp_path):
    path = tmp_path / "odd.toml"
    path.write_text('name = "a"\n"\\u001b]0;owned\\u0007" = 1\n', "utf-8")
    with pytest.raises(ConfigurationError, match="there is no such key") as caught:
        read_table(Scene, read_toml(path))
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("speed = 0,05", "write the decimal point as ., not as a comma"),
        ("driver = \u201cspacemouse\u201d", 'write quotes as " and no others'),
        ("collisions = True", "write true and false in small letters"),
        ("speed\u00a0= 1", "there is a no-break space: write a space"),
        ('path = "C:\\Users\\me"', "write a path in single quotes, or with / for \\"),
        ('path = "C:\\Data"', "write a path in single quotes, or with / for \\"),
        ('path = "C:\\Udddddddd"', "write a path in single quotes, or with / for \\"),
    ],
)
def test_a_habit_of_other_languages_is_reported_with_what_to_write(line, words):
    with pytest.raises(ConfigurationError, match=r"^own:2:\d+: is not TOML: .*: ") as caught:
        parse_toml(f"# {line}\n{line}\n", "own")
    assert str(caught.value).endswith(words)


@pytest.mark.parametrize(
    ("text", "at"),
    [
        ('a = 1\nb = "c\0"\n', "2:7"),
        ("a = 1\n\0b = 2\n", "2:1"),
        ("a = 1 # \0\n", "1:9"),
        ("\0" * 512, "1:1"),
    ],
    ids=ascii,
)
def test_a_character_nul_is_called_by_its_name(text, at):
    with pytest.raises(ConfigurationError) as caught:
        parse_toml(text, "own")
    assert str(caught.value).startswith(f"own:{at}: is not TOML: ")
    assert "there is a NUL character (U+0000)" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = 1\n b = 2\n a = [\n3]\n", "own:3:2: a: is given twice; first in line 1"),
        ("x.a = 1\nx.b = 2\nx.a = 3\n", "own:3:1: x.a: is given twice; first in line 1"),
        ("a = {b = 1, c = 2, b = 3}", "own:1:20: a.b: is given twice; first in line 1"),
        ("[d]\nx = 1\n[e]\n[d]\ny = 2\n", "own:4:1: d: is given twice; first in line 1"),
        ("[d.e]\n[d]\nx = 1\nx = 2\n", "own:4:1: d.x: is given twice; first in line 3"),
        ("[[f]]\na = 1\n[[f]]\na = 1\na = 2", "own:5:1: f.1.a: is given twice; first in line 4"),
        ("d = 1\n[d]\n", "own:2:1: d: is given twice; first in line 1"),
        ("[d]\n[[d]]\n", "own:2:1: d: is given twice; first in line 1"),
        ("d = {}\n[d.e]\n", "own:2:1: d: is given twice; first in line 1"),
    ],
)
def test_a_key_given_twice_is_named_with_both_places(text, words):
    with pytest.raises(ConfigurationError) as caught:
        parse_toml(text, "own")
    assert str(caught.value) == words


def test_what_is_no_toml_has_its_place_as_other_errors_have_it(tmp_path):
    (tmp_path / "a.toml").write_text('a = 1\nb = "x\n')
    with pytest.raises(ConfigurationError) as caught:
        read_toml(tmp_path / "a.toml")
    assert str(caught.value).startswith(f"{tmp_path}/a.toml:2:7: is not TOML: Illegal character")
    assert "at line" not in str(caught.value)


@dataclass(frozen=True, kw_only=True)
class Placed(Options):
    read: Annotated[str, bounds.FILE] = ""
    written: Annotated[str, bounds.PATH] = ""
    met: Annotated[str, bounds.SOCKET_PATH, bounds.MEETING] | None = None
    arm: Annotated[str, bounds.ARM_FILE] = "ur5"
    dds: Annotated[str, bounds.DDS_CONFIG] = ""
    inside: tuple[Placed, ...] = ()


def test_paths_are_relative_to_the_file_that_names_them(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("CELL", str(tmp_path / "cell"))
    (tmp_path / "there").write_text("")
    (tmp_path / "arm.URDF").write_text("")
    file = tmp_path / "file.toml"
    for key, said, found in (
        ("read", "there", tmp_path / "there"),
        ("read", "", ""),
        ("read", "/nowhere", "/nowhere"),
        ("written", "new.csv", tmp_path / "new.csv"),
        ("written", "~/new.csv", tmp_path / "home" / "new.csv"),
        ("written", "$CELL/new.csv", tmp_path / "cell" / "new.csv"),
        ("met", "mouse.sock", "mouse.sock"),
        ("met", "~/mouse.sock", tmp_path / "home" / "mouse.sock"),
        ("arm", "ur5", "ur5"),
        ("arm", "arm.URDF", tmp_path / "arm.URDF"),
        ("arm", "package:arm.urdf", "package:arm.urdf"),
        ("dds", "file://there", f"file://{tmp_path}/there"),
        ("dds", "<CycloneDDS/>", "<CycloneDDS/>"),
        ("arm", 3, 3),
    ):
        found = found if isinstance(found, int) else str(found)
        assert resolved(Placed, {key: said, "other": 1}, file) == {key: found, "other": 1}
        inside = resolved(Placed, {"inside": [{key: said}]}, file)
        assert inside == {"inside": [{key: found}]}


@pytest.mark.parametrize("path", ["$NOWHERE/a.toml", "${NOWHERE}/a.toml", "$CELL/$NOWHERE"])
@pytest.mark.parametrize("key", ["read", "written", "met", "arm"])
def test_a_variable_that_the_environment_has_not_is_named(tmp_path, monkeypatch, key, path):
    monkeypatch.delenv("NOWHERE", raising=False)
    monkeypatch.setenv("CELL", str(tmp_path))
    path = f"{path}.urdf" if key == "arm" else path
    with pytest.raises(ConfigurationError) as caught:
        resolved(Placed, {"inside": [{key: path}]}, tmp_path / "file.toml")
    assert str(caught.value) == f"inside.0.{key}: the environment has no variable NOWHERE"


def test_a_file_that_is_not_there_is_named_with_the_folder(tmp_path):
    with pytest.raises(ConfigurationError) as error:
        resolved(Placed, {"inside": [{"read": "none.toml"}]}, tmp_path / "file.toml")
    assert error.value.key == "inside.0.read"
    assert error.value.message == (
        f"cannot read 'none.toml': there is none in {tmp_path}, the folder of the file that names "
        "it"
    )
