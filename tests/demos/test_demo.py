"""The demos: programs that they start, and faults that they report."""

import contextlib
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from cardan.common.haptics import FeedbackLimits
from cardan.common.tables import read_toml
from cardan.demos import demo
from cardan.demos.demo import (
    EXIT_INCOMPLETE,
    FORCE_AGE_S,
    HELD_SHARE,
    PAUSE_S,
    choose_demo,
    find_problems,
    find_remarks,
    run_demo,
    simulated_hardware,
    with_delay,
)
from cardan.demos.examples import find_demos
from cardan.demos.peers import Peers
from cardan.errors import ConfigurationError, DriverError, OptionError
from cardan.gateway.session.session import EXIT_OK, STOPPED_ON_REQUEST
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.gateway.session.supervisor import SessionExit
from tests.gateway.force.fakes import FakeHaptic
from tests.snapshots import changed

MOVED = Snapshot.of(
    {
        "loop": {"cycles": 1000},
        "tracking": {"path_m": 0.1, "error_max_m": 0.004},
        "robot": {"metrics": {}},
    }
)
DRAWN = changed(
    MOVED,
    force__state="enabled",
    force__peak_n=0.9,
    force__energy_given_j=-0.02,
    force__energy_given_peak_j=0.001,
    elapsed_s=25.0,
    force__measured_age_p50_s=0.004,
    force__measured_age_p99_s=0.005,
    contact__force_n=5.5,
    contact__time_s=10.0,
    contact__path_m=0.2,
    contact__mean_n=5.5,
    contact__target_n=5.6,
    contact__rms_error_n=0.6,
)


LIMITS = FeedbackLimits(force_n=2.0, energy_j=0.005)


def test_what_went_well_is_not_found_fault_with():
    assert find_problems(MOVED) == []
    assert find_problems(DRAWN, LIMITS) == []


@pytest.mark.parametrize(
    ("lack", "words"),
    [
        ({"loop__cycles": 0}, "never commanded"),
        ({"tracking__path_m": 0.0}, "no path"),
        ({"tracking__error_max_m": 0.03}, "30.0 mm away"),
        ({"arm__trips": 2}, "2 times"),
    ],
)
def test_what_any_demo_may_lack(lack, words):
    for good, options in ((MOVED, None), (DRAWN, LIMITS)):
        (found,) = find_problems(changed(good, **lack), options)
        assert words in found


def test_an_arm_that_nobody_need_move_may_rest(monkeypatch, capsys):
    rested = changed(MOVED, finished=True, tracking__path_m=0.0)
    assert find_problems(rested, may_rest=True) == []
    pretend(monkeypatch, rested)
    assert run_demo(10.0, "console") == EXIT_OK
    said = capsys.readouterr().out
    assert "open the page, press *Enable motion*" in said
    assert "server console: http://127.0.0.1:8443" in said
    assert "nobody moved the arm" in said
    assert run_demo(10.0, "gofa") == EXIT_INCOMPLETE
    (found,) = find_problems(changed(rested, loop__cycles=0), may_rest=True)
    assert "never commanded" in found


@pytest.mark.parametrize(
    ("lack", "words"),
    [
        ({"contact__path_m": 0.0}, "nothing was drawn"),
        ({"contact__rms_error_n": HELD_SHARE * 5.6 + 0.1}, "1.5 N RMS away"),
        ({"force__peak_n": 0.0}, "no force was rendered"),
        ({"force__peak_n": LIMITS.force_n + 0.1}, "force was 2.10 N, above 2 N"),
        (
            {"force__energy_given_peak_j": LIMITS.energy_j + 0.001},
            "given up to 6.0 mJ in one engagement (bound: 5 mJ)",
        ),
        (
            {"force__losses": 1, "force__lost_reason": "the motors are hot"},
            "1 times there was no force: the motors are hot",
        ),
        (
            {"force__out_s": 0.5, "force__lost_reason": "the tick was late"},
            "without force for 0.50 s: the tick was late",
        ),
        ({"force__measured_age_p99_s": FORCE_AGE_S + 0.005}, "15.0 ms old"),
        ({"force__state": "fault", "force__reason": "too fast"}, "fault at the end: too fast"),
    ],
)
def test_what_a_drawing_may_lack(lack, words):
    (found,) = find_problems(changed(DRAWN, **lack), LIMITS)
    assert words in found


