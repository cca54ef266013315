"""Classes are found by name, ours and those of other packages."""

from importlib.metadata import EntryPoint

import pytest

from cardan.errors import ConfigurationError
from cardan.plugins import Finder

POINTS = [
    EntryPoint("theirs", "decimal:DivisionByZero", "group"),
    EntryPoint("ours", "decimal:Overflow", "group"),
    EntryPoint("function", "math:sqrt", "group"),
    EntryPoint("other", "decimal:Decimal", "group"),
    EntryPoint("broken", "nowhere_at_all:Trap", "group"),
    EntryPoint("empty", "math:Trap", "group"),
]


@pytest.fixture
def finder():
    return Finder(ArithmeticError, "trap", {"ours": "builtins:ZeroDivisionError"}, lambda: POINTS)


def test_the_built_in_table_wins_over_entry_points(finder):
    assert finder.load("ours") is ZeroDivisionError
    assert finder.load("theirs").__name__ == "DivisionByZero"
    assert finder.names() == ("broken", "empty", "function", "other", "ours", "theirs")


def test_the_packages_are_named_ours_first(finder):
    assert finder.packages() == ("builtins", "decimal", "math", "nowhere_at_all")


def test_the_table_may_change_later():
    table = {}
    finder = Finder(ArithmeticError, "trap", table, lambda: ())
    table["late"] = "builtins:OverflowError"
    assert finder.names() == ("late",)
    assert finder.load("late") is OverflowError


def test_entry_points_are_not_asked_for_what_is_built_in():
    def refuse():
        raise AssertionError

    finder = Finder(ArithmeticError, "trap", {"ours": "builtins:ZeroDivisionError"}, refuse)
    assert finder.load("ours") is ZeroDivisionError


def test_an_unknown_name_is_answered_with_those_there_are(finder):
    message = "trap: there is no trap 'our'; allowed: broken, empty, function, other, ours, theirs"
    with pytest.raises(ConfigurationError, match=message):
        finder.load("our")


@pytest.mark.parametrize(
    ("name", "words"), [("broken", "No module named 'nowhere_at_all'"), ("empty", "'Trap'")]
)
def test_what_cannot_be_loaded_is_told_with_the_reason(finder, name, words):
    with pytest.raises(ConfigurationError, match=f"of trap '{name}' cannot be loaded: .*{words}"):
        finder.load(name)


@pytest.mark.parametrize(
    ("name", "target"), [("function", "math:sqrt"), ("other", "decimal:Decimal")]
)
def test_what_is_not_of_the_kind_is_refused(finder, name, target):
    with pytest.raises(ConfigurationError, match=f"{target} of trap '{name}' is not a cardan trap"):
        finder.load(name)
