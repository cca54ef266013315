"""Each simulated peer has a command that offers the peer's options."""

from __future__ import annotations

import enum
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from typing import Any, Literal

import pytest
import typer.main
from typer.testing import CliRunner

from cardan.cli.sim import sim
from cardan.errors import ConfigurationError, ScriptError
from cardan.sim_peers import registry
from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.command import PeerCommand, name_and_unit, numbers, option
from tests.docs_tables import ours

WIDE = {"COLUMNS": "400", "NO_COLOR": "1", "TERM": "dumb"}


def said(*words: str, code: int = 0) -> str:
    """Return the output of ``cardan sim`` with these words."""
    outcome = CliRunner().invoke(sim, words, env=WIDE, catch_exceptions=False, terminal_width=400)
    assert outcome.exit_code == code, outcome.output
    return outcome.output


def flags(name: str) -> set[str]:
    parameters = typer.main.get_command(sim).commands[name].params
    return {flag for parameter in parameters for flag in parameter.opts}


# -- registered peers -----------------------------------------------------------------------------


def test_the_help_lists_every_peer_with_its_summary():
    lines = said("--help").splitlines()
    for name in registry.names():
        summary = " ".join(registry.load(name).__doc__.split())
        assert any(f" {name} " in line and summary in line for line in lines), name


@pytest.mark.parametrize("name", ours(registry))
def test_what_a_peer_declares_is_offered(name):
    peer = registry.load(name)
    reported = said(name, "--help")
    assert peer.epilog in reported
    assert all(flag in reported for flag in flags(name) if flag.startswith("--"))
    listed = said(name, "--list-faults")
    assert peer.faults
    for fault in peer.faults:
        assert f"{fault.name:16} {fault.help} (default {fault.default:g})\n" in listed
    assert ("--list-scripts" in flags(name)) == bool(peer.scripts)
    if peer.scripts:
        lines = said(name, "--list-scripts").splitlines()
        assert {line.split()[0] for line in lines[: lines.index("")]} == set(peer.scripts)
        assert lines[-len(peer.verbs) :] == [f"  {usage}" for usage in peer.verbs.values()]


@pytest.mark.parametrize(
    ("name", "flag", "key", "count"),
    [
        ("spacemouse", "--list-models", "spacenavigator", 25),
        ("spacemouse-serial", "--list-models", "magellan", 6),
        ("gamepad", "--list-models", "xbox-360", 6),
        ("jr3", "--list-sensors", "right-hand", 4),
    ],
)
def test_the_values_of_an_option_are_listed(name, flag, key, count):
    lines = said(name, flag).splitlines()
    assert len(lines) == count
    assert [line.split()[0] for line in lines].count(key) == 1


def test_a_peer_is_imported_when_its_command_is_asked_for(monkeypatch):
    asked = []
    load = registry.load
    monkeypatch.setattr(registry, "load", lambda name: (asked.append(name), load(name))[1])
    said("gamepad", "--help")
    assert asked == ["gamepad"]


@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        ("arm", ("--plane", "1,2"), "--plane: '1,2' is not 6 numbers with commas"),
        ("arm", ("--listen", "5"), "--listen: '5' is not HOST:PORT"),
        ("arm", ("--drive", "no"), "--drive: 'no' is unknown; allowed: dynamic, ideal"),
        ("arm", ("--fault", "no"), "there is no fault 'no'"),
        ("motoman-gp8", ("--plant", "no"), "--plant: 'no' is unknown; allowed: ideal, paper"),
        ("motoman-gp8", ("--fault", "no"), "there is no fault 'no'"),
        ("motoman-gp8", ("--fault", "split=2"), "fault split: 2 is not in 0 to 1"),
        (
            "motoman-gp8",
            ("--log", "/nowhere/at/all", "--base-port", "0"),
            "--log: '/nowhere/at/all'",
        ),
        ("abb-gofa", ("--surface", "low"), "--surface: "),
        ("abb-gofa", ("--surface", "0.2:1:2:3:4"), "--surface: "),
        ("abb-gofa", ("--surface", "0.2:-1"), "--surface: "),
        ("abb-gofa", ("--force-frame", "world"), "--force-frame: "),
        ("abb-gofa", ("--force-sense", "pulled"), "--force-sense: "),
        ("abb-gofa", ("--joints", "1,2,3"), "--joints: "),
    ],
)
def test_wrong_words_are_reported_with_the_option(name, words, message):
    with pytest.raises((ConfigurationError, ScriptError), match=f"^{re.escape(message)}"):
        said(name, *words, "--seconds", "0")


@pytest.mark.parametrize(
    ("name", "option", "former", "now"),
    [
        ("abb-gofa", "--force-sense", "felt", "reaction"),
        ("ur", "--fault", "kept-inputs", "stale-inputs"),
        ("phone", "--fault", "leap", "jump"),
    ],
)
def test_a_former_name_of_a_choice_is_refused_with_the_present_one(name, option, former, now):
    with pytest.raises((ConfigurationError, ScriptError), match=f"; '{former}' is now '{now}'$"):
        said(name, option, former, "--seconds", "0")


def test_an_unknown_peer_is_refused():
    assert "No such command 'toaster'" in said("toaster", code=2)


# -- third parties' -------------------------------------------------------------------------------


