"""USB/IP: bytes of the kernel's documentation, and a simulated SpaceMouse behind the protocol."""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given, strategies as st

from cardan.errors import AddressError, OptionError, ScriptError
from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.protocols.connexion.devices import model_by_key
from cardan.sim_peers.backends.usbip import ENDPOINT_REPORTS, SetupPacket, Speed, UsbipSession
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from cardan.sim_peers.spacemouse.usb import SpaceMouseUsb

pytestmark = pytest.mark.matrix

DEVLIST = bytes.fromhex("0111 8005 00000000")
IMPORT = bytes.fromhex("0111 8003 00000000") + b"1-1".ljust(32, b"\0")
GET_DEVICE = bytes.fromhex("80 06 0001 0000 1200")
"""GET_DESCRIPTOR(device), 18 bytes."""
SET_LED = bytes.fromhex("21 09 0402 0000 0200")
"""SET_REPORT(output 4), 2 bytes."""


def submit(
    sequence: int,
    endpoint: int,
    length: int,
    *,
    to_host: bool = True,
    setup: bytes = bytes(8),
    data: bytes = b"",
) -> bytes:
    head = struct.pack(">IIIII", 1, sequence, 0x0001_0002, int(to_host), endpoint)
    return head + struct.pack(">Iiiii", 0, length, 0, -1, 8) + setup + data


def unlink(sequence: int, victim: int) -> bytes:
    return struct.pack(">IIIIII24x", 2, sequence, 0x0001_0002, 0, 0, victim)


def returned(sequence: int, status: int, data: bytes = b"", actual: int | None = None) -> bytes:
    actual = len(data) if actual is None else actual
    return struct.pack(">IIIIIiiiii8x", 3, sequence, 0, 0, 0, status, actual, 0, 0, 0) + data


def unlinked(sequence: int, status: int) -> bytes:
    return struct.pack(">IIIIIi24x", 4, sequence, 0, 0, 0, status)


class Puck:
    """USB/IP session with a SpaceMouse."""

    def __init__(self, key: str = "spacenavigator", imported: bool = True) -> None:
        self.outputs: list[bytes] = []
        self.usb = SpaceMouseUsb(model_by_key(key), self.outputs.append)
        self.session = UsbipSession(self.usb)
        if imported:
            assert self.say(IMPORT)[:8] == bytes.fromhex("0111 0003 00000000")

    def say(self, data: bytes) -> bytes:
        self.session.receive(data)
        return self.session.take_output()

    def control(self, setup: str, length: int = 0, data: bytes = b"") -> bytes | None:
        """Return the device's answer without USB/IP; None: it stalls."""
        kind, request, value, target, size = struct.unpack("<BBHHH", bytes.fromhex(setup))
        return self.usb.control(SetupPacket(kind, request, value, target, length or size), data)


@pytest.fixture
def puck() -> Puck:
    return Puck()


# ---------------------------------------------------------------------------------------------
# The protocol


@pytest.mark.judged(
    device="SpaceNavigator", transport="USB/IP", by="worked bytes of usbip_protocol.rst"
)
def test_the_list_of_devices_has_every_field_at_its_place():
    said = Puck(imported=False).say(DEVLIST)
    assert said[:12] == bytes.fromhex("0111 0005 00000000 00000001")
    device = said[12:]
    assert device[256:288].rstrip(b"\0") == b"1-1"
    busnum, devnum, speed = struct.unpack_from(">III", device, 288)
    assert (busnum, devnum, speed) == (1, 2, Speed.LOW)
    assert struct.unpack_from(">HHH", device, 300) == (0x046D, 0xC626, 0x0431)
    assert device[306:312] == bytes((0, 0, 0, 1, 1, 1))
    assert device[312:] == bytes((3, 0, 0, 0))


def test_an_import_gives_the_device_without_its_interfaces():
    said = Puck(imported=False).say(IMPORT)
    assert said[:8] == bytes.fromhex("0111 0003 00000000")
    assert len(said) == 8 + 312


