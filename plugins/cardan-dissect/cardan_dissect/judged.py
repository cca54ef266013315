"""Timeline of a capture for `cardan conform --capture`.

The tested side, or its client, has the well-known port of the suite's protocol. Packets are
assigned by address and port, reports of devices by their dissector. A connection is not judged
after its first missing byte; if its beginning is missing, no failure is reported.
"""

from __future__ import annotations

import os
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, NoReturn

from cardan.conform import (
    Kind,
    Requirement,
    Suite,
    Verdict,
    VerdictOutcome,
    WireEvent,
    WireTimeline,
    not_applicable,
    not_seen,
)
from cardan.conform.report import DOUBTED
from cardan.conform.requirements import V
from cardan.conform.timeline import TimelinePhase, UnaskedError
from cardan.conform.transports import host_and_port
from cardan.errors import CaptureError, ConfigurationError
from cardan_dissect import CaptureReader, network, registry, tcp
from cardan_dissect.capture import LINK_CAN, CapturedPacket, Direction
from cardan_dissect.network import TCP_ACK, TCP_FIN, TCP_RST, TCP_SYN, Endpoint, Segment
from cardan_dissect.reader import CUT, Dissector, Found, Message

PATIENCE_S = 15.0
"""A request that was open for a shorter time at the end of the capture may have been answered."""
BEGINNING_S = 0.5
"""Traffic that began before a capture of datagrams appears within this time."""
LACKS_BEGINNING = "the capture lacks the beginning of a connection"
LACKS_BYTES = "the capture lacks bytes of a connection"
STRAY_DATAGRAMS = 16
"""A client that sent fewer, and got no answer, is a stray next to another client."""
MOST_REPORTED = 10
"""Most flows that are named if none is the protocol's, and most hosts of strays."""


_REPORTS_OF = re.compile(r"(?P<device>.*) (?:endpoint \d+|control|interrupt) (?P<way>IN|OUT)")
"""Directions of reports for dissectors of devices."""
_USB_IDS = re.compile(r"[0-9a-f]{4}:[0-9a-f]{4}(?= )")


class _Unasked(dict[str, TimelinePhase]):
    """Phases of a capture, which has none: a search for a phase raises UnaskedError."""

    def _none(self, *_: object) -> NoReturn:
        raise UnaskedError

    get = __getitem__ = __contains__ = __iter__ = keys = values = items = _none


class ClientTraffic(NamedTuple):
    """One of several simultaneous clients."""

    name: str
    """Its address and port."""
    numbers: list[int]
    """Numbers of its events in the timeline of all."""
    timeline: Captured
    decoded: Any
    """Its timeline as decoded by the suite."""


_WORST = (
    VerdictOutcome.FAILED,
    VerdictOutcome.PASSED,
    VerdictOutcome.NOT_SEEN,
    VerdictOutcome.NOT_APPLICABLE,
)
"""Outcomes in the order of severity: of several clients, the first of these outcomes counts."""


class Captured(WireTimeline):
    """A timeline from a capture. Requirements are not judged by events that it cannot contain."""

    lacks = ""
    """Why the capture may be incomplete; no failure is judged then."""
    unsure = -2
    """Last event (number) up to which the capture may begin in the middle of an exchange. A failure
    does not count if its evidence does not go beyond it."""

    def __init__(self) -> None:
        super().__init__()
        self.clients: list[ClientTraffic] = []
        """Simultaneous clients: each is judged separately."""

    def phases(self) -> dict[str, TimelinePhase]:
        return _Unasked()

    def _of_clients(self, requirement: Requirement[Any]) -> Verdict:
        """Return the worst verdict of all clients."""

        def rank(found: tuple[ClientTraffic, Verdict]) -> tuple[bool, int]:
            outcome, said, *_ = found[1]
            doubted = outcome is VerdictOutcome.NOT_SEEN and said.startswith(DOUBTED)
            return outcome is not VerdictOutcome.FAILED and not doubted, _WORST.index(outcome)

        verdicts = [
            (each, each.timeline.verdict(requirement, each.decoded)) for each in self.clients
        ]
        client, worst = min(verdicts, key=rank)
        begun = DOUBTED if worst.said.startswith(DOUBTED) else ""
        said = worst.said.removeprefix(begun)
        if worst.outcome is not VerdictOutcome.NOT_APPLICABLE:
            said = f"{begun}of {len(verdicts)} clients at a time, {client.name}: {said}"
        evidence = tuple(client.numbers[number] for number in worst.evidence)
        return worst._replace(said=said, evidence=evidence)

    def verdict(self, requirement: Requirement[V], decoded: V) -> Verdict:
        if self.clients:
            return self._of_clients(requirement)
        try:
            found = super().verdict(requirement, decoded)
        except UnaskedError:
            return not_applicable("no client requested it in this capture")
        if found.outcome is VerdictOutcome.PASSED and self.lacks:
            return found._replace(said=f"{found.said}, in what the capture has")
        if found.outcome is not VerdictOutcome.FAILED:
            return found
        if self.lacks:
            return not_seen(f"{DOUBTED}{self.lacks}; {found.said}")
        if max(found.evidence, default=-1) <= self.unsure:
            return not_seen(f"not judged: the capture may begin in the middle of it; {found.said}")
        return found


