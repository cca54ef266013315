"""The simulated JR3's shell: options, and its bus server, compatible with socketcand."""

import socket
import sys
import threading
import time

import pytest
from hypothesis import given, strategies as st

from cardan.errors import AddressError, ExtraMissingError, OptionError, ScriptError
from cardan_jr3.peer import Jr3Peer, Jr3PeerOptions, socketcand
from cardan_jr3.peer.socketcand import Session, SocketcandHub, frame_line
from cardan_jr3.protocol import CanFrame
from tests.serving import in_a_thread
from tests.sim_peers.backend_shell import BareShell
from tests.waiting import until

# -- the protocol ----------------------------------------------------------------------------------


def joined():
    session = Session()
    assert session.feed(b"< open can0 >< rawmode >") == (b"< ok >< ok >", [])
    return session


@pytest.mark.judged(device="JR3", transport="CAN over socketcand", by="worked bytes")
def test_worked_lines():
    assert joined().feed(b"< send 221 6 c8 0 10 27 0 0 >") == (
        b"",
        [CanFrame(0x221, bytes.fromhex("c80010270000"))],
    )
    line = frame_line(CanFrame(0x621, bytes.fromhex("5703ffff00403412")), 23.424242)
    assert line == b"< frame 621 23.424242 5703FFFF00403412 >"
    # Two spaces where there is no data, because clients count the words.
    assert frame_line(CanFrame(0x080, b""), 1.0) == b"< frame 080 1.000000  >"


def test_commands_may_come_in_pieces():
    session = joined()
    frames = []
    for byte in b"< send 080 0 >< send 121 1 ff >":
        frames += session.feed(bytes([byte]))[1]
    assert frames == [CanFrame(0x080, b""), CanFrame(0x121, b"\xff")]


@pytest.mark.parametrize(
    "line",
    [b"< send >", b"< send 800 0 >", b"< send 121 2 00 >", b"< send 00000121 1 00 >",
     b"< send 121 9 0 0 0 0 0 0 0 0 0 >", b"< send xyz 0 >", b"< send 121 1 100 >"],
)  # fmt: skip
def test_frames_that_are_none_are_refused(line):
    assert joined().feed(line) == (b"< error could not parse the frame >", [])


def test_a_client_must_join_before_it_sends():
    session = Session()
    assert session.feed(b"< rawmode >< send 080 0 >< nonsense >") == (
        b"< error unknown command >" * 3,
        [],
    )
    assert session.feed(b"< echo >") == (b"< echo >", [])


@given(st.binary(max_size=600))
def test_no_bytes_raise(data):
    for session in (Session(), joined()):
        replies, frames = session.feed(data)
        assert isinstance(replies, bytes)
        assert all(frame.arbitration_id <= 0x7FF for frame in frames)


def test_a_client_that_never_ends_a_command_is_let_go():
    session = joined()
    session.feed(b"<" + b"a" * 300)
    assert session.broken


# -- the server ------------------------------------------------------------------------------------


class Node:
    """A device on the hub's bus that receives frames."""

    node_id = 33

    def __init__(self):
        self.asked = []

    def receive(self, arbitration_id, data, now_s):
        self.asked.append(CanFrame(arbitration_id, data))


class Client:
    """A plain client of the hub."""

    def __init__(self, endpoint):
        host, _, port = endpoint.rpartition(":")
        self.sock = socket.create_connection((host, int(port)), 2.0)
        self.heard = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.sock.close()

    def join(self):
        self.expect(b"< hi >")
        self.sock.sendall(b"< open can0 >")
        self.expect(b"< ok >")
        self.sock.sendall(b"< rawmode >")
        self.expect(b"< ok >")

    def expect(self, words):
        end_s = time.monotonic() + 3.0
        while words not in self.heard:
            assert time.monotonic() < end_s, self.heard
            self.heard += self.sock.recv(4096)
        self.heard = self.heard[self.heard.index(words) + len(words) :]

    def closed(self):
        self.sock.settimeout(3.0)
        while self.sock.recv(65536):
            pass
        return True


@pytest.fixture
def served():
    options = Jr3PeerOptions(serve_socketcand=True, port=0, script="rest", boot_s=0.0)
    with in_a_thread(Jr3Peer(options)) as peer:
        yield peer


def test_every_client_hears_all_others_and_the_board(served):
    with Client(served.endpoint) as a, Client(served.endpoint) as b:
        for client in (a, b):
            client.join()
        a.sock.sendall(b"< send 421 0 >")
        b.expect(b"< frame 421 ")
        for client in (a, b):
            client.expect(b"< frame 121 ")
            client.expect(b" 00 >")
        b.sock.sendall(b"< send 7A1 4 0 0 48 c2 >")  # gripper command, not acknowledged
        a.expect(b" 000048C2 >")
        assert b"7A1" not in b.heard  # no node receives its own frames
    until(lambda: served.device.gripper_percent == -50.0, "the gripper's motion")


