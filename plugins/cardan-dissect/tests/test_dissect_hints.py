"""Flows on unknown ports: the likely protocol, and the options that read them."""

import io
import random
import re
import struct

import pytest

from cardan.conform import Level, registry
from cardan.conform.attachments import pcap
from cardan.conform.run import simulated
from cardan_dissect import dissect_file, network
from cardan_dissect.capture import Capture
from cardan_dissect.ports import (
    EGM_PORTS,
    JOINT_STREAM_PORT,
    RTDE_PORTS,
    SIMPLE_MESSAGE_PORTS,
)
from tests.captures import MOTOMAN, require

pytestmark = pytest.mark.matrix

KNOWN = (*EGM_PORTS, JOINT_STREAM_PORT, *SIMPLE_MESSAGE_PORTS, *RTDE_PORTS)
MOVED = 10_000
"""Offset that moves the ports away from the known ones."""
HEAD = struct.Struct("<IIII")
CLIENT, SERVER = bytes((10, 0, 0, 1)), bytes((10, 0, 0, 2))


def ip(source, destination, protocol, payload):
    size = 20 + len(payload)
    return struct.pack(">BBHHHBBH", 0x45, 0, size, 0, 0, 64, protocol, 0) + (
        source + destination + payload
    )


def written(path, packets):
    """Return packets of raw IP, 1 ms apart."""
    start = struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 262_144, network.RAW)
    listed = (
        HEAD.pack(n // 1000, n % 1000 * 10**6, len(p), len(p)) + p for n, p in enumerate(packets)
    )
    path.write_bytes(start + b"".join(listed))
    return path


def moved(data):
    """Move the packet to unknown ports."""
    at = (data[0] & 15) * 4
    ports = struct.unpack_from(">HH", data, at)
    return (
        data[:at]
        + struct.pack(">HH", *(p + MOVED if p in KNOWN else p for p in ports))
        + data[at + 4 :]
    )


def hints(path, **options):
    out = io.StringIO()
    dissect_file(path, out, summary=True, **options)
    return [line for line in out.getvalue().splitlines() if "looks like" in line]


def session(tmp_path, name):
    suite = registry.load(name)
    _, timeline = simulated(suite, Level.LISTEN)
    path = tmp_path / "session.pcap"
    path.write_bytes(pcap(suite, timeline, 1_700_000_000 * 10**9))
    return path


def reads_as_it_says(path, lines, name):
    """Apply the options of the hints: every flow is decoded, and no hint is left."""
    given = {}
    for line in lines:
        assert f"looks like {name}, " in line
        flag, port = re.search(r"; read it with --(\S+) (\d+)", line).groups()
        key = {"port": "egm_ports"}.get(flag, f"{flag.replace('-', '_')}s")
        given.setdefault(key, []).append(int(port))
    out = io.StringIO()
    counts = dissect_file(path, out, summary=True, **given)
    assert counts.messages[name] > 0
    assert "looks like" not in out.getvalue()
    return counts


@pytest.mark.parametrize(
    ("suite", "name", "side", "port"),
    [
        ("egm", "EGM", "the robot at 192.0.2.1:", EGM_PORTS[0]),
        ("ur-rtde", "RTDE", "the robot at 192.0.2.1:40004", RTDE_PORTS[0]),
        ("motoros", "simple message", "the controller at 192.0.2.1:60241", SIMPLE_MESSAGE_PORTS[1]),
    ],
)
def test_a_session_on_other_ports_is_recognized(tmp_path, suite, name, side, port):
    path = session(tmp_path, suite)
    assert hints(path) == []
    known = dissect_file(path, io.StringIO(), summary=True)
    elsewhere = written(tmp_path / "moved.pcap", [moved(p.data) for p in Capture(path)])
    lines = hints(elsewhere)
    assert any(f" {port + MOVED}" in line and side in line for line in lines)
    assert reads_as_it_says(elsewhere, lines, name).messages[name] == known.messages[name]


def test_the_joint_stream_needs_no_port(tmp_path):
    path = session(tmp_path, "joint-stream")
    elsewhere = written(tmp_path / "moved.pcap", [moved(p.data) for p in Capture(path)])
    assert hints(elsewhere) == []
    counts = dissect_file(elsewhere, io.StringIO(), summary=True)
    assert counts.messages["joint stream"] == counts.packets


def test_a_capture_of_a_real_controller_on_other_ports(tmp_path):
    packets = [moved(p.data[14:]) for p in Capture(require(MOTOMAN)) if p.data[12:14] == b"\x08\0"]
    path = written(tmp_path / "moved.pcap", packets)
    reads_as_it_says(path, hints(path), "simple message")


def test_a_stream_of_rtde_whose_beginning_is_missing_has_one_side(tmp_path):
    def segment(n):
        head = struct.pack(">HHIIBBHHH", 4000, 50000, 31 * n, 0, 0x50, 0x18, 65535, 0, 0)
        return ip(SERVER, CLIENT, 6, head + struct.pack(">HBB", 31, 85, 1) + bytes(27))

    path = written(tmp_path / "rtde.pcap", map(segment, range(20)))
    (line,) = hints(path)
    assert line == (
        "10.0.0.2:4000 > 10.0.0.1:50000: looks like RTDE, the robot at 10.0.0.2:4000; "
        "read it with --rtde-port 4000"
    )


def udp(payload, source=40000, destination=40001):
    head = struct.pack(">HHHH", source, destination, 8 + len(payload), 0)
    return ip(CLIENT, SERVER, 17, head + payload)


def talk(*said, source=40000, destination=40001):
    """Return a connection on which client and server send in turns."""
    places, packets = [1, 1], []
    for flags, turn in ((0x02, 0), (0x12, 1)):
        ends = (source, destination) if turn == 0 else (destination, source)
        head = struct.pack(">HHIIBBHHH", *ends, 0, turn, 0x50, flags, 65535, 0, 0)
        packets.append(ip(*((CLIENT, SERVER) if turn == 0 else (SERVER, CLIENT)), 6, head))
    for n, data in enumerate(said):
        turn = n % 2
        ends = (source, destination) if turn == 0 else (destination, source)
        head = struct.pack(
            ">HHIIBBHHH", *ends, places[turn], places[1 - turn], 0x50, 0x18, 65535, 0, 0
        )
        packets.append(ip(*((CLIENT, SERVER) if turn == 0 else (SERVER, CLIENT)), 6, head + data))
        places[turn] += len(data)
    return packets


def asked(n):
    name = b"\7example\3org\0"
    return struct.pack(">6H", n, 0x0100, 1, 0, 0, 0) + name + struct.pack(">HH", 1, 1)


HELLO = bytes.fromhex("16030100c8010000c40303") + bytes(range(189))
GET = b"GET /index.html HTTP/1.1\r\nHost: example.org\r\n\r\n"
PAGE = b"HTTP/1.1 200 OK\r\nContent-Length: 20\r\n\r\n<html>POST PUT</html>"
NOISE = {
    "DNS": [udp(asked(n), destination=53) for n in range(20)],
    "NTP": [udp(b"\x23\0\6\xec" + bytes([n]) * 44, 123, 123) for n in range(20)],
    "zeros": [udp(bytes(100)) for n in range(20)],
    "zeros on TCP": talk(*[bytes(100)] * 20),
    "HTTP": talk(*[GET, PAGE] * 8),
    "POST": talk(*[b"POST" + GET[3:], PAGE] * 8),
    "TLS": talk(*[HELLO, b"\x17\3\3\0\x40" + bytes(64)] * 8),
    "lengths of 4 bytes": talk(*[struct.pack("<I", 40) + bytes(40)] * 16),
    "lengths of 2 bytes": talk(*[struct.pack(">HB", 40, 0) + bytes(37)] * 16),
    "Modbus": talk(*[struct.pack(">HHHBBHH", n, 0, 6, 1, 3, 0, 10) for n in range(16)]),
}


@pytest.mark.parametrize("name", NOISE)
def test_what_is_no_protocol_of_ours_is_not_recognized(tmp_path, name):
    path = written(tmp_path / "noise.pcap", NOISE[name])
    assert hints(path) == []


def test_random_bytes_are_not_recognized(tmp_path):
    chance = random.Random(44)
    packets = []
    for n in range(200):
        pieces = [chance.randbytes(chance.randrange(1, 200)) for _ in range(12)]
        packets += [udp(each, 20_000 + n, 40_000 + n) for each in pieces]
        packets += talk(*pieces, source=20_000 + n, destination=40_000 + n)
    assert hints(written(tmp_path / "noise.pcap", packets)) == []


@pytest.mark.parametrize("suite", ["egm", "joint-stream", "motoros", "ur-rtde"])
def test_what_is_on_its_usual_port_needs_no_hint(tmp_path, suite):
    suite = registry.load(suite)
    data = pcap(suite, simulated(suite, Level.LISTEN)[1], 0)
    assert data is not None
    path = tmp_path / "session.pcap"
    path.write_bytes(data)
    assert hints(path) == []


def test_many_flows_to_one_port_are_one_line(tmp_path):
    path = session(tmp_path, "egm")
    packets = [moved(p.data) for p in Capture(path)][:10]
    spread = []
    for n in range(5):
        for data in packets:
            at = (data[0] & 15) * 4
            spread.append(data[:at] + struct.pack(">H", 30_000 + n) + data[at + 2 :])
    (line,) = hints(written(tmp_path / "spread.pcap", spread))
    assert line.endswith("read it with --port 16510 (4 more of these flows)")


@pytest.mark.parametrize(("suite", "name"), [("ur-rtde", "RTDE"), ("motoros", "simple message")])
def test_one_side_or_the_beginning_can_be_missing(tmp_path, suite, name):
    packets = [moved(p.data) for p in Capture(session(tmp_path, suite))]
    robot = bytes((192, 0, 2, 1))
    for some in (packets[len(packets) // 2 :], [p for p in packets if p[12:16] == robot]):
        (line,) = hints(written(tmp_path / "some.pcap", some))
        assert re.search(rf"looks like {name}, the (robot|controller) at 192\.0\.2\.1:", line)


def test_what_the_capture_cut_is_no_fault_of_a_flow(tmp_path):
    packets = [moved(p.data) for p in Capture(session(tmp_path, "ur-rtde"))]
    path = tmp_path / "cut.pcap"
    start = struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 96, network.RAW)
    cut = (HEAD.pack(n, 0, min(96, len(p)), len(p)) + p[:96] for n, p in enumerate(packets))
    path.write_bytes(start + b"".join(cut))
    (line,) = hints(path)
    assert "looks like RTDE, the robot at 192.0.2.1:40004" in line
