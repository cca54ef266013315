"""Makes of a capture the timeline that `cardan conform --capture` judges.

What is judged has the port that the suite's protocol is known for, or its client has. The capture
says nothing of a connection after the first of its bytes that are missing; where the beginning of
one is, no failure is judged.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

from cardan.conform import (
    Event,
    Kind,
    Outcome,
    Requirement,
    Suite,
    Timeline,
    Verdict,
    not_applicable,
    not_seen,
)
from cardan.conform.report import DOUBTED
from cardan.conform.requirements import V
from cardan.conform.timeline import Phase
from cardan.conform.transports import host_and_port
from cardan.errors import CaptureError, ConfigurationError
from cardan_dissect import CaptureReader, network, registry, tcp
from cardan_dissect.capture import LINK_CAN, CapturedPacket, Direction
from cardan_dissect.network import TCP_ACK, TCP_FIN, TCP_RST, TCP_SYN, Endpoint, Segment

PATIENCE_S = 15.0
"""A request that the end of the capture left open for a shorter time was perhaps answered."""
BEGINNING_S = 0.5
"""What went on before a capture of datagrams shows within this time."""
LACKS_BYTES = "the capture lacks bytes of a connection"
MOST_TOLD = 10
"""Flows that are named where none is the protocol's."""


class UnaskedError(Exception):
    """A judge wants what came of something that was asked for, and nobody asked for it."""


class _Unasked(dict[str, Phase]):
    """Phases of which there is none: a look for one raises UnaskedError."""

    def _none(self, *_: object) -> NoReturn:
        raise UnaskedError

    get = __getitem__ = __contains__ = __iter__ = keys = values = items = _none


class Captured(Timeline):
    """A timeline that somebody else recorded. Nothing is judged that it cannot show."""

    lacks = ""
    """Why it may not show what was there: no failure is judged then."""
    unsure = -2
    """Of one that may begin in the middle of things: the number of the last event that shows it. A
    failure is none where its evidence does not go beyond it."""

    def phases(self) -> dict[str, Phase]:
        return _Unasked()

    def verdict(self, requirement: Requirement[V], seen: V) -> Verdict:
        try:
            found = super().verdict(requirement, seen)
        except UnaskedError:
            return not_applicable("nobody asked for it in this capture")
        if found.outcome is Outcome.PASSED and self.lacks:
            return found._replace(said=f"{found.said}, in what the capture has")
        if found.outcome is not Outcome.FAILED:
            return found
        if self.lacks:
            return not_seen(f"{DOUBTED}{self.lacks}; {found.said}")
        if max(found.evidence, default=-1) <= self.unsure:
            return not_seen(f"not judged: the capture may begin in the middle of it; {found.said}")
        return found


def timeline(suite: Suite[Any], path: str | os.PathLike[str], target: str = "") -> Timeline:
    """What a capture shows of what `suite` judges; times are the capture's.

    `target` is ``[HOST][:PORT]`` of the flow, or of a bus as the suite has it. Raises CaptureError
    for a file that is no capture, is damaged, or has no packets, and ConfigurationError for a
    target that is none and for a capture without the flow, which names those that there are.
    """
    kind = suite.transport.kind
    if kind == "other":
        raise ConfigurationError(
            "--capture", f"{suite.name} has no packets of a network: no capture of it is judged"
        )
    if kind == "can":
        if target:
            suite.wires(target)
        return _of_bus(suite, path)
    first = next(iter(suite.transport.ports.values()))
    host, port = host_and_port(target, "--target", first)
    reading = (_Tcp if kind == "tcp" else _Udp)(suite, host, port - first)
    return _read(reading, path, suite, kind.upper())


def _ends(segment: Segment, sent: bool) -> tuple[Endpoint, Endpoint]:
    """That of what is judged, and ours."""
    return segment.ends(Direction.TO_DEVICE if sent else Direction.FROM_DEVICE)