def test_a_client_that_goes_or_talks_nonsense_does_not_disturb(served):
    for junk in (b"", b"< open ca", b"<" * 400, b"\xff" * 400):
        with Client(served.endpoint) as client:
            client.sock.sendall(junk)
    with Client(served.endpoint) as client:
        client.join()
        client.sock.sendall(b"< send 421 0 >")
    with Client(served.endpoint) as good:
        good.join()
        good.sock.sendall(b"< send 421 0 >")
        good.expect(b"< frame 121 ")


def test_a_client_that_does_not_read_is_let_go(monkeypatch):
    monkeypatch.setattr(socketcand, "ROOM", 1 << 16)
    node, shell = Node(), BareShell()
    hub = SocketcandHub(node, "127.0.0.1", 0)
    hub.open(shell)
    try:
        with Client(hub.endpoint) as client:
            client.sock.sendall(b"< open can0 >< rawmode >")
            end_s = time.monotonic() + 30.0
            while not (hub.clients and hub.clients[0].session.raw):
                assert time.monotonic() < end_s
                shell.serve(hub, 0.05)
            shell.serve(hub, 0.05)
            count = 0
            while hub.clients:
                assert time.monotonic() < end_s
                hub.send([CanFrame(0x621, bytes(8))])
                count += 1
            assert count > 65536 / 45  # at least this much is queued
            assert client.closed()
    finally:
        hub.close()


def test_a_port_that_is_taken_is_named(served):
    port = int(served.endpoint.rpartition(":")[2])
    with pytest.raises(AddressError, match=f"cannot serve socketcand on 127.0.0.1:{port}"):
        Jr3Peer(Jr3PeerOptions(serve_socketcand=True, port=port)).open()


# -- options ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sensor": "left-ear"}, "right-hand"),
        ({"node_id": 128}, "to 127"),
        ({"port": 70000}, "65535"),
        ({"boot_s": -1.0}, "0 or more"),
        ({"noise_n": float("nan")}, "0 or more"),
        ({"offset": (0.0,)}, "6 values"),
        ({"interface": ""}, "python-can"),
    ],
)
def test_options_say_what_is_allowed(options, words):
    (key,) = options
    with pytest.raises(OptionError, match=f"{key}: .*{words}"):
        Jr3PeerOptions(**options)


def test_scripts_and_faults_are_checked():
    with pytest.raises(ScriptError, match="nosuch"):
        Jr3Peer(Jr3PeerOptions(script="nosuch"))
    with pytest.raises(ScriptError, match="nosuch"):
        Jr3PeerOptions(faults={"nosuch": 1.0})


def test_nodes_are_those_of_teo():
    for sensor, node_id in (("right-hand", 33), ("left-foot", 32)):
        assert Jr3Peer(Jr3PeerOptions(sensor=sensor)).device.node_id == node_id
    assert Jr3Peer(Jr3PeerOptions(node_id=5)).endpoint.endswith("node 5")


def test_a_bus_that_cannot_be_opened_is_named(monkeypatch):
    pytest.importorskip("can", reason='python-can is not installed: pip install "cardan[can]"')
    with pytest.raises(AddressError, match="no-such-interface"):
        Jr3Peer(Jr3PeerOptions(interface="no-such-interface")).open()
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(ExtraMissingError, match=r'pip install "cardan\[can\]"'):
        Jr3Peer().open()


@pytest.mark.judged(device="JR3", transport="CAN over socketcand", by="python-can's own client")
def test_python_can_loses_nothing_of_a_burst():
    can = pytest.importorskip("can", reason='python-can is not installed: "cardan[can]"')
    node, shell = Node(), BareShell()
    hub = SocketcandHub(node, "127.0.0.1", 0)
    hub.open(shell)
    heard = []

    def listen():
        host, _, port = hub.endpoint.rpartition(":")
        with can.Bus(
            interface="socketcand", channel="can0", host=host, port=int(port), ignore_config=True
        ) as bus:
            bus.send(can.Message(arbitration_id=0x421, is_extended_id=False))
            while len(heard) < 2000 and (message := bus.recv(5.0)) is not None:
                heard.append(message)

    client = threading.Thread(target=listen)
    client.start()
    try:
        end_s = time.monotonic() + 5.0
        while not node.asked:
            assert time.monotonic() < end_s
            shell.serve(hub, 0.02)
        assert node.asked == [CanFrame(0x421, b"")]
        for count in range(2000):
            hub.send([CanFrame(0x621, count.to_bytes(8, "little"))])
        while client.is_alive() and time.monotonic() < end_s:
            shell.serve(hub, 0.02)
    finally:
        client.join(5.0)
        hub.close()
    assert [int.from_bytes(message.data, "little") for message in heard] == list(range(2000))
    assert {message.arbitration_id for message in heard} == {0x621}
