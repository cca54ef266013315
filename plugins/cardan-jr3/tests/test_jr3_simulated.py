"""The JR3 driver and the simulated sensor on real buses: python-can's own, UDP, socketcand."""

import importlib
import socket
import subprocess
import sys
import threading

import pytest

from cardan.errors import (
    CommandError,
    DeviceNotFoundError,
    DriverError,
    NotOpenError,
)
from cardan.types import DeviceLink
from cardan_jr3.driver import Jr3, Jr3Options, bus, can_interfaces, device as device_module
from cardan_jr3.peer import Jr3Peer, Jr3PeerOptions
from cardan_jr3.protocol import CanFrame, Opcode
from tests.serving import free_tcp_port, free_udp_port, in_a_thread
from tests.waiting import until

pytestmark = pytest.mark.matrix

pytest.importorskip("can", reason='python-can is not installed: pip install "cardan[can]"')

GROUP = "239.74.163.2"
REST = (0.0,) * 6
UP = {"boot_s": 0.0}


def live(device):
    return until(lambda: device.state().link is DeviceLink.LIVE)


def zeroed(device):
    """Try to take zero; return whether it was taken."""
    try:
        device.zero()
    except CommandError:
        return False
    return True


def push(peer, force_n):
    """Replace the script by a constant push."""
    peer.motion.advance = lambda now_s, sensor: sensor.set_wrench((force_n, 0, 0, 0, 0, 0))


