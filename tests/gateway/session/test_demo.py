"""The demos: what they join, and what they find fault with."""

import contextlib
import dataclasses
import itertools
import re
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest

from cardan.drivers.omni import OmniOptions
from cardan.errors import ConfigurationError, DriverError
from cardan.gateway.session import demo, network_demo, rosbridge_program
from cardan.gateway.session.demo import (
    EXIT_INCOMPLETE,
    FORCE_AGE_S,
    HELD_SHARE,
    choose_demo,
    find_problems,
    launched,
    run_demo,
    simulated_hardware,
)
from cardan.gateway.session.examples import find_demos
from cardan.gateway.session.rosbridge_program import RosbridgeProgram
from cardan.gateway.session.session import EXIT_OK, STOPPED_ON_REQUEST
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import Outcome
from cardan.tables import read_toml

MOVED = Snapshot(cycles=1000, path_m=0.1, error_max_m=0.004, metrics={})
DRAWN = dataclasses.replace(
    MOVED,
    haptic_state="enabled",
    force_peak_n=0.9,
    energy_given_j=-0.02,
    energy_given_peak_j=0.001,
    elapsed_s=25.0,
    measured_age_p50_s=0.004,
    measured_age_p99_s=0.005,
    contact_force_n=5.5,
    contact_s=10.0,
    contact_path_m=0.2,
    contact_force_mean_n=5.5,
    contact_target_n=5.6,
    contact_force_rms_error_n=0.6,
)


FELT = OmniOptions()


def test_what_went_well_is_not_found_fault_with(monkeypatch, capsys):
    assert find_problems(MOVED) == []
    assert find_problems(DRAWN, FELT) == []
    pretend(monkeypatch, dataclasses.replace(DRAWN, finished=True))
    assert run_demo(10.0, "omni") == EXIT_OK
    said = " ".join(capsys.readouterr().out.split())
    assert "felt the board, 0.90 N at most" in said
    assert "given at most 1.00 mJ in one engagement, of the 5 mJ" in said


@pytest.mark.parametrize(
    ("lack", "words"),
    [
        ({"cycles": 0}, "never commanded"),
        ({"path_m": 0.0}, "no path"),
        ({"error_max_m": 0.03}, "30.0 mm away"),
        ({"trips": 2}, "2 times"),
    ],
)
def test_what_any_demo_may_lack(lack, words):
    for good, options in ((MOVED, None), (DRAWN, FELT)):
        (found,) = find_problems(dataclasses.replace(good, **lack), options)
        assert words in found


@pytest.mark.parametrize(
    ("lack", "words"),
    [
        ({"contact_path_m": 0.0}, "nothing was drawn"),
        ({"contact_force_rms_error_n": HELD_SHARE * 5.6 + 0.1}, "1.5 N RMS away"),
        ({"force_peak_n": 0.0}, "no force was rendered"),
        ({"force_peak_n": OmniOptions().clamp_n + 0.1}, "force was 2.10 N, above 2 N"),
        (
            {"energy_given_peak_j": OmniOptions().energy_budget_j + 0.001},
            "given up to 6.0 mJ in one engagement (bound: 5 mJ)",
        ),
        (
            {"force_losses": 1, "force_lost_reason": "the motors are hot"},
            "1 times there was no force: the motors are hot",
        ),
        (
            {"force_out_s": 0.5, "force_lost_reason": "the tick was late"},
            "without force for 0.50 s: the tick was late",
        ),
        ({"measured_age_p99_s": FORCE_AGE_S + 0.005}, "15.0 ms old"),
        ({"haptic_state": "fault", "haptic_reason": "too fast"}, "fault at the end: too fast"),
    ],
)
def test_what_a_drawing_may_lack(lack, words):
    (found,) = find_problems(dataclasses.replace(DRAWN, **lack), FELT)
    assert words in found


def test_an_unknown_demo_is_refused_with_the_known_ones():
    with pytest.raises(ConfigurationError, match=r"allowed: .*gofa, gp8, .*omni, "):
        run_demo(1.0, "teo")


def test_a_drawing_that_would_not_begin_is_refused():
    with pytest.raises(ConfigurationError, match=r"--seconds: 5 are too few .* 10 or more"):
        run_demo(5.0, "omni")