def test_a_device_in_use_or_unknown_is_refused():
    puck = Puck(imported=False)
    assert puck.say(IMPORT.replace(b"1-1", b"2-1")) == bytes.fromhex("0111 0003 00000004")
    puck.session.available = False
    assert puck.say(IMPORT) == bytes.fromhex("0111 0003 00000002")
    assert puck.say(DEVLIST) == bytes.fromhex("0111 0005 00000000 00000000")
    assert not puck.session.imported
    puck.session.present = False
    assert puck.say(IMPORT) == bytes.fromhex("0111 0003 00000004")


def test_a_control_read_returns_what_fits(puck):
    said = puck.say(submit(7, 0, 64, setup=GET_DEVICE))
    assert said[:48] == returned(7, 0, bytes(18))[:48]
    assert said[48:56] == bytes.fromhex("12 01 1001 00 00 00 08")
    assert struct.unpack_from("<HHH", said, 56) == (0x046D, 0xC626, 0x0431)
    short = GET_DEVICE[:-2] + b"\x08\x00"
    assert puck.say(submit(8, 0, 64, setup=short)) == returned(8, 0, said[48:56])


def test_a_control_write_reaches_the_device(puck):
    command = submit(9, 0, 2, to_host=False, setup=SET_LED, data=b"\x04\x00")
    assert puck.say(command) == returned(9, 0, actual=2)
    assert puck.outputs == [b"\x04\x00"]


def test_what_the_device_does_not_know_stalls():
    feature = bytes.fromhex("a1 01 0503 0000 0800")
    assert Puck().say(submit(3, 0, 8, setup=feature)) == returned(3, -errno.EPIPE)
    assert Puck().say(submit(3, 2, 1, to_host=False, data=b"x")) == returned(3, -errno.EPIPE)


def test_a_read_waits_for_a_report_and_a_report_for_a_read(puck):
    assert puck.say(submit(1, 1, 64)) == b""
    puck.session.push(1, b"\x03\x01\x00")
    assert puck.session.take_output() == returned(1, 0, b"\x03\x01\x00")
    puck.session.push(1, b"\x03\x00\x00")
    assert puck.session.take_output() == b""
    assert puck.say(submit(2, 1, 64)) == returned(2, 0, b"\x03\x00\x00")


def test_of_reports_that_nobody_reads_the_oldest_go(puck):
    for number in range(10):
        puck.session.push(1, bytes((number,)))
    said = puck.say(b"".join(submit(number, 1, 64) for number in range(10)))
    retained = [bytes((number,)) for number in range(10 - ENDPOINT_REPORTS, 10)]
    assert said == b"".join(returned(number, 0, data) for number, data in enumerate(retained))


def test_a_report_longer_than_the_read_is_an_overflow(puck):
    puck.session.push(1, bytes(9))
    assert puck.say(submit(1, 1, 8)) == returned(1, -errno.EOVERFLOW)


def test_a_waiting_read_can_be_taken_back(puck):
    puck.say(submit(1, 1, 64))
    assert puck.say(unlink(2, 1)) == unlinked(2, -errno.ECONNRESET)
    puck.session.push(1, b"\x01")
    assert puck.session.take_output() == b""
    assert puck.say(unlink(3, 1)) == unlinked(3, 0)


@pytest.mark.parametrize("first", [7, (1 << 32) - 1])
def test_what_takes_a_transfer_back_before_it_is_asked_for_waits_for_it(first, puck):
    puck.say(submit(first - 1, 1, 64))
    puck.session.push(1, b"\x01")
    assert puck.session.take_output() == returned(first - 1, 0, b"\x01")
    after = (first + 1) % (1 << 32)
    assert puck.say(unlink(after, first)) == b""
    assert puck.say(submit(first, 1, 64)) == unlinked(after, -errno.ECONNRESET)
    puck.session.push(1, b"\x02")
    assert puck.session.take_output() == b""
    assert puck.say(submit(after + 1, 1, 64)) == returned(after + 1, 0, b"\x02")
    assert puck.say(unlink(after + 2, after + 1)) == unlinked(after + 2, 0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (bytes.fromhex("0222 8005 00000000"), "version 0x0222, not 0x0111"),
        (bytes.fromhex("0111 1234 00000000"), "operation 0x1234 is unknown"),
        (IMPORT + bytes.fromhex("00000009") + bytes(44), "command 0x9 is unknown"),
        (IMPORT + submit(1, 1, -1), "a transfer of -1 bytes on endpoint 1"),
        (IMPORT + submit(1, 16, 1), "a transfer of 1 bytes on endpoint 16"),
    ],
)
def test_what_makes_no_sense_ends_the_session_in_words(data, words):
    session = Puck(imported=False).session
    session.receive(data)
    assert session.failed == words