def need_multicast():
    """Skip if this computer cannot send to a multicast group."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.sendto(b"", (GROUP, 9))
        except OSError as error:
            pytest.skip(f"no multicast here ({error}): sudo ip route add 239.0.0.0/8 dev lo")


def drive(device, peer):
    """Check the states from opening to a push and back."""
    live(device)
    assert device.state().axes == REST

    def followed():
        # On a machine that stalls the sensor becomes stale, and then has to be released first.
        push(peer, 0.0)
        live(device)
        push(peer, 6.0)
        until(lambda: device.state().link is not DeviceLink.LIVE or device.state().axes[0] > 0.45)
        state = device.state()
        return state if state.link is DeviceLink.LIVE else None

    state = until(followed)
    assert state.wrench.force.x == pytest.approx(6.0, abs=0.6)
    push(peer, 0.0)
    until(lambda: device.state().axes == REST and device.state().link is DeviceLink.LIVE)


@pytest.mark.real
@pytest.mark.judged(device="JR3", transport="python-can virtual bus", by="simulated peer")
def test_on_a_virtual_bus():
    peer = Jr3Peer(Jr3PeerOptions(interface="virtual", channel="jr3-drive", script="rest", **UP))
    options = Jr3Options(interface="virtual", channel="jr3-drive", period_s=0.005)
    with in_a_thread(peer), Jr3(options) as device:
        drive(device, peer)
        assert device.capabilities.buttons == ()
        assert list(device.button_events()) == []
        assert device.metrics()["malformed_frames"] == 0
    assert device.state().link is DeviceLink.CLOSED


@pytest.mark.real
@pytest.mark.judged(device="JR3", transport="CAN over UDP multicast", by="simulated peer")
def test_over_udp_multicast():
    need_multicast()
    port = free_udp_port()
    peer = Jr3Peer(Jr3PeerOptions(port=port, script="rest", **UP))
    assert peer.endpoint == f"udp_multicast {GROUP}:{port} node 33"
    options = Jr3Options(interface="udp_multicast", channel=GROUP, port=port)
    device = Jr3(options)
    recorded = []
    device.raw_packet_callback = lambda *packet: recorded.append(packet)
    with in_a_thread(peer), device:
        drive(device, peer)
        # Invalid datagrams on the port are counted and change nothing.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            for junk in (b"", b"junk", b"\x81" * 200):
                probe.sendto(junk, (GROUP, port))
        until(lambda: device.metrics()["garbled_frames"] >= 2)
        live(device)
    # The multicast group returns the driver's own frames, which are not the board's.
    said = {int(name.removeprefix("can "), 16) - 33 for _, sent, name in recorded if not sent}
    assert said - {Opcode.BOOTUP} == {Opcode.ACK, Opcode.FORCES, Opcode.MOMENTS}
    assert any(sent for _, sent, _ in recorded)


@pytest.mark.real
@pytest.mark.judged(device="JR3", transport="CAN over socketcand", by="simulated peer")
def test_over_socketcand_in_sync_mode():
    peer = Jr3Peer(Jr3PeerOptions(serve_socketcand=True, port=0, script="rest", node_id=40, **UP))
    with in_a_thread(peer):
        port = int(peer.endpoint.rpartition(":")[2])
        options = Jr3Options(
            interface="socketcand", channel="can0", port=port, node_id=40, mode="sync",
            period_s=0.005,
        )  # fmt: skip
        with Jr3(options) as device:
            drive(device, peer)


def test_zero_over_the_bus():
    channel = "jr3-zero"
    peer = Jr3Peer(Jr3PeerOptions(interface="virtual", channel=channel, script="rest", **UP))
    device = Jr3(Jr3Options(interface="virtual", channel=channel, period_s=0.005))
    with pytest.raises(NotOpenError):
        device.zero()
    with in_a_thread(peer), device:
        live(device)
        assert zeroed(device)  # The call waits for the samples that it needs.
        live(device)
        push(peer, 4.0)
        until(lambda: (state := device.state()).wrench and state.wrench.force.x > 3.8)
        until(lambda: zeroed(device))
        live(device)
        until(lambda: (state := device.state()).wrench and abs(state.wrench.force.x) < 0.5)


def test_a_power_failure_costs_the_zero():
    channel = "jr3-power"
    peer = Jr3Peer(
        Jr3PeerOptions(
            interface="virtual", channel=channel, script="rest", boot_s=0.2,
            faults={"power-cycle": 0.9},
        )
    )  # fmt: skip
    with in_a_thread(peer), Jr3(Jr3Options(interface="virtual", channel=channel)) as device:
        live(device)
        boots = device.metrics()["boots"]
        until(lambda: device.metrics()["boots"] == boots + 1)
        assert "zero is lost" in device.state().reason
        until(lambda: zeroed(device))
        live(device)


def test_a_server_that_goes_is_noticed_and_found_again():
    port = free_tcp_port()
    serve = Jr3PeerOptions(serve_socketcand=True, port=port, script="rest", offset=(0.0,) * 6, **UP)
    options = Jr3Options(interface="socketcand", port=port, wait_for_device=True)
    with Jr3(options) as device:
        assert device.state().link is DeviceLink.LOST
        assert f"no socketcand at 127.0.0.1:{port}" in device.state().reason
        with in_a_thread(Jr3Peer(serve)):
            live(device)
        until(lambda: device.state().link is DeviceLink.LOST)
        with in_a_thread(Jr3Peer(serve)):
            # The new board cannot be recognized as the one whose zero was taken.
            until(lambda: "zero is lost" in device.state().reason)
            until(lambda: zeroed(device))
            live(device)


def test_nobody_on_the_bus(monkeypatch):
    monkeypatch.setattr(device_module, "ANSWER_TIMEOUT_S", 0.4)
    device = Jr3(Jr3Options(interface="virtual", channel="jr3-nobody"))
    with pytest.raises(DeviceNotFoundError, match="node 33 does not answer its ping"):
        device.open()
    device.close()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"interface": "socketcand", "port": 1}, "no socketcand at 127.0.0.1:1"),
        ({"interface": "socketcan", "channel": "nocan7"}, "cannot open the CAN bus 'nocan7'"),
        ({"interface": "no-such-interface"}, "cannot open the CAN bus 'can0'"),
        ({"interface": "slcan", "channel": "/dev/no-such-port"}, "cannot open the CAN bus"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_named(options, words):
    with pytest.raises(DriverError, match=words):
        Jr3(Jr3Options(**options)).open()


@pytest.mark.parametrize(
    ("greeting", "words"), [(b"SSH-2.0", "another program answers"), (b"", "timed out")]
)
def test_another_server_is_not_taken_for_socketcand(greeting, words, monkeypatch):
    monkeypatch.setattr(bus, "CONNECT_TIMEOUT_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            client, _ = server.accept()
            client.sendall(greeting)
            clients.append(client)

        clients = []
        thread = threading.Thread(target=serve)
        thread.start()
        options = Jr3Options(interface="socketcand", port=server.getsockname()[1])
        with pytest.raises(DeviceNotFoundError, match=words):
            Jr3(options).open()
        thread.join()
        clients[0].close()


def test_without_python_can_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(DriverError, match=r'pip install "cardan\[can\]"'):
        Jr3().open()


def test_can_interfaces_are_listed_with_what_stands_in_the_way(tmp_path, monkeypatch):
    for name, kind, flags in (("can0", 280, 0x40080), ("vcan0", 280, 0xC1), ("eth0", 1, 0x1003)):
        folder = tmp_path / "sys/class/net" / name
        folder.mkdir(parents=True)
        (folder / "type").write_text(f"{kind}\n")
        (folder / "flags").write_text(f"{flags:#x}\n")
    found = can_interfaces(tmp_path)
    assert [(each.path, each.transport) for each in found] == [
        ("can0", "socketcan"),
        ("vcan0", "socketcan"),
    ]
    assert "sudo ip link set can0 up" in found[0].obstacle
    assert found[1].obstacle == ""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "cardan[can]" in can_interfaces(tmp_path)[1].obstacle
    assert can_interfaces(tmp_path / "nowhere") == []
    assert isinstance(Jr3.find(), list)


class _BrokenBus:
    """A python-can bus that raises the given errors."""

    def __init__(self, *errors):
        self.errors = list(errors)

    def recv(self, timeout):
        raise self.errors.pop(0)

    def send(self, message, timeout):
        raise self.errors.pop(0)

    def shutdown(self):
        raise RuntimeError("never mind")


def test_what_cannot_be_read_is_distinguished_from_a_bus_that_is_gone():
    import can

    garbled = can.CanOperationError("could not unpack received message")
    garbled.__cause__ = ValueError("junk")
    gone = can.CanOperationError("Error receiving")
    gone.__cause__ = OSError(100, "Network is down")
    open_bus = bus.CanBus(_BrokenBus(garbled, gone, ValueError("fileno is -1")))
    assert open_bus.receive(0.0) == bus.Unusable("garbled_frames")
    with pytest.raises(OSError, match="Network is down"):
        open_bus.receive(0.0)
    with pytest.raises(OSError, match="fileno"):
        open_bus.receive(0.0)
    open_bus.close()
    down = can.CanOperationError("Failed to transmit: Network is down", 100)
    with pytest.raises(OSError, match="Network is down") as raised:
        bus.CanBus(_BrokenBus(down)).send(CanFrame(0x421, b""))
    words = str(bus.in_use(Jr3Options(), raised.value))
    assert "sudo ip link set can0 up" in words
    nobody = can.CanOperationError("Failed to transmit", 105)
    with pytest.raises(OSError, match="buffer space") as raised:
        bus.CanBus(_BrokenBus(nobody)).send(CanFrame(0x421, b""))
    assert "no node on the bus acknowledges" in str(bus.in_use(Jr3Options(), raised.value))
    flood = bus.CanBus(_BrokenBus(*[garbled] * 60))
    for _ in range(50):
        assert flood.receive(0.0) == bus.Unusable("garbled_frames")
    with pytest.raises(OSError, match="junk"):
        flood.receive(0.0)


def test_other_kinds_of_frames_are_sorted_out():
    import can

    messages = [
        can.Message(arbitration_id=0x621, data=b"\1", is_extended_id=False),
        can.Message(arbitration_id=0x621, is_extended_id=True),
        can.Message(arbitration_id=0x621, is_remote_frame=True, is_extended_id=False),
        can.Message(is_error_frame=True),
    ]

    class Bus(_BrokenBus):
        def recv(self, timeout):
            return messages.pop(0)

    one = bus.CanBus(Bus())
    assert one.receive(0.0) == CanFrame(0x621, b"\1")
    assert one.receive(0.0) == one.receive(0.0) == bus.Unusable("foreign_frames")
    assert one.receive(0.0) == bus.Unusable("bus_errors")


def test_the_end_of_a_stream_is_no_silence():
    import can

    class Spinning(can.BusABC):
        """At the end of its stream python-can's socketcand returns no message, at once."""

        def __init__(self, stream):
            self._SocketCanDaemonBus__socket = stream
            super().__init__(channel="can0")

        def _recv_internal(self, timeout):
            return None, False

        def send(self, msg, timeout=None):
            raise AssertionError("nothing is sent")

    ours, theirs = socket.socketpair()
    with ours, theirs:
        one = bus.CanBus(Spinning(ours))
        assert one.receive(0.0) is None
        theirs.send(b"< frame")
        assert one.receive(0.0) is None
        ours.recv(100)
        theirs.close()
        with pytest.raises(OSError, match="closed the connection"):
            one.receive(0.05)
        one.close()


