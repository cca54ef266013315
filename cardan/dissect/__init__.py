"""Reads captures line by line: EGM and the joint stream on UDP, simple message (MotoROS) on TCP,
3Dconnexion reports on USB, Wii Remotes on Bluetooth, JR3 force-torque sensors on CAN.

Needs the optional extra ``cardan[dissect]`` (scapy). The scapy layers themselves, for building
datagrams as well, are in :mod:`cardan.dissect.egm`, :mod:`cardan.dissect.joint_stream`,
:mod:`cardan.dissect.simple_message`, :mod:`cardan.dissect.connexion`, :mod:`cardan.dissect.wiimote`
and :mod:`cardan.dissect.jr3_can`; those of protocols that no capture has, because they stay on a
serial line or a Unix socket, in :mod:`cardan.dissect.connexion_serial` and
:mod:`cardan.dissect.spnav`. They are written from the protocols' documentation and not from
:mod:`cardan.protocols`.
"""

from __future__ import annotations

import datetime
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, TextIO

from cardan.dissect import network
from cardan.dissect.capture import Capture, CapturedPacket
from cardan.dissect.errors import ScapyMissingError
from cardan.dissect.ports import (
    EGM_PORTS,
    SIMPLE_MESSAGE_PORTS,
    SIMPLE_MESSAGE_RT_CONTROL_PORT,
)
from cardan.dissect.reader import Options, ProtocolReader, load_link_reader, load_readers
from cardan.dissect.statistics import tally
from cardan.errors import CaptureError, ConfigurationError

__all__ = [
    "EGM_PORTS",
    "SIMPLE_MESSAGE_PORTS",
    "Counts",
    "ScapyMissingError",
    "dissect_file",
]

NODES = frozenset(range(1, 128))
"""Ids that a JR3 board on CAN can have."""


class Counts(NamedTuple):
    """What a capture held. `messages` and `malformed` are by protocol: "EGM", "3Dconnexion",
    "joint stream", "simple message"; with a Bluetooth link also "Wiimote", with CAN "JR3"."""

    packets: int
    messages: Mapping[str, int]
    malformed: Mapping[str, int]
    other_packets: int


def dissect_file(
    path: str | os.PathLike[str],
    out: TextIO,
    *,
    limit: int | None = None,
    summary: bool = False,
    egm_ports: Iterable[int] = (),
    simple_message_ports: Iterable[int] = (),
    jr3_nodes: Iterable[int] = (),
) -> Counts:
    """Writes a line per datagram, report and message of the protocols in a capture, then a summary.

    `path` is a pcap or pcapng file, gzipped or not, of Ethernet, Linux cooked, loopback, raw IP,
    Linux usbmon, Bluetooth HCI (H4) or SocketCAN. Reading stops at the packet with which `limit`
    datagrams, reports, frames and messages are reached. With `summary` the lines are left out.
    `egm_ports` are UDP ports a PC listens at besides EGM_PORTS, `simple_message_ports` TCP ports of
    a controller besides SIMPLE_MESSAGE_PORTS. The joint stream is found on its port and, by its
    mark, on any other. `jr3_nodes` are node ids of JR3 boards (1 to 127) besides those known by
    what they send. Malformed datagrams and messages are shown and counted.
    Raises CaptureError when the file is missing, not a capture, damaged or truncated (after
    everything before the damage was written), ConfigurationError for a node id that cannot be,
    ScapyMissingError without scapy.
    """
    nodes = frozenset(jr3_nodes)
    if not nodes <= NODES:
        wrong = ", ".join(map(str, sorted(nodes - NODES)))
        raise ConfigurationError("jr3_nodes", f"node id {wrong}: those of boards are 1 to 127")
    options = Options(
        frozenset((*EGM_PORTS, *egm_ports)),
        frozenset((*SIMPLE_MESSAGE_PORTS, SIMPLE_MESSAGE_RT_CONTROL_PORT, *simple_message_ports)),
        nodes,
    )
    readers = load_readers(options)
    others: Counter[str] = Counter()
    packets = start_ns = 0
    stopped, damage = False, None
    try:
        for frame in Capture(path):
            if limit is not None and sum(r.messages for r in readers) >= limit:
                stopped = True
                break
            packets += 1
            if packets == 1:
                start_ns = frame.time_ns
                print(f"capture starts {_utc(start_ns)}", file=out)
            link_reader = load_link_reader(frame.link_type, readers, options)
            if link_reader is not None:
                readers.append(link_reader)
            parsed = network.parse(frame)
            before = sum(r.frames for r in readers)
            for reader in readers:
                for shown, line in reader.feed(frame, parsed):
                    if not summary:
                        _print_line(shown, line, start_ns, out)
            # A reader can take earlier frames too, once it knows what they are.
            others[str(parsed)] += 1 - (sum(r.frames for r in readers) - before)
    except CaptureError as error:
        if not packets:
            raise
        damage = error
    for reader in () if stopped else readers:
        for shown, line in reader.finish():
            if not summary:
                _print_line(shown, line, start_ns, out)
    counts = Counts(
        packets,
        {r.name: r.messages for r in readers},
        {r.name: r.malformed.total() for r in readers},
        others.total(),
    )
    for line in _summary(readers, counts, others, options):
        print(line, file=out)
    if stopped:
        print(f"stopped at the limit of {limit}; the rest of the capture is not read", file=out)
    if damage is not None:
        raise damage
    return counts


def _print_line(frame: CapturedPacket, line: str, start_ns: int, out: TextIO) -> None:
    print(f"#{frame.number} {(frame.time_ns - start_ns) / 1e9:.6f} {line}", file=out)


def _summary(
    readers: Iterable[ProtocolReader], counts: Counts, others: Counter[str], options: Options
) -> Iterator[str]:
    for reader in readers:
        yield from reader.summary()
    if any(counts.messages.values()):
        shown = (
            f"{n} {name}, {counts.malformed[name]} malformed"
            for name, n in counts.messages.items()
            if n
        )
        yield f"{counts.packets} packets: {'; '.join(shown)}; {counts.other_packets} others"
    else:
        *names, last = (reader.name for reader in readers)
        yield f"no {', '.join(names)} or {last} traffic found in {counts.packets} packets"
        ports = " ".join(map(str, sorted(options.egm_ports)))
        yield f"EGM was looked for on UDP ports {ports} (--port for others)"
        ports = " ".join(map(str, sorted(options.simple_message_ports)))
        yield f"simple message was looked for on TCP ports {ports}"
    if counts.other_packets:
        yield f"other packets: {tally(+others)}"


def _utc(time_ns: int) -> str:
    moment = datetime.datetime.fromtimestamp(time_ns // 10**9, datetime.timezone.utc)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{time_ns % 10**9 // 1000:06d} UTC"