@pytest.mark.parametrize(
    ("last", "code"),
    [
        (Snapshot(finished=True, ending="the session's time is over"), EXIT_INCOMPLETE),
        (Snapshot(finished=True, ending=STOPPED_ON_REQUEST), EXIT_OK),
        (Snapshot(message="stopped before it began"), EXIT_OK),
    ],
)
def test_a_demo_that_was_ended_before_its_time_is_not_judged(monkeypatch, capsys, last, code):
    pretend(monkeypatch, last)
    assert run_demo(10.0, "omni") == code
    assert ("not judged" in capsys.readouterr().out) is (code == EXIT_OK)


def pretend(monkeypatch, last):
    """A session that ends with this snapshot; nothing runs."""
    monkeypatch.setattr(demo, "launched", lambda *_, **__: contextlib.nullcontext())
    monkeypatch.setattr(demo, "supervise", lambda *_, **__: Outcome(EXIT_OK, last))


def test_what_found_fault_with_is_said(monkeypatch, capsys):
    pretend(monkeypatch, dataclasses.replace(MOVED, finished=True, trips=2))
    assert run_demo(10.0, "gofa") == EXIT_INCOMPLETE
    assert "cardan demo: teleoperation was disengaged 2 times" in capsys.readouterr().err


def test_a_file_that_is_no_demo_is_refused():
    file = choose_demo("gofa").file.with_name("spacemouse-gofa.toml")
    with pytest.raises(ConfigurationError, match="does not say how it runs without hardware"):
        run_demo(10.0, str(file))


@pytest.mark.matrix
def test_what_does_not_serve_is_told(capsys):
    with (
        pytest.raises(DriverError, match="`cardan sim spacemouse` ended before it served"),
        launched("sim", "spacemouse"),
    ):
        pass
    assert "--hid" in capsys.readouterr().err


@pytest.mark.matrix
def test_what_a_demo_launches_serves_what_its_configuration_has():
    with simulated_hardware(choose_demo("leap-ur5"), 1.0) as (config, through):
        assert config.device is not None
        port = config.device.options["port"]
        assert port != 6437
        with contextlib.closing(socket.create_connection(("127.0.0.1", port), 5.0)):
            assert through == ()


