"""Every command with machine-readable output has --json."""

import contextlib
import enum
import json
import math
from typing import NamedTuple

import pytest
import typer

from cardan.bus.network import Topic
from cardan.cli import bus
from cardan.cli.common import print_json, print_table
from cardan.errors import ConfigurationError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import revised
from cardan.protocols.ros2.messages import completed
from tests.command_line import the_command_line

WITHOUT = {
    "run": "lives until it is ended; its session is read by the daemon or the network",
    "daemon run": "its log is JSON by --log-format",
    "daemon service": "show prints a file; the others do what their lines say",
    "devices udev": "prints a file",
    "devices force": "lives until it is ended",
    "devices haptic": "lives until it is ended",
    "devices share": "lives until it is ended",
    "net pair": "writes files",
    "net messages": "writes files",
    "net echo": "prints JSON, nothing else",
    "net record": "writes a file, and says in words what is missing",
    "net replay": "likewise",
    "net plot": "writes a file",
    "conform": "prints JSON by --format, as it has four of them",
    "robots": "list and show have it; add writes a file",
}
"""Commands without it, with the reason."""


def test_every_command_has_it_or_a_reason_why_not():
    commands = dict(the_command_line().commands)
    for group in ("daemon", "devices", "net"):
        below = the_command_line().commands[group].commands
        commands |= {f"{group} {name}": command for name, command in below.items()}
        if group != "devices":  # this one lists them itself
            del commands[group]
    has = {
        name
        for name, command in commands.items()
        if any("--json" in parameter.opts for parameter in command.params)
    }
    assert commands.keys() == has | WITHOUT.keys()
    assert not has & WITHOUT.keys()
    daemon = {f"daemon {each}" for each in ("ps", "top", "events", "log", "arm")}
    assert daemon | {"check", "devices", "devices list", "net list", "net hz"} <= has


class Phase(enum.Enum):
    MOVING = "moving"


class State(enum.IntEnum):
    STOPPED = 3


class Pair(NamedTuple):
    first: object
    second: object


@pytest.mark.parametrize(
    ("value", "printed"),
    [
        (math.inf, None),
        ({"a": math.nan, 1: Phase.MOVING}, {"a": None, "1": "moving"}),
        (Pair(State.STOPPED, (1.5, None)), {"first": "stopped", "second": [1.5, None]}),
        ([True, "\x1b[2J"], [True, "\x1b[2J"]),
    ],
)
def test_values_as_json(capsys, value, printed):
    print_json(value)
    out = capsys.readouterr().out
    assert json.loads(out) == printed
    assert out.rstrip("\n").isprintable()


def test_a_table_as_json(capsys):
    print_table(("name", "simulated by"), [("a[red]", "b")], as_json=True)
    assert json.loads(capsys.readouterr().out) == [{"name": "a[red]", "simulated_by": "b"}]


@pytest.fixture
def printed(capsys):
    def run(*words):
        with contextlib.suppress(typer.Exit):
            the_command_line()([*words], standalone_mode=False)
        return json.loads(capsys.readouterr().out)

    return run


def test_lists_and_checks_as_json(printed):
    assert "gofa" in {row["demo"] for row in printed("demo", "--list", "--json")}
    assert "metrics" in {row["server"] for row in printed("net", "server", "--list", "--json")}
    assert "arm" in {row["peer"] for row in printed("sim", "--json", "--list")}
    assert printed("devices", "drivers", "abb_egm", "--json")[0]["table"] == "[robot]"
    assert isinstance(printed("devices", "--json"), list)
    found = printed("check", "examples/verbs-ur5-simulated.toml", "--json")
    assert found["robot"] == ["sim_arm"]
    assert found["warnings"] == []


@pytest.mark.parametrize("group", ["demo", "net server", "sim"])
def test_it_goes_with_a_list(group):
    with pytest.raises(ConfigurationError, match="--json: goes with --list"):
        the_command_line()([*group.split(), "--json"], standalone_mode=False)


def test_of_a_group_that_lists_by_itself_it_is_not_a_commands():
    with pytest.raises(ConfigurationError, match="--json: goes behind the command's name"):
        the_command_line()(["devices", "--json", "drivers"], standalone_mode=False)


def test_echo_reads_feedback_of_every_distribution(monkeypatch, capsys):
    name = "control_msgs/action/FollowJointTrajectory_FeedbackMessage"
    given = {name: {"joint_names": ["a"]}, revised(name): {"joint_names": ["b"], "index": 3}}
    heard = [
        (codec_of(kind).encode(completed(kind, {"feedback": feedback})), Topic(name))
        for kind, feedback in given.items()
    ]
    monkeypatch.setattr(bus, "_heard", lambda *_: iter(heard))
    bus.echo("/move/_action/feedback")
    old, new = (json.loads(line)["feedback"] for line in capsys.readouterr().out.splitlines())
    assert (old["joint_names"], "index" in old) == (["a"], False)
    assert (new["joint_names"], new["index"]) == (["b"], 3)
