"""Registrations of the installed plug-in, and its examples, run by their own commands."""

import contextlib
import re
import shlex
from pathlib import Path

import pytest

import cardan_leap
from cardan.conform import registry as suites
from cardan.demos.examples import find_demos, free_ports
from cardan.drivers import registry as drivers
from cardan.gateway.session.session import EXIT_OK
from cardan.sim_peers import registry as peers
from cardan_leap.driver import Leap
from tests.test_device_examples import MOVED_M, port_of_its_own, served, supervised

EXAMPLES = Path(cardan_leap.__file__).parent / "examples"


def test_all_of_it_is_found_by_name():
    assert drivers.load("leap") is Leap
    assert Leap.peer in peers.names()
    assert "leap" in suites.names()
    demos = find_demos()
    assert all("leap" in demos[name].drivers for name in ("leap-ur5", "leap-gofa"))


@pytest.mark.matrix
@pytest.mark.parametrize("path", sorted(EXAMPLES.iterdir()), ids=lambda path: path.stem)
def test_the_example_runs(path, tmp_path, monkeypatch):
    port = str(free_ports())
    text = port_of_its_own(path.read_text(encoding="utf-8")).replace("6437", port)
    text = text.replace('driver = "leap"', f'driver = "leap"\nport = {port}')
    monkeypatch.chdir(tmp_path)
    Path(path.name).write_text(text, encoding="utf-8")
    service, *others, then = re.findall(r"^#   cardan (.*)$", text, re.MULTILINE)
    assert then == f"run {path.name}"
    said = tmp_path / "said"
    with contextlib.ExitStack() as peers:
        # The script repeats, because the session may be ready later than the hand.
        for words in (f"{service} --script clutching", *others):
            peers.enter_context(served(shlex.split(words), said))
        outcome = supervised(path.name, lambda snapshot: snapshot.tracking.path_m > MOVED_M)
    last = outcome.last
    assert (outcome.exit_code, last.error, last.arm.trips) == (EXIT_OK, "", 0), last.arm.message
    assert last.tracking.path_m > 1e-4, (last.arm.message, last.device.reason, last.diagnosis)