def test_socketcand_of_python_can_has_the_stream_that_is_watched():
    port = free_tcp_port()
    serve = Jr3PeerOptions(serve_socketcand=True, port=port, script="rest", **UP)
    with in_a_thread(Jr3Peer(serve)):
        opened = bus.open_bus(Jr3Options(interface="socketcand", port=port))

    def ended():
        try:
            opened.receive(0.01)
        except OSError:
            return True
        return False

    until(ended)
    opened.close()


def test_an_interface_that_fails_in_its_own_way_is_refused_in_words(monkeypatch):
    import can

    def bus_of(**_):
        raise NameError("name 'canGetNumberOfChannels' is not defined")

    monkeypatch.setattr(can, "Bus", bus_of)
    with pytest.raises(DriverError, match=r"by kvaser: .*canGetNumberOfChannels.*installed\?"):
        bus.open_bus(Jr3Options(interface="kvaser", channel="0"))


@pytest.mark.parametrize(
    ("number", "words"), [(19, "no route for multicast"), (22, "address of a multicast group")]
)
def test_a_missing_route_is_distinguished_from_a_wrong_group(number, words, monkeypatch):
    import can

    def bus_of(**_):
        raise can.CanInitializationError("could not create socket") from OSError(number, "no")

    monkeypatch.setattr(can, "Bus", bus_of)
    with pytest.raises(DeviceNotFoundError, match=words):
        bus.open_bus(Jr3Options(interface="udp_multicast", channel="1.2.3.4"))


def test_warnings_of_python_can_stay_off_the_terminal():
    script = (
        "import logging\n"
        "from cardan_jr3.driver import Jr3Options, bus\n"
        "try:\n"
        "    bus.open_bus(Jr3Options(interface='nican', channel='x'))\n"
        "except bus.DriverError:\n"
        "    logging.getLogger('can.nican').warning('not for the operator')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=30, check=True
    )
    assert done.stdout + done.stderr == ""
