"""Whole captures: output, counts, and errors for files that are no capture."""

import gzip
import io
import struct
import subprocess
import sys
import tracemalloc
from contextlib import suppress

import pytest
from scapy.layers.inet import IP, TCP, UDP
from scapy.layers.inet6 import IPv6
from scapy.layers.l2 import ARP, CookedLinux, CookedLinuxV2, Dot1Q, Ether, Loopback
from scapy.packet import Raw
from scapy.utils import PcapWriter, RawPcapWriter, wrpcap, wrpcapng

from cardan.errors import CaptureError
from cardan_dissect import EGM_PORTS, Counts, dissect_file
from cardan_dissect.egm import (
    CORRECTION,
    DATA,
    EgmFeedBack,
    EgmHeader,
    EgmJoints,
    EgmPlanned,
    EgmRobot,
    EgmSensor,
)
from tests.protocols import worked

pytestmark = pytest.mark.matrix

START_S = 1_700_000_000
PERIOD_S = 0.004
CONTROLLER, PC = ("10.0.0.1", 50123), ("10.0.0.2", EGM_PORTS[0])
# With addresses, so that scapy does not resolve them on the network.
ETHER = Ether(src="02:00:00:00:00:01", dst="02:00:00:00:00:02")
ETHERTYPE_ONLY = Ether(src=ETHER.src, dst=ETHER.dst, type=0x800)
FIVE_JOINTS = [0.0] * 5
NONE = {"EGM": 0, "3Dconnexion": 0, "joint stream": 0, "simple message": 0, "RTDE": 0}
NOTHING = "no EGM, 3Dconnexion, joint stream, simple message or RTDE traffic found in"


def read(path, **options):
    out = io.StringIO()
    counts = dissect_file(path, out, **options)
    return counts, out.getvalue()


def at(time_s, packet):
    packet.time = START_S + time_s
    return packet


def datagram(source, destination, payload):
    addresses = IP(src=source[0], dst=destination[0])
    return ETHER / addresses / UDP(sport=source[1], dport=destination[1]) / Raw(bytes(payload))


def robot(seqno, tm=None):
    header = EgmHeader(seqno=seqno, tm=seqno * 4 if tm is None else tm, mtype=DATA)
    return EgmRobot(
        header=header, feedBack=EgmFeedBack(joints=EgmJoints(joints=[1.0 * seqno, *FIVE_JOINTS]))
    )


def reply(seqno, tm):
    header = EgmHeader(seqno=seqno, tm=tm, mtype=CORRECTION)
    return EgmSensor(header=header, planned=EgmPlanned(joints=EgmJoints(joints=[0.5] * 6)))


def to_pc(time_s, payload, source=CONTROLLER):
    return at(time_s, datagram(source, PC, payload))


def from_pc(time_s, payload, destination=CONTROLLER):
    return at(time_s, datagram(PC, destination, payload))


def session(count, replies=True, start_s=0.0, source=CONTROLLER):
    packets = []
    for n in range(count):
        packets.append(to_pc(start_s + n * PERIOD_S, robot(n), source))
        if replies:
            packets.append(from_pc(start_s + n * PERIOD_S + 0.001, reply(n, n * 4), source))
    return packets


@pytest.fixture
def capture(tmp_path):
    def write(packets, name="capture.pcap"):
        path = tmp_path / name
        wrpcap(str(path), packets)
        return path

    return write


