"""The command ``cardan conform``."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import EntryPoint
from xml.etree import ElementTree

import pytest

from cardan.cli import app
from cardan.conform import registry
from cardan.errors import ConfigurationError


def run(*words):
    """Run the command in this process; return its exit code."""
    try:
        return app(["conform", *words], standalone_mode=False) or 0
    except SystemExit as reported:
        return reported.code


@pytest.fixture
def output(capsys):
    def read():
        return capsys.readouterr().out

    return read


def test_the_list_has_every_suite(output):
    assert run("--list") == 0
    text = output()
    for name in registry.names():
        assert name in text


def test_the_requirements_are_listed_with_their_sources(output):
    assert run("3dconnexion", "--requirements") == 0
    lines = output().splitlines()
    assert len(lines) == len(registry.load("3dconnexion").requirements)
    assert lines[0].startswith("HID3D-001  level 0  The device can be opened")
    assert lines[0].endswith("[the system's HID driver]")


def test_a_simulated_peer_is_judged(output):
    assert run("3dconnexion") == 0
    assert "0 failed" in output()
    assert run("3dconnexion", "--fault", "unknown-id", "--format", "markdown") == 4
    assert "| HID3D-003 | failed |" in output()


def test_every_form_can_be_printed(output):
    assert run("magellan", "--level", "0", "--format", "json") == 0
    assert json.loads(output())["suite"] == "magellan"
    assert run("magellan", "--level", "0", "--format", "junit") == 0
    assert ElementTree.fromstring(output()).get("failures") == "0"


def test_reports_are_saved_and_compared(output, tmp_path):
    assert run("motoros", "--level", "1", "--save", str(tmp_path / "a")) == 0
    assert run("motoros", "--level", "1", "--fault", "late", "--save", str(tmp_path / "b")) == 4
    output()
    both = [str(tmp_path / each / "report.json") for each in "ab"]
    assert run("--compare", *both) == 0
    text = output()
    assert "MOTO-102" in text
    assert "simulated motoman-gp8 is easier" in text
    report = json.loads((tmp_path / "a" / "report.json").read_text())
    assert {*report["attached"]} == {"capture.pcap", "record.mcap"}


def test_a_report_is_not_written_over_without_being_reported(output, tmp_path):
    words = ("egm", "--level", "0", "--save", str(tmp_path))
    assert run(*words) == 0
    before = (tmp_path / "report.json").read_bytes()
    with pytest.raises(ConfigurationError, match="has a report: give another folder, or --over"):
        run(*words, "--seconds", "4")
    assert (tmp_path / "report.json").read_bytes() == before
    assert run(*words, "--seconds", "4", "--overwrite") == 0
    assert (tmp_path / "report.json").read_bytes() != before


def test_a_folder_that_cannot_be_is_refused_before_anything_is_run(monkeypatch, tmp_path):
    from cardan.conform import run as running

    monkeypatch.setattr(running, "simulated", None)
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "inside"):
        with pytest.raises(ConfigurationError, match=r"^--save: .* cannot be written: "):
            run("egm", "--save", str(folder))


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ((), "PROTOCOL: give one of: 3dconnexion, "),
        (("nothing",), "there is no protocol 'nothing'; allowed: 3dconnexion, "),
        (("egm", "--fault", "gremlins"), "there is no fault 'gremlins'; there are: clock-step"),
        (("egm", "--fault", "drop", "--target", "x:1"), "only a simulated peer has faults"),
        (("egm", "--target", ":6510", "--level", "2", "--yes"), "give --i-am-at-the-enable-switch"),
        (("--compare", "nothing.json", "nothing.json"), "nothing.json cannot be read: "),
    ],
)
def test_what_is_wrong_is_said(words, why):
    with pytest.raises(Exception, match=why):
        app(["conform", *words], standalone_mode=False)


def test_a_level_at_a_target_is_asked_for(monkeypatch, capsys):
    from typer import Abort

    from cardan.conform import run as running

    def never(*_):
        raise AssertionError("it ran")

    monkeypatch.setattr(running, "at", never)
    asked = []

    def confirm(text, **_):
        asked.append(text)
        raise Abort

    monkeypatch.setattr("typer.confirm", confirm)
    with pytest.raises(Abort):
        app(["conform", "motoros", "--target", "127.0.0.1", "--level", "1"], standalone_mode=False)
    assert asked == ["go on?"]
    assert "level 1 opens a session and holds" in capsys.readouterr().err


WITHOUT_SCAPY = """
import sys
sys.modules["scapy.fields"] = None
from cardan.cli import app
app(["conform", "magellan", "--format", "json"])
"""


def test_without_scapy_its_requirement_says_what_to_install():
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_SCAPY], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = [
        each for each in json.loads(done.stdout)["results"] if "cardan[dissect]" in each["said"]
    ]
    assert [each["outcome"] for each in found] == ["not applicable"]


@pytest.mark.parametrize("name", ["joint-stream", "ros2-arm"])
def test_a_suite_of_a_plug_in_that_is_not_installed_says_what_installs_it(monkeypatch, name):
    monkeypatch.setattr(registry.FINDER, "_installed", list)
    with pytest.raises(ConfigurationError) as error:
        run(name, "--level", "0")
    reported = str(error.value)
    assert reported.startswith(f"protocol: {name!r} is in the folder plugins/cardan-conform-arms ")
    assert "`pip install ./plugins/cardan-conform-arms`" in reported
    assert "\n" not in reported


def test_suites_of_other_packages_are_there_and_broken_ones_are_named(output, monkeypatch):
    points = [
        EntryPoint("another", "cardan.conform.egm.suite:EgmSuite", registry.ENTRY_POINT_GROUP),
        EntryPoint("broken", "nowhere:Suite", registry.ENTRY_POINT_GROUP),
    ]
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: points)
    assert registry.load("another").name == "egm"
    assert set(registry.names()) == {*registry.BUILT_IN, "another", "broken"}
    assert run("--list") == 0
    out = output()
    assert "broken  cannot be loaded: " in out
    assert "3dconnexion" in out
