"""Protocols with consecutive messages on TCP: reassembly of streams, and splitting into
messages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import ClassVar, NamedTuple

from cardan_dissect import tcp
from cardan_dissect.capture import CapturedPacket, Direction
from cardan_dissect.network import TCP_ACK, TCP_SYN, Segment
from cardan_dissect.reader import CUT, Decoded, Dissector, Found, Message, Note

MOST_FLOWS = 1024
"""Most flows that are followed at once; a further one ends the flow with the longest silence."""

MOST_ABOUT = 4 * MOST_FLOWS
"""Most directions with figures of the stream."""


class Measured(NamedTuple):
    """Length of a message from its first bytes."""

    size: int | None
    """None: they are not a message's."""
    reason: str = ""
    """Reason why they are not, or why it is not one if it is incomplete; empty: the rest may
    follow."""


class Conversation(ABC):
    """Message format between a port of a device and a client, in both directions.

    A protocol's class recognizes the beginning and length of its messages, and decodes them.
    """

    head_bytes: ClassVar[int]
    """Bytes of a message that determine its length."""

    @abstractmethod
    def begins(self, data: bytes) -> bool:
        """Return True if `data`, a head or more, looks like the beginning of a message."""

    @abstractmethod
    def measure(self, data: bytearray) -> Measured:
        """Return the length of the message at the beginning of `data`, a head or more."""

    @abstractmethod
    def decode(self, data: bytes, direction: Direction) -> Decoded:
        """Decode a whole message."""

    def restart(self) -> None:  # noqa: B027 - few remember anything
        """Reset at the beginning of a connection."""


class _Stream:
    """One direction of a connection: bytes in order, split into messages."""

    def __init__(self, conversation: Conversation, direction: Direction) -> None:
        self.tcp = tcp.TcpStream()
        self.skipped_bytes = 0
        """Number of bytes of messages whose beginning is missing."""
        self._conversation, self._direction = conversation, direction
        self._buffer = bytearray()
        self._synchronized = False
        self._early = b""
        """Too few bytes to recognize the beginning of a message."""
        self._passed_over = 0
        """Remaining bytes of a message of which the capture lacks a part."""

    def take(self, event: tcp.Event) -> Iterator[str | tuple[bytes, Decoded]]:
        """Yield the notes and messages, with their bytes, that an event completes."""
        if isinstance(event, tcp.Bytes):
            yield from self._cut(event.data)
            return
        if isinstance(event, tcp.Cut):
            yield from self._lack(event.size)
            return
        if isinstance(event, tcp.Gap):
            note = f"GAP: {event.size} bytes are missing in the capture"
            if self._buffer:
                note += f", {len(self._buffer)} bytes of an unfinished message dropped"
            yield note
        self._passed_over = 0
        yield from self._skip_early()
        if self._buffer and isinstance(event, tcp.End):
            yield self._broken("the connection ends inside a message")
        self._buffer.clear()
        self._synchronized = isinstance(event, tcp.Begin)
        if self._synchronized:
            self._conversation.restart()

    def _lack(self, size: int) -> Iterator[str | tuple[bytes, Decoded]]:
        """Handle `size` bytes that are missing in the capture. Their message is shown as cut; if
        its length is known, and no more than its own bytes are missing, the next one begins at its
        end."""
        yield from self._skip_early()
        known = min(size, self._passed_over)
        size -= known
        self._passed_over -= known
        if not size:
            return
        length, reason = None, ""
        if len(self._buffer) >= self._conversation.head_bytes:
            length, reason = self._conversation.measure(self._buffer)
        left = -1 if length is None or reason else length - len(self._buffer)
        if self._buffer:
            yield self._broken(CUT)
            self._buffer.clear()
        self._synchronized = size <= left
        self._passed_over = max(0, left - size) if self._synchronized else 0

    def _cut(self, payload: bytes) -> Iterator[str | tuple[bytes, Decoded]]:
        """Yield the messages that the next bytes of the stream complete."""
        head_bytes = self._conversation.head_bytes
        if self._passed_over:
            known = min(len(payload), self._passed_over)
            self._passed_over -= known
            payload = payload[known:]
            if not payload:
                return
        while not self._synchronized:
            fresh = self._early + payload
            if len(fresh) < head_bytes:
                self._early = fresh
                return
            if self._conversation.begins(fresh):
                payload, self._early, self._synchronized = fresh, b"", True
            elif self._early:
                yield from self._skip_early()
            else:
                yield self._skipped(len(payload))
                return
        self._buffer += payload
        while len(self._buffer) >= head_bytes:
            size, reason = self._conversation.measure(self._buffer)
            if size is not None and len(self._buffer) >= size:
                data = bytes(self._buffer[:size])
                del self._buffer[:size]
                yield data, self._conversation.decode(data, self._direction)
                continue
            if not reason:
                return
            yield self._broken(reason)
            self._buffer.clear()
            self._synchronized = False

    def _broken(self, reason: str) -> tuple[bytes, Decoded]:
        return bytes(self._buffer), Decoded(None, fault=reason)

    def _skip_early(self) -> Iterator[str]:
        if self._early:
            yield self._skipped(len(self._early))
            self._early = b""

    def _skipped(self, count: int) -> str:
        self.skipped_bytes += count
        return f"SKIPPED {count} bytes that begin no message"

    def __str__(self) -> str:
        stream, left = self.tcp, len(self._buffer) + len(self._early)
        line = (
            f"{stream.segments} segments, retransmitted {stream.retransmitted} "
            f"out of order {stream.reordered} gaps {stream.gaps}"
        )
        line += f" ({stream.lost_bytes} B missing)" if stream.gaps else ""
        line += f", {stream.cut} cut by the capture" if stream.cut else ""
        line += f" skipped {self.skipped_bytes} B" if self.skipped_bytes else ""
        return line + (f", the capture ends {left} B into a message" if left else "")


