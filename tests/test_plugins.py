"""Classes are found by name, Cardan's and those of other packages."""

import importlib.metadata
import re
import shutil
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from cardan.common.plugins import IN_SOURCE_TREE, Finder, entry_points, reason
from cardan.common.signals import EndingSignalError
from cardan.errors import ConfigurationError, ExtraMissingError
from tests.installed import add_metadata

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

POINTS = [
    EntryPoint("theirs", "decimal:DivisionByZero", "group"),
    EntryPoint("ours", "decimal:Overflow", "group"),
    EntryPoint("function", "math:sqrt", "group"),
    EntryPoint("other", "decimal:Decimal", "group"),
    EntryPoint("broken", "nowhere_at_all:Trap", "group"),
    EntryPoint("empty", "math:Trap", "group"),
]


class DeclaredError(ArithmeticError):
    """Base class of this kind with its declared attributes."""

    summary = ""
    matches = ()


class NoTextError(DeclaredError):
    summary = None


class NoTupleError(DeclaredError):
    matches = property(lambda _: 3)


class NoOptionsError(DeclaredError):
    Options = None


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


def test_packages_are_read_once_until_one_comes_or_goes(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    assert entry_points(group="cardan.of_a_test").names == set()
    with monkeypatch.context() as patched:
        patched.setattr(importlib.metadata, "entry_points", None)
        assert entry_points(group="cardan.of_another").names == set()
    add_metadata(tmp_path, "late", {"cardan.of_a_test": {"late": "decimal:Overflow"}})
    assert entry_points(group="cardan.of_a_test").names == {"late"}
    shutil.rmtree(tmp_path / "late-1.0.dist-info")
    assert entry_points(group="cardan.of_a_test").names == set()


def test_an_unknown_name_is_answered_with_those_there_are(finder):
    message = "trap: there is no trap 'our'; allowed: broken, empty, function, other, ours, theirs"
    with pytest.raises(ConfigurationError, match=message):
        finder.load("our")


@pytest.mark.parametrize(
    ("name", "words"), [("broken", "No module named 'nowhere_at_all'"), ("empty", "'Trap'")]
)
def test_what_cannot_be_loaded_is_reported_with_the_reason(finder, name, words):
    with pytest.raises(ConfigurationError, match=f"of trap '{name}' cannot be loaded: .*{words}"):
        finder.load(name)


@pytest.mark.parametrize(
    ("name", "target"), [("function", "math:sqrt"), ("other", "decimal:Decimal")]
)
def test_what_is_not_of_the_kind_is_refused(finder, name, target):
    with pytest.raises(ConfigurationError, match=f"{target} of trap '{name}' is not a cardan trap"):
        finder.load(name)


def test_a_signal_that_ends_the_program_is_no_fault_of_a_plug_in(tmp_path, monkeypatch):
    (tmp_path / "plugin_that_is_interrupted.py").write_text(
        "from cardan.common.signals import EndingSignalError\nraise EndingSignalError(130)"
    )
    monkeypatch.syspath_prepend(tmp_path)
    points = [EntryPoint("slow", "plugin_that_is_interrupted:Trap", "group")]
    finder = Finder(ArithmeticError, "trap", {}, lambda: points)
    with pytest.raises(EndingSignalError):
        finder.load_all()


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (":Dev", "ValueError: Empty module name"),
        ("decimal", "has no attribute ''"),
        ("plugin_that_raises:Trap", "RuntimeError: boom at import$"),
        ("plugin_that_exits:Trap", "SystemExit: 7"),
        ("decimal:Decimal", "decimal:Decimal .* is not a cardan trap"),
        (f"{__name__}:NoTextError", "summary is None; it must be a text"),
        (f"{__name__}:NoTupleError", "matches is .*; it must be a tuple"),
        (f"{__name__}:NoOptionsError", "Options is None; it must be a dataclass"),
    ],
)
def test_a_broken_one_is_listed_with_the_reason_beside_the_others(
    tmp_path, monkeypatch, target, words
):
    (tmp_path / "plugin_that_raises.py").write_text('raise RuntimeError("boom\\nat  import")')
    (tmp_path / "plugin_that_exits.py").write_text("raise SystemExit(7)")
    monkeypatch.syspath_prepend(tmp_path)
    points = [EntryPoint("bad", target, "group"), POINTS[0]]
    finder = Finder(ArithmeticError, "trap", {"ours": "builtins:ZeroDivisionError"}, lambda: points)
    with pytest.raises(ConfigurationError, match=words):
        finder.load("bad")
    found = finder.load_all()
    assert list(found.classes) == ["ours", "theirs"]
    assert list(found.refused) == ["bad"]
    assert re.match(f"cannot be loaded: .*{words}", found.refused["bad"])
    assert "\n" not in found.refused["bad"]
    assert "" not in finder.packages()


