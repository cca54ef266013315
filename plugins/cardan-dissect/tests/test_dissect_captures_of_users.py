"""Captures as users record them: cut, compressed, from pipes, in several files, of all
interfaces."""

import io
import os
import struct
import sys
import threading
from types import SimpleNamespace

import pytest
from scapy.utils import RawPcapWriter

from cardan.conform import Level, registry
from cardan.conform.attachments import pcap
from cardan.conform.run import simulated
from cardan.errors import CaptureError
from cardan_dissect import dissect_file, network
from cardan_dissect.capture import CapturedPacket
from cardan_dissect.command import _Progress

pytestmark = pytest.mark.matrix

HEAD = struct.Struct("<IIII")


@pytest.fixture(scope="module")
def rtde(tmp_path_factory):
    """Return a capture of an RTDE session with nanoseconds and raw IP."""
    suite = registry.load("ur-rtde")
    _, timeline = simulated(suite, Level.LISTEN)
    path = tmp_path_factory.mktemp("captures") / "rtde.pcap"
    path.write_bytes(pcap(suite, timeline, 1_700_000_000 * 10**9))
    return path


def packets(path):
    data, at = path.read_bytes(), 24
    while at < len(data):
        seconds, ns, size, wire = HEAD.unpack_from(data, at)
        yield seconds, ns, data[at + 16 : at + 16 + size], wire
        at += 16 + size


def written(path, listed, start):
    path.write_bytes(start + b"".join(HEAD.pack(s, n, len(d), w) + d for s, n, d, w in listed))
    return path


def read(path, **options):
    out = io.StringIO()
    counts = dissect_file(path, out, **options)
    return counts, out.getvalue()


@pytest.mark.parametrize("snap", [60, 96])
def test_what_a_snap_length_cuts_is_no_gap(rtde, tmp_path, snap):
    listed = [(s, n, data[:snap], wire) for s, n, data, wire in packets(rtde)]
    cut = written(tmp_path / "cut.pcap", listed, rtde.read_bytes()[:24])
    whole, _ = read(rtde)
    counts, text = read(cut)
    assert "GAP" not in text
    assert "SKIPPED" not in text
    assert "out of order 0 gaps 0" in text
    assert "out of order 0 gaps 0 (" not in text
    many = sum(wire > snap for *_, wire in listed)
    assert f"{many} packets are cut by the capture, which kept at most {snap} bytes" in text
    assert counts.messages["RTDE"] == whole.messages["RTDE"]
    assert 0 < counts.malformed["RTDE"] <= counts.messages["RTDE"]
    assert "cut by the capture (" in text


@pytest.mark.parametrize(
    ("magic", "kind", "command"),
    [
        (b"\x28\xb5\x2f\xfd", "zstd", "zstd -dc"),
        (b"\xfd7zXZ\0", "xz", "xz -dc"),
        (b"\x04\x22\x4d\x18", "lz4", "lz4 -dc"),
        (b"BZh9", "bzip2", "bzip2 -dc"),
    ],
)
def test_a_compressed_file_is_named_with_what_unpacks_it(tmp_path, magic, kind, command):
    path = tmp_path / "my capture"
    path.write_bytes(magic + bytes(100))
    with pytest.raises(CaptureError) as raised:
        read(path)
    assert f"it is compressed with {kind}: `{command} '{path}' | cardan dissect -`" in str(
        raised.value
    )


@pytest.mark.parametrize("zipped", [False, True])
def test_a_pipe_is_read(rtde, tmp_path, zipped):
    import gzip

    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    data = rtde.read_bytes()
    data = gzip.compress(data) if zipped else data
    writer = threading.Thread(target=pipe.write_bytes, args=(data,))
    writer.start()
    found = read(pipe)
    writer.join()
    assert found == read(rtde)


def test_a_dash_is_standard_input(rtde, monkeypatch):
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(rtde.read_bytes())))
    assert read("-") == read(rtde)


def test_several_files_are_one_capture(rtde, tmp_path):
    listed, start = list(packets(rtde)), rtde.read_bytes()[:24]
    middle = len(listed) // 2
    one = written(tmp_path / "one.pcap", listed[:middle], start)
    two = written(tmp_path / "two.pcap", listed[middle:], start)
    assert read([one, two]) == read(rtde)
    assert f"{one} begins before the file before it ends" in read([two, one])[1]


def test_of_several_files_none_is_read_where_one_is_missing(rtde, tmp_path):
    out = io.StringIO()
    with pytest.raises(CaptureError, match=r"nope\.pcap: there is no such file"):
        dissect_file([rtde, tmp_path / "nope.pcap"], out)
    other = tmp_path / "notes.txt"
    other.write_text("notes")
    with pytest.raises(CaptureError, match=r"notes\.txt: not a pcap"):
        dissect_file([rtde, other], out)
    assert out.getvalue() == ""


def test_of_several_files_each_that_cannot_be_read_is_named(rtde, tmp_path):
    other, empty = tmp_path / "notes.txt", tmp_path / "empty.pcap"
    other.write_text("notes")
    empty.write_bytes(b"")
    with pytest.raises(CaptureError) as caught:
        dissect_file([tmp_path / "nope.pcap", rtde, other, empty, tmp_path], io.StringIO())
    said = str(caught.value)
    assert said.startswith(f"{tmp_path / 'nope.pcap'}: there is no such file; {other}: not a pcap")
    assert f"; {empty}: the file is empty; {tmp_path}: cannot be read: it is a dir" in said
    missing = [tmp_path / f"{number}.pcap" for number in range(13)]
    with pytest.raises(CaptureError) as caught:
        dissect_file(missing, io.StringIO())
    assert str(caught.value).count("there is no such file") == 10
    assert str(caught.value).endswith("9.pcap: there is no such file (and 3 more)")


