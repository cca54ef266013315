"""Protocols between a socket of a device and one of a client: flows by their endpoints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Generic, NamedTuple, TypeVar

from cardan.dissect.capture import CapturedPacket, Direction
from cardan.dissect.network import Endpoint, Segment
from cardan.dissect.reader import CUT, PacketLine, ProtocolReader
from cardan.dissect.statistics import Intervals, Sequence, tallies

SHOWN_BYTES = 24
"""Bytes shown of a malformed datagram; the first fields show its intended type."""


class Sender:
    """What one end of a flow sent."""

    def __init__(self) -> None:
        self.datagrams = 0
        self.malformed: Counter[str] = Counter()
        self.remarks: Counter[str] = Counter()
        self.sequence = Sequence()
        self.intervals = Intervals()

    def add(self, number: int, datagram: bytes, time_ns: int) -> str:
        """One good datagram; what its sequence number says, as `Sequence.add` has it."""
        verdict = self.sequence.add(number, datagram)
        if verdict == "restart":
            self.intervals.pause()
        if verdict not in ("duplicate", "repeated", "late"):
            self.intervals.add(time_ns)
        return verdict

    def summary(self, name: str, more: str = "") -> Iterator[str]:
        """Figures of everything that was added."""
        yield (
            f"  from {name}: {self.datagrams} datagrams, {self.sequence}, {self.intervals}{more}"
        )
        yield from self.reasons()

    def reasons(self) -> Iterator[str]:
        """Why messages were malformed or remarkable, and how often."""
        yield from tallies("    ", ("malformed", self.malformed), ("remarks", self.remarks))


SenderT = TypeVar("SenderT", bound=Sender)


class Flow(ABC, Generic[SenderT]):
    """A device's socket and a client's."""

    def __init__(self, device: Endpoint, client: Endpoint, sender: Callable[[], SenderT]) -> None:
        self.device, self.client = device, client
        self.senders = {direction: sender() for direction in Direction}
        """By the direction in which they send."""

    @abstractmethod
    def summary(self) -> Iterator[str]:
        """Figures of everything that was sent."""


FlowT = TypeVar("FlowT", bound=Flow[Any])


class FlowReader(ProtocolReader, Generic[FlowT]):
    """A reader whose protocol has flows."""

    def __init__(self) -> None:
        super().__init__()
        self.flows: dict[tuple[Endpoint, Endpoint], FlowT] = {}
        """By the device's and the client's endpoint."""

    @abstractmethod
    def open(self, device: Endpoint, client: Endpoint) -> FlowT:
        """A new flow between these."""

    def flow(self, segment: Segment, direction: Direction) -> FlowT:
        """The flow of a segment, a new one where there is none."""
        ends = segment.ends(direction)
        if ends not in self.flows:
            self.flows[ends] = self.open(*ends)
        return self.flows[ends]

    def known_direction(self, segment: Segment) -> Direction | None:
        """That of a segment between the ends of a flow there is; None when there is none."""
        return next((d for d in Direction if segment.ends(d) in self.flows), None)

    def summary(self) -> Iterable[str]:
        for flow in self.flows.values():
            yield from flow.summary()


class DatagramFlow(Flow[Sender]):
    """A flow of UDP datagrams."""

    def __init__(self, device: Endpoint, client: Endpoint) -> None:
        super().__init__(device, client, Sender)

    @abstractmethod
    def take(self, direction: Direction, layer: Any, time_ns: int) -> Iterator[str]:
        """A good datagram: its values, and remarks on it."""


class Dissected(NamedTuple):
    """A dissected datagram."""

    layer: Any
    direction: Direction
    title: str
    """What it is called where it is malformed."""
    fault: str | None
    """Why it is malformed, None when it is not."""


DatagramFlowT = TypeVar("DatagramFlowT", bound=DatagramFlow)


class DatagramReader(FlowReader[DatagramFlowT]):
    """A reader of a protocol on UDP, a message in each datagram."""

    @abstractmethod
    def dissect(self, segment: Segment) -> Dissected | None:
        """A UDP datagram; None: it is another protocol's."""

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        if not isinstance(network, Segment) or network.protocol != "UDP":
            return
        found = self.dissect(network)
        if found is None:
            return
        self.packets += 1
        self.messages += 1
        flow = self.flow(network, found.direction)
        sender = flow.senders[found.direction]
        sender.datagrams += 1
        reason = CUT if network.cut else found.fault
        if reason is None:
            text = " | ".join(flow.take(found.direction, found.layer, packet.time_ns))
        else:
            self.count_malformed(reason, sender.malformed)
            text = f"MALFORMED {found.title}: {reason} {excerpt(network.payload)}"
        yield packet, f"{network.source} > {network.destination} {text}"


def excerpt(data: bytes, most: int = SHOWN_BYTES, group: int = 1) -> str:
    """The length of malformed bytes, and the first of them in hex."""
    more = " ..." if len(data) > most else ""
    return f"({len(data)} B: {data[:most].hex(' ', group)}{more})"
