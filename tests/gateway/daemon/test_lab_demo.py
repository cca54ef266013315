"""The demo of a lab: what it refuses, what it finds fault with, and the whole of it."""

import os
import re
import signal
import subprocess
import sys

import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.daemon import lab_demo
from cardan.gateway.daemon.lab_demo import EXIT_INCOMPLETE, _Arm, _Hardware, _Lab, run_lab
from cardan.gateway.session.demo import choose_demo
from cardan.gateway.session.examples import read_demo
from cardan.gateway.session.session import EXIT_OK
from tests.gateway.daemon.test_view import SESSION
from tests.programs import Program
from tests.test_cli import ENVIRONMENT

DEMO = choose_demo("lab")
STARTS_WITHIN_S = 150.0
"""Five simulated peers, one after the other, and a daemon, on a busy computer."""


@pytest.fixture
def changed(tmp_path, monkeypatch):
    """A demo whose file is another one; what it launches is not started."""
    monkeypatch.setattr(_Hardware, "_launch", lambda *_: None)

    def make(*pairs, end=""):
        text = DEMO.file.read_text(encoding="utf-8")
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / "lab.toml"
        file.write_text(text + end)
        return read_demo(file)

    return make


def test_its_roles(changed):
    hardware = _Hardware(changed(), 20.0)
    with hardware:
        assert hardware.folder.is_dir()
        assert hardware.roles == ("gofa", "left", "gp8", "pad", "ur5-a", "ur5-b")
        before = hardware._tables["sessions"][2]["mapping"]["linear_speed_m_s"]
        hardware.change("ur5-a")
        assert hardware._tables["sessions"][2]["mapping"]["linear_speed_m_s"] < before
        assert hardware._commands[hardware._of("left")][1] == "spacemouse"
    assert not hardware.folder.exists()


@pytest.mark.parametrize(
    ("pair", "end", "words"),
    [
        (('files = ["devices.left.path", ', "files = ["), "", r"devices\.left\.path.*own"),
        (('"robots.gofa.listen_port", ', ""), "", r"robots\.gofa"),
        (('device = "left"', 'device = "right"'), "", "two sessions with a device for itself"),
        (("", ""), "[faces.rosbridge]\nport = 9090\n", "faces: a demo has none"),
        (("", ""), "[daemon]\nstart_limit = 3\n", "daemon: the demo has a daemon of its own"),
        (('driver = "sim_arm"\nrobot = "ur5"', 'driver = "ros2"\nrobot = "ur5"'), "", "robots.ur5"),
    ],
)
def test_what_is_not_simulated_or_no_lab_is_refused(changed, pair, end, words):
    demo = changed(pair, end=end)
    with pytest.raises(ConfigurationError, match=words), _Hardware(demo, 20.0):
        pass


def seen(**values):
    snapshot = {"phase": "disarmed", "pose": [0.4, 0.0, 0.4], "error_max_m": 0.001, "trips": 0}
    snapshot |= {"authority": ""} | values.pop("snapshot", {})
    return SESSION | {"phase": snapshot["phase"], "snapshot": snapshot} | values


def test_what_is_seen_of_an_arm():
    arm = _Arm()
    arm.take(seen(snapshot={"phase": ""}, robot_link=""))
    assert arm.first == []
    arm.take(seen())
    arm.take(seen(snapshot={"phase": "moving", "pose": [0.4, 0.03, 0.44], "authority": "hand"}))
    assert arm.moved_m == pytest.approx(0.05)
    assert arm.moved_by == {"hand"}
    assert arm.phases == ["disarmed", "moving"]
    arm.take(seen(pid=4712, snapshot={"error_max_m": 0.03}))
    assert arm.phases == ["disarmed"]
    assert arm.error_max_m == 0.03


class Told:
    """A daemon that tells what it is given; no arm, no process."""

    def __init__(self, rows):
        self.rows = rows

    def ask(self, *_words):
        return {"units": self.rows}

    def close(self):
        pass


@pytest.fixture
def watched(monkeypatch, changed):
    monkeypatch.setattr(lab_demo, "ControlClient", lambda _path: Told([]))
    monkeypatch.setattr(lab_demo, "POLL_S", 0.0)
    hardware = _Hardware(changed(), 20.0)
    hardware.sessions = ("gofa",)
    return _Lab(hardware, "", 20.0, lab_demo.LabView(), [])


def look(lab, **values):
    lab._client.rows = [seen(**values)]
    lab._poll()


