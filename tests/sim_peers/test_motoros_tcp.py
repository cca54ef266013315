"""Sockets of the simulated controller, over loopback."""

from __future__ import annotations

import csv
import itertools
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cardan.errors import AddressError, ConfigurationError
from cardan.protocols.simple_message.codec import WireFormat
from cardan.protocols.simple_message.codes import MessageType, MotionCommand
from cardan.protocols.simple_message.framing import ByteOrder, FrameReader
from cardan.protocols.simple_message.messages import (
    Empty,
    JointFeedback,
    MotionCtrl,
    ReadIo,
    RobotStatus,
    request,
)
from cardan.sim_peers.motoros_controller import (
    MotorosControllerOptions,
    MotorosControllerPeer,
)
from tests.serving import in_a_thread
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

PING = request(Empty(), MessageType.PING)
READY = request(MotionCtrl(0, 7, MotionCommand.CHECK_MOTION_READY))
START = request(MotionCtrl(0, 2, MotionCommand.START_TRAJ_MODE))


class Client:
    """Blocking client of one port, with a deadline for every operation."""

    def __init__(self, port, byte_order=ByteOrder.LITTLE, host="127.0.0.1"):
        self.link = socket.create_connection((host, port), timeout=WITHIN_S)
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.wire = WireFormat(byte_order)
        self.reader = FrameReader(byte_order)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.link.close()

    def send(self, message):
        self.link.sendall(self.wire.encode(message))

    def next(self):
        """Return the next message; None if the other side has closed."""
        while (frame := self.reader.take()) is None:
            data = self.link.recv(4096)
            if not data:
                return None
            self.reader.feed(data)
        return self.wire.decode(frame)

    def ask(self, message):
        self.send(message)
        return self.next()


def serving(**changes):
    options = MotorosControllerOptions(**{"base_port": 0, "servo_on": True, **changes})
    return in_a_thread(MotorosControllerPeer(options))


@pytest.mark.real
@pytest.mark.parametrize("order", ByteOrder)
def test_the_three_ports_serve(order):
    with (
        serving(big_endian=order is ByteOrder.BIG) as peer,
        Client(peer.motion_port, order) as motion,
        Client(peer.state_port, order) as state,
        Client(peer.io_port, order) as io,
    ):
        assert peer.endpoint == f"127.0.0.1:{peer.motion_port}"
        assert len({peer.motion_port, peer.state_port, peer.io_port}) == 3
        assert motion.ask(PING).msg_type == MessageType.PING
        assert motion.ask(START).body[2:4] == (MotionCommand.START_TRAJ_MODE, 0)
        assert io.ask(request(ReadIo(11124), MessageType.MOTO_READ_IO_BIT)).body == (1, 0)
        messages = [state.next().body for _ in range(20)]
        assert [type(body) for body in messages] == [JointFeedback, RobotStatus] * 10


@pytest.mark.real
def test_a_second_motion_client_takes_over():
    with serving() as peer, Client(peer.motion_port) as first:
        assert first.ask(PING) is not None
        with Client(peer.motion_port) as second:
            assert second.ask(PING) is not None
            assert first.next() is None


def test_clients_that_go_in_any_way_do_no_harm():
    with serving() as peer:
        for attempt in range(12):
            clients = [Client(port) for port in (peer.motion_port, peer.state_port, peer.io_port)]
            for client in clients:
                client.link.sendall(PING.msg_type.to_bytes(1, "little") * attempt)
                if attempt % 3 == 0:
                    client.link.setsockopt(
                        socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
                    )
                elif attempt % 3 == 1:
                    client.link.shutdown(socket.SHUT_WR)
                client.link.close()
        with Client(peer.motion_port) as motion, Client(peer.state_port) as state:
            assert motion.ask(PING) is not None
            assert isinstance(state.next().body, JointFeedback)


def test_a_client_that_reads_nothing_is_dropped_and_the_others_are_served():
    with serving() as peer:
        small = socket.socket()
        small.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        small.settimeout(WITHIN_S)
        small.connect(("127.0.0.1", peer.motion_port))
        data = WireFormat().encode(READY) * 500

        def flood():
            deadline_s = time.monotonic() + WITHIN_S
            while time.monotonic() < deadline_s:
                small.sendall(data)

        with pytest.raises(ConnectionError):
            flood()
        small.close()
        assert any("does not read" in text for _, text in peer.servers.events)
        with Client(peer.motion_port) as motion:
            assert motion.ask(PING) is not None


