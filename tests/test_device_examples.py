"""Every example with a simulated device runs, by the commands in its head."""

import contextlib
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cardan.demos.examples import free_ports
from cardan.gateway.session.assembly import load_config
from cardan.gateway.session.session import EXIT_OK
from cardan.gateway.session.supervisor import supervise
from cardan.sim_peers import registry as peers
from cardan.sim_peers.device_peer import DevicePeerOptions

# On a computer with four such tests at a time, a device was late once: no watchdog may trip.
pytestmark = pytest.mark.matrix

EXAMPLES = Path(__file__).parents[1] / "examples"
LONGEST_S = 25.0
"""Time limit until every short script has armed and moved, even on a busy computer."""

MOVED_M = 1e-3
"""Path length that counts as motion."""

GOES_ON_S = 1.5
"""Duration of a session after that: as long as the first strokes of every short script."""

PRESSED_N = 0.4
"""Least feedback force while a device presses against an obstacle; used by tests of plugins/."""

SCRIPTS = {
    "gamepad-ur5-simulated.toml": "short",
    "keyboard-ur5-simulated.toml": "short",
    "spacemouse-ur5-simulated.toml": "strokes",
    "spnav-ur5-simulated.toml": "strokes",
}
"""Scripts that show more in a short time than ``demo``, by example."""

TESTED_ELSEWHERE = {
    "console-gofa-simulated.toml",
    "lab-simulated.toml",
    "ros2-gofa-simulated.toml",
    "spacemouse-gofa-simulated.toml",
    "spacemouse-gp8-simulated.toml",
    "verbs-ur5-simulated.toml",
}

DEVICES = {
    path.name: SCRIPTS.get(path.name, "demo")
    for path in sorted(EXAMPLES.glob("*-simulated.toml"))
    if path.name not in TESTED_ELSEWHERE
}
"""All other examples, with the script of each device."""

LIGHTS = {
    "spacemouse-ur5-simulated.toml": ("LED on", "LED off"),
    "spnav-ur5-simulated.toml": ("LED on", "LED off"),
}
"""Messages of the simulated device when its light goes on, and when it goes out."""

STROKES = """
0.1  axes 0 0 0.2 0 0 0 over 0.05
0.2  neutral over 0.05
0.5  press first
0.6  swing 0.5 0 0 0 0 0 over 0.6
1.3  release first
1.6  loop
"""
"""Script for devices whose scripts may have begun before the session starts."""


def commands(text):
    """Return the commands in a file's head before the one that runs the session."""
    found = re.findall(r"^#   cardan (.*)$", text, re.MULTILINE)
    return found[: next(at for at, words in enumerate(found) if "run examples/" in words)]


def port_of_its_own(text):
    """Return `text` with a free port in place of EGM's usual one."""
    return text.replace("6510", str(free_ports()))


def supervised(name, shown, **more):
    """Run an example's session until a while after it has shown everything; return the outcome."""
    end_s = []

    def show(snapshot):
        if shown(snapshot) and not end_s:
            end_s.append(time.monotonic() + GOES_ON_S)

    def goes_on():
        return not end_s or time.monotonic() < end_s[0]

    return supervise(load_config(Path(name)), LONGEST_S, show, goes_on, **more)


def is_a_device(peer):
    """Return whether the simulated peer of that name is a device."""
    return issubclass(peers.load(peer).Options, DevicePeerOptions)


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run an example with its simulated device; return the outcome once the device has printed
    `words` last, in this order."""

    def run(name, words=()):
        text = port_of_its_own((EXAMPLES / name).read_text(encoding="utf-8"))
        monkeypatch.chdir(tmp_path)
        (tmp_path / name).write_text(text, encoding="utf-8")
        (tmp_path / "strokes").write_text(STROKES, encoding="utf-8")
        (tmp_path / "examples").symlink_to(EXAMPLES)
        said = tmp_path / "said"
        with contextlib.ExitStack() as peers:
            for command in commands(text):
                arguments = shlex.split(command.partition("  #")[0])
                if arguments[0] == "sim" and is_a_device(arguments[1]):
                    arguments = [word for word in arguments if word != "--keyboard"]
                    arguments += ["--script", DEVICES[name]]
                peers.enter_context(served(arguments, said))
            outcome = supervised(name, lambda snapshot: snapshot.tracking.path_m > MOVED_M)
            wait_until_said(said, words)
        return outcome

    return run


@pytest.mark.parametrize("name", DEVICES)
def test_the_example_runs(run, name):
    lit, dark = LIGHTS.get(name, ("", ""))
    # The light is off while the session waits, on while the device moves the robot, off at the end.
    outcome = run(name, (dark, lit, dark) if lit else ())
    last = outcome.last
    assert (outcome.exit_code, last.error, last.arm.trips) == (EXIT_OK, "", 0), last.arm.message
    assert last.tracking.path_m > 1e-4, (last.arm.message, last.device.reason, last.diagnosis)


@contextlib.contextmanager
def served(words, said):
    """Run a command that prints READY; its standard error is appended to `said`."""
    with said.open("a") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "cardan", *words, "--seconds", "40"],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
    try:
        assert process.stdout.readline().startswith("READY "), said.read_text()
        yield
    finally:
        process.terminate()
        process.wait(5.0)
        process.stdout.close()


def wait_until_said(said, words):
    """Wait until the last lines in the log `said` that are among `words` equal `words`."""
    give_up_s = time.monotonic() + 5.0
    while True:
        found = [line.rpartition(": ")[2] for line in said.read_text().splitlines()]
        found = [word for word in found if word in words]
        if found[-len(words) :] == list(words):
            return
        assert time.monotonic() < give_up_s, said.read_text()
        time.sleep(0.01)


def test_no_example_is_forgotten():
    assert SCRIPTS.keys() <= DEVICES.keys()
    assert {path.name for path in EXAMPLES.glob("*-simulated.toml")} == {
        *DEVICES,
        *TESTED_ELSEWHERE,
    }
