"""Tree of errors in the docstring of cardan.errors and on its page, compared with the classes."""

import copy
import importlib
import inspect
import multiprocessing
import pickle
import pkgutil
import re
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

import cardan
from cardan import errors
from cardan.errors import CardanError

PAGE = (Path(__file__).parents[1] / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
LINE = re.compile(r"^(?P<indent>[| ]*)(?:\+-- )?(?P<name>\w+Error)\b(?P<words>.*)$", re.MULTILINE)


def all_errors():
    """Return every subclass of CardanError in the package, by name."""
    for module in pkgutil.walk_packages(cardan.__path__, "cardan."):
        if module.name.endswith("__main__") or ".lib" in module.name:  # programs, C libraries
            continue
        importlib.import_module(module.name)
    found, left = {}, [CardanError]
    while left:
        kind = left.pop()
        left += kind.__subclasses__()
        if kind.__module__.startswith("cardan."):
            assert kind.__name__ not in found, f"two errors are called {kind.__name__}"
            found[kind.__name__] = kind
    return found


def block(text):
    """Return the lines of the tree without indentation."""
    lines = text[text.index("CardanError\n") :].splitlines()
    tree = [lines[0]]
    for line in lines[1:]:
        if "+--" not in line:
            break
        tree.append(line.removeprefix("    ") if line.startswith("    ") else line)
    return tree


TREE = block(errors.__doc__)


def parents(tree):
    """Return the name of each error's parent, and the error's description."""
    found, path = {}, []
    for line in tree:
        match = LINE.match(line)
        depth = 0 if "+--" not in line else 1 + len(match["indent"]) // 4
        del path[depth:]
        found[match["name"]] = (path[-1] if path else None, match["words"].strip())
        path.append(match["name"])
    return found


@pytest.fixture(scope="module")
def there():
    return all_errors()


def test_the_tree_has_every_error_below_its_parent(there):
    parent_of = {
        name: kind.__bases__[0].__name__ if kind is not CardanError else None
        for name, kind in there.items()
    }
    assert {name: parent for name, (parent, _) in parents(TREE).items()} == parent_of


def test_the_tree_names_the_module_of_those_that_live_elsewhere(there):
    for name, (_, words) in parents(TREE).items():
        module = re.match(r"(cardan\.[\w.]+):", words)
        home = importlib.import_module(module[1] if module else "cardan.errors")
        assert getattr(home, name) is there[name]


def test_the_page_has_the_same_tree():
    assert block(PAGE) == TREE


def test_the_page_says_of_every_error_when_it_comes_and_what_to_do(there):
    rows = re.findall(r"^\| `(\w+)` \| (.+) \| (.+) \|$", PAGE, re.MULTILINE)
    assert [name for name, _, _ in rows] == list(parents(TREE))
    assert {name for name, _, _ in rows} == set(there)


def test_a_bad_setting_is_a_value_error_too():
    assert issubclass(errors.ConfigurationError, ValueError)


def test_errors_of_settings_say_in_which_table_they_are():
    with pytest.raises(errors.OptionError) as caught, errors.below("cells.1"):
        raise errors.OptionError("size", 3, "less")
    assert (caught.value.key, caught.value.value) == ("cells.1.size", 3)


def test_errors_say_what_they_are_about():
    with (
        pytest.raises(errors.ConfigurationError, match=r"^own\.toml: joint 'j': no limit$"),
        errors.about("own.toml"),
        errors.about("joint 'j'"),
    ):
        raise ValueError("no limit")


WAYS = {"pickled": lambda error: pickle.loads(pickle.dumps(error)), "copied": copy.copy}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_every_error_survives_being_pickled_and_copied(there, way):
    for kind in there.values():
        own = kind.__init__ is not Exception.__init__
        count = len(inspect.signature(kind).parameters) if own else 1
        error = kind(*map(str, range(count)))
        error.more = ("an attribute", 1)
        again = way(error)
        assert type(again) is kind
        assert str(again) == str(error)
        assert again.args == error.args
        assert vars(again) == vars(error)


def test_an_error_about_what_cannot_be_pickled_keeps_how_it_is_shown():
    again = pickle.loads(pickle.dumps(errors.OptionError("key", lambda: 0, "a number")))
    assert again.value.startswith("<function")
    assert str(again).startswith("key: <function")
    assert (again.key, again.allowed) == ("key", "a number")


def test_an_error_comes_out_of_another_process():
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        future = pool.submit(cardan.SpaceMouse, dead_zone=2.0)
        with pytest.raises(errors.OptionError, match=r"dead_zone: 2\.0 is not allowed") as caught:
            future.result(60.0)
    assert (caught.value.key, caught.value.value) == ("dead_zone", 2.0)
