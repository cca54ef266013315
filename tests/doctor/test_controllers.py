"""Controllers: the doctor listens or connects to them, and never commands them."""

import contextlib
import errno
import socket
import threading

import pytest

from cardan.doctor.base import Subject
from cardan.doctor.controllers import (
    Controllers,
    Heard,
    check_controllers,
    connect,
    listen,
)
from cardan.doctor.files import read_files
from cardan.drivers.abb_egm import AbbEgm
from cardan.drivers.base import Endpoint
from cardan.drivers.motoros import Motoros
from cardan.drivers.sim_arm import SimArm
from cardan.drivers.ur_rtde import UrRtde
from cardan.protocols.ur.dashboard import GREETING
from cardan.protocols.ur.rtde import PacketType, reply_accepted, text
from tests.doctor.levels_and_codes import levels_and_codes
from tests.serving import free_udp_port

EGM = Endpoint("udp", "192.168.125.99", 6510, True, "192.168.125.1")
STATE = Endpoint("tcp", "192.168.255.1", 50241)
RTDE, DASHBOARD = UrRtde().endpoints()
VERSION = reply_accepted(PacketType.PROTOCOL_VERSION, True)
(MOTOROS,) = Motoros().endpoints()
STATUS = (40).to_bytes(4, "little")


def test_what_drivers_use():
    egm = AbbEgm(listen_host="127.0.0.1", listen_port=6599, controller_host="127.0.0.2")
    (listens,) = egm.endpoints()
    assert listens[:5] == ("udp", "127.0.0.1", 6599, True, "127.0.0.2")
    (state,) = Motoros(host="127.0.0.3").endpoints()
    assert state[:4] == ("tcp", "127.0.0.3", 50241, False)
    assert egm.endpoints() == (listens,)  # two users of one are examined once
    assert SimArm().endpoints() == ()


@pytest.mark.parametrize(
    ("endpoint", "heard", "level", "code"),
    [
        (EGM, Heard(("192.168.125.1",)), "good", "heard"),
        (EGM._replace(peer=None), Heard(("192.168.125.7",)), "good", "heard"),
        (EGM, Heard(("192.168.125.7",)), "failure", "other-controller"),
        (EGM, Heard(), "caution", "not-heard"),
        (EGM, Heard(error=errno.EADDRINUSE), "good", "heard"),
        (EGM, Heard(error=errno.EADDRNOTAVAIL), "failure", "listen-address"),
        (EGM, Heard(error=errno.EACCES), "failure", "listen-address"),
        (STATE, Heard(("192.168.255.1",)), "good", "reached"),
        (EGM, Heard(said=b"GET / HTTP/1.1"), "failure", "other-server"),
        (MOTOROS, Heard(("192.168.255.1",), b"SSH-2.0-OpenSSH"), "failure", "other-server"),
        (MOTOROS, Heard(("192.168.255.1",)), "failure", "other-server"),
        (MOTOROS, Heard(("192.168.255.1",), STATUS), "good", "reached"),
        (DASHBOARD, Heard(("192.168.255.1",), GREETING.encode()), "good", "reached"),
        (DASHBOARD, Heard(("192.168.255.1",), GREETING[:9].encode()), "failure", "other-server"),
        (RTDE, Heard(("192.168.255.1",), VERSION), "good", "reached"),
        (RTDE, Heard(("192.168.255.1",), text("hello", "", 3) + VERSION), "good", "reached"),
        (RTDE, Heard(("192.168.255.1",), b"RTSP/1.0 400"), "failure", "other-server"),
        (RTDE, Heard(("192.168.255.1",), b"HTTP/1.1 400"), "failure", "other-server"),
        (RTDE, Heard(("192.168.255.1",)), "failure", "other-server"),
        (STATE, Heard(error=errno.ECONNREFUSED), "failure", "not-reached"),
        (STATE, Heard(error=errno.ETIMEDOUT), "failure", "not-reached"),
    ],
)
def test_findings(endpoint, heard, level, code):
    found = list(check_controllers({endpoint: "robot of a"}, {endpoint: heard}))
    assert levels_and_codes(Controllers, found) == [(level, code)]


