"""Reads captures line by line: EGM and the joint stream on UDP, simple message (MotoROS) and RTDE
(Universal Robots) on TCP, 3Dconnexion reports on USB.

The printed values of a message are those of its codec in :mod:`cardan.protocols`. The protocols are
declared in :mod:`cardan_dissect.dissectors`; other packages add protocols by an entry point, see
:class:`cardan_dissect.reader.Dissector`.

scapy layers, for building datagrams as well, are in :mod:`cardan_dissect.egm`,
:mod:`cardan_dissect.joint_stream`, :mod:`cardan_dissect.simple_message`, :mod:`cardan_dissect.rtde`
and :mod:`cardan_dissect.connexion`. They need the optional extra ``cardan[dissect]``, and are
written from the protocols' documentation, independent of the codecs, for cross-checks.
"""

from __future__ import annotations

import datetime
import os
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, TextIO

from cardan.common.text_sanitizer import printable
from cardan.errors import CaptureError, ConfigurationError
from cardan_dissect import network, registry
from cardan_dissect.capture import Capture, CapturedPacket
from cardan_dissect.figures import Figures, tally
from cardan_dissect.hints import Hints
from cardan_dissect.network import Segment
from cardan_dissect.ports import EGM_PORTS, RTDE_PORTS, SIMPLE_MESSAGE_PORTS
from cardan_dissect.reader import Dissector, Message, Note, describe, excerpt

__all__ = [
    "EGM_PORTS",
    "RTDE_PORTS",
    "SIMPLE_MESSAGE_PORTS",
    "Counts",
    "dissect_file",
]


MOST_FIGURES = 4096
"""Most senders and receivers with separate figures."""
MOST_OTHERS = 4096
"""Most kinds of other packets that are counted separately."""
COPY_NS = 20_000_000
"""Longest time that a datagram takes from one interface of a computer to another: a bridge, a
container."""
MOST_REPORTED = 10
"""Most unread files that are named."""
PROGRESS_PACKETS = 4096
"""Packets between two reports of the progress."""


class Counts(NamedTuple):
    """Contents of a capture. `messages` and `malformed` count by protocol: "EGM", "3Dconnexion",
    "joint stream", "simple message", "RTDE"; and by those of plug-ins."""

    packets: int
    messages: Mapping[str, int]
    malformed: Mapping[str, int]
    other_packets: int


def dissect_file(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    out: TextIO,
    *,
    limit: int | None = None,
    summary: bool = False,
    progress: Callable[[int, float | None], None] = lambda packets, share: None,
    **numbers: Iterable[int],
) -> Counts:
    """Write a line per datagram, report and message of the protocols in a capture, then a summary.

    `path` is a pcap or pcapng file, gzipped or not, of Ethernet, Linux cooked, loopback, raw IP,
    Linux usbmon, or of a link that a plug-in reads; a btsnoop log of Bluetooth; a log of a CAN bus,
    of candump or (with python-can) .asc or .blf; a pipe of such, "-" for standard input; or several
    of them, which are read in sequence as one capture, but not if one of them is missing. Packets
    that passed two interfaces are counted once. The summary has the likely protocol of flows that
    were not read. `progress` is called periodically with the number of packets read and the share
    of the file (None: unknown). Reading stops at the packet that reaches `limit` datagrams,
    reports, frames and messages. `summary` omits the lines. `numbers` has additional ports of
    protocols, by the keys of their dissectors' options: `egm_ports` are UDP ports a PC listens at
    besides EGM_PORTS, `simple_message_ports` TCP ports of a controller besides
    SIMPLE_MESSAGE_PORTS, `rtde_ports` such of Universal Robots besides RTDE_PORTS. The joint stream
    is recognized on its port and, by its mark, on any other. Malformed datagrams and messages are
    shown and counted. Raises CaptureError when the file is missing, not a capture, damaged or
    truncated (after everything before the damage was written), ConfigurationError for an option
    that no dissector has and for a number out of its range.
    """
    capture = CaptureReader(registry.dissectors(), numbers)
    paths = [path] if isinstance(path, str | os.PathLike) else path
    if len(paths) > 1:
        _look(paths)
    start_ns = None
    stopped, damage = False, None

    def show(found: Iterable[Message | Note], dissector: Dissector) -> None:
        for each in found:
            remarks = capture.take(each, dissector)
            if not summary:
                line = _line(each, dissector, remarks)
                time_s = (each.packet.time_ns - (start_ns or 0)) / 1e9
                out.write(f"#{each.packet.number} {time_s:.6f} {printable(line)}\n")

    try:
        for packet in capture.read(paths, progress):
            if limit is not None and capture.messages >= limit:
                stopped = True
                break
            capture.packets += 1
            if start_ns is None:
                start_ns = packet.time_ns
                print(f"capture starts {_utc(start_ns)}", file=out)
            parsed = network.parse(packet)
            if capture.is_copy(packet, parsed):
                continue
            for dissector in capture.offered(packet.link_type):
                before = dissector.packets
                show(dissector.feed(packet, parsed), dissector)
                taken = dissector.packets - before
                if taken:
                    if taken > 1:
                        # Earlier packets too, because their type is known now.
                        capture.others[str(parsed)] -= taken - 1
                    break
            else:
                capture.others[str(parsed)] += 1
                if isinstance(parsed, Segment):
                    capture.hints.add(packet, parsed)
                if len(capture.others) > MOST_OTHERS:
                    capture.fold()
    except CaptureError as error:
        if not capture.packets:
            raise
        damage = error
    for dissector in () if stopped else capture.dissectors.values():
        show(dissector.finish(), dissector)
    counts = capture.counts()
    for line in capture.summary(counts):
        print(printable(line), file=out)
    if stopped:
        print(f"stopped at the limit of {limit}; the rest of the capture is not read", file=out)
    if damage is not None:
        raise damage
    return counts