def test_a_silent_controller_keeps_its_sockets_open():
    with serving(faults={"silent": 0.3}) as peer, Client(peer.state_port) as state:

        def listen():
            while state.next() is not None:
                pass

        state.link.settimeout(1.0)
        with pytest.raises(TimeoutError):
            listen()
        # The kernel still accepts connections, but no reply comes.
        with Client(peer.motion_port) as motion:
            motion.link.settimeout(0.2)
            with pytest.raises(TimeoutError):
                motion.ask(PING)


def test_connections_can_be_reset():
    with serving(faults={"reset": 0.2}) as peer, Client(peer.state_port) as state:

        def listen():
            while state.next() is not None:
                pass

        with pytest.raises(ConnectionResetError):
            listen()
        with Client(peer.state_port) as again:
            assert again.next() is not None


def test_a_taken_port_and_a_bad_log_are_named(tmp_path):
    with serving() as peer:
        port = peer.motion_port
        with pytest.raises(AddressError, match=f"cannot listen on 127.0.0.1:{port}"):
            MotorosControllerPeer(MotorosControllerOptions(base_port=port)).open()
    with pytest.raises(AddressError, match=r"cannot listen on nowhere\.invalid"):
        MotorosControllerPeer(MotorosControllerOptions(host="nowhere.invalid")).open()
    bad = MotorosControllerPeer(MotorosControllerOptions(log=str(tmp_path), base_port=0))
    with pytest.raises(ConfigurationError, match=r"^log: .* cannot be written"):
        bad.open()
    bad.step(time.monotonic() + 0.1)
    bad.close()


def test_who_cannot_listen_leaves_the_log_as_it_is(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("of another one\n")
    with serving() as peer:
        options = MotorosControllerOptions(base_port=peer.motion_port, log=str(path))
        with pytest.raises(AddressError):
            MotorosControllerPeer(options).open()
    assert path.read_text() == "of another one\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_log_that_cannot_be_written_ends_and_nothing_else(caplog):
    with serving(log="/dev/full", ipc_s=0.001) as peer, Client(peer.motion_port) as motion:
        deadline_s = time.monotonic() + WITHIN_S
        while not caplog.records and time.monotonic() < deadline_s:
            assert motion.ask(PING).msg_type == MessageType.PING
        for _ in range(20):
            assert motion.ask(PING).msg_type == MessageType.PING
    (record,) = [each for each in caplog.records if each.levelname == "ERROR"]
    assert record.getMessage().startswith("/dev/full ends here, it cannot be written: No space")


def test_it_can_be_opened_again():
    peer = MotorosControllerPeer(MotorosControllerOptions(base_port=0))
    peer.open()
    peer.open()
    peer.close()
    peer.close()
    assert peer.endpoint == "127.0.0.1:0"
    fixed = MotorosControllerPeer(MotorosControllerOptions())
    assert (fixed.motion_port, fixed.state_port, fixed.io_port) == (50240, 50241, 50242)


def test_every_interpolation_cycle_becomes_a_row(tmp_path):
    path = tmp_path / "cycles.csv"
    peer = MotorosControllerPeer(MotorosControllerOptions(base_port=0, log=str(path)))
    peer.open()
    for _ in range(3):
        peer.step(time.monotonic() + 0.1)
    peer.close()
    with path.open() as file:
        header, *rows = csv.reader(file)
    assert header[0] == "monotonic_s"
    assert {len(row) for row in rows} == {len(header)}
    times = [float(row[0]) for row in rows]
    assert len(times) > 10
    gaps = sorted(b - a for a, b in itertools.pairwise(times))
    assert gaps[len(gaps) // 2] == pytest.approx(0.004, abs=1e-4)


def test_the_command_serves_it(tmp_path):
    path = tmp_path / "cycles.csv"
    arguments = ("--base-port", "0", "--seconds", "20", "--big-endian", "--log", str(path))
    command = [sys.executable, "-m", "cardan", "sim", "motoman-gp8", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            ready, endpoint = process.stdout.readline().split()
            assert ready == "READY"
            with Client(int(endpoint.split(":")[1]), ByteOrder.BIG) as motion:
                assert motion.ask(PING).msg_type == MessageType.PING
        finally:
            process.terminate()
    assert process.returncode == 0
    assert path.read_text().startswith("monotonic_s,")