def test_a_clean_session(capture):
    counts, text = read(capture(session(10)))
    assert counts == Counts(20, {**NONE, "EGM": 20}, NONE, 0)
    lines = text.splitlines()
    assert lines[0] == "capture starts 2023-11-14 22:13:20.000000 UTC"
    assert lines[1] == (
        "#1 0.000000 10.0.0.1:50123 > 10.0.0.2:6510 EgmRobot | "
        "header (seqno 0, tm_ms 0, mtype DATA) | feed_back (joints 0 0 0 0 0 0)"
    )
    assert lines[4] == (
        "#4 0.005000 10.0.0.2:6510 > 10.0.0.1:50123 EgmSensor | "
        f"header (seqno 1, tm_ms 4, mtype CORRECTION) | planned (joints{' 0.0087266463' * 6})"
    )
    assert lines[21:] == [
        "EGM 10.0.0.1:50123 > 10.0.0.2:6510",
        "  10 messages",
        "  EgmRobot x10, period mean 4.000 min 4.000 max 4.000 ms, "
        "lost 0 duplicate 0 out of order 0 restarts 0",
        "  answers x9, after: median 3.000 p99 3.000 ms",
        "EGM 10.0.0.2:6510 > 10.0.0.1:50123",
        "  10 messages",
        "  EgmSensor x10, period mean 4.000 min 4.000 max 4.000 ms, "
        "lost 0 duplicate 0 out of order 0 restarts 0",
        "  answers x10, after: median 1.000 p99 1.000 ms",
        "20 packets: 20 EGM, 0 malformed; 0 others",
    ]


def test_loss_duplicates_reordering_restart_and_damage(capture):
    packets = [to_pc(n * PERIOD_S, robot(n)) for n in range(5)]
    packets.append(to_pc(0.024, robot(6)))  # 5 is lost
    packets.append(to_pc(0.0241, robot(6)))  # sent twice
    packets.append(to_pc(0.032, robot(8)))
    packets.append(to_pc(0.0325, robot(7)))  # late
    packets.append(to_pc(0.036, robot(9)))
    packets.append(to_pc(0.040, worked.R0[:30]))
    packets.append(to_pc(0.041, b""))
    packets.append(from_pc(0.042, b"\x0a\x05ab"))
    packets.append(to_pc(0.5, robot(0, tm=500)))  # another session
    packets.append(to_pc(0.504, robot(1, tm=504)))
    packets.append(from_pc(0.506, reply(1, tm=504)))
    packets.append(from_pc(0.507, reply(2, tm=504)))
    counts, text = read(capture(packets))
    assert counts.messages["EGM"] == len(packets)
    assert counts.malformed["EGM"] == 3
    assert "SEQUENCE GAP" in text
    assert "SEQUENCE LATE" in text
    assert text.count("SEQUENCE RESTART") == 1
    assert "SEQUENCE DUPLICATE" in text
    assert "MALFORMED EgmRobot: empty: the datagram has no bytes (0 B: )" in text
    assert "MALFORMED EgmRobot: truncated or not protobuf: " in text
    assert " (30 B: 0a 06 08 00" in text
    assert "  14 messages\n" in text
    assert (
        "  EgmRobot x12, period mean 5.000 min 4.000 max 8.000 ms, "
        "lost 1 duplicate 1 out of order 1 restarts 1\n" in text
    )
    assert "  malformed: truncated or not protobuf x1, empty x1" in text
    assert "  answers x1, after: median 2.000 p99 2.000 ms" in text


def test_a_late_reply_belongs_to_the_datagram_it_echoes(capture):
    packets = [to_pc(n * PERIOD_S, robot(n + 1)) for n in range(10)]
    packets += [from_pc(n * PERIOD_S + 0.006, reply(n, (n + 1) * 4)) for n in range(10)]
    packets.sort(key=lambda p: p.time)
    _, text = read(capture(packets), summary=True)
    assert "  answers x10, after: median 6.000 p99 6.000 ms" in text


def test_replies_without_an_echo_belong_to_the_newest_datagram(capture):
    packets = []
    for n in range(4):
        packets.append(to_pc(n * PERIOD_S, robot(n + 1)))
        if n != 2:
            packets.append(from_pc(n * PERIOD_S + 0.002, reply(2 * n, 0)))
    _, text = read(capture(packets), summary=True)
    assert "  answers x3, after: median 2.000 p99 2.000 ms" in text
    assert "(steps by 2)" in text


def test_seqno_wraps_without_loss(capture):
    numbers = [2**32 - 2, 2**32 - 1, 0, 1]
    packets = [to_pc(i * PERIOD_S, robot(n, tm=i)) for i, n in enumerate(numbers)]
    _, text = read(capture(packets), summary=True)
    assert "lost 0 duplicate 0 out of order 0 restarts 0" in text