def test_of_several_files_one_that_is_damaged_is_read_to_there(rtde, tmp_path):
    two = tmp_path / "two.pcap"
    two.write_bytes(rtde.read_bytes()[:30])
    out = io.StringIO()
    with pytest.raises(CaptureError, match=r"two\.pcap: truncated"):
        dissect_file([rtde, two], out, summary=True)
    assert "RTDE, 0 malformed" in out.getvalue()


def test_a_record_is_named_with_the_commands_that_read_it(tmp_path):
    path = tmp_path / "a session.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with pytest.raises(CaptureError) as raised:
        read(path)
    for command in ("replay", "plot", "export"):
        assert f"`cardan net {command} '{path}'`" in str(raised.value)


def cooked2(interface, protocol, rest):
    return struct.pack("!HHIHBB8s", protocol, 0, interface, 1, 0, 6, bytes(8)) + rest


def packet(data, link_type=network.LINUX_SLL2, time_ns=0, interface=None):
    return CapturedPacket(1, time_ns, link_type, "<", data, len(data), interface)


def an_ip_packet(rtde):
    return next(data for *_, data, _ in packets(rtde) if len(data) > 60)


def test_a_tag_of_a_vlan_is_passed_over_in_captures_of_any_interface(rtde):
    data = an_ip_packet(rtde)
    plain = network.parse(packet(cooked2(2, 0x0800, data)))
    assert isinstance(plain, network.Segment)
    tagged = cooked2(2, 0x8100, struct.pack("!HH", 7, 0x0800) + data)
    assert network.parse(packet(tagged)) == plain
    twice = cooked2(2, 0x88A8, struct.pack("!HHHH", 7, 0x8100, 8, 0x0800) + data)
    assert network.parse(packet(twice)) == plain


def test_what_is_no_network_is_named():
    assert network.parse(packet(bytes(20), 254)) == "Bluetooth monitor"
    assert network.parse(packet(cooked2(2, 0x0004, bytes(20)))) == "IEEE 802.2"
    assert network.parse(packet(cooked2(2, 0x000D, bytes(20)))) == "CAN FD"


def test_frames_of_can_are_taken_out_of_captures_of_any_interface():
    frame = struct.pack("!IB3x", 0x123, 2) + b"\1\2" + bytes(6)
    found = network.unwrapped(packet(cooked2(5, 0x000C, frame)))
    assert (found.link_type, found.data, found.wire_bytes) == (network.CAN, frame, 16)
    cooked1 = struct.pack("!HHH8sH", 0, 280, 0, bytes(8), 0x000C)
    assert network.unwrapped(packet(cooked1 + frame, network.LINUX_SLL)).data == frame
    other = packet(cooked2(5, 0x0800, frame))
    assert network.unwrapped(other) is other


def egm_twice(tmp_path, interfaces):
    """Return EGM datagrams, each captured on every one of `interfaces` in sequence."""
    from cardan.conform.attachments import _ip
    from cardan.protocols.egm.encode import encode_sensor
    from cardan.protocols.egm.messages import EgmHeader, EgmMotion, EgmSensor

    path = tmp_path / "any.pcap"
    writer = RawPcapWriter(str(path), linktype=network.LINUX_SLL2)
    writer.write_header(b"")
    for n in range(10):
        sent = encode_sensor(EgmSensor(EgmHeader(n, 4 * n, 3), EgmMotion((0.0,) * 6)))
        udp = struct.pack(">HHHH", 6510, 50000, 8 + len(sent), 0) + sent
        for interface in interfaces:
            data = cooked2(interface, 0x0800, _ip(True, 17, udp))
            writer.write_packet(data, sec=1_700_000_000, usec=4000 * n + interface)
    writer.close()
    return path


def test_what_passes_two_interfaces_is_counted_once(tmp_path):
    counts, text = read(egm_twice(tmp_path, (2, 3)))
    assert (counts.packets, counts.messages["EGM"], counts.other_packets) == (20, 10, 10)
    assert "duplicate 0" in text
    assert "10 packets were seen on a second interface, and are counted once" in text


def test_what_comes_twice_on_one_interface_is_a_duplicate(tmp_path):
    counts, text = read(egm_twice(tmp_path, (2, 2)))
    assert (counts.messages["EGM"], counts.other_packets) == (20, 0)
    assert "duplicate 10" in text
    counts, text = read(egm_twice(tmp_path, (2, 2, 3, 3)))
    assert (counts.messages["EGM"], counts.other_packets) == (20, 20)
    assert "duplicate 10" in text


def test_progress_is_reported_and_taken_away(rtde, capsys, monkeypatch):
    raised = []
    monkeypatch.setattr("cardan_dissect.PROGRESS_PACKETS", 100)
    read(rtde, summary=True, progress=lambda packets, share: raised.append((packets, share)))
    shares = [share for _, share in raised]
    assert [number for number, _ in raised] == [100 * (n + 1) for n in range(len(raised))] != []
    assert shares == sorted(shares)
    assert all(0.0 < share <= 1.0 for share in shares)

    monkeypatch.setattr(sys.modules[_Progress.__module__], "PROGRESS_S", 0.0)
    line = _Progress(True)
    line.tell(4096, 0.25)
    line.tell(8192, None)
    line.clear()
    assert capsys.readouterr().err == (
        f"\r4096 packets, 25% of the file\r{'8192 packets'.ljust(29)}\r{' ' * 12}\r"
    )
    silent = _Progress(False)
    silent.tell(4096, 0.25)
    silent.clear()
    assert capsys.readouterr().err == ""