class _Flow:
    """Both directions, and the packets without bytes before the first with one; None after it."""

    def __init__(self, conversation: Conversation) -> None:
        self.streams = {each: _Stream(conversation, each) for each in Direction}
        self.waiting_packets: int | None = 0


class StreamDissector(Dissector):
    """A protocol on TCP, to and from the ports of its first option.

    A connection that carries no byte is left to the other packets.
    """

    always = True

    conversation: ClassVar[type[Conversation]]

    def __init__(self, numbers: Mapping[str, frozenset[int]]) -> None:
        super().__init__(numbers)
        self._flows: dict[str, _Flow] = {}
        """By the device's end, then the client's; the latest sender is the last."""
        self._about: dict[str, str] = {}
        self._last: CapturedPacket | None = None

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Found:
        if not isinstance(network, Segment) or network.protocol != "TCP":
            return
        direction = self._direction(network)
        if direction is None:
            return
        key = _key(network, direction)
        flow = self._flows.pop(key, None) or _Flow(self.conversation())
        if len(self._flows) >= MOST_FLOWS:
            oldest = next(iter(self._flows))
            yield from self._end(packet, oldest, self._flows.pop(oldest))
        self._flows[key] = flow
        if flow.waiting_packets is None:
            self.packets += 1
        elif network.payload:
            self.packets += flow.waiting_packets + 1
            flow.waiting_packets = None
        else:
            flow.waiting_packets += 1
        self._last = packet
        for event in flow.streams[direction].tcp.feed(network, packet.time_ns):
            yield from self._read(packet, key, flow, direction, event)

    def finish(self) -> Found:
        for key, flow in self._flows.items():
            if self._last is not None:
                yield from self._end(self._last, key, flow)

    def _end(self, packet: CapturedPacket, key: str, flow: _Flow) -> Found:
        """End a flow, which is followed no more."""
        for direction, stream in flow.streams.items():
            for event in stream.tcp.flush():
                yield from self._read(packet, key, flow, direction, event)
            if stream.tcp.segments and len(self._about) < MOST_ABOUT:
                self._about[_where(key, direction)] = str(stream)

    def _read(
        self,
        packet: CapturedPacket,
        key: str,
        flow: _Flow,
        direction: Direction,
        event: tcp.Event,
    ) -> Found:
        """Yield the messages and notes that an event of a stream completes, with `packet`."""
        where, back = (_where(key, each) for each in (direction, direction.opposite))
        if isinstance(event, tcp.Bytes):
            packet = packet._replace(time_ns=event.time_ns)
        for piece in flow.streams[direction].take(event):
            if isinstance(piece, str):
                yield Note(packet, where, piece)
            else:
                data, decoded = piece
                yield Message(packet, where, decoded, data, back)

    def about(self, where: str) -> str:
        return self._about.get(where, "")

    def _direction(self, segment: Segment) -> Direction | None:
        """Return the direction; None if the segment is not to or from a device."""
        ports = self.numbers[self.options[0].key]
        from_port, to_port = segment.source.port in ports, segment.destination.port in ports
        if from_port and to_port:  # The client's port happens to be one of the device's.
            for direction in Direction:
                if _key(segment, direction) in self._flows:
                    return direction
            from_port = segment.flags & (TCP_SYN | TCP_ACK) != TCP_SYN
        if from_port:
            return Direction.FROM_DEVICE
        return Direction.TO_DEVICE if to_port else None


def _key(segment: Segment, direction: Direction) -> str:
    device, client = segment.ends(direction)
    return f"{device} {client}"


def _where(key: str, direction: Direction) -> str:
    device, client = key.split(" ")
    if direction is Direction.FROM_DEVICE:
        return f"{device} > {client}"
    return f"{client} > {device}"