def test_a_seqno_sent_again_with_other_content_is_named(capture):
    packets = [to_pc(i * PERIOD_S, robot(n, tm=i)) for i, n in enumerate([1, 2, 2, 3])]
    _, text = read(capture(packets))
    assert "SEQUENCE REPEATED" in text
    assert "repeated with other content 1" in text


def test_a_new_local_port_has_figures_of_its_own(capture):
    later = session(3, start_s=1.0, source=("10.0.0.1", 50999))
    _, text = read(capture(session(3) + later), summary=True)
    assert "EGM 10.0.0.1:50123 > 10.0.0.2:6510\n  3 messages" in text
    assert "EGM 10.0.0.1:50999 > 10.0.0.2:6510\n  3 messages" in text


def test_what_the_codec_refuses_is_malformed_and_what_only_informs_is_shown(capture):
    wrong = EgmRobot(header=EgmHeader(seqno=1, tm=1, mtype=CORRECTION))
    odd = robot(2)
    odd.utilizationRate = float("nan")
    counts, text = read(capture([to_pc(0, wrong), to_pc(0.004, odd)]))
    assert counts.malformed["EGM"] == 1
    assert "MALFORMED EgmRobot: not the expected EGM message: mtype 3 is not" in text
    assert "  malformed: not the expected EGM message x1" in text
    assert "utilization_rate nan" in text


def test_a_controller_port_among_ours_is_reported_by_the_type(capture):
    controller = ("127.0.0.1", EGM_PORTS[1])
    pc = ("127.0.0.1", EGM_PORTS[0])
    packets = [
        at(0, datagram(controller, pc, robot(1))),
        at(0.001, datagram(pc, controller, reply(1, 4))),
    ]
    _, text = read(capture(packets), summary=True)
    assert "EgmRobot x1" in text
    assert "EgmSensor x1, lost 0" in text
    assert "restarts 0\n  answers x1, after: median 1.000" in text


def test_other_ports_on_request(capture):
    packets = [at(n, datagram(CONTROLLER, ("10.0.0.2", 7000), robot(n))) for n in range(3)]
    path = capture(packets)
    counts, text = read(path)
    assert counts.messages["EGM"] == 0
    assert (
        "no EGM, 3Dconnexion, joint stream, simple message or RTDE traffic found in 3 packets"
        in text
    )
    assert "EGM was looked for on UDP ports 6510 6511 6512 6513" in text
    assert read(path, egm_ports=[7000])[0].messages["EGM"] == 3


def test_another_protocol_is_said_not_to_be_ours(capture):
    packets = [
        at(n, ETHER / IP(src="10.0.0.1", dst="10.0.0.2") / TCP(sport=40000, dport=50240))
        for n in range(3)
    ]
    packets.append(at(4, ETHER / ARP(hwsrc=ETHER.src, psrc="10.0.0.1", pdst="10.0.0.2")))
    counts, text = read(capture(packets))
    assert counts.other_packets == 4
    assert (
        "no EGM, 3Dconnexion, joint stream, simple message or RTDE traffic found in 4 packets"
        in text
    )
    assert "other packets: TCP 40000/50240 x3, ARP x1" in text


def test_something_else_on_the_port_is_said_not_to_be_egm(capture):
    packets = [to_pc(n, b"GET / HTTP/1.1") for n in range(2)]
    counts, text = read(capture(packets), summary=True)
    assert counts.malformed["EGM"] == 2
    assert "EGM 10.0.0.1:50123 > 10.0.0.2:6510\n  2 messages\n  malformed: truncated" in text


def test_limit_and_summary(capture):
    path = capture(session(10))
    counts, text = read(path, limit=3)
    assert counts.messages["EGM"] == 3
    assert "#3 " in text
    assert "#4 " not in text
    assert "stopped at the limit of 3" in text
    counts, text = read(path, limit=20, summary=True)
    assert counts.messages["EGM"] == 20
    assert "#1 " not in text
    assert "stopped" not in text


def pcapng_blocks(*blocks, order="<"):
    return b"".join(
        struct.pack(f"{order}II", kind, len(body) + 12)
        + body
        + struct.pack(f"{order}I", len(body) + 12)
        for kind, body in blocks
    )


