"""Simple message in a capture: TCP streams put together, a line per message, figures per flow."""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from cardan.dissect.capture import CapturedPacket
from cardan.dissect.network import TCP_ACK, TCP_FIN, TCP_RST, TCP_SYN, Endpoint, Segment
from cardan.dissect.ports import SIMPLE_MESSAGE_RT_PORT
from cardan.dissect.reader import Options, PacketLine, ProtocolReader
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
from cardan.dissect.statistics import Intervals, Latencies, milliseconds, tally

SEQUENCE_MODULUS = 2**32
HELD_BYTES, HELD_NS = 2**16, 10**9
"""A hole in a stream that is not filled while so much, or for so long, comes after it is one of
the capture."""
FARTHEST_BACK = 2**20
"""A sequence number farther back is of another connection and not a retransmission."""
PENDING = 256
"""Requests remembered until they are answered."""
SHOWN_BYTES = 32
"""Of a malformed message: its header, and four words."""
CYCLE_MESSAGES = 16
"""The most that is taken for one cycle of the state port."""
PORT_NAMES = {50240: "motion", 50241: "state", 50242: "I/O", 50243: "RT control", 50244: "RT"}


class _Piece(NamedTuple):
    """What a stream holds next: a whole message, malformed bytes with the reason, or a note."""

    data: bytes
    malformed: str = ""
    note: str = ""
    time_ns: int | None = None
    """When it could be read; None: with the frame that is fed."""


class _Stream:
    """One direction of a TCP connection: segments in any order to messages in order."""

    def __init__(self, flow: _Flow) -> None:
        self.segments = self.retransmitted = self.reordered = self.gaps = self.lost_bytes = 0
        self.skipped_bytes = 0
        """Of messages whose beginning is missing."""
        self._flow = flow
        self._next: int | None = None
        self._buffer = bytearray()
        self._synchronised = False
        self._early = b""
        """Too few bytes to tell whether a message begins with them."""
        self._held: list[tuple[int, bytes, int]] = []  # sequence, payload, time
        self._held_since_ns = 0

    @property
    def left_bytes(self) -> int:
        """Of a message that has begun and not ended."""
        return len(self._buffer) + len(self._early)

    def feed(self, segment: Segment, time_ns: int) -> Iterator[_Piece]:
        """One segment; what can be read now."""
        sequence, payload = segment.sequence, segment.payload
        if segment.flags & TCP_SYN:
            start = (sequence + 1) % SEQUENCE_MODULUS
            if self._next is None or start != self._next or self._buffer:
                yield from self.end()
                self._next, self._synchronised = start, True
            sequence = start
        if payload:
            self.segments += 1
            yield from self._take(sequence, payload, time_ns)
        if segment.flags & TCP_RST or (
            segment.flags & TCP_FIN
            and not self._held
            and self._next == (sequence + len(payload)) % SEQUENCE_MODULUS
        ):
            yield from self.end()

    def _take(self, sequence: int, payload: bytes, time_ns: int) -> Iterator[_Piece]:
        if self._next is None:
            self._next = sequence
        ahead = _difference(sequence, self._next)
        if ahead < -FARTHEST_BACK:
            yield from self.end()
            self._next, ahead = sequence, 0
        if ahead > 0:
            if not self._held:
                self._held_since_ns = time_ns
            self.reordered += 1
            self._held.append((sequence, payload, time_ns))
            total = sum(len(data) for _, data, _ in self._held)
            if total > HELD_BYTES or time_ns - self._held_since_ns > HELD_NS:
                yield from self._give_up()
            return
        yield from self._append(sequence, payload)
        yield from self._release(filled=True)
        if self._held and time_ns - self._held_since_ns > HELD_NS:
            yield from self._give_up()

    def _append(self, sequence: int, payload: bytes) -> Iterator[_Piece]:
        """A segment that begins at or before what is expected next."""
        known = -_difference(sequence, self._next or 0)
        if known:
            self.retransmitted += 1
        fresh = payload[known:]
        if fresh:
            self._next = ((self._next or 0) + len(fresh)) % SEQUENCE_MODULUS
            yield from self._cut(fresh)

    def _release(self, *, filled: bool) -> Iterator[_Piece]:
        """Held segments that are not ahead any more. When the hole was `filled` they could not be
        read before, else it is the capture's and they could as soon as they came."""
        found = True
        while found:
            found = False
            for held in self._held:
                if _difference(held[0], self._next or 0) <= 0:
                    self._held.remove(held)
                    for piece in self._append(*held[:2]):
                        yield piece if filled else piece._replace(time_ns=held[2])
                    found = True
                    break

    def _give_up(self) -> Iterator[_Piece]:
        """What is missing will not come any more."""
        nearest = min(_difference(sequence, self._next or 0) for sequence, _, _ in self._held)
        self.gaps += 1
        self.lost_bytes += nearest
        note = f"GAP: {nearest} bytes are missing in the capture"
        if self._buffer:
            note += f", {len(self._buffer)} bytes of an unfinished message dropped"
        yield _Piece(b"", note=note)
        yield from self._skip_early()
        self._buffer.clear()
        self._synchronised = False
        self._next = ((self._next or 0) + nearest) % SEQUENCE_MODULUS
        yield from self._release(filled=False)

    def end(self) -> Iterator[_Piece]:
        """The connection has ended."""
        yield from self.flush()
        yield from self._skip_early()
        if self._buffer:
            yield _Piece(bytes(self._buffer), "the connection ends inside a message")
        self._buffer.clear()
        self._next, self._synchronised = None, False

    def flush(self) -> Iterator[_Piece]:
        """Nothing more comes: what is held back."""
        while self._held:
            yield from self._give_up()

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