@given(st.binary(max_size=200), st.booleans())
def test_no_bytes_make_it_raise(data, imported):
    Puck(imported=imported).say(data)


@given(st.lists(st.integers(1, 60), max_size=40))
def test_it_does_not_matter_how_the_bytes_come_in_pieces(sizes):
    stream = (
        IMPORT
        + submit(1, 0, 64, setup=GET_DEVICE)
        + submit(2, 0, 2, to_host=False, setup=SET_LED, data=b"\x04\x01")
        + submit(3, 1, 64)
        + unlink(4, 3)
    )
    whole = Puck(imported=False).say(stream)
    puck = Puck(imported=False)
    said = b""
    for size in sizes:
        said += puck.say(stream[:size])
        stream = stream[size:]
    assert said + puck.say(stream) == whole


# ---------------------------------------------------------------------------------------------
# The device behind it


def test_the_configuration_says_what_it_holds():
    data = Puck().control("80 06 0002 0000 ff00")
    assert data is not None
    assert struct.unpack_from("<BBHBB", data) == (9, 2, len(data), 1, 1)
    assert data[9:18] == bytes((9, 4, 0, 0, 1, 3, 0, 0, 0))
    assert data[18:27] == struct.pack(
        "<BBHBBBH", 9, 0x21, 0x111, 0, 1, 0x22, len(descriptor_for(model_by_key("spacenavigator")))
    )
    assert data[27:] == bytes((7, 5, 0x81, 3, 8, 0, 8))


def test_a_receiver_has_five_interfaces_each_with_an_endpoint_of_its_own():
    puck = Puck("universal-receiver")
    data = puck.control("80 06 0002 0000 ff00")
    assert data is not None
    assert data[4] == 5
    assert [data[9 + 25 * number + 20] for number in range(5)] == [0x81, 0x82, 0x83, 0x84, 0x85]
    assert puck.usb.identity.speed is Speed.FULL
    descriptor = descriptor_for(model_by_key("universal-receiver"))
    assert puck.control("81 06 0022 0400 0010") == descriptor
    assert puck.control("81 06 0022 0500 0010") is None


def test_standard_requests_are_answered_as_usb_demands(puck):
    assert puck.control("80 08 0000 0000 0100") == b"\0"
    assert puck.control("00 09 0100 0000 0000") == b""
    assert puck.control("80 08 0000 0000 0100") == b"\1"
    assert puck.control("00 09 0200 0000 0000") is None
    assert puck.control("80 00 0000 0000 0200") == b"\0\0"
    assert puck.control("80 06 0003 0000 ff00") == bytes((4, 3, 9, 4))
    assert puck.control("80 06 0203 0904 ff00")[2:].decode("utf-16-le") == "SpaceNavigator"
    assert puck.control("80 06 0903 0904 ff00") is None
    assert puck.control("81 06 0022 0000 0010") == descriptor_for(model_by_key("spacenavigator"))
    assert puck.control("21 0a 007d 0000 0000") == b""
    assert puck.control("a1 02 0000 0000 0100") == b"\x7d"
    assert puck.control("c0 01 0000 0000 0100") is None


# ---------------------------------------------------------------------------------------------
# The server


class Host:
    """Host with one connection to a peer that the test steps."""

    def __init__(self, peer: SpaceMousePeer) -> None:
        self.peer = peer
        self.sock = socket.create_connection(peer.backend.address, 5.0)
        self.sock.settimeout(0.002)

    def get(self, size: int) -> bytes:
        """Return the next `size` bytes from the peer; fewer after 5 s."""
        said = b""
        end_s = time.monotonic() + 5.0
        while len(said) < size and time.monotonic() < end_s:
            self.peer.step(time.monotonic() + 0.002)
            said = self._more(said)
        return said

    def gone(self) -> bool:
        """Return whether the peer has closed the connection."""
        end_s = time.monotonic() + 5.0
        while time.monotonic() < end_s:
            self.peer.step(time.monotonic() + 0.002)
            try:
                if not self.sock.recv(4096):
                    return True
            except TimeoutError:
                continue
            except OSError:
                return True
        return False

    def _more(self, said: bytes) -> bytes:
        try:
            return said + self.sock.recv(4096)
        except TimeoutError:
            return said