class _Reading(ABC):
    """Collects the events of one protocol's packets."""

    def __init__(self, suite: Suite[Any], host: str, shift: int) -> None:
        _, known, ours, pilots = suite.transport
        self.ports = {name: port + shift for name, port in known.items() if name not in pilots}
        self.ours = ours
        self.host = host
        self.events: list[tuple[int, Event]] = []
        """With the times of their packets, ns."""
        self.lacks: list[str] = []
        self.last_ns = 0
        self.judged: dict[str, None] = {}
        """Hosts that are judged, in the order in which they came."""

    def side(self, segment: Segment) -> tuple[bool, frozenset[str]] | None:
        """Whether a segment goes to what is judged, and the channels that it can be; None: it is
        none of this protocol's."""
        source, destination = segment.source, segment.destination
        if self.host and self.host not in (source.host, destination.host):
            return None
        for port, from_known in ((destination.port, False), (source.port, True)):
            names = frozenset(name for name, each in self.ports.items() if each == port)
            if not names:
                continue
            known_is_ours = names <= self.ours
            sent = from_known == known_is_ours
            self.judged[(destination if sent else source).host] = None
            return sent, names
        return None

    @abstractmethod
    def take(self, segment: Segment, time_ns: int) -> bool:
        """Whether it is one of the protocol's."""

    def add(
        self, time_ns: int, kind: Kind, sent: bool, channel: str, data: bytes = b"", note: str = ""
    ) -> None:
        """What happened next."""
        self.events.append((time_ns, Event(0.0, kind, sent, channel, data, note)))

    def finish(self) -> None:  # noqa: B027 - datagrams are never held back
        """The capture ends."""


class _Udp(_Reading):
    """Datagrams. Of several channels at one port each client is one."""

    def __init__(self, suite: Suite[Any], host: str, shift: int) -> None:
        super().__init__(suite, host, shift)
        self._channels: dict[Endpoint, str] = {}

    def take(self, segment: Segment, time_ns: int) -> bool:
        found = self.side(segment)
        if found is None or segment.protocol != "UDP":
            return False
        sent, names = found
        judged, ours = _ends(segment, sent)
        ordered = [name for name in self.ports if name in names]
        channel = self._channels.get(ours)
        if channel is None:
            channel = ordered[min(len(self._channels), len(ordered) - 1)]
            self._channels[ours] = channel
        if segment.cut:
            self.lacks.append("the capture cut some of its datagrams")
        else:
            note = "" if sent else str(judged)
            self.add(time_ns, Kind.DATA, sent, channel, segment.payload, note)
        return True


@dataclass
class _Connection:
    """One that is followed from its beginning."""

    channel: str
    begun: set[bool] = field(default_factory=set)
    """Ways in which its SYN was seen: to what is judged, and from it."""
    open: bool = False
    over: bool = False
    reached: dict[bool, int] = field(default_factory=dict)
    """By ways: the sequence number of the last segment without bytes."""
    streams: Mapping[bool, tcp.TcpStream] = field(
        default_factory=lambda: {way: tcp.TcpStream() for way in (False, True)}
    )


class _Tcp(_Reading):
    """Connections. A port of ours gives each client a channel: "motion 2", the second to any."""

    def __init__(self, suite: Suite[Any], host: str, shift: int) -> None:
        super().__init__(suite, host, shift)
        self._connections: dict[tuple[Endpoint, Endpoint], _Connection] = {}
        self._clients = 0

    def take(self, segment: Segment, time_ns: int) -> bool:
        found = self.side(segment)
        if found is None or segment.protocol != "TCP":
            return False
        sent, names = found
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
                return True
            self.lacks.append("the capture lacks the beginning of a connection")
            known = self._connections[key] = _Connection(self._channel(names), {False, True}, True)
            self._tell(known, time_ns, Kind.OPENED, False)
        self._follow(known, segment, sent, syn, time_ns)
        return True

    def _channel(self, names: frozenset[str]) -> str:
        """The channel of a new connection; empty: all that there can be are taken."""
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
            self._lost(known, "the capture lacks the beginning of a connection")
            return
        if not segment.payload and not syn & TCP_SYN:
            known.reached[sent] = segment.sequence
            if segment.flags & TCP_FIN:
                self._complete(known)
        for event in known.streams[sent].feed(segment, time_ns):
            self._read(known, event, sent, time_ns)
        # A stream ends what was before its beginning, which is none of this connection's.
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
        self, known: _Connection, time_ns: int, kind: Kind, sent: bool, data: bytes = b""
    ) -> None:
        if known.channel:
            self.add(time_ns, kind, sent, known.channel, data)

    def _end(self, known: _Connection, time_ns: int, sent: bool) -> None:
        known.over = True
        self._tell(known, time_ns, Kind.CLOSED, sent)

    def _lost(self, known: _Connection, why: str) -> None:
        """It is not followed any further."""
        known.over = True
        if known.channel:
            self.lacks.append(why)

    def _complete(self, known: _Connection) -> None:
        """Look whether the last of its bytes came, which no later ones would tell."""
        if any(known.streams[way].missing_before(at) for way, at in known.reached.items()):
            self._lost(known, LACKS_BYTES)

    def finish(self) -> None:
        for known in self._connections.values():
            self._complete(known)
            for sent, stream in known.streams.items():
                for event in stream.flush():
                    self._read(known, event, sent, self.last_ns)