def as_pcapng(pcap):
    """Convert to pcapng; older scapy cannot write other link types."""
    link_type, at_byte = struct.unpack_from("<I", pcap, 20)[0], 24
    blocks = [
        (0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)),
        (1, struct.pack("<HHI", link_type, 0, 0)),
    ]
    while at_byte < len(pcap):
        seconds, microseconds, size, wire_bytes = struct.unpack_from("<4I", pcap, at_byte)
        stamp = seconds * 10**6 + microseconds
        content = pcap[at_byte + 16 : at_byte + 16 + size]
        words = struct.pack("<5I", 0, stamp >> 32, stamp & 0xFFFFFFFF, size, wire_bytes)
        blocks.append((6, words + content + bytes(-size % 4)))
        at_byte += 16 + size
    return pcapng_blocks(*blocks)


LINKS = {
    "ethernet": ETHER / IP(src="10.0.0.1", dst="10.0.0.2"),
    "vlan": ETHER / Dot1Q(vlan=5) / IP(src="10.0.0.1", dst="10.0.0.2"),
    "cooked": CookedLinux(proto=0x800) / IP(src="10.0.0.1", dst="10.0.0.2"),
    "cooked2": CookedLinuxV2(proto=0x800) / IP(src="10.0.0.1", dst="10.0.0.2"),
    "loopback": Loopback() / IP(src="10.0.0.1", dst="10.0.0.2"),
    "raw": IP(src="10.0.0.1", dst="10.0.0.2"),
    "ipv6": ETHER / IPv6(src="fd00::1", dst="fd00::2"),
}


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("form", ["pcap", "pcapng"])
def test_link_types_and_file_formats(tmp_path, link, form):
    path = tmp_path / f"capture.{form}"
    packets = [
        at(n * PERIOD_S, LINKS[link].copy() / UDP(sport=5, dport=6510) / Raw(bytes(robot(n))))
        for n in range(3)
    ]
    wrpcap(str(path), packets)
    if form == "pcapng":
        path.write_bytes(as_pcapng(path.read_bytes()))
    counts, text = read(path)
    assert counts == Counts(3, {**NONE, "EGM": 3}, NONE, 0)
    address = "[fd00::1]:5 > [fd00::2]:6510" if link == "ipv6" else "10.0.0.1:5 > 10.0.0.2:6510"
    assert f"{address} EgmRobot | header (seqno 2, tm_ms 8, mtype DATA)" in text
    assert "period mean 4.000 min 4.000 max 4.000 ms" in text


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("nano", [False, True])
def test_byte_orders_and_nanoseconds(tmp_path, order, nano):
    path = tmp_path / "capture.pcap"
    writer = PcapWriter(str(path), endianness=order, nano=nano, linktype=1)
    for packet in session(3):
        writer.write(packet)
    writer.close()
    _, text = read(path)
    assert "capture starts 2023-11-14 22:13:20.000000 UTC" in text
    assert "answers x3, after: median 1.000 p99 1.000 ms" in text


@pytest.mark.parametrize("zipped", [False, True])
def test_a_damaged_length_takes_no_memory(capture, tmp_path, zipped):
    data = capture(session(1)).read_bytes()
    data += struct.pack("<4I", START_S, 0, 200_000_000, 200_000_000) + bytes(40)
    path = tmp_path / "damaged.pcap"
    path.write_bytes(gzip.compress(data) if zipped else data)
    tracemalloc.start()
    try:
        with pytest.raises(CaptureError, match="the file ends inside a packet after packet 2"):
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()


def test_gzip(capture, tmp_path):
    path = tmp_path / "capture.pcap.gz"
    path.write_bytes(gzip.compress(capture(session(3)).read_bytes()))
    assert read(path)[0].messages["EGM"] == 6
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(CaptureError, match="gzip data are damaged"):
        read(path)


