"""Acceptance test of a lab: problems that it reports, and a whole run."""

import os
import re

import pytest

from cardan.demos import lab as demo
from cardan.demos.demo import choose_demo
from cardan.demos.examples import read_demo
from cardan.demos.lab import simulated_lab
from cardan.demos.peers import Peers
from cardan.errors import ConfigurationError
from tests.acceptance import lab
from tests.acceptance.lab import Arm, Hardware, Lab, NotSeenError, live_in_lab
from tests.demos.test_lab import Served
from tests.gateway.daemon.test_view import SESSION

DEMO = choose_demo("lab")


@pytest.fixture
def prepared(monkeypatch):
    """The lab example with its daemon; no process is started."""
    monkeypatch.setattr(Peers, "start", lambda *_: None)
    monkeypatch.setattr(demo, "CardanSubprocess", Served)
    with simulated_lab(DEMO, 20.0) as (peers, layout, _):
        yield peers, layout


@pytest.fixture
def hardware(prepared):
    return Hardware(DEMO, *prepared)


def test_its_roles(prepared, hardware):
    peers, _ = prepared
    assert hardware.roles == ("gofa", "left", "gp8", "pad", "ur5-a", "ur5-b")
    before = peers.tables["sessions"][2]["mapping"]["linear_speed_m_s"]
    hardware.change("ur5-a")
    assert peers.tables["sessions"][2]["mapping"]["linear_speed_m_s"] < before
    assert peers.commands[hardware._of("left")][1] == "spacemouse"


def test_what_is_no_lab_for_this_is_refused(prepared, tmp_path):
    text = DEMO.file.read_text(encoding="utf-8")
    assert 'device = "left"' in text
    file = tmp_path / "lab.toml"
    file.write_text(text.replace('device = "left"', 'device = "right"'))
    with (
        pytest.raises(ConfigurationError, match="two sessions with a device for itself"),
        simulated_lab(read_demo(file), 20.0) as (peers, layout, _),
    ):
        Hardware(DEMO, peers, layout)


def seen(**values):
    given = {"phase": "disarmed", "pose": [0.4, 0.0, 0.4], "error_max_m": 0.001, "authority": ""}
    given |= values.pop("snapshot", {})
    snapshot = {
        "arm": {"phase": given["phase"], "authority": given["authority"], "trips": 0},
        "robot": {"pose": given["pose"]},
        "tracking": {"error_max_m": given["error_max_m"]},
    }
    return SESSION | {"phase": given["phase"], "snapshot": snapshot} | values


def test_what_is_seen_of_an_arm():
    arm = Arm()
    arm.take(seen(snapshot={"phase": ""}, robot_link=""))
    assert arm.first == []
    arm.take(seen())
    arm.take(seen(snapshot={"phase": "moving", "pose": [0.4, 0.03, 0.44], "authority": "device"}))
    assert arm.moved_m == pytest.approx(0.05)
    assert arm.moved_by == {"device"}
    assert arm.phases == ["disarmed", "moving"]
    arm.take(seen(pid=4712, snapshot={"error_max_m": 0.03}))
    assert arm.phases == ["disarmed"]
    assert arm.error_max_m == 0.03


class FakeClient:
    """A daemon that reports given values, without arms and processes."""

    def __init__(self, rows):
        self.rows = rows

    def ask(self, *_words):
        return {"units": self.rows}


@pytest.fixture
def watched(hardware, monkeypatch):
    monkeypatch.setattr(lab, "POLL_S", 0.0)
    hardware.sessions = ("gofa",)
    return Lab(hardware, "", FakeClient([]), [].append)


def look(watched, **values):
    watched._client.rows = [seen(**values)]
    watched._poll()


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
    assert lab._armed_by_plugging(events) is armed


def test_what_is_left_behind_is_found_fault_with(watched, tmp_path):
    look(watched, pid=os.getpid(), snapshot={"error_max_m": 0.03})
    assert watched.left_behind(tmp_path) == [
        "gofa was 30 mm away from its reference",
        f"processes were left behind: [{os.getpid()}]",
        f"{tmp_path} was left behind",
    ]


def test_what_does_not_happen_in_time_is_found_fault_with(watched):
    with pytest.raises(NotSeenError, match="within 0 s: the moon"):
        watched._until("the moon", lambda: False, 0.0)


@pytest.mark.matrix
def test_the_whole_of_it():
    lines = []
    assert live_in_lab(lines.append) == []
    said = "\n".join(lines)
    assert "reload: ur5-a mapping.linear_speed_m_s: 0.1 -> 0.08" in said
    assert "stood until the dead-man was pressed" in said
    assert "came back disarmed" in said
    assert re.search(r"ur5-b: \d+ mm by device and verbs", said)
