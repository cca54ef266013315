"""Registrations of the installed plug-in, and its examples, run by their own commands."""

import contextlib
import dataclasses
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import cardan_omni
from cardan.conform import registry as suites
from cardan.demos.demo import haptic_limits, run_demo, with_delay
from cardan.demos.examples import example_files, find_demos
from cardan.drivers import registry as drivers
from cardan.errors import ConfigurationError
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import EXIT_OK
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.sim_peers import registry as peers
from cardan_omni.driver import Omni, OmniOptions
from tests.demos.test_demo import DRAWN, pretend
from tests.test_device_examples import PRESSED_N, port_of_its_own, supervised

EXAMPLES = Path(cardan_omni.__file__).parent / "examples"


def test_all_of_it_is_found_by_name():
    assert drivers.load("omni") is Omni
    assert Omni.peer in peers.names()
    assert "hdapi" in suites.names()
    demos = find_demos()
    assert all("omni" in demos[name].drivers for name in ("omni", "omni-sphere", "omni-ur5"))
    assert demos["omni-remote"].drivers == {"remote", "sim_arm"}
    assert {file for file in example_files() if file.parent == EXAMPLES} == {*EXAMPLES.iterdir()}


def test_a_hand_that_drew_is_reported_what_it_felt(monkeypatch, capsys):
    pretend(monkeypatch, dataclasses.replace(DRAWN, finished=True))
    assert run_demo(10.0, "omni") == EXIT_OK
    said = " ".join(capsys.readouterr().out.split())
    assert "felt the board, 0.90 N at most" in said
    assert "given at most 1.00 mJ in one engagement, of the 5 mJ" in said


def test_the_limits_that_a_demo_is_held_against_are_those_of_the_options():
    limits = Omni(OmniOptions(clamp_n=1.5, energy_budget_j=0.004)).feedback_limits
    assert (limits.force_n, limits.energy_j) == (1.5, 0.004)


def test_a_demo_that_would_not_begin_says_how_long_it_needs():
    with pytest.raises(ConfigurationError) as caught:
        run_demo(5.0, "omni")
    assert str(caught.value) == "--seconds: 5 are too few for this demo; allowed: 10 or more"


@pytest.mark.matrix
def test_the_drawing_runs_and_is_felt():
    # On a busy machine other problems are tolerated, but none with the force and the energy.
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


def test_a_hand_far_away_is_held_against_the_limits_of_its_own_device(tmp_path):
    demo = find_demos()["omni-remote"]
    tables, launches = demo.prepare(tmp_path)
    limits = haptic_limits(demo, parse_config(tables))
    assert limits == Omni(OmniOptions()).feedback_limits
    share, network = (" ".join(words) for words in launches)
    far = re.search(r"--listen tcp/(\S+)", share)[1]
    assert f"--listen 127.0.0.1:{tables['device']['port']} --to {far} --delay 60" in network
    assert "--delay 5" in " ".join(with_delay(demo, 5.0).prepare(tmp_path)[1][1])


@pytest.mark.matrix
def test_a_wall_far_away_is_felt_as_stiff_as_it_is():
    ran = subprocess.run(
        [sys.executable, "-m", "cardan", "demo", "omni-remote", "--seconds", "35"],
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    # On a busy machine other problems are tolerated, but none with the force and the energy.
    assert ran.returncode in (0, 4), ran.stderr
    for never in ("above", "given", "no contact"):
        assert never not in ran.stderr, ran.stderr
    found = re.search(
        r"rendered stiffness, depth of the hand *\S +(\d+) N/m, ([\d.]+) mm", ran.stdout
    )
    assert found, ran.stdout + ran.stderr
    # Scales of motion and force, times the wall's stiffness: 0.25 * 0.03 * 8000 N/m.
    assert float(found[1]) == pytest.approx(60.0, rel=0.25), ran.stdout
    assert 10.0 < float(found[2]) < 40.0


@pytest.mark.matrix
@pytest.mark.parametrize(
    "name",
    sorted(
        each.name
        for each in EXAMPLES.glob("*-simulated.toml")
        if each.name != "omni-remote-simulated.toml"  # The example's demo runs the same programs.
    ),
)
def test_the_haptic_example_runs_and_is_felt(name, tmp_path, monkeypatch):
    for path in EXAMPLES.iterdir():  # An example may refer to another one.
        (tmp_path / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    text = port_of_its_own((EXAMPLES / name).read_text(encoding="utf-8"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(text, encoding="utf-8")
    *others, last = re.findall(r"^#   (cardan .*)$", text, re.MULTILINE)
    device, dashes, run = last.partition(" -- ")
    assert (dashes, run) == (" -- ", f"cardan run {name}")
    through = (sys.executable, "-m", *shlex.split(device), "--")
    with contextlib.ExitStack() as peers:
        for command in others:
            words = shlex.split(command)[1:]
            if words[:2] == ["devices", "force"]:
                peers.enter_context(waiting(words))
            else:
                to = re.search(r"listen_port = (\d+)", text)[1]
                peers.enter_context(
                    cardan_subprocess(*words, "--to", f"127.0.0.1:{to}", "--seconds", "40")
                )
        outcome = supervised(name, lambda seen: seen.force.peak_n > PRESSED_N, through=through)
    last = outcome.last
    assert (outcome.exit_code, last.error, last.arm.trips) == (EXIT_OK, "", 0), last.arm.message
    assert PRESSED_N < last.force.peak_n <= OmniOptions().clamp_n, last.diagnosis
    assert last.force.state == "enabled", last.force.reason


@contextlib.contextmanager
def waiting(words):
    """Run a command that waits for a later session, and ends with it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "cardan", *words, "--seconds", "40"], stdout=subprocess.DEVNULL
    )
    try:
        yield
        assert process.wait(5.0) == EXIT_OK
    finally:
        process.kill()
        process.wait()