def test_of_two_with_one_name_the_other_is_reported():
    points = [
        EntryPoint("ours", "decimal:Overflow", "group"),
        EntryPoint("theirs", "decimal:DivisionByZero", "group"),
        EntryPoint("theirs", "decimal:Underflow", "group"),
        EntryPoint("theirs", "decimal:DivisionByZero", "group"),
    ]
    finder = Finder(ArithmeticError, "trap", {"ours": "builtins:ZeroDivisionError"}, lambda: points)
    found = finder.load_all()
    assert found.classes["ours"] is ZeroDivisionError
    assert found.classes["theirs"].__name__ == "DivisionByZero"
    assert found.notes == [
        "trap 'ours' is builtins:ZeroDivisionError; decimal:Overflow, which has the same name, "
        "is not used",
        "trap 'theirs' is decimal:DivisionByZero; decimal:Underflow, which has the same name, "
        "is not used",
    ]


def test_what_anothers_class_raises_is_an_error_of_the_key(finder):
    words = r"device\.driver: trap 'theirs' .*KeyError: 'x'"
    with (
        pytest.raises(ConfigurationError, match=words),
        finder.using("theirs", "device.driver"),
    ):
        raise KeyError("x")
    with pytest.raises(KeyError), finder.using("ours", "device.driver"):
        raise KeyError("x")


@pytest.mark.parametrize(
    ("raised", "kind", "words"),
    [
        ("raise MemoryError", MemoryError, "there is too little memory"),
        ("import errno; raise OSError(errno.ENOMEM, 'x')", OSError, "there is too little memory"),
        ("import errno; raise OSError(errno.EMFILE, 'x')", OSError, "too many files are open"),
        ("raise ImportError('cannot allocate memory')", ImportError, "there is too little memory"),
        (
            "from cardan.errors import ExtraMissingError\n"
            "raise ExtraMissingError('it', 'numpy', 'arm', 'gone')",
            ExtraMissingError,
            'it needs numpy, which cannot be imported \\(gone\\): pip install "cardan\\[arm\\]"',
        ),
    ],
)
def test_what_is_missing_is_no_fault_of_a_plug_in(tmp_path, monkeypatch, raised, kind, words):
    (tmp_path / "plugin_that_lacks.py").write_text(raised)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "plugin_that_lacks", raising=False)
    points = [EntryPoint("poor", "plugin_that_lacks:Trap", "group"), POINTS[0]]
    finder = Finder(ArithmeticError, "trap", {}, lambda: points)
    with pytest.raises(kind) as error:
        finder.load("poor")
    assert re.match(words, reason(error.value))
    found = finder.load_all()
    assert list(found.classes) == ["theirs"]
    assert re.match(f"cannot be loaded: {words}", found.refused["poor"])
    assert found.lacking == ({"poor": "arm"} if kind is ExtraMissingError else {})


def test_a_shortage_in_use_is_no_fault_of_a_plug_in(finder):
    with pytest.raises(MemoryError), finder.using("theirs", "trap"):
        raise MemoryError


def plugins_entry_points():
    """Yield kind, name and folder of each entry point in this source tree's groups."""
    words = {
        "cardan.buses": "transport",
        "cardan.checks": "check",
        "cardan.commands": "command",
        "cardan.conform": "protocol",
        "cardan.dissect": "dissector",
        "cardan.drivers": "driver",
        "cardan.servers": "server",
        "cardan.filters": "filter",
        "cardan.sim_peers": "simulated peer",
    }
    root = Path(__file__).parents[1]
    for file in (root / "studies/pyproject.toml", *root.glob("plugins/cardan-*/pyproject.toml")):
        project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
        for group, points in project.get("entry-points", {}).items():
            if group in ("cardan.captures", "cardan.second_descriptions"):
                continue  # never requested by name: missing features name the extra
            for name in points:
                yield words[group], name, str(file.parent.relative_to(root))


def test_what_only_the_source_tree_has_is_said_with_its_folder():
    found = list(plugins_entry_points())
    assert {(word, name): folder for word, name, folder in found} == {
        (word, name): folder
        for word, names in IN_SOURCE_TREE.items()
        for name, folder in names.items()
    }
    for word, name, folder in found:
        none = Finder(Exception, word, {}, list)
        with pytest.raises(ConfigurationError, match=f"pip install ./{folder}"):
            none.load(name)