def test_a_hand_far_away_has_to_feel_a_contact_and_no_age_of_it_is_known():
    felt = changed(DRAWN, force__rendered_stiffness_n_m=60.0, force__measured_age_p99_s=0.3)
    assert find_problems(felt, LIMITS, far=True) == []
    untouched = changed(felt, force__rendered_stiffness_n_m=None)
    assert find_problems(untouched, LIMITS, far=True) == ["no contact of the tool was rendered"]
    (found,) = find_problems(felt, LIMITS)
    assert "300.0 ms old" in found
    assert find_remarks(felt, LIMITS, far=True, paused_s=1.0) == []


def test_a_delay_is_for_a_demo_with_a_network():
    with pytest.raises(ConfigurationError, match="the demo gofa has no simulated network"):
        run_demo(10.0, "gofa", delay_ms=10.0)
    demo = with_delay(choose_demo("omni-remote"), 10.0)
    assert demo.delay_ms == 10.0
    with pytest.raises(OptionError, match="--delay: 300"):
        with_delay(demo, 300.0)


def test_a_device_without_a_bound_of_its_energy_is_held_against_its_force_alone():
    given = changed(DRAWN, force__energy_given_peak_j=9.0)
    assert find_problems(given, FeedbackLimits(2.0)) == []
    (found,) = find_problems(changed(given, force__peak_n=2.1), FeedbackLimits(2.0))
    assert "above 2 N" in found


@pytest.mark.parametrize(
    ("felt", "words"),
    [
        (
            LIMITS,
            "0.90 N at most: it was given at most 1.00 mJ in one engagement, of the 5 mJ "
            "that passivity allows",
        ),
        (FeedbackLimits(2.0), "0.90 N at most"),
    ],
)
def test_what_a_hand_felt_is_reported(monkeypatch, capsys, felt, words):
    device = FakeHaptic()
    device.feedback_limits = felt
    monkeypatch.setattr(demo, "make_device", lambda config: device)
    pretend(monkeypatch, changed(DRAWN, finished=True))
    assert run_demo(10.0, "gofa") == EXIT_OK
    said = " ".join(capsys.readouterr().out.split())
    _, _, reported = said.partition(f"{choose_demo('gofa').success_message}, ")
    assert reported == words


def test_an_unknown_demo_is_refused_with_the_known_ones():
    with pytest.raises(ConfigurationError, match=r"allowed: .*gofa, gp8, .*so101, "):
        run_demo(1.0, "teo")


@pytest.mark.parametrize(
    ("name", "seconds", "words"),
    [
        ("spnav-ur5", 20.0, "20 are too few for this demo; allowed: 25 or more"),
    ],
)
def test_a_demo_that_would_not_begin_says_how_long_it_needs(name, seconds, words):
    with pytest.raises(ConfigurationError) as caught:
        run_demo(seconds, name)
    assert str(caught.value) == f"--seconds: {words}"


@pytest.mark.parametrize(
    ("last", "code"),
    [
        (Snapshot(finished=True, ending="the session's time limit is reached"), EXIT_INCOMPLETE),
        (Snapshot(finished=True, ending=STOPPED_ON_REQUEST), EXIT_OK),
        (Snapshot.of({"arm": {"message": "stopped before it began"}}), EXIT_OK),
    ],
)
def test_a_demo_that_was_ended_before_its_time_is_not_judged(monkeypatch, capsys, last, code):
    pretend(monkeypatch, last)
    assert run_demo(10.0, "gofa") == code
    assert ("not judged" in capsys.readouterr().out) is (code == EXIT_OK)


class Served:
    """Stand-in for a server."""

    before, endpoint = (), "http://127.0.0.1:8443"


def pretend(monkeypatch, last):
    """Replace the session by one that ends with this snapshot and runs nothing."""
    monkeypatch.setattr(Peers, "start", lambda *_: None)
    monkeypatch.setattr(demo, "with_server", lambda *_: contextlib.nullcontext(Served()))
    monkeypatch.setattr(demo, "supervise", lambda *_, **__: SessionExit(EXIT_OK, last))


def test_what_found_fault_with_is_said(monkeypatch, capsys):
    pretend(monkeypatch, changed(MOVED, finished=True, arm__trips=2))
    assert run_demo(10.0, "gofa") == EXIT_INCOMPLETE
    assert "cardan demo: teleoperation was disengaged 2 times" in capsys.readouterr().err


