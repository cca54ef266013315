"""Reads captures line by line: EGM and the joint stream on UDP, simple message (MotoROS) and RTDE
(Universal Robots) on TCP, 3Dconnexion reports on USB, Wii Remotes on Bluetooth, JR3 force-torque
sensors on CAN.

Needs the optional extra ``cardan[dissect]`` (scapy). The scapy layers themselves, for building
datagrams as well, are in :mod:`cardan.dissect.egm`, :mod:`cardan.dissect.joint_stream`,
:mod:`cardan.dissect.simple_message`, :mod:`cardan.dissect.rtde`, :mod:`cardan.dissect.connexion`,
:mod:`cardan.dissect.wiimote` and :mod:`cardan.dissect.jr3_can`. They are written from the
protocols' documentation and not from :mod:`cardan.protocols`. Other packages add protocols by an
entry point, see :class:`cardan.dissect.reader.Dissector`.
"""

from __future__ import annotations

import datetime
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, TextIO

from cardan.dissect import network, registry
from cardan.dissect.capture import Capture, CapturedPacket
from cardan.dissect.ports import EGM_PORTS, RTDE_PORTS, SIMPLE_MESSAGE_PORTS
from cardan.dissect.reader import Dissector, PacketLine, ProtocolReader
from cardan.dissect.statistics import tally
from cardan.errors import CaptureError, ConfigurationError
from cardan.printable import printable

__all__ = [
    "EGM_PORTS",
    "RTDE_PORTS",
    "SIMPLE_MESSAGE_PORTS",
    "Counts",
    "dissect_file",
]


class Counts(NamedTuple):
    """What a capture held. `messages` and `malformed` are by protocol: "EGM", "3Dconnexion",
    "joint stream", "simple message", "RTDE"; with a Bluetooth link also "Wiimote", with CAN
    "JR3"."""

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
    **numbers: Iterable[int],
) -> Counts:
    """Writes a line per datagram, report and message of the protocols in a capture, then a summary.

    `path` is a pcap or pcapng file, gzipped or not, of Ethernet, Linux cooked, loopback, raw IP,
    Linux usbmon, Bluetooth HCI (H4) or SocketCAN. Reading stops at the packet with which `limit`
    datagrams, reports, frames and messages are reached. With `summary` the lines are left out.
    `numbers` are where protocols are looked for besides the usual places, by the keys of their
    dissectors' options: `egm_ports` are UDP ports a PC listens at besides EGM_PORTS,
    `simple_message_ports` TCP ports of a controller besides SIMPLE_MESSAGE_PORTS, `rtde_ports` such
    of Universal Robots besides RTDE_PORTS, `jr3_nodes` node ids of JR3 boards (1 to 127) besides
    those known by what they send. The joint stream is found on its port and, by its mark, on any
    other. Malformed datagrams and messages are shown and counted.
    Raises CaptureError when the file is missing, not a capture, damaged or truncated (after
    everything before the damage was written), ConfigurationError for an option that no dissector
    has and for a number out of its range, ExtraMissingError without scapy.
    """
    readers = _Readers(registry.dissectors(), numbers)
    others: Counter[str] = Counter()
    packets = start_ns = 0
    stopped, damage = False, None

    def show(lines: Iterable[PacketLine]) -> None:
        for packet, line in lines:
            if not summary:
                time_s = (packet.time_ns - start_ns) / 1e9
                print(f"#{packet.number} {time_s:.6f} {printable(line)}", file=out)

    try:
        for packet in Capture(path):
            if limit is not None and sum(readers.messages.values()) >= limit:
                stopped = True
                break
            packets += 1
            if packets == 1:
                start_ns = packet.time_ns
                print(f"capture starts {_utc(start_ns)}", file=out)
            parsed = network.parse(packet)
            others[str(parsed)] += 1
            for reader in readers.offered(packet):
                before = reader.packets
                show(reader.feed(packet, parsed))
                if reader.packets > before:
                    # It can take earlier packets too, once it knows what they are.
                    others[str(parsed)] -= reader.packets - before
                    break
    except CaptureError as error:
        if not packets:
            raise
        damage = error
    for reader in () if stopped else readers.by_dissector.values():
        show(reader.finish())
    malformed = {d.name: r.malformed.total() for d, r in readers.by_dissector.items()}
    counts = Counts(packets, readers.messages, malformed, others.total())
    for line in _summary(readers, counts, others):
        print(printable(line), file=out)
    if stopped:
        print(f"stopped at the limit of {limit}; the rest of the capture is not read", file=out)
    if damage is not None:
        raise damage
    return counts


class _Readers:
    """The readers that a capture needs, each made when it does, with its numbers."""

    def __init__(
        self, dissectors: Iterable[type[Dissector]], numbers: Mapping[str, Iterable[int]]
    ) -> None:
        self._dissectors = tuple(dissectors)
        options = [option for dissector in self._dissectors for option in dissector.options]
        if unknown := sorted(numbers.keys() - {option.key for option in options}):
            keys = ", ".join(option.key for option in options)
            raise ConfigurationError(unknown[0], f"no dissector has this option; allowed: {keys}")
        self.numbers = {o.key: o.with_usual(numbers.get(o.key, ())) for o in options}
        self.by_dissector = {d: d.open(self.numbers) for d in self._dissectors if d.always}
        self._offered: dict[int, list[ProtocolReader]] = {}

    def offered(self, packet: CapturedPacket) -> list[ProtocolReader]:
        """The readers for packets of this link type, in their order."""
        link_type = packet.link_type
        if link_type not in self._offered:
            found = [d for d in self._dissectors if link_type in d.link_types]
            for dissector in found:
                if dissector not in self.by_dissector:
                    self.by_dissector[dissector] = dissector.open(self.numbers)
            self._offered[link_type] = [self.by_dissector[dissector] for dissector in found]
        return self._offered[link_type]

    @property
    def messages(self) -> dict[str, int]:
        """How many each protocol had."""
        return {d.name: reader.messages for d, reader in self.by_dissector.items()}


def _summary(readers: _Readers, counts: Counts, others: Counter[str]) -> Iterator[str]:
    for reader in readers.by_dissector.values():
        yield from reader.summary()
    if any(counts.messages.values()):
        shown = (
            f"{n} {name}, {counts.malformed[name]} malformed"
            for name, n in counts.messages.items()
            if n
        )
        yield f"{counts.packets} packets: {'; '.join(shown)}; {counts.other_packets} others"
    else:
        *names, last = counts.messages
        yield f"no {', '.join(names)} or {last} traffic found in {counts.packets} packets"
        for dissector in readers.by_dissector:
            for option in dissector.options:
                if option.usual:
                    places = " ".join(map(str, sorted(readers.numbers[option.key])))
                    yield (
                        f"{dissector.name} was looked for on {option.what}s {places} "
                        f"(--{option.flag} for others)"
                    )
    if counts.other_packets:
        yield f"other packets: {tally(+others)}"


def _utc(time_ns: int) -> str:
    moment = datetime.datetime.fromtimestamp(time_ns // 10**9, datetime.timezone.utc)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{time_ns % 10**9 // 1000:06d} UTC"