def _difference(sequence: int, other: int) -> int:
    """`sequence` - `other` modulo 2**32, between -2**31 and 2**31."""
    half = SEQUENCE_MODULUS // 2
    return (sequence - other + half) % SEQUENCE_MODULUS - half


class _Direction:
    """What went one way in a flow."""

    def __init__(self, flow: _Flow) -> None:
        self.stream = _Stream(flow)
        self.types: Counter[str] = Counter()
        self.malformed: Counter[str] = Counter()
        self.remarks: Counter[str] = Counter()
        self.datagrams = 0

    def summary(self, sender: str) -> Iterator[str]:
        stream, messages = self.stream, self.types.total() + self.malformed.total()
        if not messages and not stream.segments:
            return
        line = f"  from {sender}: {messages} messages in "
        if self.datagrams:
            line += f"{self.datagrams} datagrams"
        else:
            line += (
                f"{stream.segments} segments, retransmitted {stream.retransmitted} "
                f"out of order {stream.reordered} gaps {stream.gaps}"
            )
            line += f" ({stream.lost_bytes} B missing)" if stream.gaps else ""
            line += f" skipped {stream.skipped_bytes} B" if stream.skipped_bytes else ""
            if stream.left_bytes:
                line += f", the capture ends {stream.left_bytes} B into a message"
        yield line
        if self.types:
            yield f"    {tally(self.types)}"
        if self.malformed:
            yield f"    malformed: {tally(self.malformed)}"
        if self.remarks:
            yield f"    remarks: {tally(self.remarks)}"


class _Asked(NamedTuple):
    """A request that waits for its reply."""

    message: SimpleMessage
    time_ns: int
    what: str
    expected: bool


class _Flow:
    """One port of a controller and one client."""

    def __init__(self, controller: Endpoint, client: Endpoint) -> None:
        self.controller, self.client = controller, client
        self.byte_order: str | None = None
        self.waiting_frames: int | None = 0
        """Frames without a byte before the first with one; None after it."""
        self.from_controller, self.from_client = _Direction(self), _Direction(self)
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

    def take(self, data: bytes, from_controller: bool, time_ns: int) -> tuple[str, str]:
        """One whole message; its line, and why it is malformed ("" when it is not)."""
        direction = self.from_controller if from_controller else self.from_client
        message = SimpleMessage(data)
        reason = malformed(message)
        if reason is not None:
            return self.broken(data, reason, from_controller), reason
        if any(getattr(field, "reals", 0) for field in message.body_fields):
            self._real_bytes.add(message.real_bytes)
        direction.types[message_name(message.msg_type)] += 1
        said = list(remarks(message))
        if from_controller:
            said += self._from_controller(message, time_ns)
        else:
            said += self._from_client(message, time_ns)
        direction.remarks.update(said)
        return " | ".join((describe(message), *(text.upper() for text in said))), ""

    def broken(self, data: bytes, reason: str, from_controller: bool) -> str:
        """The line of bytes that are no message."""
        direction = self.from_controller if from_controller else self.from_client
        direction.malformed[reason] += 1
        more = " ..." if len(data) > SHOWN_BYTES else ""
        shown = data[:SHOWN_BYTES].hex(" ", 4)
        return f"MALFORMED simple message: {reason} ({len(data)} B: {shown}{more})"

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
        port = PORT_NAMES.get(self.controller.port)
        order = {"<": "little-endian", ">": "big-endian", None: "byte order unknown"}
        sizes = " and ".join(f"{8 * size}-bit" for size in sorted(self._real_bytes))
        yield (
            f"simple message flow controller {self.controller}"
            f"{f' ({port})' if port else ''} - client {self.client}, {order[self.byte_order]}"
            f"{f', {sizes} reals' if sizes else ''}"
        )
        yield from self.from_controller.summary("controller")
        yield from self.from_client.summary("client")
        if self._replies:
            yield f"  replies: {tally(self._replies)}"
        if self._busy:
            yield f"  BUSY: {tally(self._busy)}"
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


