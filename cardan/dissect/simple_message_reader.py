"""Simple message in a capture: TCP streams put together, a line per message, figures per flow."""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from cardan.dissect import tcp
from cardan.dissect.capture import CapturedPacket, Direction
from cardan.dissect.flows import Flow, FlowReader, Sender, excerpt
from cardan.dissect.network import TCP_ACK, TCP_SYN, Endpoint, Segment
from cardan.dissect.ports import (
    SIMPLE_MESSAGE_PORTS,
    SIMPLE_MESSAGE_RT_CONTROL_PORT,
    SIMPLE_MESSAGE_RT_PORT,
)
from cardan.dissect.reader import PacketLine
from cardan.dissect.simple_message import (
    BUSY,
    DISCONNECT,
    LARGEST_PREFIX,
    LEAST_PREFIX,
    MOST_PREFIX,
    PREFIX_BYTES,
    REPLY,
    REQUEST,
    TOPIC,
    IoErrorReply,
    JointVelocity,
    JointVelocityEx,
    MotionCtrl,
    MotionReply,
    RobotStatus,
    RtJointCommand,
    RtJointState,
    SimpleMessage,
    SimpleMessageBroken,
    begins_message,
    byte_order,
    malformed,
    remarks,
    result_name,
    subcode_name,
)
from cardan.dissect.simple_message_text import describe, message_name
from cardan.dissect.statistics import Intervals, Latencies, milliseconds, tallies, tally

PENDING = 256
"""Requests remembered until they are answered."""
SHOWN_BYTES = 32
"""Bytes shown of a malformed message: its header, and four words."""
CYCLE_MESSAGES = 16
"""Most messages that count as one cycle of the state port."""
PORT_NAMES = {50240: "motion", 50241: "state", 50242: "I/O", 50243: "RT control", 50244: "RT"}


class _Piece(NamedTuple):
    """The next item of a stream: a whole message, malformed bytes with the reason, or a note."""

    data: bytes
    malformed: str = ""
    note: str = ""


class _Framer:
    """Cuts the bytes of one direction into messages."""

    def __init__(self, flow: _Flow) -> None:
        self.skipped_bytes = 0
        """Bytes of messages whose beginning is missing."""
        self._flow = flow
        self._buffer = bytearray()
        self._synchronised = False
        self._early = b""
        """Too few bytes to tell whether a message begins with them."""

    @property
    def left_bytes(self) -> int:
        """Bytes of a message that has begun and not ended."""
        return len(self._buffer) + len(self._early)

    def take(self, event: tcp.Event) -> Iterator[_Piece]:
        """What the stream says next; what can be read now."""
        if isinstance(event, tcp.Bytes):
            yield from self._cut(event.data)
            return
        if isinstance(event, tcp.Gap):
            note = f"GAP: {event.size} bytes are missing in the capture"
            if self._buffer:
                note += f", {len(self._buffer)} bytes of an unfinished message dropped"
            yield _Piece(b"", note=note)
        yield from self._skip_early()
        if self._buffer and isinstance(event, tcp.End):
            yield _Piece(bytes(self._buffer), "the connection ends inside a message")
        self._buffer.clear()
        self._synchronised = isinstance(event, tcp.Begin)

    def _cut(self, payload: bytes) -> Iterator[_Piece]:
        """The next bytes of the stream; the messages they end."""
        while not self._synchronised:
            fresh = self._early + payload
            if len(fresh) < PREFIX_BYTES:
                self._early = fresh
                return
            if begins_message(fresh, self._flow.byte_order):
                payload, self._early, self._synchronised = fresh, b"", True
            elif self._early:
                yield from self._skip_early()
            else:
                yield self._skipped(len(payload))
                return
        self._buffer += payload
        while len(self._buffer) >= PREFIX_BYTES:
            order = self._flow.byte_order or byte_order(self._buffer)
            prefix = struct.unpack_from(f"{order}i", self._buffer)[0]
            if LEAST_PREFIX <= prefix <= MOST_PREFIX:
                self._flow.byte_order = order
                if len(self._buffer) >= PREFIX_BYTES + prefix:
                    yield _Piece(bytes(self._buffer[: PREFIX_BYTES + prefix]))
                    del self._buffer[: PREFIX_BYTES + prefix]
                    continue
                if prefix <= LARGEST_PREFIX:
                    return
                reason = f"prefix above {LARGEST_PREFIX}, which no message has"
            else:
                reason = f"prefix outside {LEAST_PREFIX} to {MOST_PREFIX}"
            yield _Piece(bytes(self._buffer), reason)
            self._buffer.clear()
            self._synchronised = False

    def _skip_early(self) -> Iterator[_Piece]:
        if self._early:
            yield self._skipped(len(self._early))
            self._early = b""

    def _skipped(self, count: int) -> _Piece:
        self.skipped_bytes += count
        return _Piece(b"", note=f"SKIPPED {count} bytes that begin no message")


class _Sender(Sender):
    """What one end of a flow sent."""

    def __init__(self, flow: _Flow) -> None:
        super().__init__()
        self.stream, self.framer = tcp.TcpStream(), _Framer(flow)
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