def timeline(suite: Suite[Any], path: str | os.PathLike[str], target: str = "") -> WireTimeline:
    """Return the timeline of a capture for `suite`; times are the capture's.

    `target` is ``[HOST][:PORT]`` of the flow, a bus in the suite's notation, or a device in that of
    `cardan dissect` ("USB 1.5"). Of a truncated or damaged file the packets before the damage are
    taken. Raises CaptureError for a file that is no capture or has no whole packet, and
    ConfigurationError for a malformed target and for a capture without the flow, which names the
    flows of the capture.
    """
    kind = suite.transport.kind
    if kind == "other" and suite.dissector:
        return _of_device(suite, path, target)
    if kind == "other":
        raise ConfigurationError(
            "--capture",
            f"{suite.name} has no packets of a network: no capture of it is judged; pcap and "
            "pcapng of UDP, TCP, CAN, USB, HCI are, btsnoop logs, and logs of a CAN bus (candump "
            "-L, .asc, .blf)",
        )
    if kind == "can":
        if target:
            suite.wires(target)
        return _of_bus(suite, path)
    first = next(iter(suite.transport.ports.values()))
    host, port = host_and_port(target, "--target", first)
    reading = (_Tcp if kind == "tcp" else _Udp)(suite, host, port - first)
    return _read(reading, path, suite)


def _ends(segment: Segment, sent: bool) -> tuple[Endpoint, Endpoint]:
    """Return the tested endpoint, and ours."""
    return segment.ends(Direction.TO_DEVICE if sent else Direction.FROM_DEVICE)


class _Packet(NamedTuple):
    """Packet of a flow."""

    time_ns: int
    number: int
    """Its number among the protocol's packets."""
    sent: bool
    names: frozenset[str]
    """Channels that it may belong to."""
    segment: Segment


class _Flow(NamedTuple):
    """Packets between an address and port of the tested side, and one of the suite."""

    tested: Endpoint
    ours: Endpoint
    client: Endpoint
    """The endpoint that connects to the other's known port."""
    packets: list[_Packet]

    @property
    def known(self) -> Endpoint:
        """The endpoint other than the client."""
        return self.tested if self.client == self.ours else self.ours

    @property
    def ways(self) -> set[bool]:
        """Return the directions that occur: to the tested side, and from it."""
        return {each.sent for each in self.packets}