class SimpleMessageReader(ProtocolReader):
    """TCP streams to and from the ports of a controller, and the datagrams of the NTNU fork.

    A connection that carries no byte is left to the other packets.
    """

    name = "simple message"

    def __init__(self, options: Options) -> None:
        super().__init__(options)
        self._ports, self._egm_ports = options.simple_message_ports, options.egm_ports
        self._flows: dict[tuple[Endpoint, Endpoint], _Flow] = {}
        self._last: CapturedPacket | None = None

    def feed(self, frame: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        if not isinstance(network, Segment):
            return
        ways = (network.source, network.destination), (network.destination, network.source)
        if network.protocol == "UDP":
            yield from self._datagram(frame, network, ways)
            return
        from_controller = self._sent_by_controller(network, ways)
        if from_controller is None:
            return
        key = ways[0] if from_controller else ways[1]
        flow = self._flows.get(key)
        if flow is None:
            flow = self._flows[key] = _Flow(*key)
        if flow.waiting_frames is None:
            self.frames += 1
        elif network.payload:
            self.frames += flow.waiting_frames + 1
            flow.waiting_frames = None
        else:
            flow.waiting_frames += 1
        self._last = frame
        direction = flow.from_controller if from_controller else flow.from_client
        pieces = direction.stream.feed(network, frame.time_ns)
        for text in self._lines(flow, from_controller, pieces, frame.time_ns):
            yield frame, text

    def finish(self) -> Iterable[PacketLine]:
        for flow in self._flows.values():
            for from_controller in (True, False):
                direction = flow.from_controller if from_controller else flow.from_client
                if self._last is not None:
                    time_ns, pieces = self._last.time_ns, direction.stream.flush()
                    for text in self._lines(flow, from_controller, pieces, time_ns):
                        yield self._last, text

    def _lines(
        self, flow: _Flow, from_controller: bool, pieces: Iterable[_Piece], time_ns: int
    ) -> Iterator[str]:
        ends = (flow.controller, flow.client) if from_controller else (flow.client, flow.controller)
        way = f"{ends[0]} > {ends[1]}"
        for piece in pieces:
            if piece.note:
                yield f"{way} {piece.note}"
                continue
            reason = piece.malformed
            if reason:
                text = flow.broken(piece.data, reason, from_controller)
            else:
                when_ns = time_ns if piece.time_ns is None else piece.time_ns
                text, reason = flow.take(piece.data, from_controller, when_ns)
            self.messages += 1
            if reason:
                self.malformed[reason] += 1
            yield f"{way} {text}"

    def _sent_by_controller(
        self, segment: Segment, ways: tuple[tuple[Endpoint, Endpoint], ...]
    ) -> bool | None:
        """None when the segment is to or from no controller."""
        from_port = segment.source.port in self._ports
        to_port = segment.destination.port in self._ports
        if from_port and to_port:  # the client's port happens to be one of ours
            if ways[0] in self._flows or ways[1] in self._flows:
                return ways[0] in self._flows
            return segment.flags & (TCP_SYN | TCP_ACK) != TCP_SYN
        return from_port if from_port or to_port else None

    def _datagram(
        self, frame: CapturedPacket, segment: Segment, ways: tuple[tuple[Endpoint, Endpoint], ...]
    ) -> Iterator[PacketLine]:
        ports = {segment.source.port, segment.destination.port}
        if SIMPLE_MESSAGE_RT_PORT not in ports or ports & self._egm_ports or segment.cut:
            return
        if not begins_message(segment.payload):
            return
        message = SimpleMessage(segment.payload)
        if isinstance(message, SimpleMessageBroken):
            from_controller = segment.destination.port == SIMPLE_MESSAGE_RT_PORT
        else:
            from_controller = isinstance(message, RtJointState)
        key = ways[0] if from_controller else ways[1]
        flow = self._flows.setdefault(key, _Flow(*key))
        flow.waiting_frames = None
        flow.byte_order = byte_order(segment.payload)
        (flow.from_controller if from_controller else flow.from_client).datagrams += 1
        self.frames += 1
        # Firmware sends its whole buffer; what follows the message means nothing.
        size = PREFIX_BYTES + struct.unpack_from(f"{flow.byte_order}i", segment.payload)[0]
        pieces = [_Piece(segment.payload[:size])]
        for text in self._lines(flow, from_controller, pieces, frame.time_ns):
            yield frame, text

    def summary(self) -> Iterable[str]:
        for flow in self._flows.values():
            if flow.waiting_frames is None:
                yield from flow.summary()