class _Asked(NamedTuple):
    """A request that waits for its reply."""

    message: SimpleMessage
    time_ns: int
    what: str
    expected: bool


class _Flow(Flow[_Sender]):
    """One port of a controller and one client."""

    def __init__(self, controller: Endpoint, client: Endpoint) -> None:
        super().__init__(controller, client, lambda: _Sender(self))
        self.byte_order: str | None = None
        self.waiting_packets: int | None = 0
        """Packets without a byte before the first with one; None after it."""
        self._real_bytes: set[int] = set()
        self._pending: deque[_Asked] = deque(maxlen=PENDING)
        self._latencies: dict[str, Latencies] = {}
        self._replies: Counter[str] = Counter()
        self._busy: Counter[str] = Counter()
        self._unanswered = self._hasty = 0
        self._periods: dict[str, Intervals] = {}
        self._cycle: list[str] = []
        self._cycles: Counter[str] = Counter()
        self._rt: tuple[int, int] | None = None  # message id, time

    def take(self, data: bytes, direction: Direction, time_ns: int) -> tuple[str, str]:
        """One whole message; its line, and why it is malformed ("" when it is not)."""
        sender, message = self.senders[direction], SimpleMessage(data)
        reason = malformed(message)
        if reason is not None:
            return self.broken(data, reason, direction), reason
        if any(getattr(field, "reals", 0) for field in message.body_fields):
            self._real_bytes.add(message.real_bytes)
        sender.types[message_name(message.msg_type)] += 1
        said = list(remarks(message))
        if direction is Direction.FROM_DEVICE:
            said += self._from_controller(message, time_ns)
        else:
            said += self._from_client(message, time_ns)
        sender.remarks.update(said)
        return " | ".join((describe(message), *(text.upper() for text in said))), ""

    def broken(self, data: bytes, reason: str, direction: Direction) -> str:
        """The line of bytes that are no message."""
        self.senders[direction].malformed[reason] += 1
        return f"MALFORMED simple message: {reason} {excerpt(data, SHOWN_BYTES, 4)}"

    def _from_client(self, message: SimpleMessage, time_ns: int) -> Iterator[str]:
        if isinstance(message, RtJointCommand):
            if self._rt is not None and self._rt[0] == message.message_id:
                self._latency("RT_JOINT_COMMAND_EX", time_ns - self._rt[1])
                self._rt = None
            else:
                yield "answers no RT_JOINT_STATE_EX"
            return
        if message.comm_type not in (TOPIC, REQUEST):
            return
        if isinstance(message, JointVelocity | JointVelocityEx) and message.comm_type == TOPIC:
            return
        command = message.command_code if isinstance(message, MotionCtrl) else message.msg_type
        if any(asked.expected for asked in self._pending):
            self._hasty += 1
        if len(self._pending) == PENDING:
            self._unanswered += self._pending.popleft().expected
        expected = message.comm_type == REQUEST and command != DISCONNECT
        self._pending.append(_Asked(message, time_ns, message_name(command), expected))

    def _from_controller(self, message: SimpleMessage, time_ns: int) -> Iterator[str]:
        if message.comm_type == TOPIC:
            self._published(message, time_ns)
        elif message.comm_type == REPLY or isinstance(message, MotionReply):
            yield from self._answered(message, time_ns)

    def _published(self, message: SimpleMessage, time_ns: int) -> None:
        if isinstance(message, RtJointState):
            self._rt = message.message_id, time_ns
        name = message_name(message.msg_type)
        if message.fields_desc[-1].name == "accelerations":
            name += f" of group {message.group}"
        self._periods.setdefault(name, Intervals()).add(time_ns)
        self._cycle.append(name)
        if isinstance(message, RobotStatus) or len(self._cycle) >= CYCLE_MESSAGES:
            self._cycles[" then ".join(self._cycle)] += 1
            self._cycle.clear()

    def _answered(self, reply: SimpleMessage, time_ns: int) -> Iterator[str]:
        place = next((n for n, a in enumerate(self._pending) if _answers(reply, a.message)), None)
        if isinstance(reply, MotionReply):
            what = message_name(reply.command_code)
        elif place is not None:
            what = self._pending[place].what
        else:
            what = message_name(reply.msg_type).removesuffix("_REPLY")
        outcome = _outcome(reply)
        self._replies[f"{what} {outcome}"] += 1
        if isinstance(reply, MotionReply) and reply.result == BUSY:
            self._busy[what] += 1
        if place is None:
            yield "answers no request"
            return
        for _ in range(place):
            self._unanswered += self._pending.popleft().expected
        self._latency(what, time_ns - self._pending.popleft().time_ns)

    def _latency(self, what: str, duration_ns: int) -> None:
        self._latencies.setdefault(what, Latencies()).add(duration_ns)

    def summary(self) -> Iterator[str]:
        port = PORT_NAMES.get(self.device.port)
        order = {"<": "little-endian", ">": "big-endian", None: "byte order unknown"}
        sizes = " and ".join(f"{8 * size}-bit" for size in sorted(self._real_bytes))
        yield (
            f"simple message flow controller {self.device}"
            f"{f' ({port})' if port else ''} - client {self.client}, {order[self.byte_order]}"
            f"{f', {sizes} reals' if sizes else ''}"
        )
        for name, sender in zip(("controller", "client"), self.senders.values(), strict=True):
            yield from sender.summary(name)
        yield from tallies("  ", ("replies", self._replies), ("BUSY", self._busy))
        for what, latencies in self._latencies.items():
            figures = zip(("min", "median", "p95", "max"), (0.0, 0.5, 0.95, 1.0), strict=True)
            shown = " ".join(
                f"{name} {milliseconds(latencies.quantile_ns(q))}" for name, q in figures
            )
            yield f"  {what} to its reply x{len(latencies)}: {shown} ms"
        unanswered = self._unanswered + sum(asked.expected for asked in self._pending)
        if unanswered:
            yield f"  requests without a reply {unanswered}"
        if self._hasty:
            yield f"  requests sent before the reply to an earlier one {self._hasty}"
        for name, period in self._periods.items():
            yield f"  {name}: {period}"
        if self._cycles:
            yield f"  cycle: {tally(self._cycles)}"


