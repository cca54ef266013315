"""A whole session with filters: opened before the robot, obeyed, shown, and closed after."""

import socket

import pytest

from cardan.errors import AddressError
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import make_session
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.view import plain
from tests.gateway.session.test_view import render, shown


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def session(port, **options):
    return make_session(
        parse_config(
            {
                "device": {"driver": "fake_device"},
                "robot": {"driver": "fake_robot", "cycles": 300},
                "mapping": {"deadman": "go"},
                "filters": [{"filter": "proximity", "port": port, **options}],
            }
        )
    )


@pytest.mark.usefixtures("fake_drivers")
def test_without_its_sensor_nothing_moves_and_everyone_is_told(port):
    made = session(port)
    last = made.run()
    assert last.path_m == 0.0
    assert last.filters == ["no proximity reading yet: stopped"]
    assert any("nothing was heard" in line for line in last.diagnosis)
    assert not made.controller.hand.filters[0].listener.is_open
    again = Snapshot.from_bytes(last.to_bytes())
    assert again.filters == last.filters
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