def test_what_did_not_arrive_and_how_a_firewall_s_rules_are_seen():
    (found,) = check_controllers({EGM: "robot of a"}, {EGM: Heard()})
    assert found.what == "no datagram came to UDP port 6510 of robot of a within 2 s"
    for command in ("sudo nft list ruleset", "sudo iptables -L -n", "udp port 6510"):
        assert command in found.mend


def udp():
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    return sock


@contextlib.contextmanager
def sending(data, port):
    """Yield a socket that sends the same datagram every 10 ms."""
    stop = threading.Event()
    with udp() as sock:

        def send():
            while not stop.wait(0.01):
                sock.sendto(data, ("127.0.0.1", port))

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield sock
        finally:
            stop.set()
            thread.join()


@pytest.mark.real
def test_a_controller_that_sends_is_heard_and_not_answered():
    endpoint = Endpoint("udp", "127.0.0.1", free_udp_port(), True)
    with sending(b"state", endpoint.port) as controller:
        controller.setblocking(False)
        assert listen([endpoint], 20.0) == {endpoint: Heard(("127.0.0.1",))}
        with pytest.raises(BlockingIOError):
            controller.recv(100)


@pytest.mark.matrix
def test_datagrams_of_another_protocol_are_no_controller():
    (endpoint,) = AbbEgm(listen_host="127.0.0.1", listen_port=free_udp_port()).endpoints()
    with sending(b"GET / HTTP/1.1", endpoint.port):
        assert listen([endpoint], 2.0) == {endpoint: Heard(said=b"GET / HTTP/1.1")}


@pytest.mark.matrix
def test_silence_and_ports_that_cannot_be_had():
    with udp() as other:
        port = other.getsockname()[1]
        quiet = Endpoint("udp", "127.0.0.1", free_udp_port(), True)
        taken = Endpoint("udp", "127.0.0.1", port, True)
        foreign = Endpoint("udp", "192.0.2.1", port, True)
        unnamed = Endpoint("udp", "no host of this name", port, True)
        shared = Endpoint("udp", "224.0.0.1", port, True)
        heard = listen([quiet, taken, foreign, unnamed, shared], 0.05)
    assert heard == {
        quiet: Heard(),
        taken: Heard(error=errno.EADDRINUSE),
        foreign: Heard(error=errno.EADDRNOTAVAIL),
        unnamed: Heard(error=errno.EADDRNOTAVAIL),
        shared: Heard(error=errno.EADDRNOTAVAIL),
    }
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", quiet.port))  # the doctor has closed it


@pytest.mark.matrix
def test_a_server_is_connected_to_and_sent_nothing():
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = Endpoint("tcp", "127.0.0.1", server.getsockname()[1])
        assert connect(endpoint) == Heard(("127.0.0.1",))
        client, _ = server.accept()
        with client:
            client.settimeout(20.0)
            assert client.recv(100) == b""
    assert connect(endpoint) == Heard(error=errno.ECONNREFUSED)
    assert connect(Endpoint("tcp", "no host of this name", 1)) == Heard(error=errno.EHOSTUNREACH)


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (STATUS, ("good", "reached")),
        (b"SSH-2.0-OpenSSH_9.6\r\n", ("failure", "other-server")),
        (b"", ("failure", "other-server")),
    ],
)
def test_the_check(tmp_path, said, expected):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def serve():
            client, _ = server.accept()
            with client:
                client.sendall(said)

        serving = threading.Thread(target=serve)
        serving.start()
        file = tmp_path / "gp8.toml"
        file.write_text(f'[robot]\ndriver = "motoros"\nstate_port = {port}\n[arm]\nmodel = "gp8"\n')
        config, wrong = read_files([file])
        assert not wrong
        found = list(Controllers.look(Subject((file,), config)))
        serving.join()
    assert levels_and_codes(Controllers, found) == [expected]