def _look(paths: Iterable[str | os.PathLike[str]]) -> None:
    """Raise CaptureError with the fault of each file that cannot be read."""
    wrong = []
    for path in paths:
        try:
            Capture(path).look()
        except CaptureError as error:
            wrong.append(str(error))
    if wrong:
        more = f" (and {len(wrong) - MOST_REPORTED} more)" if len(wrong) > MOST_REPORTED else ""
        raise CaptureError("; ".join(wrong[:MOST_REPORTED]) + more)


class CaptureReader:
    """Reader of a capture's messages, with a dissector of each protocol that it needs."""

    def __init__(
        self, kinds: Iterable[type[Dissector]], numbers: Mapping[str, Iterable[int]]
    ) -> None:
        self._kinds = tuple(kinds)
        options = [option for kind in self._kinds for option in kind.options]
        if unknown := sorted(numbers.keys() - {option.key for option in options}):
            keys = ", ".join(option.key for option in options)
            raise ConfigurationError(unknown[0], f"no dissector has this option; allowed: {keys}")
        self._numbers = {o.key: o.with_usual(numbers.get(o.key, ())) for o in options}
        self.dissectors = {kind: kind(self._numbers) for kind in self._kinds if kind.always}
        self._offered: dict[int, list[Dissector]] = {}
        self.packets = 0
        self.messages = 0
        self.others: Counter[str] = Counter()
        self.hints = Hints()
        self._figures: dict[tuple[Dissector, str], Figures] = {}
        self.lost = 0
        """Packets lost according to the capturing programs."""
        self.damage = ""
        """Truncation or damage of the last file, and its place; empty: none."""
        self.cut: Counter[int] = Counter()
        """Number of packets that the capture cut, by the number of bytes kept."""
        self._copies = 0
        self._late: list[str] = []
        """Files that begin before the end of the previous one."""
        self._seen: OrderedDict[Segment, tuple[int, Counter[int]]] = OrderedDict()
        """Recent packets: their time, and their count on each interface."""

    def read(
        self,
        paths: Iterable[str | os.PathLike[str]],
        progress: Callable[[int, float | None], None],
    ) -> Iterator[CapturedPacket]:
        """Yield the packets of the files in sequence."""
        last_ns = 0
        for path in paths:
            file = Capture(path, self.packets + 1)
            begins = True
            try:
                for packet in file:
                    if begins and packet.time_ns < last_ns:
                        self._late.append(file.path)
                    number, last_ns, link_type, _, data, wire_bytes, _ = packet
                    begins = False
                    if wire_bytes > len(data):
                        self.cut[len(data)] += 1
                    if number % PROGRESS_PACKETS == 0:
                        progress(number, file.share)
                    yield network.unwrapped(packet) if link_type in network.COOKED_BYTES else packet
            finally:
                self.lost += file.lost
                self.damage = file.damage

    def is_copy(self, packet: CapturedPacket, parsed: Segment | str) -> bool:
        """Return True if a packet's content was seen on another interface just before."""
        interface = network.interface(packet)
        if interface is None or isinstance(parsed, str):
            return False
        seen = self._seen
        while seen and next(iter(seen.values()))[0] < packet.time_ns - COPY_NS:
            seen.popitem(last=False)
        before = seen.get(parsed)
        if before is None:
            seen[parsed] = packet.time_ns, Counter((interface,))
            return False
        _, counts = before
        counts[interface] += 1
        elsewhere = max((n for each, n in counts.items() if each != interface), default=0)
        if counts[interface] > elsewhere:
            return False
        self._copies += 1
        return True

    def offered(self, link_type: int) -> list[Dissector]:
        """Return the dissectors for packets of this link type, in their order."""
        if link_type not in self._offered:
            found = [kind for kind in self._kinds if link_type in kind.link_types]
            for kind in found:
                if kind not in self.dissectors:
                    self.dissectors[kind] = kind(self._numbers)
            self._offered[link_type] = [self.dissectors[kind] for kind in found]
        return self._offered[link_type]

    def take(self, found: Message | Note, dissector: Dissector) -> tuple[str, ...]:
        """Count a message; return remarks about it in addition to its values."""
        if isinstance(found, Note):
            return ()
        self.messages += 1
        key = dissector, found.where
        figures = self._figures.get(key)
        if figures is None:
            other_way = self._figures.get((dissector, found.other_way))
            if len(self._figures) >= MOST_FIGURES:
                key, other_way = (dissector, "others"), None
            figures = self._figures.setdefault(key, Figures(other_way))
        return figures.add(found)

    def fold(self) -> None:
        """Keep the most frequent of the other packets, and the number of the rest."""
        retained = Counter(dict(self.others.most_common(MOST_OTHERS // 2)))
        retained["others"] += self.others.total() - retained.total()
        self.others = retained

    def counts(self) -> Counts:
        """Return the counts of packets and messages."""
        messages = {kind.name: 0 for kind in self.dissectors}
        malformed = dict(messages)
        for (dissector, _), figures in self._figures.items():
            messages[dissector.name] += figures.messages
            malformed[dissector.name] += figures.malformed
        return Counts(
            self.packets,
            messages,
            malformed,
            self.others.total() + self._copies,
        )

    def summary(self, counts: Counts) -> Iterator[str]:
        """Yield the figures of all messages."""
        for (dissector, where), figures in self._figures.items():
            about = dissector.about(where)
            yield f"{dissector.name} {where}{f': {about}' if about else ''}"
            yield from figures
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
            for kind in self.dissectors:
                for option in kind.options:
                    if option.usual:
                        places = " ".join(map(str, sorted(self._numbers[option.key])))
                        yield (
                            f"{kind.name} was looked for on {option.what}s {places} "
                            f"(--{option.flag} for others)"
                        )
        yield from self.hints.lines(self._kinds)
        if self._copies:
            yield f"{self._copies} packets were seen on a second interface, and are counted once"
        if self.lost:
            yield f"the capturing program says that it lost {self.lost} packets"
        if self.cut:
            retained, most = max(self.cut), self.cut.total()
            yield (
                f"{most} packets are cut by the capture, which kept at most {retained} bytes of "
                "them (tcpdump -s 0 keeps all)"
            )
        for path in self._late:
            yield f"{path} begins before the file before it ends: give them in the order of time"
        if counts.other_packets:
            yield f"other packets: {tally(+self.others)}"


def _line(found: Message | Note, dissector: Dissector, remarks: tuple[str, ...]) -> str:
    """Format a message or a note."""
    if isinstance(found, Note):
        return f"{found.where} {found.text}"
    decoded = found.decoded
    if decoded.fault:
        title = decoded.title or dissector.name
        return f"{found.where} MALFORMED {title}: {decoded.fault} {excerpt(found.data)}"
    return " | ".join((f"{found.where} {describe(decoded)}", *remarks))


def _utc(time_ns: int) -> str:
    moment = datetime.datetime.fromtimestamp(time_ns // 10**9, datetime.timezone.utc)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{time_ns % 10**9 // 1000:06d} UTC"
