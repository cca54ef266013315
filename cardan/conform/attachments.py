"""Export of a timeline for other programs: a capture (pcap) and a record (MCAP)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

from cardan.common.extras import missing_extra
from cardan.conform.requirements import Level, V
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import Kind, WireEvent, WireTimeline
from cardan.errors import CaptureError

PCAP_MAGIC_NS = 0xA1B23C4D
LINK_RAW_IP, LINK_SOCKETCAN = 101, 227
SNAP_BYTES = 262_144
TESTED, OURS = bytes((192, 0, 2, 1)), bytes((192, 0, 2, 2))
"""Addresses in captures, from the documentation network of RFC 5737."""
FREE_PORT = 50_000
"""Port of the side without a known port; each further channel has the next one."""
_UDP, _TCP = 17, 6
_FIN, _SYN, _PUSH, _ACK = 0x01, 0x02, 0x08, 0x10
_LONGEST_SEGMENT = 1400


def pcap(suite: Suite[V], timeline: WireTimeline, start_ns: int) -> bytes | None:
    """Return the capture, without real addresses; None if the protocol has no network packets.

    `start_ns` is the wall time of the timeline's zero, ns since the epoch.
    """
    transport = suite.transport
    if transport.kind == "other":
        return None
    link = LINK_SOCKETCAN if transport.kind == "can" else LINK_RAW_IP
    parts = [struct.pack("<IHHiIII", PCAP_MAGIC_NS, 2, 4, 0, 0, SNAP_BYTES, link)]
    writers = {"udp": _datagrams, "tcp": _segments, "can": _frames}
    events = (suite.redacted(each) for each in timeline)
    packets = writers[transport.kind](transport, events)
    # Received data have the kernel's earlier time stamp, data sent before the read have not.
    for time_s, packet in sorted(packets, key=lambda each: each[0]):
        time_ns = start_ns + round(time_s * 1e9)
        seconds, ns = divmod(time_ns, 1_000_000_000)
        parts.append(struct.pack("<IIII", seconds, ns, len(packet), len(packet)) + packet)
    return b"".join(parts)


_Packets = Iterator[tuple[float, bytes]]


def _frames(_transport: SuiteTransport, events: Iterator[WireEvent]) -> _Packets:
    for event in events:
        if event.kind is Kind.DATA:
            yield event.time_s, event.data


def _ports(transport: SuiteTransport, channel: str, note: str) -> tuple[int, int]:
    """Return the tested side's port and ours."""
    # Each client of a port of ours is a channel: "motion 2".
    channel, _, client = channel.partition(" ")
    known = transport.ports.get(channel, 0)
    # A client has a port of its own; the listening side has the known one.
    digits = note.rpartition(":")[2] if channel in transport.ours else ""
    free = int(digits) if digits.isdigit() and 0 < int(digits) < 65536 else 0
    if not free:
        names = sorted(transport.ports)
        free = FREE_PORT + (names.index(channel) if channel in names else 0)
        free += int(client) if client.isdigit() else 0
    return (free, known) if channel in transport.ours else (known, free)


def _datagrams(transport: SuiteTransport, events: Iterator[WireEvent]) -> _Packets:
    theirs: dict[str, str] = {}
    for event in events:
        if event.kind is not Kind.DATA:
            continue
        if not event.sent:
            theirs[event.channel] = event.note
        tested, ours = _ports(transport, event.channel, theirs.get(event.channel, ""))
        source, target = (ours, tested) if event.sent else (tested, ours)
        udp = struct.pack(">HHHH", source, target, 8 + len(event.data), 0) + event.data
        yield event.time_s, _ip(event.sent, _UDP, udp)


def _segments(transport: SuiteTransport, events: Iterator[WireEvent]) -> _Packets:
    """Yield TCP segments of a connection without loss: opened, acknowledged with data, closed."""
    places: dict[str, list[int]] = {}
    opened: dict[str, int] = {}

    def segment(
        event: WireEvent, from_us: bool, flags: int, data: bytes = b""
    ) -> tuple[float, bytes]:
        tested, ours = _ports(transport, event.channel, "")
        ours += 16 * (opened.get(event.channel, 1) - 1)
        source, target = (ours, tested) if from_us else (tested, ours)
        sent, heard = (0, 1) if from_us else (1, 0)
        place = places.setdefault(event.channel, [0, 0])
        head = [source, target, place[sent], place[heard], 5 << 4, flags, 65535, 0, 0]
        whole = struct.pack(">HHIIBBHHH", *head) + data
        ends = (OURS, TESTED) if from_us else (TESTED, OURS)
        head[7] = _checksum(b"".join(ends) + struct.pack(">HH", _TCP, len(whole)) + whole)
        place[sent] += len(data) + bool(flags & (_SYN | _FIN))
        packet = _ip(from_us, _TCP, struct.pack(">HHIIBBHHH", *head) + data)
        return event.time_s, packet

    for event in events:
        if event.kind is Kind.OPENED:
            if event.channel in transport.ours:
                continue
            places.pop(event.channel, None)
            opened[event.channel] = opened.get(event.channel, 0) + 1
            we_come = event.channel.partition(" ")[0] not in transport.ours
            yield segment(event, we_come, _SYN)
            yield segment(event, not we_come, _SYN | _ACK)
            yield segment(event, we_come, _ACK)
        elif event.kind is Kind.CLOSED:
            yield segment(event, event.sent, _FIN | _ACK)
            yield segment(event, not event.sent, _FIN | _ACK)
        elif event.kind is Kind.DATA:
            for at in range(0, len(event.data), _LONGEST_SEGMENT):
                piece = event.data[at : at + _LONGEST_SEGMENT]
                yield segment(event, event.sent, _PUSH | _ACK, piece)


