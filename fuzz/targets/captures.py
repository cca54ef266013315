"""Readers of captures and records: pcap, pcapng, every dissector, MCAP."""

from __future__ import annotations

import io
import json
import os
import struct
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from cardan.errors import CaptureError, ConfigurationError, OptionError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ur import rtde
from cardan.recording.mcap_file import (
    RecordedMessage,
    RecordedTopic,
    RecordReader,
    RecordWriter,
)
from cardan.recording.plot import read_series
from cardan.recording.verify import verify
from cardan_dissect import dissect_file, network, tcp, usbmon
from cardan_dissect.capture import Capture, CapturedPacket
from cardan_jr3 import capture as jr3_capture
from cardan_wiimote import bluetooth
from fuzz.target import Form, Packets, Target
from fuzz.targets import devices, robots
from tests.protocols import worked

_BASE = tempfile.TemporaryDirectory(prefix="cardan-fuzz-")


def _folder() -> Path:
    """A folder of this process: several run at once, and all are removed with the first."""
    path = Path(_BASE.name) / str(os.getpid())
    path.mkdir(parents=True, exist_ok=True)
    return path


def _file(data: bytes, name: str) -> Path:
    path = _folder() / name
    path.write_bytes(data)
    return path


def _pcap(link_type: int, packets: list[bytes]) -> bytes:
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link_type)
    return head + b"".join(
        struct.pack("<4I", 1_700_000_000, 4000 * number, len(each), len(each)) + each
        for number, each in enumerate(packets)
    )


def _pcapng(link_type: int, packets: list[bytes]) -> bytes:
    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        size = struct.pack("<I", 12 + len(body))
        return struct.pack("<I", kind) + size + body + size

    found = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    found += block(1, struct.pack("<HHI", link_type, 0, 0) + struct.pack("<HHB3x", 9, 1, 9))
    for number, each in enumerate(packets):
        head = struct.pack("<5I", 0, 400_000, 4000 * number, len(each), len(each))
        found += block(6, head + each)
    return found + block(3, struct.pack("<I", 4) + b"abcd")


def _udp(payload: bytes, source: int, destination: int) -> bytes:
    body = struct.pack("!4H", source, destination, 8 + len(payload), 0) + payload
    head = struct.pack("!BBHHHBBH", 0x45, 0, 20 + len(body), 1, 0, 64, 17, 0)
    return head + bytes((192, 0, 2, 1)) + bytes((192, 0, 2, 2)) + body


def _tcp(
    payload: bytes, sequence: int, flags: int = 0x18, back: bool = False, port: int = 50240
) -> bytes:
    ports = (port, 40000) if back else (40000, port)
    body = struct.pack("!HHIIBBHHH", *ports, sequence, 1, 0x50, flags, 9999, 0, 0) + payload
    head = struct.pack("!BBHHHBBH", 0x45, 0, 20 + len(body), 1, 0, 64, 6, 0)
    ends = (bytes((192, 0, 2, 1)), bytes((192, 0, 2, 2)))
    return head + (ends[1] + ends[0] if back else ends[0] + ends[1]) + body