class _Reading(ABC):
    """Collects the packets of one protocol by flows, and then the events."""

    protocol: str

    def __init__(self, suite: Suite[Any], host: str, shift: int) -> None:
        _, known, ours, not_checked = suite.transport
        self.ports = {name: port + shift for name, port in known.items() if name not in not_checked}
        self.ours = ours
        self.host = host
        self.events: list[tuple[int, WireEvent]] = []
        """Events with the times of their packets, ns."""
        self.lacks: list[str] = []
        self.last_ns = 0
        self.strays: list[str] = []
        self.parts: list[_Part] = []
        """Simultaneous clients: the events of each."""
        self._flows: dict[tuple[Endpoint, Endpoint], _Flow] = {}
        self._count = 0

    @property
    def tested(self) -> dict[str, None]:
        """Return the tested hosts, in the order of their first packet."""
        return dict.fromkeys(flow.tested.host for flow in self._flows.values())

    def take(self, segment: Segment, time_ns: int) -> bool:
        """Return True if the segment is one of the protocol's."""
        source, destination = segment.source, segment.destination
        if segment.protocol != self.protocol:
            return False
        if self.host and self.host not in (source.host, destination.host):
            return False
        for port, from_known in ((destination.port, False), (source.port, True)):
            names = frozenset(name for name, each in self.ports.items() if each == port)
            if not names:
                continue
            sent = from_known == (names <= self.ours)
            key = _ends(segment, sent)
            if key[::-1] in self._flows:  # Both ends have the known port; the client began.
                continue
            client = destination if from_known else source
            packet = _Packet(time_ns, self._count, sent, names, segment)
            self._flows.setdefault(key, _Flow(*key, client, [])).packets.append(packet)
            self._count += 1
            return True
        return False

    def finish(self) -> None:
        """Process the end of the capture."""
        self._set_aside()
        self.read(list(self._flows.values()))

    @abstractmethod
    def is_stray(self, flow: _Flow) -> bool:
        """Return True if it is not a conversation, while another host's is one."""

    @abstractmethod
    def read(self, flows: list[_Flow]) -> None:
        """Make the events of the tested side."""

    def _set_aside(self) -> None:
        """Remove traffic of other hosts to the same ports: port scans, wrong senders."""
        flows = self._flows.values()
        strays = [flow for flow in flows if self.is_stray(flow)]
        hosts = {flow.client.host for flow in flows if not self.is_stray(flow)}
        count: Counter[tuple[str, Endpoint]] = Counter()
        for flow in strays:
            if hosts and flow.client.host not in hosts:
                del self._flows[flow.tested, flow.ours]
                count[flow.client.host, flow.known] += len(flow.packets)
        self.strays = [
            f"{packets} packets between {host} and {known} are strays, and not judged"
            for (host, known), packets in count.most_common(MOST_REPORTED)
        ]
        if len(count) > MOST_REPORTED:
            self.strays.append(f"strays of {len(count) - MOST_REPORTED} more hosts are not judged")

    def add(
        self, time_ns: int, kind: Kind, sent: bool, channel: str, data: bytes = b"", note: str = ""
    ) -> None:
        """Append an event."""
        self.events.append((time_ns, WireEvent(0.0, kind, sent, channel, data, note)))


class _Part(NamedTuple):
    """Events of one of several clients."""

    client: str
    numbers: list[int]
    lacks: list[str]


class _Udp(_Reading):
    """Datagrams. Of several channels at one port each successive client is one; simultaneous
    clients are judged separately."""

    protocol = "UDP"

    def is_stray(self, flow: _Flow) -> bool:
        if flow.ways == {True}:
            return True
        few = len(flow.packets) < STRAY_DATAGRAMS
        return few and flow.ways == {False} and flow.client == flow.tested

    def read(self, flows: list[_Flow]) -> None:
        clients = _one_after_another(flows)
        found: list[tuple[int, int, WireEvent]] = []
        owners: dict[int, int] = {}
        lacks: list[list[str]] = [[] for _ in clients]
        for index, of_client in enumerate(clients):
            channels: dict[Endpoint, str] = {}
            packets = sorted((p for flow in of_client for p in flow.packets), key=_as_they_came)
            for time_ns, number, sent, names, segment in packets:
                tested, ours = _ends(segment, sent)
                ordered = [name for name in self.ports if name in names]
                channel = channels.setdefault(ours, ordered[min(len(channels), len(ordered) - 1)])
                if segment.cut:
                    lacks[index].append("the capture cut some of its datagrams")
                    continue
                channel += f" {index + 1}" if index else ""
                note = "" if sent else str(tested)
                event = WireEvent(0.0, Kind.DATA, sent, channel, segment.payload, note)
                found.append((time_ns, number, event))
                owners[number] = index
        found.sort(key=lambda each: each[1])
        self.events = [(time_ns, event) for time_ns, _, event in found]
        self.lacks += [why for each in lacks for why in each]
        if len(clients) > 1:
            for index, (first, *_) in enumerate(clients):
                places = [n for n, each in enumerate(found) if owners[each[1]] == index]
                self.parts.append(_Part(str(first.client), places, lacks[index]))


def _as_they_came(packet: _Packet) -> int:
    return packet.number


def _one_after_another(flows: list[_Flow]) -> list[list[_Flow]]:
    """Group flows by client: one that begins after the last packet of the client in another belongs
    to the same client, at another port."""
    clients: list[tuple[int, list[_Flow]]] = []
    for flow in sorted(flows, key=lambda each: each.packets[0].number):
        by_client = [p.number for p in flow.packets if p.segment.source == flow.client]
        numbers = by_client or [p.number for p in flow.packets]
        for index, (last, of_client) in enumerate(clients):
            if last < numbers[0] and of_client[0].client.host == flow.client.host:
                of_client.append(flow)
                clients[index] = numbers[-1], of_client
                break
        else:
            clients.append((numbers[-1], [flow]))
    return [of_client for _, of_client in clients]


