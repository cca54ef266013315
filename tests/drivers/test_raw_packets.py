"""Raw-packet callback of every driver that exchanges bytes: it gets them unchanged."""

import socket
import threading

import pytest

from cardan.drivers.abb_egm import AbbEgm
from cardan.drivers.gamepad import Gamepad
from cardan.drivers.motoros import Motoros
from cardan.drivers.sim_arm import SimArm
from cardan.drivers.spacemouse import SpaceMouse
from cardan.drivers.spnav import Spnav
from cardan.drivers.tcp_robot import TcpConnection
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions
from cardan.types import HoldCommand


class Packets(list):
    def __call__(self, data, sent, connection):
        assert type(data) is bytes
        self.append((data, sent, connection))


@pytest.fixture
def packets():
    return Packets()


class Link:
    """Link that returns the items of `given` one at a time, then ends the reader."""

    def __init__(self, *given):
        self.stop = threading.Event()
        self.given, self.written = list(given), []

    def read(self, _timeout_s):
        if self.given:
            return self.given.pop(0)
        self.stop.set()
        return None

    def write(self, data):
        self.written.append(data)

    send = write

    def answers(self, _timeout_s):
        return True


def test_without_one_there_is_none():
    assert SimArm().raw_packet_callback is None
    assert SpaceMouse().raw_packet_callback is None


def test_datagrams_of_the_simulated_arm(packets):
    with SimArm(pacing="virtual") as robot:
        robot.raw_packet_callback = packets
        for number, _ in enumerate(robot.cycles()):
            robot.send(HoldCommand())
            if number == 5:
                break
    # A keepalive, then a state and its answer each; and final commands.
    assert [sent for _, sent, _ in packets[:13]] == [True] + 6 * [False, True]
    assert packets[13:]
    assert all(sent for _, sent, _ in packets[13:])


@pytest.mark.real
def test_datagrams_of_egm(packets):
    controller = EgmController(EgmControllerOptions())
    with (
        AbbEgm(listen_host="127.0.0.1", listen_port=0) as robot,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs,
    ):
        robot.raw_packet_callback = packets
        theirs.bind(("127.0.0.1", 0))
        cycles = robot.cycles()
        sent, answers = [], []
        for number in range(1, 4):
            sent.append(controller.cycle(0.004 * number))
            theirs.sendto(sent[-1], robot.endpoint)
            next(cycles)
            robot.send(HoldCommand())
            answers.append(theirs.recv(2000))
        assert packets == [
            entry
            for data, answer in zip(sent, answers, strict=True)
            for entry in ((data, False, ""), (answer, True, ""))
        ]
        cycles.close()


@pytest.mark.real
def test_messages_of_motoros_with_their_connection(packets):
    ours, theirs = socket.socketpair()
    robot = Motoros(host="127.0.0.1")
    robot.raw_packet_callback = packets
    with ours, theirs:
        ours.setblocking(False)
        link = TcpConnection(ours, 0.0)
        robot._links["state"] = link
        theirs.send(b"\0\0\0\4abcd")
        robot._receive(robot._session, "state", link)
        robot._session._out.append(("state", b"\0\0\0\4efgh"))
        robot._flush(robot._session)
        assert theirs.recv(100).endswith(b"efgh")
    assert packets == [(b"\0\0\0\4abcd", False, "state"), (b"\0\0\0\4efgh", True, "state")]


def test_reports_of_a_spacemouse(packets):
    mouse = SpaceMouse()
    mouse.raw_packet_callback = packets
    mouse._take(bytes(7))
    assert packets == [(bytes(7), False, "")]


def test_packets_of_a_gamepad(packets):
    pad, link = Gamepad(), Link(bytes(24))
    pad.raw_packet_callback, pad._link = packets, link
    pad._serve(link.stop)
    assert packets == [(bytes(24), False, "")]


def test_bytes_of_spacenavd(packets):
    ours, theirs = socket.socketpair()
    navigator = Spnav()
    navigator.raw_packet_callback = packets
    with ours, theirs:
        theirs.send(bytes(32))
        navigator._exchange(ours, 1.0)
    assert packets == [(bytes(32), False, "")]