class StoodStill:
    """Pause detector with given pauses."""

    longest_s = 0.13

    def __enter__(self):
        return self

    def __exit__(self, *_exception):
        pass


def test_what_comes_of_a_computer_that_stood_still_is_no_problem_of_the_demo(monkeypatch, capsys):
    pretend(monkeypatch, changed(MOVED, finished=True, arm__trips=1, tracking__path_m=0.0))
    monkeypatch.setattr(demo, "Pauses", StoodStill)
    assert run_demo(10.0, "gofa") == EXIT_OK
    said = "not judged, because this computer stalled for 130 ms: teleoperation was disengaged 1"
    assert said in capsys.readouterr().err
    pretend(monkeypatch, changed(MOVED, finished=True, arm__trips=1, tracking__error_max_m=0.03))
    assert run_demo(10.0, "gofa") == EXIT_INCOMPLETE
    assert "30.0 mm away" in capsys.readouterr().err


@pytest.mark.parametrize(
    "change",
    [
        {"arm__trips": 2},
        {"force__losses": 1, "force__lost_reason": "the tick was late"},
        {"force__out_s": 0.5, "force__lost_reason": "the tick was late"},
        {"force__measured_age_p99_s": FORCE_AGE_S + 0.005},
    ],
)
def test_a_pause_explains_what_is_late_and_nothing_else(change):
    late = changed(DRAWN, **change)
    assert find_problems(late, LIMITS, paused_s=PAUSE_S)
    assert find_remarks(late, LIMITS, paused_s=PAUSE_S) == []
    assert find_problems(late, LIMITS, paused_s=PAUSE_S + 0.001) == []
    assert len(find_remarks(late, LIMITS, paused_s=PAUSE_S + 0.001)) == 1
    for lack in ({"loop__cycles": 0}, {"tracking__error_max_m": 0.03}, {"force__peak_n": 0.0}):
        assert find_problems(changed(late, **lack), LIMITS, paused_s=1.0)


def test_a_file_that_is_no_demo_is_refused():
    file = choose_demo("gofa").file.with_name("spacemouse-gofa.toml")
    with pytest.raises(ConfigurationError, match="does not say how it runs without hardware"):
        run_demo(10.0, str(file))


@pytest.mark.matrix
def test_what_does_not_serve_is_reported(capsys):
    with (
        pytest.raises(DriverError, match="`cardan sim spacemouse` ended before it served"),
        cardan_subprocess("sim", "spacemouse"),
    ):
        pass
    assert "--hid" in capsys.readouterr().err


@pytest.mark.matrix
def test_what_a_demo_launches_serves_what_its_configuration_has():
    with simulated_hardware(choose_demo("gp8"), 1.0) as (config, through):
        assert config.robot is not None
        port = config.robot.options["state_port"]
        assert port != 50241
        with contextlib.closing(socket.create_connection(("127.0.0.1", port), 5.0)):
            assert through == ()


@pytest.mark.matrix
def test_a_server_is_served_beside_the_session_for_all_clients(capsys):
    """No client connects here."""
    assert run_demo(5.0, "ros2") == EXIT_OK
    said = capsys.readouterr().out
    assert re.search(r"server rosbridge: ws://127\.0\.0\.1:\d+", said)
    assert "move the arm by a client of that address" in said
    assert "nobody moved the arm" in said


def test_every_demo_names_the_extras_that_it_needs():
    pyproject = read_toml(Path(__file__).parents[2] / "pyproject.toml")
    known = set(pyproject["project"]["optional-dependencies"])
    for each in find_demos().values():
        assert set(each.extras) <= known, each.name
        text = each.file.read_text(encoding="utf-8")
        of_nodes = any(name.startswith(("phone", "remote", "ros2", "xr")) for name in each.drivers)
        on_a_network = of_nodes or "[network]" in text
        assert ("network" in each.extras) == on_a_network, each.name
        assert ("console" in each.extras) == ("console" in each.servers), each.name
        assert ("can" in each.extras) == ("jr3_can" in each.drivers), each.name


@pytest.mark.parametrize(("name", "extras"), [("ros2", "network\n"), ("gofa", "\n")])
def test_the_extras_of_a_demo_are_reported(name, extras):
    reported = subprocess.run(
        [sys.executable, "-m", "cardan", "demo", "--extras", name],
        capture_output=True,
        text=True,
        check=True,
    )
    assert reported.stdout == extras