Serve = Callable[..., SpaceMousePeer]


@pytest.fixture
def serve(tmp_path) -> Iterator[Serve]:
    peers = []

    def start(script: str = "0.0 axes 1 0 0 0 0 0", **options: object) -> SpaceMousePeer:
        file = tmp_path / "script.txt"
        file.write_text(script)
        peer = SpaceMousePeer(
            SpaceMousePeerOptions(usbip=0, script=str(file), jitter_lsb=0, **options)
        )
        peers.append(peer)
        peer.open()
        return peer

    yield start
    for peer in peers:
        peer.close()


@pytest.fixture
def host() -> Iterator[Callable[[SpaceMousePeer], Host]]:
    hosts = []

    def connect(peer: SpaceMousePeer) -> Host:
        hosts.append(Host(peer))
        return hosts[-1]

    yield connect
    for one in hosts:
        one.sock.close()


def imported(host: Host) -> Host:
    host.sock.sendall(IMPORT)
    assert host.get(320)[4:8] == bytes(4)
    return host


@pytest.mark.real
def test_an_attached_puck_moves_once_it_is_polled_and_takes_its_led(serve, host):
    peer = serve()
    pc = imported(host(peer))
    assert peer.backend.attached
    assert peer.endpoint.endswith(" 1-1")
    assert peer._start_s is None
    pc.sock.sendall(submit(1, 1, 64))
    report = pc.get(48 + 7)[48:]
    # Full deflection forward is -350 on the raw Y axis.
    assert report == bytes.fromhex("01 0000 a2fe 0000")
    pc.sock.sendall(submit(2, 0, 2, to_host=False, setup=SET_LED, data=b"\x04\x00"))
    pc.get(48)
    assert not peer.device.led


def test_one_host_at_a_time(serve, host):
    peer = serve()
    first, second = imported(host(peer)), host(peer)
    second.sock.sendall(IMPORT)
    assert second.get(8) == bytes.fromhex("0111 0003 00000002")
    first.sock.close()
    while peer.backend.attached:
        peer.step(time.monotonic() + 0.002)
    imported(second)


def test_unplugged_it_hangs_up_and_can_be_attached_again_once_it_is_back(serve, host):
    peer = serve("0.1 unplug\n0.6 replug", start_on_connect=False)
    pc = imported(host(peer))
    assert pc.gone()
    other = host(peer)
    other.sock.sendall(IMPORT)
    assert other.get(8) == bytes.fromhex("0111 0003 00000004")
    while not peer.device.plugged:
        peer.step(time.monotonic() + 0.002)
    imported(host(peer))


def test_a_device_that_refuses_is_busy(serve, host):
    pc = host(serve(faults={"refuse": float("inf")}))
    pc.sock.sendall(IMPORT)
    assert pc.get(8) == bytes.fromhex("0111 0003 00000002")


def test_junk_ends_the_connection_and_nothing_else(serve, host):
    peer = serve()
    pc, junk = imported(host(peer)), host(peer)
    junk.sock.sendall(b"GET / HTTP/1.1\r\n\r\n")
    assert junk.gone()
    pc.sock.sendall(submit(1, 0, 64, setup=GET_DEVICE))
    assert len(pc.get(66)) == 66


def test_a_port_in_use_is_named(serve):
    port = serve().backend.address[1]
    with pytest.raises(AddressError, match=rf"cannot listen on 127.0.0.1:{port}"):
        SpaceMousePeer(SpaceMousePeerOptions(usbip=port)).open()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"usbip": 70000}, "usbip: 70000 is not allowed; it must be"),
        ({"bus_id": "x" * 32}, "it must be a name of 1 to 31 bytes"),
        ({"model": "teapot"}, "model: 'teapot' is not allowed; it must be"),
        ({"faults": {"newest-lost": 1.0}}, "the host's kernel keeps the queue"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, words):
    error = OptionError if "it must be" in words else ScriptError
    with pytest.raises(error, match=words):
        SpaceMousePeer(SpaceMousePeerOptions(**{"usbip": 0, **options}))