def _ip(from_us: bool, protocol: int, payload: bytes) -> bytes:
    ends = OURS + TESTED if from_us else TESTED + OURS
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(payload), 0, 0x4000, 64, protocol, 0) + ends
    return head[:10] + struct.pack(">H", _checksum(head)) + head[12:] + payload


def _checksum(data: bytes) -> int:
    if len(data) % 2:
        data += b"\0"
    total: int = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


_METADATA = "cardan conform"
"""Name of the metadata that make a record one of a timeline."""
_METADATA_OPCODE = 0x0C


def write_mcap(
    path: Path, suite: Suite[V], timeline: WireTimeline, start_ns: int, level: Level
) -> None:
    """Write the record of a timeline made on `level`: a channel for each wire and direction, with
    its bytes, and one for marks.

    Raises ExtraMissingError without mcap, and CaptureError if `path` cannot be written.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise missing_extra("a record", "mcap", "record", error) from error
    facts = (suite.name, int(level), timeline.late_s, start_ns)
    try:
        with path.open("wb") as file:
            writer: Any = Writer(file)
            writer.start("", "cardan conform")
            names = ("suite", "level", "late_s", "start_ns")
            writer.add_metadata(_METADATA, dict(zip(names, map(str, facts), strict=True)))
            channels: dict[tuple[str, ...], int] = {}
            for number, event in enumerate(map(suite.redacted, timeline)):
                topic = f"/{suite.name}/" + "/".join(
                    filter(None, (event.channel, "to" if event.sent else "from"))
                )
                data, encoding, note = event.data, "application/octet-stream", event.note
                if event.kind is not Kind.DATA:
                    topic, encoding, note = f"/{suite.name}/events", "text/plain", ""
                    data = " ".join(filter(None, (*_begin(event), event.note))).encode()
                key = (topic, *_begin(event), "to" if event.sent else "from", note)
                if key not in channels:
                    metadata = {
                        "kind": event.kind.value,
                        "channel": event.channel,
                        "sent": str(event.sent),
                        "note": note,
                    }
                    channels[key] = writer.register_channel(topic, encoding, 0, metadata)
                time_ns = start_ns + round(event.time_s * 1e9)
                writer.add_message(channels[key], time_ns, data, time_ns, number)
            writer.finish()
    except OSError as error:
        raise CaptureError(f"{path} cannot be written: {error.strerror or error}") from None


def _begin(event: WireEvent) -> tuple[str, ...]:
    return event.kind.value, event.channel


def read_mcap(path: Path, suite: Suite[V]) -> tuple[WireTimeline, Level]:
    """Return the timeline of a record that :func:`write_mcap` wrote, and its level.

    Raises ExtraMissingError without mcap, and CaptureError for any other file, and for a record of
    another suite.
    """
    from cardan.recording.mcap_file import OtherRecord, RecordReader

    reader = RecordReader(path)  # Raises ExtraMissingError.
    from mcap.records import Channel, Message

    timeline, level, start_ns = WireTimeline(), None, 0
    events: dict[int, WireEvent] = {}
    try:
        for record in reader.records():
            if isinstance(record, OtherRecord):
                if record.opcode == _METADATA_OPCODE and level is None:
                    level, start_ns = _facts(path, suite, timeline, record.body)
            elif isinstance(record, Channel):
                of = record.metadata
                sent = of["sent"] == str(True)
                events[record.id] = WireEvent(
                    0.0, Kind(of["kind"]), sent, of["channel"], b"", of["note"]
                )
            elif isinstance(record, Message):
                event, data = events[record.channel_id], record.data
                event = event._replace(time_s=(record.log_time - start_ns) / 1e9, data=data)
                if event.kind is not Kind.DATA:
                    begin = " ".join(filter(None, _begin(event)))
                    note = data.decode().removeprefix(begin).removeprefix(" ")
                    event = event._replace(data=b"", note=note)
                timeline.add(event)
    except (KeyError, ValueError) as error:
        if level is not None:
            raise CaptureError(f"{path} is not as `--save` writes it: {error!r:.80}") from None
    if level is None:
        raise CaptureError(f"{path} has no recorded traffic: only a record.mcap of --save has them")
    timeline.start_ns, timeline.strays = start_ns, tuple(reader.problems)
    return timeline, level


def _facts(path: Path, suite: Suite[V], timeline: WireTimeline, body: bytes) -> tuple[Level, int]:
    """Level and start, ns since the epoch, by the metadata."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Metadata

    metadata = Metadata.read(ReadDataStream(BytesIO(body)))
    if metadata.name != _METADATA:
        raise ValueError(metadata.name)
    facts = metadata.metadata
    if facts["suite"] != suite.name:
        raise CaptureError(f"{path} is of {facts['suite']}: check it by `cardan conform` of that")
    timeline.late_s = float(facts["late_s"])
    return Level(int(facts["level"])), int(facts["start_ns"])