def _answers(reply: SimpleMessage, request: SimpleMessage) -> bool:
    """Whether a message of the controller can be the reply to the client's."""
    if isinstance(reply, IoErrorReply):
        return True
    if isinstance(reply, MotionReply):
        command = request.command_code if isinstance(request, MotionCtrl) else request.msg_type
        if reply.command_code != command:
            return False
        sequences = [f.name for f in request.fields_desc if f.name == "sequence"]
        return not sequences or reply.sequence in (request.sequence, -1)
    same_id = request.msg_type == reply.msg_type
    followed = (2003, 2005, 2007, 2009)
    return same_id or (request.msg_type in followed and reply.msg_type == request.msg_type + 1)


def _outcome(reply: SimpleMessage) -> str:
    if isinstance(reply, MotionReply | IoErrorReply):
        name = result_name(reply)
        counted = name in ("SUCCESS", "TRUE", "BUSY")
        return name if counted else f"{name} {subcode_name(reply)}"
    for field in reply.body_fields:
        if field.name == "result":
            return str(field.i2s.get(reply.result, reply.result))
    return "SUCCESS" if reply.reply_code == 1 else f"reply_code {reply.reply_code}"


class SimpleMessageReader(FlowReader[_Flow]):
    """TCP streams to and from the ports of a controller, and the datagrams of the NTNU fork.

    A connection that carries no byte is left to the other packets.
    """

    def __init__(
        self,
        simple_message_ports: frozenset[int] = frozenset(
            (*SIMPLE_MESSAGE_PORTS, SIMPLE_MESSAGE_RT_CONTROL_PORT)
        ),
    ) -> None:
        super().__init__()
        self._ports = simple_message_ports
        self._last: CapturedPacket | None = None

    def open(self, device: Endpoint, client: Endpoint) -> _Flow:
        return _Flow(device, client)

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        if not isinstance(network, Segment):
            return
        if network.protocol == "UDP":
            yield from self._datagram(packet, network)
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
        flow: _Flow,
        direction: Direction,
        events: Iterable[tcp.Event],
    ) -> Iterator[PacketLine]:
        """The messages that a stream's events complete, shown with `packet`."""
        for event in events:
            time_ns = event.time_ns if isinstance(event, tcp.Bytes) else packet.time_ns
            for piece in flow.senders[direction].framer.take(event):
                yield packet, self._line(flow, direction, piece, time_ns)

    def _line(self, flow: _Flow, direction: Direction, piece: _Piece, time_ns: int) -> str:
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
        """None when the segment is to or from no controller."""
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

    def _datagram(self, packet: CapturedPacket, segment: Segment) -> Iterator[PacketLine]:
        ports = {segment.source.port, segment.destination.port}
        if SIMPLE_MESSAGE_RT_PORT not in ports or segment.cut:
            return
        if not begins_message(segment.payload):
            return
        message = SimpleMessage(segment.payload)
        if isinstance(message, SimpleMessageBroken):
            from_controller = segment.destination.port == SIMPLE_MESSAGE_RT_PORT
        else:
            from_controller = isinstance(message, RtJointState)
        direction = Direction.FROM_DEVICE if from_controller else Direction.TO_DEVICE
        flow = self.flow(segment, direction)
        flow.waiting_packets = None
        flow.byte_order = byte_order(segment.payload)
        flow.senders[direction].datagrams += 1
        self.packets += 1
        # Firmware sends its whole buffer; what follows the message means nothing.
        size = PREFIX_BYTES + struct.unpack_from(f"{flow.byte_order}i", segment.payload)[0]
        piece = _Piece(segment.payload[:size])
        yield packet, self._line(flow, direction, piece, packet.time_ns)

    def summary(self) -> Iterable[str]:
        for flow in self.flows.values():
            if flow.waiting_packets is None:
                yield from flow.summary()
