"""The driver and the simulated service, over real sockets."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import contextmanager

import pytest

from cardan.drivers.base import Endpoint
from cardan.errors import CommandError, DeviceAccessError, DeviceNotFoundError
from cardan.types import DeviceFeedback, DeviceLink
from cardan_leap.driver import BUTTONS, Leap, LeapOptions
from cardan_leap.driver.connection import Connection, ServiceClosedError, connect
from cardan_leap.driver.core import STALE_AFTER_S
from cardan_leap.peer import LeapPeer, LeapPeerOptions
from cardan_leap.protocol import ClientOptions, Version
from tests.serving import in_a_thread
from tests.waiting import until

pytestmark = pytest.mark.matrix

DEADLINE_S = 15.0

simulated = pytest.mark.judged(device="Leap Motion", transport="WebSocket", by="simulated peer")


@pytest.fixture
def script(tmp_path):
    """Write a script and return its path."""

    def write(text):
        path = tmp_path / "hand.script"
        path.write_text(text)
        return str(path)

    return write


def peer_with(script, faults=None, **options):
    return LeapPeer(LeapPeerOptions(port=0, script=script, faults=faults or {}, **options))


@pytest.mark.real
@simulated
def test_a_hand_engages_moves_grabs_and_leaves(script):
    path = script(
        """0.1 enter right
        0.8 move right 0 200 -100 over 0.4
        1.2 grab right 1
        1.5 leave right
        1.6 loop"""
    )
    with in_a_thread(peer_with(path)) as peer, Leap(LeapOptions(port=peer.backend.port)) as leap:
        assert leap.capabilities.gives_pose
        assert leap.capabilities.buttons == BUTTONS
        state = until(lambda: "clutch" in (s := leap.state()).buttons and s, "clutch")
        assert state.link is DeviceLink.LIVE
        assert state.pose.position == pytest.approx((0.0, 0.0, 0.2), abs=0.01)
        both = {"clutch", "grab"}
        state = until(lambda: (s := leap.state()).buttons >= both and s, "grab")
        assert state.pose.position.x == pytest.approx(0.1, abs=0.03)
        state = until(lambda: not (s := leap.state()).buttons and s, "left")
        assert state.pose is None
        assert state.link is DeviceLink.LIVE
        edges = []

        def engaged():
            edges.extend("-+"[event.pressed] + event.button for event in leap.button_events())
            # A computer that stalls loses the hand; the script restarts from its beginning.
            return "+hand +clutch +grab" in " ".join(edges)

        until(engaged, "a hand that engages and grabs")
        assert edges[3:6] == ["-clutch", "-grab", "-hand"]
        assert leap.metrics()["frames"] > 50
        with pytest.raises(CommandError, match="no rumble feedback"):
            leap.feedback(DeviceFeedback(rumble=1.0))
        # The driver sends its options in the public client's order, the focus last.
        asked = [options for _, options in peer.device.requests]
        assert asked == [
            ClientOptions(background=True),
            ClientOptions(optimize_hmd=False),
            ClientOptions(focused=True),
        ]
    assert leap.state().link is DeviceLink.CLOSED


@simulated
@pytest.mark.parametrize("highest", [5, 3, 1])
def test_an_older_service_is_asked_for_less(script, highest):
    path = script("0.1 enter right\n1.5 leave right\n1.6 loop")
    with (
        in_a_thread(peer_with(path, {"highest-version": highest})) as peer,
        Leap(LeapOptions(port=peer.backend.port)) as leap,
    ):
        until(lambda: "clutch" in leap.state().buttons, "clutch")
        assert any(f"version {highest}" in line for line in leap.diagnosis())


@pytest.mark.real
@simulated
def test_a_restart_is_lost_then_found_and_needs_neutral(script):
    path = script("0.1 enter right\n.7 restart .1\n1.3 leave right\n1.6 loop")
    with in_a_thread(peer_with(path)) as peer, Leap(LeapOptions(port=peer.backend.port)) as leap:
        until(lambda: "clutch" in leap.state().buttons, "clutch")
        state = until(lambda: (s := leap.state()).link is DeviceLink.LOST and s, "lost")
        assert state.pose is None
        assert state.buttons == frozenset()
        state = until(lambda: (s := leap.state()).link is DeviceLink.NEEDS_NEUTRAL and s, "found")
        assert state.reason
        until(lambda: leap.state().link is DeviceLink.LIVE, "live without the hand")
        assert peer.device.restarts >= 1


@simulated
def test_the_tracker_is_unplugged_and_plugged_in_again(script):
    path = script("0.1 enter right\n.7 unplug\n.8 replug\n.9 leave right\n1.6 loop")
    with in_a_thread(peer_with(path)) as peer, Leap(LeapOptions(port=peer.backend.port)) as leap:
        until(lambda: "clutch" in leap.state().buttons, "clutch")
        state = until(lambda: (s := leap.state()).link is DeviceLink.LOST and s, "lost")
        assert "unplugged" in state.reason
        until(lambda: leap.state().link is DeviceLink.LIVE, "live again")


@simulated
def test_a_stall_is_noticed_in_time(script):
    path = script("0.1 enter right\n.7 stall\n1.1 resume\n1.2 leave right\n1.6 loop")
    with in_a_thread(peer_with(path)) as peer, Leap(LeapOptions(port=peer.backend.port)) as leap:
        until(lambda: "clutch" in leap.state().buttons, "clutch")
        state = until(lambda: (s := leap.state()).link is DeviceLink.STALE and s, "stale")
        seen_s = time.monotonic()
        assert state.pose is None
        # How much later depends on the machine; the virtual-time tests are exact.
        assert seen_s - state.stamp_s > STALE_AFTER_S
        until(lambda: leap.state().link is DeviceLink.LIVE, "live again")


@simulated
def test_another_program_may_take_the_focus(script):
    with (
        in_a_thread(peer_with(script("0.2 steal-focus"), start_on_connect=False)) as peer,
        Leap(LeapOptions(port=peer.backend.port)) as leap,
    ):
        other, _, _ = connect("127.0.0.1", peer.backend.port, 6, 2.0)
        other.send('{"focused":true}')
        before = leap.metrics()["frames"]
        until(lambda: leap.metrics()["frames"] > before + 30, "frames in the background")
        other.close()


def test_nobody_there():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound, but not listening
        leap = Leap(LeapOptions(port=taken.getsockname()[1]))
        with pytest.raises(DeviceNotFoundError, match="start the tracking service"):
            leap.open()
        leap.close()


@simulated
def test_it_waits_for_the_service(script):
    peer = peer_with(script("0.1 enter right"))
    peer.open()
    port = peer.backend.port
    peer.close()
    with Leap(LeapOptions(port=port, wait_for_device=True)) as leap:
        assert leap.state().link is DeviceLink.LOST
        assert "no service at" in leap.state().reason
        with in_a_thread(LeapPeer(LeapPeerOptions(port=port, script="empty"))):
            until(lambda: leap.state().link is DeviceLink.LIVE, "live")
        until(lambda: leap.state().link is DeviceLink.LOST, "lost")
        assert "code 1001" in leap.state().reason


@contextmanager
def answering(serve):
    """TCP server that calls `serve` with each connection, one at a time."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(DEADLINE_S)

        def run():
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                with connection:
                    serve(connection)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join()


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b"", "the service refused"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "404"),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "the service refused"),
        (b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\n\r\n", "Connection"),
    ],
)
def test_something_else_answers(answer, words):
    def serve(connection):
        connection.recv(4096)
        connection.sendall(answer)

    with answering(serve) as port, pytest.raises(DeviceAccessError, match=words):
        connect("127.0.0.1", port, 6, 2.0)