@cache
def _flows() -> tuple[tuple[int, list[bytes]], ...]:
    """Link type and packets of small captures of each protocol."""
    egm = [_udp(worked.R0, 6511, 6510), _udp(worked.R1, 6511, 6510), _udp(worked.S1, 6510, 6511)]
    egm.append(_udp(worked.C1, 6510, 6511))
    stream = [_udp(each, 6599, 40001) for each in robots._joint_stream_seeds()]
    said = worked.START_TRAJ_MODE + worked.TRAJECTORY_POINT
    simple = [
        _tcp(b"", 99, 0x02),
        _tcp(said[:30], 100),
        _tcp(said[30:], 130),
        _tcp(worked.START_TRAJ_MODE_REPLY + worked.STATUS_ESTOP, 500, back=True),
        _tcp(worked.BUSY_REPLY, 900, 0x11, back=True),
    ]
    asked = rtde.ask_version() + rtde.ask_outputs(500.0, ("timestamp", "actual_q"))
    recipe = rtde.Recipe(1, ("timestamp", "actual_q"), ("DOUBLE", "VECTOR6D"))
    reported = rtde.reply_setup(rtde.SetupReply(rtde.PacketType.OUTPUTS, 1, recipe.types))
    states = recipe.pack([0.002, (0.5,) * 6]) + recipe.pack([0.004, (0.5,) * 6])
    ur = [
        _tcp(b"", 99, 0x02, port=30004),
        _tcp(asked, 100, port=30004),
        _tcp(rtde.reply_accepted(rtde.PacketType.START, True) + reported, 500, 0x18, True, 30004),
        _tcp(states[:80], 500 + 4 + len(reported), 0x18, True, 30004),
        _tcp(states[80:], 500 + 84 + len(reported), 0x18, True, 30004),
    ]
    urb = struct.pack("<QBBBBHBBqiiII", 7, 67, 1, 0x81, 5, 2, 45, 0, 1, 2, 0, 13, 13) + bytes(24)
    usb = [urb + worked.MOTION, urb + worked.BUTTONS_PRO]
    acl = [
        struct.pack("<BHH", 2, 0x200B, 4 + 1 + len(each))
        + struct.pack("<HH", 1 + len(each), 0x41)
        + b"\xa1"
        + each
        for each in devices._wiimote_said()[0][:12]
    ]
    signal = struct.pack("<BBHHH", 2, 1, 4, 0x13, 0x40)
    connect = struct.pack("<BHH", 2, 0x200B, 4 + len(signal)) + struct.pack("<HH", len(signal), 1)
    acl.insert(0, connect + signal)
    frames = [
        struct.pack("!IB3x", int.from_bytes(each[:2], "little"), len(each) - 2) + each[2:]
        for each in devices._jr3_frames()
    ]
    ethernet = [bytes(12) + b"\x08\x00" + each for each in (*egm, *simple)]
    return (
        (101, egm),
        (101, stream),
        (101, simple),
        (101, ur),
        (220, usb),
        (187, acl),
        (227, frames),
        (1, ethernet),
    )


def _captures() -> Iterator[bytes]:
    for link_type, packets in _flows():
        yield _pcap(link_type, packets)
        yield _pcapng(link_type, packets)


def _dissect(data: bytes) -> object:
    out = io.StringIO()
    counts = dissect_file(_file(data, "fuzz.pcap"), out)
    assert len(out.getvalue()) <= 20_000 + 400 * len(data), "it says more than there is"
    return tuple(name for name, count in counts.messages.items() if count), counts.packets > 3


def _capture(data: bytes) -> object:
    """The file formats alone, and what is under the protocols."""
    links, streams = bluetooth.Links(), tcp.TcpStream()
    packets = Capture(_file(data, "fuzz-only.pcap"))
    found = [_packet(packet, links, streams) for packet in packets]
    return tuple(found[:4])


def _packet(packet: CapturedPacket, links: bluetooth.Links, streams: tcp.TcpStream) -> object:
    segment = network.parse(packet)
    if isinstance(segment, network.Segment) and segment.protocol == "TCP":
        list(streams.feed(segment, packet.time_ns))
    if packet.link_type in (187, 201):
        list(links.feed(packet))
    if packet.link_type in (189, 220):
        return usbmon.parse(packet) is None
    if packet.link_type == 227:
        return jr3_capture.parse(packet) is None
    return segment if isinstance(segment, str) else segment.protocol


_LINKS = (1, 101, 113, 189, 220, 187, 201, 227, 276, 0, 108, 12, 228, 229)