@pytest.mark.parametrize("order", "<>")
def test_pcapng_by_hand(tmp_path, order):
    packet = bytes(datagram(CONTROLLER, PC, robot(1)))
    padded = packet + bytes(-len(packet) % 4)
    section = (0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
    options = struct.pack(f"{order}HHB3xHHqHH", 9, 1, 9, 14, 8, START_S, 0, 0)
    interface = (1, struct.pack(f"{order}HHI", 1, 0, 0) + options)
    sizes = len(packet), len(packet)
    new = (6, struct.pack(f"{order}5I", 0, 0, 500_000_000, *sizes) + padded)
    old = (2, struct.pack(f"{order}HH4I", 0, 0, 0, 750_000_000, *sizes) + padded)
    simple = (3, struct.pack(f"{order}I", len(packet)) + padded)
    unknown = (0x999, b"abcd")
    path = tmp_path / "capture.pcapng"
    data = pcapng_blocks(section, unknown, interface, new, old, simple, order=order)
    path.write_bytes(data)
    counts, text = read(path)
    assert counts.messages["EGM"] == 3
    assert "capture starts 2023-11-14 22:13:20.500000 UTC" in text
    assert "#2 0.250000 " in text
    assert "#3 0.250000 " in text  # A simple packet block has no time stamp.
    path.write_bytes(
        data + pcapng_blocks((6, struct.pack(f"{order}5I", 7, 0, 0, 0, 0)), order=order)
    )
    with pytest.raises(CaptureError, match="damaged: a pcapng block of type 6 after packet 3"):
        read(path)
    path.write_bytes(data + struct.pack(f"{order}II", 6, 2**31))
    with pytest.raises(CaptureError, match="damaged: a length of"):
        read(path)
    path.write_bytes(data + struct.pack(f"{order}II", 6, 13))
    with pytest.raises(CaptureError, match="damaged: a pcapng block of 13 bytes"):
        read(path)
    path.write_bytes(data[:8] + b"abcd" + data[12:])
    with pytest.raises(CaptureError, match="byte order mark"):
        read(path)


def test_a_snap_length_is_not_the_sender_s_fault(tmp_path):
    path = tmp_path / "capture.pcap"
    whole = bytes(datagram(CONTROLLER, PC, robot(1)))
    writer = RawPcapWriter(str(path), linktype=1)
    writer.write_header(None)
    writer.write_packet(whole[:64], sec=START_S, usec=0, caplen=64, wirelen=len(whole))
    writer.close()
    counts, text = read(path)
    assert counts.malformed["EGM"] == 1
    assert "MALFORMED EgmRobot: cut by the capture" in text


def test_fragments_and_broken_packets_are_others(capture):
    fragment = datagram(CONTROLLER, PC, robot(1))
    fragment[IP].frag = 3
    packets = [
        at(0, fragment),
        at(1, ETHERTYPE_ONLY),
        at(2, ETHERTYPE_ONLY / Raw(b"\x45abc")),
    ]
    packets.append(at(3, ETHER / IP(src="10.0.0.1", dst="10.0.0.2", proto=17) / Raw(b"abc")))
    counts, text = read(capture(packets))
    assert counts.other_packets == 4
    assert "other packets: cut or broken packet x3, IP fragment x1" in text


def test_files_that_are_no_captures(tmp_path, capture):
    with pytest.raises(CaptureError, match="there is no such file"):
        read(tmp_path / "missing.pcap")
    with pytest.raises(CaptureError, match="cannot be read"):
        read(tmp_path)
    path = tmp_path / "file"
    path.write_bytes(b"")
    with pytest.raises(CaptureError, match="the file is empty"):
        read(path)
    path.write_bytes(b"%PDF-1.7 and more")
    with pytest.raises(
        CaptureError,
        match=r"not a pcap or pcapng capture, and no log of Bluetooth or of a CAN bus "
        r"\(it begins with 25 50",
    ):
        read(path)
    path.write_bytes(capture(session(1)).read_bytes()[:24])
    assert f"{NOTHING} 0 packets" in read(path)[1]


@pytest.mark.parametrize("form", ["pcap", "pcapng"])
def test_truncated_captures_show_what_there_is(tmp_path, form):
    path = tmp_path / "capture"
    (wrpcap if form == "pcap" else wrpcapng)(str(path), session(3))
    data = path.read_bytes()
    for missing in (1, 30, 100):
        path.write_bytes(data[:-missing])
        out = io.StringIO()
        with pytest.raises(CaptureError, match=r"truncated: .* after packet 5"):
            dissect_file(path, out)
        assert "5 packets: 5 EGM, 0 malformed; 0 others" in out.getvalue()
    for size in range(5, 24):
        path.write_bytes(data[:size])
        with pytest.raises(CaptureError, match="truncated"):
            read(path)


def test_every_damaged_byte_is_read_or_refused(tmp_path):
    path = tmp_path / "capture"
    wrpcapng(str(path), session(2))
    data = path.read_bytes()
    for position in range(0, len(data), 3):
        damaged = bytearray(data)
        damaged[position] ^= 0xFF
        path.write_bytes(bytes(damaged))
        with suppress(CaptureError):
            read(path)


def test_captures_are_read_without_scapy(capture):
    program = (
        "import sys; sys.modules['scapy'] = None\n"
        "from cardan_dissect import dissect_file\n"
        "print(dissect_file(sys.argv[1], sys.stdout).messages['EGM'])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(capture(session(1)))],
        capture_output=True,
        text=True,
        timeout=30,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "2"


BUS, DEVICE = 1, 5
SUBMIT, COMPLETE = b"S", b"C"
INTERRUPT, CONTROL = 1, 2


def urb(data=b"", *, event=COMPLETE, transfer=INTERRUPT, endpoint=0x81, status=0, **more):
    """Return a usbmon record; `more`: setup, device, urb_id, header_bytes, order."""
    setup = more.get("setup")
    order = more.get("order", "<")
    header = struct.pack(
        f"{order}QcBBBHBBqiiII8s",
        more.get("urb_id", 1),
        event,
        transfer,
        endpoint,
        more.get("device", DEVICE),
        BUS,
        0 if setup else 0x2D,
        0 if data else 0x3C,
        0,
        0,
        status,
        len(data),
        len(data),
        setup or bytes(8),
    )
    return header.ljust(more.get("header_bytes", 64), b"\0") + data


def descriptor(vendor, product):
    setup = b"\x80\x06\x00\x01\x00\x00\x12\x00"
    content = b"\x12\x01\x00\x02\0\0\0\x08" + struct.pack("<HH", vendor, product) + bytes(6)
    control = {"transfer": CONTROL, "endpoint": 0x80, "urb_id": 77}
    return [urb(event=SUBMIT, setup=setup, **control), urb(content, **control)]


@pytest.fixture
def usb_capture(tmp_path):
    def write(records, link_type=220, order="<", period_s=0.008):
        path = tmp_path / "usb.pcap"
        writer = RawPcapWriter(str(path), linktype=link_type, endianness=order)
        writer.write_header(None)
        for n, record in enumerate(records):
            microseconds = round(n * period_s * 1e6)
            writer.write_packet(
                record, sec=START_S + microseconds // 10**6, usec=microseconds % 10**6
            )
        writer.close()
        return path

    return write


@pytest.mark.parametrize(("link_type", "header_bytes"), [(189, 48), (220, 64)])
@pytest.mark.parametrize("order", "<>")
def test_usb_reports_of_a_known_device(usb_capture, link_type, header_bytes, order):
    form = {"header_bytes": header_bytes, "order": order}
    records = [
        urb(event=SUBMIT, transfer=CONTROL, endpoint=0x80, urb_id=77, **form,
            setup=b"\x80\x06\x00\x01\0\0\x12\0"),
        urb(bytes.fromhex("1201000200000008 6d04 26c6") + bytes(6), transfer=CONTROL,
            endpoint=0x80, urb_id=77, **form),
        urb(event=SUBMIT, **form),
        urb(worked.TRANSLATION, **form),
        urb(worked.ROTATION, **form),
        urb(worked.BUTTONS_TWO, **form),
        urb(worked.TRANSLATION, **form),
        urb(worked.TRANSLATION[:5], **form),
        urb(b"\x2a\x01", **form),
        urb(worked.LED, event=SUBMIT, transfer=CONTROL, endpoint=0,
            setup=b"\x21\x09\x04\x02\0\0\x02\0", **form),
        urb(worked.CALIBRATE, event=SUBMIT, transfer=CONTROL, endpoint=0,
            setup=b"\x21\x09\x07\x03\0\0\x02\0", **form),
        urb(worked.LED, event=SUBMIT, endpoint=2, **form),
        urb(status=-108, **form),
        urb(b"\x00\x00\x04", device=9, **form),
    ]  # fmt: skip
    counts, text = read(usb_capture(records, link_type, order))
    assert counts.messages["3Dconnexion"] == 9
    assert counts.malformed["3Dconnexion"] == 1
    for line in (
        "#4 0.024000 USB 1.5 endpoint 1 IN Translation | x 120 | y -45 | z 300",
        "endpoint 1 IN Rotation | rx -350 | ry 8 | rz 64",
        "endpoint 1 IN ButtonBits | mask 3",
        "endpoint 1 IN MALFORMED report: 0x01 too short: 5 bytes (5 B: 01 78 00 d3 ff)",
        "endpoint 1 IN report 0x2a of an unknown id | data 01",
        "endpoint 0 OUT LedOutput | on True",
        "endpoint 0 OUT feature report | data 07 00",
        "endpoint 2 OUT LedOutput | on True",
        "endpoint 1 IN transfer failed, status -108",
        "3Dconnexion USB 1.5 endpoint 1 IN: 046d:c626 SpaceNavigator",
        "  Translation x2, period mean 24.000 min 24.000 max 24.000 ms",
        "  Rotation x1\n",
        "  ButtonBits x1\n",
        "  report 0x2a of an unknown id x1",
        "  malformed: 0x01 too short x1",
    ):
        assert line in text


def test_usb_device_without_descriptor_is_known_by_its_motion(usb_capture):
    mouse = [urb(bytes([1, 0, n, 0]), device=7) for n in range(3)]
    wheel = [urb(b"\x01\x00\x00\xff\x7f\x00\x00", device=8), urb(worked.ROTATION, device=8)]
    split = [urb(worked.BUTTONS_TWO), urb(worked.TRANSLATION), urb(worked.ROTATION)]
    one = [urb(worked.MOTION, device=6)]
    counts, text = read(usb_capture(mouse + wheel + split + one))
    assert counts.messages["3Dconnexion"] == 4
    assert counts.other_packets == 5
    assert "USB 1.5 endpoint 1 IN ButtonBits | mask 3" in text  # held until identified
    assert "3Dconnexion USB 1.5 endpoint 1 IN: by the look of its reports" in text
    assert "endpoint 1 IN MotionReport | x -210 | y 33 | z -1 | rx 350 | ry -350 | rz 128" in text
    assert "USB 1.7" not in text
    assert "USB 1.8" not in text
    assert "other packets: USB x5" in text


def test_usb_devices_that_are_no_6dof_mice(usb_capture):
    cadmouse = descriptor(0x256F, 0xC650)
    counts, text = read(usb_capture([*cadmouse, urb(worked.MOTION)]))
    assert counts.messages["3Dconnexion"] == 0
    assert (
        "no EGM, 3Dconnexion, joint stream, simple message or RTDE traffic found in 3 packets"
        in text
    )
    unknown = descriptor(0x256F, 0xC6FF)
    assert read(usb_capture([*unknown, urb(worked.MOTION)]))[0].messages["3Dconnexion"] == 1


def test_usb_records_cut_by_the_capture(usb_capture, tmp_path):
    path = usb_capture(descriptor(0x256F, 0xC631))
    cut = urb(worked.MOTION)[:-4]
    with path.open("ab") as stream:
        stream.write(struct.pack("<4I", START_S + 1, 0, len(cut), len(cut) + 4) + cut)
        stream.write(struct.pack("<4I", START_S + 1, 0, 20, 20) + bytes(20))
    counts, text = read(path)
    assert counts.malformed["3Dconnexion"] == 1
    assert "MALFORMED report: cut by the capture (9 B: 01 2e ff" in text