@pytest.mark.matrix
@pytest.mark.timeout(180)  # Eight processes begin one after the other.
def test_a_program_at_rosbridge_moves_the_robot_and_the_record_is_exact():
    ran = subprocess.run(
        [sys.executable, "-m", "cardan", "demo", "ros2", "--seconds", "8"],
        capture_output=True,
        text=True,
        timeout=170,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    for line in (
        r"rosbridge face READY at ws://127\.0\.0\.1:\d+",
        r"client: result: a twist was refused: twst: choose this streaming command first",
        r"client: parameter preset_streaming_cmd is twist",
        r"client: \d+ twists streamed in [56]\.\d s; TCP moved by up to 1\d\d\.\d mm, at most ",
        r"record: \d+ messages of \d+ topics",
        r"replay through the control core: .*: \d+ cycles, each command bit for bit the recorded",
        r"\d+ poses seen again; path difference 0\.000 mm",
    ):
        assert re.search(line, ran.stdout), (line, ran.stdout)


class Program:
    """What a demo's program saw, all of it well."""

    results: ClassVar = [
        {"command": "twist", "outcome": "refused", "success": False, "reason": "choose it"},
        {"command": "twist", "outcome": "accepted", "success": True, "reason": ""},
    ]
    moved_m, behind_m = 0.1, 0.004
    refusals = RosbridgeProgram.refusals


@pytest.mark.parametrize(
    ("lack", "words"),
    [
        ({}, None),
        ({"results": Program.results[:1]}, "did not tell that the twists were taken"),
        ({"results": Program.results[1:]}, "a twist without a preset was not refused"),
        ({"results": [*Program.results, Program.results[0]]}, "refused on the way: choose it"),
        ({"moved_m": 0.001}, "the TCP moved by 1.0 mm only"),
        ({"behind_m": 0.05}, "the TCP was 50.0 mm from where it was commanded"),
        ({"behind_m": 0.0}, "the TCP was 0.0 mm from where it was commanded"),
    ],
)
def test_what_a_program_may_find_wrong(lack, words):
    program = Program()
    vars(program).update(lack)
    found = network_demo._judge_program(program, 0.02)
    assert len(found) == (words is not None)
    assert words is None or words in found[0]


class Refused(RosbridgeProgram):
    """A program whose arm refuses a stream at first."""

    def __init__(self, reasons):
        super().__init__("ws://127.0.0.1", "/arm")
        self.results = Program.results[:1]
        self._reasons = iter(reasons)

    def wait_until_seen(self):
        pass

    def _send(self, **_operation):
        pass

    def _call(self, service, _values):
        if service == "stop":
            return {"success": True}
        reason = next(self._reasons)
        return {"results": [{"successful": not reason, "reason": reason}]}


def test_a_program_asks_again_for_a_stream_that_was_refused(monkeypatch):
    silent = "no datagram for 0.2 s"
    monkeypatch.setattr(rosbridge_program, "ASK_AGAIN_S", 0.0)
    Refused([silent, silent, ""]).drive(0.0, threading.Event())
    monkeypatch.setattr(rosbridge_program, "ANSWER_WITHIN_S", 0.0)
    with pytest.raises(DriverError, match=f"no stream of twists: {silent}"):
        Refused(itertools.repeat(silent)).drive(0.0, threading.Event())


@pytest.mark.parametrize(
    ("code", "replayed", "words"),
    [
        (0, (0, ["/arm: 500 cycles, each command bit for bit the recorded one"]), None),
        (4, (0, ["/arm: 500 cycles, each command bit for bit the recorded one"]), "not complete"),
        (0, (4, ["/arm: the command of cycle 7 differs"]), "not replayed bit for bit"),
        (0, (0, ["/arm: 300 cycles, each command bit for bit", "  not replayed"]), "to its end"),
        (0, (0, ["/arm: 300 cycles, each command bit for bit"]), "not all of the session's 500"),
        (0, (2, []), "not replayed bit for bit"),
    ],
)
def test_what_a_record_may_lack(monkeypatch, tmp_path, code, replayed, words):
    monkeypatch.setattr(network_demo, "_cardan", lambda *_: replayed)
    recorder = SimpleNamespace(code=code, lines=("9 messages dropped",), complaints="")
    outcome = Outcome(EXIT_OK, Snapshot(cycles=500))
    said = []
    found = network_demo._judge_record(recorder, tmp_path, outcome, said.append)
    assert len(found) == (words is not None), found
    assert words is None or words in found[0]
    assert said[0] == "record: 9 messages dropped"


def test_every_demo_names_the_extras_that_it_needs():
    pyproject = read_toml(Path(__file__).parents[3] / "pyproject.toml")
    known = set(pyproject["project"]["optional-dependencies"])
    for each in find_demos().values():
        assert set(each.extras) <= known, each.name
        text = each.file.read_text(encoding="utf-8")
        of_nodes = any(name.startswith(("phone", "ros2", "xr")) for name in each.drivers)
        on_a_network = of_nodes or "[network]" in text
        assert ("network" in each.extras) == on_a_network, each.name
        assert ("console" in each.extras) == (each.program == "console"), each.name
        assert ("record" in each.extras) == (each.program == "rosbridge"), each.name
        assert ("can" in each.extras) == ("jr3_can" in each.drivers), each.name


@pytest.mark.parametrize(("name", "extras"), [("ros2", "network,record\n"), ("gofa", "\n")])
def test_the_extras_of_a_demo_are_told(name, extras):
    told = subprocess.run(
        [sys.executable, "-m", "cardan", "demo", "--extras", name],
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout == extras


@pytest.mark.matrix
def test_the_drawing_runs_and_is_felt():
    # A busy machine may find fault with much, never with the force and the energy.
    ran = subprocess.run(
        [sys.executable, "-m", "cardan", "demo", "omni", "--seconds", "10"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ran.returncode in (0, 4), ran.stderr
    assert "path drawn in contact" in ran.stdout
    for never in ("above", "given"):
        assert never not in ran.stderr, ran.stderr
