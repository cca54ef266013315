"""Protocols whose messages follow each other on TCP: what cuts them out, and flows of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, NamedTuple, TypeVar

from cardan.dissect import tcp
from cardan.dissect.capture import CapturedPacket, Direction
from cardan.dissect.flows import Flow, FlowReader, Sender, excerpt
from cardan.dissect.network import TCP_ACK, TCP_SYN, Endpoint, Segment
from cardan.dissect.reader import PacketLine
from cardan.dissect.statistics import tally

SHOWN_BYTES = 32
"""Bytes shown of a malformed message: its header, and some words."""


class Piece(NamedTuple):
    """The next item of a stream: a whole message, malformed bytes with the reason, or a note."""

    data: bytes
    malformed: str = ""
    note: str = ""


class Measured(NamedTuple):
    """What the first bytes of a message say of its length."""

    size: int | None
    """None: they are no message's."""
    reason: str = ""
    """Why they are not, or why it is not if it is not all there; empty: the rest may come."""


class Framer(ABC):
    """Cuts the bytes of one direction into messages."""

    def __init__(self, head_bytes: int) -> None:
        """Of `head_bytes` a message's length is known."""
        self.skipped_bytes = 0
        """Bytes of messages whose beginning is missing."""
        self._head_bytes = head_bytes
        self._buffer = bytearray()
        self._synchronised = False
        self._early = b""
        """Too few bytes to tell whether a message begins with them."""

    @abstractmethod
    def begins(self, data: bytes) -> bool:
        """Whether `data`, a head or more, looks like the beginning of a message."""

    @abstractmethod
    def measure(self, data: bytearray) -> Measured:
        """The length of the message that `data`, a head or more, begins with."""

    @property
    def left_bytes(self) -> int:
        """Bytes of a message that has begun and not ended."""
        return len(self._buffer) + len(self._early)

    def take(self, event: tcp.Event) -> Iterator[Piece]:
        """What the stream says next; what can be read now."""
        if isinstance(event, tcp.Bytes):
            yield from self._cut(event.data)
            return
        if isinstance(event, tcp.Gap):
            note = f"GAP: {event.size} bytes are missing in the capture"
            if self._buffer:
                note += f", {len(self._buffer)} bytes of an unfinished message dropped"
            yield Piece(b"", note=note)
        yield from self._skip_early()
        if self._buffer and isinstance(event, tcp.End):
            yield Piece(bytes(self._buffer), "the connection ends inside a message")
        self._buffer.clear()
        self._synchronised = isinstance(event, tcp.Begin)

    def _cut(self, payload: bytes) -> Iterator[Piece]:
        """The next bytes of the stream; the messages they end."""
        while not self._synchronised:
            fresh = self._early + payload
            if len(fresh) < self._head_bytes:
                self._early = fresh
                return
            if self.begins(fresh):
                payload, self._early, self._synchronised = fresh, b"", True
            elif self._early:
                yield from self._skip_early()
            else:
                yield self._skipped(len(payload))
                return
        self._buffer += payload
        while len(self._buffer) >= self._head_bytes:
            size, reason = self.measure(self._buffer)
            if size is not None and len(self._buffer) >= size:
                yield Piece(bytes(self._buffer[:size]))
                del self._buffer[:size]
                continue
            if not reason:
                return
            yield Piece(bytes(self._buffer), reason)
            self._buffer.clear()
            self._synchronised = False

    def _skip_early(self) -> Iterator[Piece]:
        if self._early:
            yield self._skipped(len(self._early))
            self._early = b""

    def _skipped(self, count: int) -> Piece:
        self.skipped_bytes += count
        return Piece(b"", note=f"SKIPPED {count} bytes that begin no message")


class StreamSender(Sender):
    """What one end of a flow sent."""

    def __init__(self, framer: Framer) -> None:
        super().__init__()
        self.stream, self.framer = tcp.TcpStream(), framer
        self.types: Counter[str] = Counter()

    def summary(self, name: str, more: str = "") -> Iterator[str]:
        stream, messages = self.stream, self.types.total() + self.malformed.total()
        if not messages and not stream.segments:
            return
        line = f"  from {name}: {messages} messages in "
        if self.datagrams:
            line += f"{self.datagrams} datagrams"
        else:
            line += (
                f"{stream.segments} segments, retransmitted {stream.retransmitted} "
                f"out of order {stream.reordered} gaps {stream.gaps}"
            )
            line += f" ({stream.lost_bytes} B missing)" if stream.gaps else ""
            skipped, left = self.framer.skipped_bytes, self.framer.left_bytes
            line += f" skipped {skipped} B" if skipped else ""
            line += f", the capture ends {left} B into a message" if left else ""
        yield line + more
        if self.types:
            yield f"    {tally(self.types)}"
        yield from self.reasons()