class Color(enum.Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Oven:
    power_kg: float = option(1.0, "How heavy.")
    slots: tuple[tuple[float, ...], ...] = option(
        (), "Where bread goes.", name="slot", read=lambda text: numbers(text, 2), repeatable=True
    )
    seed: int = 7
    """Not settable on the command line."""


@dataclass(frozen=True, kw_only=True)
class ToasterOptions:
    host: str = option("::1", "Where.", name="at", metavar="HOST:PORT", port_field="port")
    port: int = 80
    color: Color = option(Color.RED, "Which.")
    size: Literal["big", "small"] | None = option(None, "How big.")
    lid: bool = option(True, "Without a lid.", name="no-lid")
    warm: bool = option(False, "Warm.")
    speed_limit_deg_s: float | None = option(None, "Of the lever.")
    oven: Oven = field(default_factory=Oven)
    script: str = "toast"
    faults: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    hidden: int = 3

    def __post_init__(self) -> None:
        if self.hidden != 3:
            raise AssertionError


MADE: list[tuple[Any, float | None]] = []


class Toaster(PeerCommand[ToasterOptions]):
    """A toaster."""

    Options = ToasterOptions
    epilog = "Prints READY when the bread is up."
    faults = (FaultSwitch("burn", "burns at VALUE s", 5.0),)
    scripts = {"toast": "# one slice\n0 push"}  # noqa: RUF012
    verbs = {"push": "push"}  # noqa: RUF012

    @staticmethod
    def run(options: ToasterOptions, seconds: float | None) -> int | None:
        MADE.append((options, seconds))
        return 9 if options.warm else None


@pytest.fixture
def toaster(monkeypatch):
    points = [EntryPoint("toaster", f"{__name__}:Toaster", registry.ENTRY_POINT_GROUP)]
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: points)
    MADE.clear()


def made(*words: str, code: int = 0) -> ToasterOptions:
    said("toaster", *words, code=code)
    return MADE.pop()[0]


@pytest.mark.usefixtures("toaster")
class TestSomebodyElsesPeer:
    def test_gets_its_command(self):
        assert "A toaster." in said("--help")
        reported = said("toaster", "--help")
        for words in ("--at", "HOST:PORT", "::1:80", "red|blue", "big|small", "DEG/S", "KG"):
            assert words in reported
        assert "hidden" not in reported
        assert flags("toaster") == {
            *("--at", "--color", "--size", "--no-lid", "--warm", "--speed-limit", "--power"),
            *(
                "--slot",
                "--seconds",
                "-v",
                "--verbose",
                "--log-level",
                "--script",
                "--fault",
                "--seed",
            ),
            *("--list-faults", "--list-scripts"),
        }

    def test_has_its_defaults_where_nothing_is_given(self):
        said("toaster")
        assert MADE.pop() == (ToasterOptions(), None)

    def test_is_given_what_the_options_say(self):
        said(
            *("toaster", "--seconds", "2", "--at", "toast:8080", "--color", "blue"),
            *("--size", "small", "--no-lid", "--speed-limit", "4", "--power", "2"),
            *("--slot", "1,2", "--slot", "3,4", "--script", "mine", "--seed", "5"),
            *("--fault", "burn"),
        )
        assert MADE.pop() == (
            ToasterOptions(
                host="toast",
                port=8080,
                color=Color.BLUE,
                size="small",
                lid=False,
                speed_limit_deg_s=4.0,
                oven=Oven(2.0, ((1.0, 2.0), (3.0, 4.0))),
                script="mine",
                faults={"burn": 5.0},
                seed=5,
            ),
            2.0,
        )

    def test_gives_the_exit_code(self):
        assert made("--warm", code=9).warm

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (("--at", "nowhere"), "--at: 'nowhere' is not HOST:PORT, as ::1:80"),
            (("--at", "x:65536"), "--at: 'x:65536' is not HOST:PORT"),
            (("--color", "pink"), "--color: 'pink' is unknown; allowed: red, blue"),
            (("--size", "huge"), "--size: 'huge' is unknown; allowed: big, small"),
            (("--slot", "1"), "--slot: '1' is not 2 numbers with commas"),
            (("--slot", "1,two"), "--slot: '1,two' is not 2 numbers with commas"),
        ],
    )
    def test_wrong_words_are_reported_with_the_option(self, words, message):
        with pytest.raises(ConfigurationError, match=message):
            said("toaster", *words)

    def test_an_unknown_fault_is_reported(self):
        with pytest.raises(ScriptError, match="there is no fault 'melt'; there are: burn"):
            said("toaster", "--fault", "melt")


def test_what_is_no_peer_is_refused(monkeypatch):
    monkeypatch.setitem(registry.BUILT_IN, "toaster", f"{__name__}:Oven")
    with pytest.raises(ConfigurationError, match="is not a cardan simulated peer"):
        said("toaster")


# -- names ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field_name", "expected"),
    [
        ("boot_s", ("boot", "S")),
        ("max_speed_deviation_deg_s", ("max-speed-deviation", "DEG/S")),
        ("payload_kg", ("payload", "KG")),
        ("force_control", ("force-control", "")),
        ("k", ("k", "")),
    ],
)
def test_a_fields_name_has_the_options_name_and_its_unit(field_name, expected):
    assert name_and_unit(field_name) == expected
