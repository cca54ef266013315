"""Simple message in a capture: TCP streams put together, a line per message, figures per flow."""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from cardan.dissect.capture import CapturedPacket, Direction
from cardan.dissect.network import Endpoint, Segment
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
from cardan.dissect.streams import Framer, Measured, Piece, StreamFlow, StreamReader

PENDING = 256
"""Requests remembered until they are answered."""
CYCLE_MESSAGES = 16
"""Most messages that count as one cycle of the state port."""
PORT_NAMES = {50240: "motion", 50241: "state", 50242: "I/O", 50243: "RT control", 50244: "RT"}


class _Framer(Framer):
    """Cuts by the prefix, whose byte order is the flow's."""

    def __init__(self, flow: _Flow) -> None:
        super().__init__(PREFIX_BYTES)
        self._flow = flow

    def begins(self, data: bytes) -> bool:
        return begins_message(data, self._flow.byte_order)

    def measure(self, data: bytearray) -> Measured:
        order = self._flow.byte_order or byte_order(data)
        prefix = struct.unpack_from(f"{order}i", data)[0]
        if not LEAST_PREFIX <= prefix <= MOST_PREFIX:
            return Measured(None, f"prefix outside {LEAST_PREFIX} to {MOST_PREFIX}")
        self._flow.byte_order = order
        reason = f"prefix above {LARGEST_PREFIX}, which no message has"
        return Measured(PREFIX_BYTES + prefix, reason if prefix > LARGEST_PREFIX else "")


class _Asked(NamedTuple):
    """A request that waits for its reply."""

    message: SimpleMessage
    time_ns: int
    what: str
    expected: bool


class _Flow(StreamFlow):
    """One port of a controller and one client."""

    title = "simple message"

    def __init__(self, controller: Endpoint, client: Endpoint) -> None:
        super().__init__(controller, client, lambda: _Framer(self))
        self.byte_order: str | None = None
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


class SimpleMessageReader(StreamReader[_Flow]):
    """TCP streams to and from the ports of a controller, and the datagrams of the NTNU fork."""

    def __init__(
        self,
        simple_message_ports: frozenset[int] = frozenset(
            (*SIMPLE_MESSAGE_PORTS, SIMPLE_MESSAGE_RT_CONTROL_PORT)
        ),
    ) -> None:
        super().__init__(simple_message_ports)

    def open(self, device: Endpoint, client: Endpoint) -> _Flow:
        return _Flow(device, client)

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        if isinstance(network, Segment) and network.protocol == "UDP":
            return self._datagram(packet, network)
        return super().feed(packet, network)

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
        piece = Piece(segment.payload[:size])
        yield packet, self.line(flow, direction, piece, packet.time_ns)
