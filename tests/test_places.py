"""Position of a key in a TOML file, for each notation and for errors of readers."""

import copy
import pickle

import pytest

from cardan.common.places import in_file, place_of
from cardan.errors import ConfigurationError, OptionError, below

TEXT = '''\
# a = 1
title = "a # b = [" # c
many = """
linear = 1
\\""" still "quoted\\""""""
raw = \'\'\'
[raw]\'\'\'
  dotted . "two words" = 1
"\\u00e9" = 2
[device]
driver = 'spacemouse'
[mapping.axes]   # of the hand
list = [ 1.5, # one ] of them
  [2, 3],
  "four, ]", { six = 6, "seven" = {eight = 8} } ]
when = 1979-05-27 07:32:00
[[filters]]
filter = "camera"
[filters.more]
gain = 1
[[ filters ]]
filter = "proximity"
gain = 2
[ lab . "left.arm" ]
x = 1
'''


@pytest.mark.parametrize(
    ("key", "line", "column"),
    [
        ("title", 2, 1),
        ("many", 3, 1),
        ("raw", 6, 1),
        ("dotted.two words", 8, 3),
        ("\u00e9", 9, 1),
        ("device", 10, 1),
        ("device.driver", 11, 1),
        ("mapping", 12, 1),
        ("mapping.axes.list", 13, 1),
        ("mapping.axes.list.0", 13, 10),
        ("mapping.axes.list.1", 14, 3),
        ("mapping.axes.list.1.1", 14, 7),
        ("mapping.axes.list.2", 15, 3),
        ("mapping.axes.list.3.six", 15, 16),
        ("mapping.axes.list.3.seven.eight", 15, 36),
        ("mapping.axes.when", 16, 1),
        ("filters", 17, 1),
        ("filters.0.filter", 18, 1),
        ("filters.0.more.gain", 20, 1),
        ("filters.1", 21, 1),
        ("filters.1.gain", 23, 1),
        ("lab.left.arm", 24, 1),
        ("lab.left.arm.x", 25, 1),
        ("device.missing", 10, 1),
        ("filters.1.more.missing", 21, 1),
    ],
)
def test_a_key_is_found_where_it_stands(tmp_path, key, line, column):
    file = tmp_path / "a.toml"
    file.write_text(TEXT, encoding="utf-8")
    assert place_of(file, key) == f"{file}:{line}:{column}"


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_line_ends_of_other_systems_are_line_ends(tmp_path, ends):
    file = tmp_path / "a.toml"
    file.write_bytes(f"a = 1{ends}b = 2{ends}".encode())
    assert place_of(file, "b") == f"{file}:2:1"


def test_what_stands_nowhere_is_of_the_file_alone(tmp_path):
    file = tmp_path / "a.toml"
    assert place_of(file, "a") == str(file)
    file.write_text("a = 1\n", encoding="utf-8")
    assert place_of(file, "b.c") == str(file)
    file.write_text(f"b = 1\na = {'[' * 5000}{']' * 5000}\n", encoding="utf-8")
    assert place_of(file, "b").startswith(str(file))


def test_an_error_keeps_its_key_its_message_and_its_kind(tmp_path):
    file = tmp_path / "a.toml"
    file.write_text("[arm]\nspeed = -1\n", encoding="utf-8")
    with pytest.raises(OptionError) as caught, in_file(file):
        raise OptionError("arm.speed", -1, "0 or more")
    error = caught.value
    assert str(error) == f"{file}:2:1: arm.speed: -1 is not allowed; it must be 0 or more"
    assert (error.key, error.value, error.allowed) == ("arm.speed", -1, "0 or more")
    assert error.message == "-1 is not allowed; it must be 0 or more"
    for same in (copy.copy(error), pickle.loads(pickle.dumps(error))):
        assert (str(same), same.place, same.key) == (str(error), f"{file}:2:1", "arm.speed")
    with pytest.raises(OptionError) as caught, below("left"):
        raise error
    assert str(caught.value).startswith(f"{file}:2:1: left.arm.speed: -1 is not")


def test_an_error_that_has_its_place_or_no_key_is_let_through(tmp_path):
    file = tmp_path / "a.toml"
    file.write_text("a = 1\n", encoding="utf-8")
    for inner in (ConfigurationError("", "no"), ConfigurationError("a", "no").placed("b.toml:3:1")):
        with pytest.raises(ConfigurationError) as caught, in_file(file):
            raise inner
        assert str(caught.value) == str(inner)