@pytest.mark.parametrize(
    "after", [{"pose": [0.4, 0.002, 0.4]}, {"phase": "holding"}, {"phase": "moving"}]
)
def test_an_arm_that_moves_while_its_device_is_away_is_found_fault_with(watched, after):
    look(watched)
    watched._parked["gofa"] = [0.4, 0.0, 0.4]
    look(watched, device_link="lost")
    assert watched.problems == []
    look(watched, device_link="lost", snapshot=after)
    look(watched, device_link="lost", snapshot=after)
    assert watched.problems == ["gofa moved, though its device was away"]


def test_one_that_was_armed_by_its_hand_before_anybody_looked_is_not(watched):
    watched._parked["gofa"] = [0.4, 0.0, 0.4]
    look(watched, device_link="live", snapshot={"phase": "moving", "pose": [0.4, 0.1, 0.4]})
    assert watched.problems == []


@pytest.mark.parametrize(
    ("after", "armed"),
    [
        ("device lost, arm braking, arm disarmed, device live, arm holding", False),
        ("arm braking, device lost, arm disarmed, device live, arm moving", False),
        ("device lost, arm disarmed, arm holding, device live", True),
        ("device lost, device needs neutral, arm moving", True),
        ("device lost, arm holding, device live, arm disarmed, device lost, device live", False),
    ],
)
def test_what_the_event_log_says_of_being_plugged_in(after, armed):
    said = ("device live, arm moving, " + after).split(", ")
    events = [dict(zip(("event", "what"), each.split(" ", 1), strict=True)) for each in said]
    assert lab_demo._armed_by_plugging(events) is armed


def test_what_is_left_behind_is_found_fault_with(watched, tmp_path):
    look(watched, pid=os.getpid(), snapshot={"error_max_m": 0.03})
    assert watched.left_behind(tmp_path) == [
        "gofa was 30 mm away from its reference",
        f"processes were left behind: [{os.getpid()}]",
        f"{tmp_path} was left behind",
    ]


def test_what_does_not_happen_in_time_is_found_fault_with(watched):
    with pytest.raises(lab_demo._NotSeenError, match="within 0 s: the moon"):
        watched._until("the moon", lambda: False, 0.0)


def test_it_is_not_judged_when_it_was_ended_by_hand(monkeypatch, capsys):
    def ended(_lab):
        raise lab_demo._EndedEarlyError

    monkeypatch.setattr(_Hardware, "_launch", lambda *_: None)
    monkeypatch.setattr(_Hardware, "daemon", lambda _: _Served())
    monkeypatch.setattr(lab_demo, "ControlClient", lambda _path: Told([]))
    monkeypatch.setattr(_Lab, "perform", ended)
    assert run_lab(DEMO, 20.0) == EXIT_OK
    assert "not judged" in capsys.readouterr().out


class _Served:
    """A daemon that has ended by itself."""

    endpoint, code, complaints = "", 3, "another one has the socket"

    def __enter__(self):
        return self

    def __exit__(self, *_exception):
        pass


def test_a_daemon_that_fails_is_found_fault_with(monkeypatch, capsys):
    monkeypatch.setattr(_Hardware, "_launch", lambda *_: None)
    monkeypatch.setattr(_Hardware, "daemon", lambda _: _Served())
    monkeypatch.setattr(lab_demo, "ControlClient", lambda _path: Told([]))
    monkeypatch.setattr(_Lab, "perform", lambda _: None)
    assert run_lab(DEMO, 20.0) == EXIT_INCOMPLETE
    assert "ended with status 3: another one has the socket" in capsys.readouterr().err


@pytest.mark.matrix
@pytest.mark.timeout(300)
def test_the_whole_of_it():
    done = subprocess.run(
        [sys.executable, "-m", "cardan", "demo", "lab", "--seconds", "15"],
        env=ENVIRONMENT, capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    assert done.returncode == EXIT_OK, done.stdout + done.stderr
    assert DEMO.success_message in done.stdout
    assert "gofa  " in done.stdout
    assert "reload: ur5-a mapping.linear_speed_m_s: 0.1 -> 0.08" in done.stdout
    assert "stood until the dead-man was pressed" in done.stdout
    assert "came back disarmed" in done.stdout
    assert re.search(r"ur5-b: \d+ mm by hand and verbs", done.stdout)
    assert "\x1b" not in done.stdout


@pytest.mark.matrix
@pytest.mark.timeout(300)
def test_ctrl_c_ends_it_and_leaves_nothing():
    with Program("demo", "lab", "--seconds", "60") as program:
        program.wait_for("gofa +running", within_s=STARTS_WITHIN_S)
        children = _children(program.process.pid)
        assert program.end(signal.SIGINT) == EXIT_OK
        assert "ended early: not judged" in program.out
    assert len(children) >= 6
    assert not any(map(lab_demo._runs, children))


def _children(pid):
    listed = subprocess.run(
        ["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True
    ).stdout
    return [int(each) for each, parent in map(str.split, listed.splitlines()) if int(parent) == pid]