@dataclass
class _Connection:
    """Connection that is followed from its beginning."""

    channel: str
    begun: set[bool] = field(default_factory=set)
    """Directions whose SYN was seen: to the tested side, and from it."""
    open: bool = False
    over: bool = False
    reached: dict[bool, int] = field(default_factory=dict)
    """By direction: the sequence number of the last segment without bytes."""
    streams: Mapping[bool, tcp.TcpStream] = field(
        default_factory=lambda: {way: tcp.TcpStream() for way in (False, True)}
    )


class _Tcp(_Reading):
    """Connections. A port of the suite gives each client a channel: "motion 2", the second to any
    port."""

    protocol = "TCP"

    def __init__(self, suite: Suite[Any], host: str, shift: int) -> None:
        super().__init__(suite, host, shift)
        self._connections: dict[tuple[Endpoint, Endpoint], _Connection] = {}
        self._clients = 0

    def is_stray(self, flow: _Flow) -> bool:
        return not any(each.segment.payload for each in flow.packets)

    def read(self, flows: list[_Flow]) -> None:
        packets = sorted((each for flow in flows for each in flow.packets), key=_as_they_came)
        for time_ns, _, sent, names, segment in packets:
            self._read_one(segment, time_ns, sent, names)
        for known in self._connections.values():
            self._complete(known)
            for sent, stream in known.streams.items():
                for event in stream.flush():
                    self._read(known, event, sent, self.last_ns)

    def _read_one(self, segment: Segment, time_ns: int, sent: bool, names: frozenset[str]) -> None:
        key = _ends(segment, sent)
        syn = segment.flags & (TCP_SYN | TCP_ACK)
        known = self._connections.get(key)
        if syn == TCP_SYN and (known is None or known.over or (sent in known.begun and known.open)):
            if known is not None:
                self._complete(known)
                if known.open and not known.over:
                    self._end(known, time_ns, sent)
            known = self._connections[key] = _Connection(self._channel(names))
        if known is None:
            if not segment.payload:
                return
            self.lacks.append(LACKS_BEGINNING)
            known = self._connections[key] = _Connection(self._channel(names), {False, True}, True)
            self._tell(known, time_ns, Kind.OPENED, False, note=LACKS_BEGINNING)
        self._follow(known, segment, sent, syn, time_ns)

    def _channel(self, names: frozenset[str]) -> str:
        """Return the channel of a new connection; empty: all possible ones are used."""
        ordered = [name for name in self.ports if name in names]
        if names <= self.ours:
            self._clients += 1
            return f"{ordered[0]} {self._clients}"
        taken = {each.channel for each in self._connections.values() if not each.over}
        return next((name for name in ordered if name not in taken), "")

    def _follow(
        self, known: _Connection, segment: Segment, sent: bool, syn: int, time_ns: int
    ) -> None:
        if syn & TCP_SYN:
            known.begun.add(sent)
        if segment.flags & TCP_RST and not known.open and not known.over:
            known.over = True
            self._tell(known, time_ns, Kind.REFUSED, sent)
            return
        if segment.payload and not known.open:
            self._lost(known, LACKS_BEGINNING)
            return
        if not segment.payload and not syn & TCP_SYN:
            known.reached[sent] = segment.sequence
            if segment.flags & TCP_FIN:
                self._complete(known)
        for event in known.streams[sent].feed(segment, time_ns):
            self._read(known, event, sent, time_ns)
        # A stream ends data from before its beginning, which do not belong to this connection.
        if syn == TCP_SYN | TCP_ACK and not known.open and len(known.begun) == 2:
            known.open = True
            self._tell(known, time_ns, Kind.OPENED, False)

    def _read(self, known: _Connection, event: tcp.Event, sent: bool, time_ns: int) -> None:
        if isinstance(event, tcp.Bytes) and not known.over:
            self._tell(known, event.time_ns, Kind.DATA, sent, event.data)
        elif isinstance(event, tcp.Gap):
            self._lost(known, LACKS_BYTES)
        elif isinstance(event, tcp.Cut):
            self._lost(known, "the capture cut some of its packets")
        elif isinstance(event, tcp.End) and known.open and not known.over:
            self._end(known, time_ns, sent)

    def _tell(
        self,
        known: _Connection,
        time_ns: int,
        kind: Kind,
        sent: bool,
        data: bytes = b"",
        note: str = "",
    ) -> None:
        if known.channel:
            self.add(time_ns, kind, sent, known.channel, data, note)

    def _end(self, known: _Connection, time_ns: int, sent: bool) -> None:
        known.over = True
        self._tell(known, time_ns, Kind.CLOSED, sent)

    def _lost(self, known: _Connection, why: str) -> None:
        """Stop following a connection."""
        known.over = True
        if known.channel:
            self.lacks.append(why)

    def _complete(self, known: _Connection) -> None:
        """Check if the last of its bytes arrived, which no later ones would show."""
        if any(known.streams[way].missing_before(at) for way, at in known.reached.items()):
            self._lost(known, LACKS_BYTES)