class StreamFlow(Flow[StreamSender]):
    """One port of a device and one client."""

    title: str
    """What a malformed message is called."""

    def __init__(self, device: Endpoint, client: Endpoint, framer: Callable[[], Framer]) -> None:
        super().__init__(device, client, lambda: StreamSender(framer()))
        self.waiting_packets: int | None = 0
        """Packets without a byte before the first with one; None after it."""

    @abstractmethod
    def take(self, data: bytes, direction: Direction, time_ns: int) -> tuple[str, str]:
        """One whole message; its line, and why it is malformed ("" when it is not)."""

    def broken(self, data: bytes, reason: str, direction: Direction) -> str:
        """The line of bytes that are no message."""
        self.senders[direction].malformed[reason] += 1
        return f"MALFORMED {self.title}: {reason} {excerpt(data, SHOWN_BYTES, 4)}"

    def noted(self, event: tcp.Event, direction: Direction) -> None:
        """A connection begins or ends, or bytes are missing."""


StreamFlowT = TypeVar("StreamFlowT", bound=StreamFlow)


class StreamReader(FlowReader[StreamFlowT], Generic[StreamFlowT]):
    """TCP streams to and from some ports of devices.

    A connection that carries no byte is left to the other packets.
    """

    def __init__(self, ports: frozenset[int]) -> None:
        super().__init__()
        self._ports = ports
        self._last: CapturedPacket | None = None

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        if not isinstance(network, Segment) or network.protocol != "TCP":
            return
        direction = self._direction(network)
        if direction is None:
            return
        flow = self.flow(network, direction)
        if flow.waiting_packets is None:
            self.packets += 1
        elif network.payload:
            self.packets += flow.waiting_packets + 1
            flow.waiting_packets = None
        else:
            flow.waiting_packets += 1
        self._last = packet
        events = flow.senders[direction].stream.feed(network, packet.time_ns)
        yield from self._read(packet, flow, direction, events)

    def finish(self) -> Iterable[PacketLine]:
        for flow in self.flows.values():
            for direction, sender in flow.senders.items():
                if self._last is not None:
                    yield from self._read(self._last, flow, direction, sender.stream.flush())

    def _read(
        self,
        packet: CapturedPacket,
        flow: StreamFlowT,
        direction: Direction,
        events: Iterable[tcp.Event],
    ) -> Iterator[PacketLine]:
        """The messages that a stream's events complete, shown with `packet`."""
        for event in events:
            flow.noted(event, direction)
            time_ns = event.time_ns if isinstance(event, tcp.Bytes) else packet.time_ns
            for piece in flow.senders[direction].framer.take(event):
                yield packet, self.line(flow, direction, piece, time_ns)

    def line(self, flow: StreamFlowT, direction: Direction, piece: Piece, time_ns: int) -> str:
        """The line of a piece, which is counted."""
        text = piece.note
        if not text:
            reason = piece.malformed
            if reason:
                text = flow.broken(piece.data, reason, direction)
            else:
                text, reason = flow.take(piece.data, direction, time_ns)
            self.messages += 1
            if reason:
                self.count_malformed(reason)
        ends = (flow.device, flow.client)
        source, destination = ends if direction is Direction.FROM_DEVICE else ends[::-1]
        return f"{source} > {destination} {text}"

    def _direction(self, segment: Segment) -> Direction | None:
        """None when the segment is to or from no device."""
        from_port = segment.source.port in self._ports
        to_port = segment.destination.port in self._ports
        if from_port and to_port:  # the client's port happens to be one of ours
            known = self.known_direction(segment)
            if known is not None:
                return known
            from_port = segment.flags & (TCP_SYN | TCP_ACK) != TCP_SYN
        if from_port:
            return Direction.FROM_DEVICE
        return Direction.TO_DEVICE if to_port else None

    def summary(self) -> Iterable[str]:
        for flow in self.flows.values():
            if flow.waiting_packets is None:
                yield from flow.summary()
