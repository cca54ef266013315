"""Commands of other packages, through entry points of the group ``cardan.commands``."""

from importlib.metadata import EntryPoint

import pytest
import typer

from cardan.cli import installed
from cardan.errors import ExtraMissingError

POINTS = {
    "wave": f"{__name__}:wave",
    "lacking": f"{__name__}:lacking",
    "gone": "no_such_module_at_all:wave",
    "number": "math:pi",
    "strange": f"{__name__}:strange",
    "check": f"{__name__}:wave",
    "devices.beckon": f"{__name__}:wave",
    "arms.nod": f"{__name__}:wave",
}


def wave(times: int = 1) -> None:
    """Wave the arm."""
    print("waved", times)
    if times == 4:
        raise typer.Exit(4)


def lacking() -> None:
    """Need a package."""
    raise ExtraMissingError("waving", "flags", "flags", "No module named 'flags'")


def strange(times: object) -> None:
    """Have a parameter that no command line can give."""


@pytest.fixture
def others(monkeypatch):
    """Register commands of other packages, each broken in its own way except for two; one has the
    name of a command of Cardan."""
    points = [EntryPoint(name, target, "cardan.commands") for name, target in POINTS.items()]
    monkeypatch.setattr(installed, "entry_points", lambda group: points)


@pytest.mark.parametrize(
    ("command", "written"),
    [
        ("run", "needs a [network]"),
        ("devices force", "[force] and [[fixtures]]"),
        ("net record", "[network]"),
    ],
)
def test_what_stands_in_brackets_is_shown_in_a_help(cardan, command, written):
    assert written in " ".join(cardan(*command.split(), "--help").split())


@pytest.mark.usefixtures("others")
def test_a_command_of_another_package_is_one_of_ours(cardan, capsys):
    assert cardan("wave", "--times", "3") == "waved 3\n"
    cardan("wave", "--times", "4", code=4)
    assert "cardan wave --help" in cardan("wave", "--often", code=2)
    assert "Wave the arm." in cardan("wave", "--help")
    assert 'pip install "cardan[flags]"' in cardan("lacking", code=3)


@pytest.mark.usefixtures("others")
def test_help_names_it_and_goes_on_past_what_cannot_be_loaded(cardan):
    said = cardan("--help")
    assert "Wave the arm\n" in said
    for name in ("gone", "number", "strange", "arms.nod"):
        assert f"\n  {name} " in said
    assert said.index("\n  doctor ") < said.index("\n  wave ")


@pytest.mark.usefixtures("others")
def test_a_command_goes_where_its_entry_point_says(cardan):
    assert cardan("devices", "beckon", "--times", "2") == "waved 2\n"
    assert "cardan devices beckon --help" in cardan("devices", "beckon", "--often", code=2)
    below = cardan("devices", "--help")
    assert below.index("Of other packages:") < below.index("\n  beckon ")
    assert "beckon" not in cardan("--help")
    assert "beckon" not in cardan("net", "--help")
    cardan("beckon", code=2)


@pytest.mark.usefixtures("others")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("gone", "cannot be loaded: ModuleNotFoundError: No module named 'no_such_module_at_all'"),
        ("number", "math:pi of command 'number' is not a function"),
        ("strange", "command 'strange' cannot be used: RuntimeError: "),
        ("arms.nod", "'arms.nod': there is no group 'arms', but daemon, devices, net"),
    ],
)
def test_what_cannot_be_loaded_says_why_in_one_line(cardan, name, words):
    said = cardan(name, "--times", "1", code=2)
    assert said.startswith("cardan: command: ")
    assert words in said
    assert said.count("\n") == 1


@pytest.mark.usefixtures("others")
def test_ours_have_their_names_first(cardan):
    assert "configuration file" in cardan("check", "--help")


@pytest.mark.parametrize(
    ("words", "folder"),
    [
        (("dissect", "a.pcap"), "plugins/cardan-dissect"),
        (("evaluate", "--quick"), "studies"),
        (("devices", "spnav", "--socket", "x"), "plugins/cardan-spnav-server"),
    ],
    ids=["dissect", "evaluate", "spnav"],
)
def test_a_command_of_the_source_tree_says_where_it_is(
    cardan, monkeypatch, tmp_path, words, folder
):
    monkeypatch.chdir(tmp_path)  # If it is installed nevertheless, it writes into this folder.
    monkeypatch.setattr(installed, "entry_points", lambda group: [])
    name = words[1] if words[0] == "devices" else words[0]
    said = cardan(*words, code=2)
    assert said.startswith(f"cardan: command: '{name}' is in the folder {folder} ")
    assert f"pip install ./{folder}" in said
    assert said.count("\n") == 1
    assert f"  {name} " not in cardan("--help") + cardan("devices", "--help")
    assert "`cardan --help`" in cardan("evaluated", code=2)


def test_a_command_of_ours_asks_nothing_about_what_is_installed(cardan, monkeypatch):
    def asked(group):
        raise AssertionError(group)

    monkeypatch.setattr(installed, "entry_points", asked)
    assert "abb_egm" in cardan("devices", "drivers")