def _read(reading: _Reading, path: str | os.PathLike[str], suite: Suite[Any]) -> Captured:
    kinds = registry.dissectors()
    capture = CaptureReader(kinds, {})
    broken = 0
    for packet in _packets(capture, path):
        reading.last_ns = packet.time_ns
        parsed = network.parse(packet)
        if not isinstance(parsed, Segment):
            broken += packet.cut and parsed == network.BROKEN
        elif not capture.is_copy(packet, parsed) and not reading.take(parsed, packet.time_ns):
            capture.hints.add(packet, parsed)
    reading.finish()
    _check_flows(reading, capture, kinds, path)
    of_all = _lacks(capture)
    if broken:
        of_all.append("the capture cut packets before their ports")
    found = _timeline(reading.events, (*reading.lacks, *of_all))
    found.strays = (*_damage(capture), *reading.strays)
    if reading.protocol == "TCP":
        _leave_open(found, reading.ours, reading.last_ns)
        return found
    found.unsure = _unsure(found)
    for part in reading.parts:
        alone = _timeline([reading.events[n] for n in part.numbers], (*part.lacks, *of_all))
        alone.unsure = _unsure(alone)
        found.clients.append(ClientTraffic(part.client, part.numbers, alone, suite.decode(alone)))
    return found


def _check_flows(
    reading: _Reading,
    capture: CaptureReader,
    kinds: Iterable[Any],
    path: str | os.PathLike[str],
) -> None:
    name = os.fspath(path)
    if not capture.packets:
        raise CaptureError(f"{name}: it has no packets")
    ports = " ".join(map(str, sorted(set(reading.ports.values()))))
    where = f"{reading.protocol} {ports}" + (f" of {reading.host}" if reading.host else "")
    if not reading.tested:
        flows = [*capture.hints.flows()]
        more = f" and {len(flows) - MOST_REPORTED} more" if len(flows) > MOST_REPORTED else ""
        there = f"there are {', '.join(flows[:MOST_REPORTED])}{more}" if flows else "there are none"
        hints = "".join(f"; {line}" for line in capture.hints.lines(kinds, "--target :"))
        raise ConfigurationError(
            "--capture", f"{name} has no flow at {where}: {there}; --target says which one{hints}"
        )
    if len(reading.tested) > 1:
        listed = ", ".join(reading.tested)
        raise ConfigurationError(
            "--target", f"{name} has several that can be judged, {listed}: give one as HOST"
        )
    if all(event.sent for _, event in reading.events):
        (tested,) = reading.tested
        raise ConfigurationError(
            "--capture",
            f"{name} has nothing of {tested}, which is judged, only what it was sent",
        )


def _timeline(events: list[tuple[int, WireEvent]], lacks: Iterable[str]) -> Captured:
    found = Captured()
    found.start_ns = events[0][0] if events else 0
    found.lacks = "; ".join(dict.fromkeys(lacks))
    for time_ns, event in events:
        found.add(event._replace(time_s=(time_ns - found.start_ns) * 1e-9))
    return found


def _unsure(found: Captured) -> int:
    """Return the last of the first events of each direction and channel within the beginning."""
    firsts: dict[tuple[str, bool], int] = {}
    for number, event in enumerate(found):
        if event.time_s > BEGINNING_S:
            break
        firsts.setdefault((event.channel, event.sent), number)
    return max(firsts.values(), default=-1)


