"""Every example against a simulated device runs, by the commands that stand in its head."""

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

# No watchdog may trip: on a computer with four at a time a device was late once.
pytestmark = pytest.mark.matrix

EXAMPLES = Path(__file__).parents[1] / "examples"
LONGEST_S = 25.0
"""Until every short script has armed and moved, on a busy machine, too."""

MOVED_M = 1e-3
"""Length of the path from which the arm has moved."""

GOES_ON_S = 1.5
"""How long a session goes on then: as long as the first strokes of every short script."""

PRESSED_N = 0.4
"""Least force felt of a hand that presses against something; for plugins/."""

SCRIPTS = {
    "gamepad-ur5-simulated.toml": "short",
    "keyboard-ur5-simulated.toml": "short",
    "spacemouse-ur5-simulated.toml": "strokes",
    "spnav-ur5-simulated.toml": "strokes",
}
"""Scripts that show more in a short time than ``demo`` does, by the examples of their devices."""

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
"""All others, and the script whose hand moves each device."""

LIGHTS = {
    "spacemouse-ur5-simulated.toml": ("LED on", "LED off"),
    "spnav-ur5-simulated.toml": ("LED on", "LED off"),
}
"""Output of the simulated device when its light goes on, and when it goes out."""

STROKES = """
0.1  axes 0 0 0.2 0 0 0 over 0.05
0.2  neutral over 0.05
0.5  press first
0.6  swing 0.5 0 0 0 0 0 over 0.6
1.3  release first
1.6  loop
"""
"""For devices whose scripts may be under way when the session starts."""


def commands(text):
    """The commands in a file's head before the one that runs the session."""
    found = re.findall(r"^#   cardan (.*)$", text, re.MULTILINE)
    return found[: next(at for at, words in enumerate(found) if "run examples/" in words)]


def port_of_its_own(text):
    """`text` with a free port instead of EGM's usual one."""
    return text.replace("6510", str(free_ports()))


def supervised(name, shown, **more):
    """The outcome of an example's session, which ends a while after it has shown what it should."""
    end_s = []

    def show(snapshot):
        if shown(snapshot) and not end_s:
            end_s.append(time.monotonic() + GOES_ON_S)

    def goes_on():
        return not end_s or time.monotonic() < end_s[0]

    return supervise(load_config(Path(name)), LONGEST_S, show, goes_on, **more)


def is_a_device(peer):
    """Whether a hand moves the simulated peer of that name."""
    return issubclass(peers.load(peer).Options, DevicePeerOptions)


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run an example with its simulated device: the outcome, once the device has said `words` at
    last, in this order."""

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
    # Dark while the session waits, lit while the hand is on the robot, dark in the end.
    outcome = run(name, (dark, lit, dark) if lit else ())
    last = outcome.last
    assert (outcome.exit_code, last.error, last.arm.trips) == (EXIT_OK, "", 0), last.arm.message
    assert last.tracking.path_m > 1e-4, (last.arm.message, last.device.reason, last.diagnosis)


@contextlib.contextmanager
def served(words, said):
    """A command that prints READY; what it says on standard error goes to the end of `said`."""
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
    """Wait until the last lines of the log `said` that are among `words` are `words`."""
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