def _read(
    reading: _Reading, path: str | os.PathLike[str], suite: Suite[Any], protocol: str
) -> Captured:
    kinds = registry.dissectors()
    capture = CaptureReader(kinds, {})
    broken = 0
    for packet in capture.read((path,), lambda packets, share: None):
        capture.packets += 1
        reading.last_ns = packet.time_ns
        parsed = network.parse(packet)
        if not isinstance(parsed, Segment):
            broken += packet.cut and parsed == network.BROKEN
        elif not capture.is_copy(packet, parsed) and not reading.take(parsed, packet.time_ns):
            capture.hints.add(packet, parsed)
    reading.finish()
    _check_flows(reading, capture, kinds, path, protocol)
    if capture.lost:
        reading.lacks.append(f"the capturing program lost {capture.lost} packets")
    if broken:
        reading.lacks.append("the capture cut packets before their ports")
    found = _timeline(reading.events, reading.lacks)
    if protocol == "UDP":
        found.unsure = _unsure(found)
    else:
        _leave_open(found, reading.ours, reading.last_ns)
    return found


def _check_flows(
    reading: _Reading,
    capture: CaptureReader,
    kinds: Iterable[Any],
    path: str | os.PathLike[str],
    protocol: str,
) -> None:
    name = os.fspath(path)
    if not capture.packets:
        raise CaptureError(f"{name}: it has no packets")
    ports = " ".join(map(str, sorted(set(reading.ports.values()))))
    where = f"{protocol} {ports}" + (f" of {reading.host}" if reading.host else "")
    if not reading.judged:
        flows = [*capture.hints.flows()]
        more = f" and {len(flows) - MOST_TOLD} more" if len(flows) > MOST_TOLD else ""
        there = f"there are {', '.join(flows[:MOST_TOLD])}{more}" if flows else "there are none"
        hints = "".join(f"; {line}" for line in capture.hints.lines(kinds, "--target :"))
        raise ConfigurationError(
            "--capture", f"{name} has no flow at {where}: {there}; --target says which one{hints}"
        )
    if len(reading.judged) > 1:
        listed = ", ".join(reading.judged)
        raise ConfigurationError(
            "--target", f"{name} has several that can be judged, {listed}: give one as HOST"
        )
    if all(event.sent for _, event in reading.events):
        (judged,) = reading.judged
        raise ConfigurationError(
            "--capture",
            f"{name} has nothing of {judged}, which is judged, only what it was sent",
        )


def _timeline(events: list[tuple[int, Event]], lacks: Iterable[str]) -> Captured:
    found = Captured()
    found.start_ns = events[0][0] if events else 0
    found.lacks = "; ".join(dict.fromkeys(lacks))
    for time_ns, event in events:
        found.add(event._replace(time_s=(time_ns - found.start_ns) * 1e-9))
    return found


def _unsure(found: Captured) -> int:
    """Of the first events of each way and channel, the last one that the beginning has."""
    firsts: dict[tuple[str, bool], int] = {}
    for number, event in enumerate(found):
        if event.time_s > BEGINNING_S:
            break
        firsts.setdefault((event.channel, event.sent), number)
    return max(firsts.values(), default=-1)


def _leave_open(found: Captured, ours: frozenset[str], last_ns: int) -> None:
    """Take out what was asked of what is judged when the capture ended and is open still."""
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
            events.append((packet.time_ns, Event(0.0, Kind.DATA, asks, "", packet.data)))
    name = os.fspath(path)
    if all(event.sent for _, event in events):
        raise ConfigurationError(
            "--capture",
            f"{name} has no frames of it in {capture.packets} packets; --target is {suite.target}",
        )
    if capture.lost:
        lacks.append(f"the capturing program lost {capture.lost} packets")
    found = _timeline(events, lacks)
    found.unsure = _unsure(found)
    return found


def _frames(capture: CaptureReader, path: str | os.PathLike[str]) -> Iterator[CapturedPacket]:
    for packet in capture.read((path,), lambda packets, share: None):
        capture.packets += 1
        if packet.link_type == LINK_CAN:
            yield packet
