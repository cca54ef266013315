"""A whole session with filters: opened before the robot, applied, shown, and closed after the
robot."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

import cardan_filters
from cardan.errors import AddressError
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import make_session
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.terminal_view import plain
from cardan_filters.listener import DatagramListener
from tests.conftest import fake_drivers  # noqa: F401 - used by its name
from tests.gateway.session.test_terminal_view import render, shown
from tests.serving import free_udp_port

EXAMPLES = Path(cardan_filters.__file__).parent / "examples"


@pytest.fixture
def port():
    return free_udp_port()


def session(port=None, **options):
    place = {} if port is None else {"port": port}
    return make_session(
        parse_config(
            {
                "device": {"driver": "fake_device"},
                "robot": {"driver": "fake_robot", "cycles": 300},
                "mapping": {"deadman": "go"},
                "filters": [{"filter": "proximity", **place, **options}],
            }
        )
    )


@pytest.mark.usefixtures("fake_drivers")
def test_without_its_sensor_nothing_moves_and_everyone_is_reported(port):
    made = session(port)
    last = made.run()
    assert last.tracking.path_m == 0.0
    assert last.arm.filters == ("no proximity reading yet: stopped",)
    assert any("nothing was received" in line for line in last.diagnosis)
    assert not made.controller.operator.filters[0].listener.is_open
    again = Snapshot.from_bytes(last.to_bytes())
    assert again.arm.filters == last.arm.filters
    assert "no proximity reading yet: stopped" in plain(again)
    assert "no proximity reading yet: stopped" in shown(render(again))


@pytest.mark.usefixtures("fake_drivers")
@pytest.mark.parametrize(
    ("level", "share"), [(b"0", 1.0), (b"250", 0.5), (b"900", 0.0)], ids=["free", "near", "stop"]
)
def test_datagrams_decide_how_fast_it_moves(port, level, share):
    made = session(port, peak_filter=False)
    send = made.robot.send
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:

        def sense_and_send(command):
            sensor.sendto(level, ("127.0.0.1", port))
            send(command)

        made.robot.send = sense_and_send
        made.run()
    assert made.controller.reference.linear.x == pytest.approx(0.1 * share)


@pytest.mark.usefixtures("fake_drivers")
def test_a_port_that_cannot_be_had_ends_it_before_the_robot_is_opened(port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", port))
        made = session(port)
        with pytest.raises(AddressError, match="another filter or program"):
            made.run()
    assert not made.robot.commands
    assert not made.device.is_open


@pytest.mark.usefixtures("fake_drivers")
def test_another_program_does_not_hide_what_the_sensor_sees(port):
    made = session(port, peak_filter=False)
    send = made.robot.send
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):

        def sense_and_send(command):
            sensor.sendto(b"900", ("127.0.0.1", port))
            other.sendto(b"20", ("127.0.0.1", port))
            send(command)

        made.robot.send = sense_and_send
        last = made.run()
    assert last.tracking.path_m == 0.0
    assert last.arm.filters == ("proximity 900, above 800: stopped",)
    assert any("the most cautious one counts" in line for line in last.diagnosis)


@pytest.mark.usefixtures("fake_drivers")
def test_a_sensor_writes_to_a_socket_of_the_users(tmp_path):
    path = tmp_path / "skin.sock"
    made = session(socket=str(path), peak_filter=False)
    send = made.robot.send
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sensor:

        def sense_and_send(command):
            sensor.sendto(b"0", socket.MSG_DONTWAIT, str(path))
            send(command)

        made.robot.send = sense_and_send
        made.run()
    assert made.controller.reference.linear.x == pytest.approx(0.1)
    assert not path.exists()


def test_the_example_of_a_sensor_says_its_words(tmp_path):
    heard = []
    listener = DatagramListener(str(tmp_path / "s"), lambda data, *_: heard.append(data))
    listener.open()
    program = EXAMPLES / "say.py"
    with subprocess.Popen([sys.executable, program, tmp_path / "s", "0.4", "-0.3"]) as sensor:
        while not heard:
            listener.drain(0.0)
        sensor.terminate()
    listener.close()
    assert heard[0] == b"0.4 -0.3"
