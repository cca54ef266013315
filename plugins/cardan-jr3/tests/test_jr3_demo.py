"""Registrations of the installed plug-in, and its examples, run by their own commands."""

import re
import shlex
import sys
from pathlib import Path

import pytest

import cardan_jr3
from cardan.conform import registry as suites
from cardan.demos.examples import find_demos, free_ports
from cardan.drivers import registry as drivers
from cardan.gateway.session.assembly import load_config
from cardan.gateway.session.session import EXIT_OK
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.sim_peers import registry as peers
from cardan_jr3.driver import Jr3
from cardan_jr3.protocol import CanFrame
from cardan_omni.driver import OmniOptions
from cardan_omni.peer.library import available
from tests.test_device_examples import MOVED_M, PRESSED_N, served, supervised

EXAMPLES = Path(cardan_jr3.__file__).parent / "examples"


def test_all_of_it_is_found_by_name():
    assert drivers.load("jr3_can") is Jr3
    assert Jr3.peer in peers.names()
    assert "jr3" in suites.names()
    demos = find_demos()
    assert all("jr3_can" in demos[name].drivers for name in ("jr3-ur5", "omni-jr3"))


def test_the_tap_gets_frames_with_their_identifier():
    sensor, given, heard = Jr3(), [CanFrame(0x181, bytes(8))], []

    class Bus:
        def receive(self, _timeout_s):
            return given.pop() if given else None

        def send(self, frame):
            pass

    sensor.raw_packet_callback = lambda *said: heard.append(said)
    sensor._turn(Bus())
    assert (bytes(8), False, "can 0x181") in heard


def test_the_example_takes_the_sensors_force():
    config = load_config(EXAMPLES / "omni-jr3-simulated.toml")
    assert config.force.source == "sensor"
    assert config.force.sensor.driver == "jr3_can"


@pytest.fixture
def example(tmp_path, monkeypatch):
    """Adapt an example to a bus served by socketcand, because multicast may be unavailable. Return
    the commands of its header: the simulated sensor's, and the others."""

    def example(name):
        port = free_ports()
        text = (EXAMPLES / name).read_text(encoding="utf-8")
        text = text.replace(
            'interface = "udp_multicast"', f'interface = "socketcand"\nport = {port}'
        )
        text = text.replace('channel = "239.74.163.2"\n', 'host = "127.0.0.1"\n')
        monkeypatch.chdir(tmp_path)
        Path(name).write_text(text, encoding="utf-8")
        sensor, then = re.findall(r"^#   cardan (.*)$", text, re.MULTILINE)
        serve = ["--serve-socketcand", "--port", str(port), "--boot", "0"]
        return [*shlex.split(sensor), *serve], then

    return example


@pytest.mark.matrix
def test_what_pushes_the_sensor_moves_the_arm(example, tmp_path):
    name = "jr3-ur5-simulated.toml"
    sensor, then = example(name)
    assert then == f"run {name}"
    with served(sensor, tmp_path / "said"):
        outcome = supervised(name, lambda snapshot: snapshot.tracking.path_m > MOVED_M)
    last = outcome.last
    assert (outcome.exit_code, last.error, last.arm.trips) == (EXIT_OK, "", 0), last.arm.message
    assert last.tracking.path_m > 1e-4, (last.arm.message, last.device.reason, last.diagnosis)


@pytest.mark.matrix
@pytest.mark.skipif(not available(), reason="the simulated libHD was not compiled")
def test_what_pushes_the_sensor_is_felt(example):
    name = "omni-jr3-simulated.toml"
    sensor, then = example(name)
    device, dashes, run = then.partition(" -- ")
    assert (dashes, run) == (" -- ", f"cardan run {name}")
    through = (sys.executable, "-m", "cardan", *shlex.split(device), "--")
    with cardan_subprocess(*sensor, "--seconds", "40"):
        outcome = supervised(name, lambda seen: seen.force.peak_n > PRESSED_N, through=through)
    last = outcome.last
    assert (outcome.exit_code, last.error, last.arm.trips) == (EXIT_OK, "", 0), last.arm.message
    assert PRESSED_N < last.force.peak_n <= OmniOptions().clamp_n, last.diagnosis
    assert last.force.state == "enabled", last.force.reason