def _leave_open(found: Captured, ours: frozenset[str], last_ns: int) -> None:
    """Remove requests to the tested side that were still open at the end of the capture."""
    assert found.start_ns is not None
    end_s = (last_ns - found.start_ns) * 1e-9
    settled: set[str] = set()
    for number in reversed(range(len(found))):
        event = found.events[number]
        if event.sent and event.kind is Kind.DATA:
            old = event.time_s < end_s - PATIENCE_S
            served = event.channel.partition(" ")[0] in ours
            if event.channel not in settled and not old and not served:
                del found.events[number]
        else:
            settled.add(event.channel)


def _of_bus(suite: Suite[Any], path: str | os.PathLike[str]) -> Captured:
    capture = CaptureReader((), {})
    events, lacks = [], []
    for packet in _frames(capture, path):
        asks = suite.asks_it(packet.data)
        if packet.cut:
            lacks.append("the capture cut some of its frames")
        elif asks is not None:
            events.append((packet.time_ns, WireEvent(0.0, Kind.DATA, asks, "", packet.data)))
    name = os.fspath(path)
    if all(event.sent for _, event in events):
        raise ConfigurationError(
            "--capture",
            f"{name} has no frames of it in {capture.packets} packets; --target is {suite.target}",
        )
    found = _timeline(events, (*_lacks(capture), *lacks))
    found.strays = _damage(capture)
    found.unsure = _unsure(found)
    return found


def _of_device(suite: Suite[Any], path: str | os.PathLike[str], target: str) -> Captured:
    """Return the reports of a device on USB or on a radio link."""
    dissector = registry.FINDER.load(suite.dissector)({})
    capture = CaptureReader((), {})
    reports: dict[str, list[tuple[str, Message]]] = {}

    def take(found: Found) -> None:
        for each in found:
            end = _REPORTS_OF.fullmatch(each.where)
            if isinstance(each, Message) and end is not None:
                reports.setdefault(end["device"], []).append((end["way"], each))

    for packet in _packets(capture, path):
        if packet.link_type in dissector.link_types:
            take(dissector.feed(packet, ""))
    take(dissector.finish())
    name = os.fspath(path)
    listed = ", ".join(reports)
    device = target or next(iter(reports), "")
    if not target and len(reports) > 1:
        raise ConfigurationError(
            "--target", f"{name} has several that can be judged: give one of {listed}"
        )
    ways = {way for way, _ in reports.get(device, ())}
    if Direction.FROM_DEVICE.value not in ways:
        of_it = f" of {target}" if target else ""
        there = f"; there are those of {listed}" if listed else ""
        raise ConfigurationError(
            "--capture",
            f"{name} has no reports{of_it} from {suite.judges} in {capture.packets} packets{there}",
        )
    return _of_reports(reports[device], dissector, capture)


def _of_reports(
    reports: list[tuple[str, Message]], dissector: Dissector, capture: CaptureReader
) -> Captured:
    lacks = _lacks(capture)
    first = reports[0][1]
    known = _USB_IDS.match(dissector.about(first.where))
    opened = WireEvent(0.0, Kind.OPENED, note=known.group() if known else "")
    events = [(first.packet.time_ns, opened)]
    for way, message in reports:
        if message.decoded.fault == CUT:
            lacks.append("the capture cut some of its reports")
            continue
        sent = way == Direction.TO_DEVICE.value
        events.append((message.packet.time_ns, WireEvent(0.0, Kind.DATA, sent, "", message.data)))
    found = _timeline(events, lacks)
    found.strays = _damage(capture)
    found.unsure = _unsure(found)
    return found


def _frames(capture: CaptureReader, path: str | os.PathLike[str]) -> Iterator[CapturedPacket]:
    for packet in _packets(capture, path):
        if packet.link_type == LINK_CAN:
            yield packet


def _packets(capture: CaptureReader, path: str | os.PathLike[str]) -> Iterator[CapturedPacket]:
    """Yield the packets, of a damaged file those before the damage. Raises CaptureError if there
    are none."""
    try:
        for packet in capture.read((path,), lambda packets, share: None):
            capture.packets += 1
            yield packet
    except CaptureError:
        if not capture.damage or not capture.packets:
            raise


def _lacks(capture: CaptureReader) -> list[str]:
    """Return what the file lacks, in words."""
    lost = f"the capturing program lost {capture.lost} packets" if capture.lost else ""
    return [each for each in (capture.damage, lost) if each]


def _damage(capture: CaptureReader) -> tuple[str, ...]:
    return (f"{capture.damage}; the rest is not read",) if capture.damage else ()