def _packets(packets: Packets) -> object:
    """Packets without a file around them: the first byte of each chooses the link."""
    links, streams = bluetooth.Links(), tcp.TcpStream()
    found: list[object] = []
    for number, data in enumerate(packets):
        link = _LINKS[data[0] % len(_LINKS)] if data else 1
        order = "<" if not data or data[0] < 128 else ">"
        packet = CapturedPacket(number + 1, number * 1000, link, order, data[1:], len(data))
        found.append(_packet(packet, links, streams))
    list(streams.flush())
    return tuple(found[:6])


def _packet_seeds() -> Iterator[Packets]:
    for link_type, packets in _flows():
        head = bytes([_LINKS.index(link_type)])
        yield tuple(head + each for each in packets[:24])


# -- records --------------------------------------------------------------------------------------


@cache
def _records() -> tuple[bytes, ...]:
    """A small record of a session, without compression."""
    path = _folder() / "seed.mcap"
    path.unlink(missing_ok=True)
    writer = RecordWriter(path)
    now_ns = 1_700_000_000_000_000_000
    pose = default_message("geometry_msgs/msg/PoseStamped")
    pose["pose"]["orientation"]["w"] = 1.0
    wrench = default_message("geometry_msgs/msg/WrenchStamped")
    snapshot = json.dumps({"cycles": 4, "tick_p50_s": 1e-4, "tick_p99_s": 2e-4, "trips": 0})
    for number, (name, kind, message) in enumerate(
        (
            ("/arm/state/pose", "geometry_msgs/msg/PoseStamped", pose),
            ("/arm/reference", "geometry_msgs/msg/PoseStamped", pose),
            ("/arm/state/wrench", "geometry_msgs/msg/WrenchStamped", wrench),
            ("/arm/snapshot", "std_msgs/msg/String", {"data": snapshot}),
            ("/arm/controller_log", "std_msgs/msg/String", {"data": _CYCLE}),
            ("/arm/configuration", "std_msgs/msg/String", {"data": '{"tables": {}}'}),
        )
    ):
        topic = RecordedTopic(name, kind, "", False, ("/arm",))
        data = codec_of(kind).encode(message)
        stamp_ns = now_ns + number
        writer.add(RecordedMessage(topic, stamp_ns, stamp_ns, number, data))
    writer.attach("configuration", "{}", now_ns)
    writer.describe("cardan", {"version": "1"})
    writer.finish()
    plain = path.read_bytes()
    return (plain, plain[: len(plain) * 2 // 3], b"\x89MCAP0\r\n" + bytes(40))


_CYCLE = (
    '{"cycle":1,"before":[],"robot":[0.0,"live",1,1,0.004,[0,0,0,0,0,0],[],null,"",null,null,null,'
    '"",[],[],"",0.0],"device":null,"events":[],"command":[]}'
)


def _mcap(data: bytes) -> object:
    path = _file(data, "fuzz.mcap")
    results: list[object] = []
    reader = RecordReader(path)
    count = sum(1 for _ in reader)
    results += [count > 3, bool(reader.cut_off)]
    for read in (read_series, verify):
        try:
            read(path)
            results.append(True)
        except (CaptureError, ConfigurationError, OptionError) as error:
            results.append(type(error).__name__)
    return tuple(results)


_BLOCK_BYTES = 32 << 20
"""A capture's packets are read whole, at most 16 MiB each, whatever the file's size."""

TARGETS = (
    Target(
        "dissect.file",
        Form.BYTES,
        _dissect,
        _captures,
        raises=(CaptureError,),
        memory=_BLOCK_BYTES,
        longest=8192,
        slow_s=0.3,
        slow_s_per_byte=300e-6,
    ),
    Target(
        "dissect.capture",
        Form.BYTES,
        _capture,
        _captures,
        raises=(CaptureError,),
        memory=_BLOCK_BYTES,
    ),
    Target("dissect.packets", Form.PACKETS, _packets, _packet_seeds, longest=8192),
    Target("recording.mcap", Form.BYTES, _mcap, _records, raises=(CaptureError,), slow_s=0.3),
)