def test_a_service_that_never_says_its_version(script):
    with (
        in_a_thread(peer_with(script("0 leave right"), {"mute": 1.0})) as peer,
        pytest.raises(DeviceNotFoundError, match="no answer"),
    ):
        connect("127.0.0.1", peer.backend.port, 6, 0.2)


def test_a_connection_that_ended_raises(script):
    with in_a_thread(peer_with(script("0 leave right"))) as peer:
        connection, version, _ = connect("127.0.0.1", peer.backend.port, 6, 2.0)
        assert version == Version(6, "2.3.1+33747")
        connection.ping()
        connection.close()
        connection.close()
        with pytest.raises(OSError, match="closed"):
            connection.send("{}")
        refused = Connection("127.0.0.1", peer.backend.port, 7, time.monotonic() + 2.0)
        with pytest.raises(ServiceClosedError) as closed:
            refused.receive(2.0)
        refused.close()
        assert closed.value.code == 1001


def test_a_service_that_vanishes_has_closed_the_connection(script):
    with in_a_thread(peer_with(script("0.1 restart 0.1"))) as peer:
        connection, _, _ = connect("127.0.0.1", peer.backend.port, 6, 2.0)
        connection.send('{"background":true}')
        with pytest.raises(ServiceClosedError, match="closed the connection") as closed:
            until(lambda: connection.receive(1.0) is None, "the end")
        connection.close()
        assert closed.value.code == 1006


def test_find_lists_the_trackers_of_a_service(script, monkeypatch):
    for faults, obstacle in (({}, ""), ({"no-device": 1.0}, "it reports no tracker")):
        with in_a_thread(peer_with(script("0 leave right"), faults)) as peer:
            monkeypatch.setattr(
                "cardan_leap.driver.device.LeapOptions",
                lambda p=peer: LeapOptions(port=p.backend.port),
            )
            (found,) = Leap.find()
            assert found.transport == "websocket"
            assert found.path == f"127.0.0.1:{peer.backend.port}"
            assert found.obstacle == obstacle
            assert "2.3.1" in found.name
            assert not peer.device.requests


def test_find_lists_what_is_plugged_in_without_a_service(tmp_path, monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        monkeypatch.setattr("cardan_leap.driver.device.LeapOptions", lambda: LeapOptions(port=port))
        monkeypatch.setattr("cardan.drivers.access.USB_DEVICES", tmp_path)
        assert Leap.find() == []
        for name, vendor, product in (("1-1", "f182", "0003"), ("1-2", "046d", "c626")):
            (tmp_path / name).mkdir()
            (tmp_path / name / "idVendor").write_text(f"{vendor}\n")
            (tmp_path / name / "idProduct").write_text(f"{product}\n")
        (found,) = Leap.find()
        assert (found.identity, found.transport) == ("f182:0003", "usb")
        assert "start the tracking service" in found.obstacle


def test_messages_of_a_leap_service():
    tapped = []
    leap, stop = Leap(), threading.Event()

    class Connection:
        heard_s = 1e12

        def receive(self, _timeout_s):
            stop.set()
            return [b'{"version": 6}']

        def send(self, text):
            pass

    leap.raw_packet_callback, leap._connection = (lambda *said: tapped.append(said)), Connection()
    leap._serve(stop)
    assert tapped == [(b'{"version": 6}', False, "")]


def test_its_endpoint_is_the_services():
    assert Leap().endpoints() == (Endpoint("tcp", "127.0.0.1", 6437),)
