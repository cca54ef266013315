"""Lab demo: refusals, reported faults, and clean-up."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from cardan.demos import lab as demo
from cardan.demos.demo import EXIT_INCOMPLETE, choose_demo
from cardan.demos.examples import read_demo
from cardan.demos.lab import ObservedArms, run_lab, simulated_lab
from cardan.demos.peers import Peers
from cardan.errors import ConfigurationError
from cardan.gateway.session.session import EXIT_OK
from tests.gateway.daemon.test_view import SESSION
from tests.programs import Program
from tests.test_cli import ENVIRONMENT

DEMO = choose_demo("lab")
STARTS_WITHIN_S = 150.0
"""Five simulated peers, one after the other, and a daemon, on a busy computer."""


class Served:
    """Stand-in for a daemon that is already up."""

    endpoint, code, complaints = "", EXIT_OK, ""

    def __init__(self, *_words, **_options):
        pass

    def end(self):
        pass


class Failed(Served):
    """Process that has exited by itself."""

    code, complaints = 3, "another one has the socket"


def seen(**values):
    tracking = {"path_m": 0.1, "error_max_m": 0.001} | values.pop("tracking", {})
    phase = values.pop("phase", "disarmed")
    snapshot = {"arm": {"phase": phase}, "tracking": tracking}
    return SESSION | {"phase": phase, "snapshot": snapshot} | values


class FakeClient:
    """Stand-in for a client of the daemon, with the status of an arm that has moved."""

    def __init__(self, _path):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_exception):
        pass

    def ask(self, *_words):
        return {"units": [seen()]}


@pytest.fixture
def changed(tmp_path, monkeypatch):
    """Replace the demo's file by another one; none of its programs are started."""
    monkeypatch.setattr(Peers, "start", lambda *_: None)
    monkeypatch.setattr(demo, "CardanSubprocess", Served)

    def make(*pairs, end=""):
        text = DEMO.file.read_text(encoding="utf-8")
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / "lab.toml"
        file.write_text(text + end)
        return read_demo(file)

    return make


def test_its_folder_is_there_as_long_as_it_runs(changed):
    with simulated_lab(changed(), 20.0) as (peers, config, _):
        assert peers.folder.is_dir()
        assert list(config.sessions) == ["gofa", "gp8", "ur5-a", "ur5-b"]
    assert not peers.folder.exists()


@pytest.mark.parametrize(
    ("pair", "end", "words"),
    [
        (('files = ["devices.left.path", ', "files = ["), "", r"devices\.left\.path.*own"),
        (('"robots.gofa.listen_port", ', ""), "", r"robots\.gofa"),
        (("", ""), "[servers.rosbridge]\nport = 9090\n", "servers: a demo has none"),
        (("", ""), "[daemon]\nstart_limit = 3\n", "daemon: the demo has a daemon of its own"),
        (('driver = "sim_arm"\nrobot = "ur5"', 'driver = "ros2"\nrobot = "ur5"'), "", "robots.ur5"),
    ],
)
def test_what_is_not_simulated_is_refused(changed, pair, end, words):
    lab = changed(pair, end=end)
    with pytest.raises(ConfigurationError, match=words), simulated_lab(lab, 20.0):
        pass


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ({}, None),
        ({"robot_link": ""}, "the robot of gofa was never connected"),
        ({"tracking": {"path_m": 0.0}}, "no path was commanded"),
        ({"tracking": {"error_max_m": 0.03}}, "gofa was 30 mm away from its reference"),
    ],
)
def test_what_a_lab_may_lack(row, words):
    lab = ObservedArms(["gofa"])
    lab.take([seen(**row)])
    found = lab.problems()
    assert len(found) == (words is not None)
    assert words is None or words in found[0]


def test_a_robot_that_was_there_counts_as_there():
    lab = ObservedArms(["gofa"])
    assert not lab.all_there
    lab.take([seen()])
    lab.take([seen(robot_link="lost", pid=None, phase="")])
    assert lab.all_there
    assert lab.problems() == []


@pytest.fixture
def quick(monkeypatch):
    """Stand-ins for the lab's programs, whose arms are up at once."""
    monkeypatch.setattr(Peers, "start", lambda *_: None)
    monkeypatch.setattr(demo, "CardanSubprocess", Served)
    monkeypatch.setattr(demo, "ControlClient", FakeClient)
    monkeypatch.setattr(demo, "ObservedArms", lambda _: ObservedArms(["gofa"]))
    monkeypatch.setattr(demo, "POLL_S", 0.0)


def test_what_went_well_is_shown_and_said(quick, capsys):
    assert run_lab(DEMO, 0.1) == EXIT_OK
    said = capsys.readouterr()
    assert "1 session" in said.out
    assert DEMO.success_message in said.out
    assert said.err == ""


def test_it_is_not_judged_when_it_was_ended_by_hand(quick, monkeypatch, capsys):
    monkeypatch.setattr(
        FakeClient, "ask", lambda *_: os.kill(os.getpid(), signal.SIGINT) or {"units": ()}
    )
    assert run_lab(DEMO, 20.0) == EXIT_OK
    assert "not judged" in capsys.readouterr().out


def test_a_daemon_that_fails_is_found_fault_with(quick, monkeypatch, capsys):
    monkeypatch.setattr(demo, "CardanSubprocess", Failed)
    assert run_lab(DEMO, 0.1) == EXIT_INCOMPLETE
    assert "ended with status 3: another one has the socket" in capsys.readouterr().err


@pytest.mark.matrix
def test_it_runs_and_leaves_nothing():
    with tempfile.TemporaryDirectory() as folder:  # socket paths have to be short
        done = subprocess.run(
            [sys.executable, "-m", "cardan", "demo", "lab", "--seconds", "15"],
            env=ENVIRONMENT | {"TMPDIR": folder},
            capture_output=True, text=True, timeout=280, check=False,
        )  # fmt: skip
        assert not [*Path(folder).glob("cardan-demo-*")]
    assert done.returncode == EXIT_OK, done.stdout + done.stderr
    assert DEMO.success_message in done.stdout
    assert "gofa  " in done.stdout
    assert "\x1b" not in done.stdout


@pytest.mark.matrix
def test_ctrl_c_ends_it_and_leaves_nothing():
    with Program("demo", "lab", "--seconds", "60") as program:
        program.wait_for("gofa +running", within_s=STARTS_WITHIN_S)
        children = _children(program.process.pid)
        assert program.end(signal.SIGINT) == EXIT_OK
        assert "ended early: not judged" in program.out
    assert len(children) >= 6
    assert not any(Path(f"/proc/{each}").exists() for each in children)


def _children(pid):
    listed = subprocess.run(
        ["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True
    ).stdout
    return [int(each) for each, parent in map(str.split, listed.splitlines()) if int(parent) == pid]
