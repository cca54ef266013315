"""Protocols whose messages follow each other on TCP."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from cardan.protocols.simple_message import codec, codes
from cardan.protocols.simple_message.codec import detect_wire
from cardan.protocols.simple_message.codes import (
    CommType,
    InvalidSubcode,
    MessageType,
    MotionCommand,
    MotionResult,
    NotReadySubcode,
    ReplyCode,
)
from cardan.protocols.simple_message.framing import (
    HEADER_BYTES,
    LONGEST_PREFIX,
    PREFIX_BYTES,
    SHORTEST_PREFIX,
    ByteOrder,
    detect_byte_order,
)
from cardan.protocols.simple_message.messages import (
    MAX_GROUPS,
    MalformedMessage,
    MotionCtrl,
    MotionReply,
)
from cardan.protocols.ur import rtde
from cardan_dissect.capture import CapturedPacket, Direction
from cardan_dissect.framing import Conversation, Measured, StreamDissector
from cardan_dissect.network import Endpoint, Segment
from cardan_dissect.ports import (
    RTDE_PORTS,
    SIMPLE_MESSAGE_PORTS,
    SIMPLE_MESSAGE_RT_CONTROL_PORT,
    SIMPLE_MESSAGE_RT_PORT,
)
from cardan_dissect.reader import Decoded, Found, Message, Numbers, message_in

LARGEST_PREFIX = HEADER_BYTES + 8 + MAX_GROUPS * (8 + 31 * 8)
"""Largest prefix of any known message: a point for every group, with reals of 8 bytes."""
MESSAGE_TYPES = frozenset(MessageType)
PENDING = 256
"""Most unanswered requests of RTDE that are remembered."""
LARGEST_TIME_S = 1e9
"""Upper bound of a controller's uptime, s."""
RTDE_KINDS = frozenset(rtde.PacketType)
LEAST_DATA = 4
"""Data packets of one size that identify an RTDE stream without its beginning."""
REPORTED = frozenset(
    each.name
    for each in (
        MessageType.JOINT_POSITION,
        MessageType.ROBOT_STATUS,
        MessageType.JOINT_FEEDBACK,
        MessageType.OLD_JOINT_FEEDBACK_EX,
        MessageType.MOTO_JOINT_FEEDBACK_EX,
    )
)
"""Unsolicited messages of a controller."""


class _SimpleMessages(Conversation):
    """Simple messages, split by the prefix in the flow's byte order."""

    head_bytes = PREFIX_BYTES

    def __init__(self) -> None:
        self.byte_order: ByteOrder | None = None

    def begins(self, data: bytes) -> bool:
        order = self.byte_order or detect_byte_order(data)
        if order is None:
            return False
        words = struct.unpack_from(f"{order.value}{min(4, len(data) // 4)}i", data)
        allowed = (
            range(SHORTEST_PREFIX, LARGEST_PREFIX + 1),
            range(1, 0x10000),
            range(len(CommType)),
            range(len(ReplyCode)),
        )
        return all(word in those for word, those in zip(words, allowed, strict=False))

    def measure(self, data: bytearray) -> Measured:
        order = self.byte_order or detect_byte_order(data)
        prefix = struct.unpack_from(f"{order.value}i", data)[0] if order else 0
        if not SHORTEST_PREFIX <= prefix <= LONGEST_PREFIX:
            return Measured(None, f"prefix outside {SHORTEST_PREFIX} to {LONGEST_PREFIX}")
        self.byte_order = order
        reason = f"prefix above {LARGEST_PREFIX}, which no message has"
        return Measured(PREFIX_BYTES + prefix, reason if prefix > LARGEST_PREFIX else "")

    def decode(self, data: bytes, direction: Direction) -> Decoded:
        wire = detect_wire(data)
        wire = wire or codec.wire(self.byte_order or ByteOrder.LITTLE)
        message = wire.decode_datagram(data)
        if isinstance(message, MalformedMessage):
            return Decoded(None, "simple message", message.reason)
        body, name_of = message.body, codes.name_of
        title = [name_of(MessageType, message.msg_type), name_of(CommType, message.comm_type)]
        if message.reply_code:
            title.append(name_of(ReplyCode, message.reply_code))
        if isinstance(body, MotionCtrl | MotionReply):
            points = body.command in MESSAGE_TYPES
            title.append(name_of(MessageType if points else MotionCommand, body.command))
        if isinstance(body, MotionReply):
            title.append(name_of(MotionResult, body.result))
            title.append(subcode_name(body.result, body.subcode))
        return Decoded(body, " ".join(title))


class SimpleMessage(StreamDissector):
    """ROS-Industrial's simple message (MotoROS), on TCP ports; the NTNU fork's on UDP."""

    name = "simple message"
    page = "protocols/simple-message.md"
    options = (
        Numbers(
            "simple_message_ports",
            "simple-message-port",
            "PORT",
            "Another TCP port of MotoROS",
            "TCP port",
            usual=frozenset((*SIMPLE_MESSAGE_PORTS, SIMPLE_MESSAGE_RT_CONTROL_PORT)),
        ),
    )
    conversation = _SimpleMessages

    def recognized(self, messages: Sequence[Message], end: Endpoint, other: Endpoint) -> str:
        for message in messages:
            kind, comm_type = message.decoded.title.split()[:2]
            answers = comm_type == CommType.SERVICE_REPLY.name
            tells = comm_type == CommType.TOPIC.name and kind in REPORTED
            from_device = message.where.startswith(f"{end} >")
            # A ping is answered by a ping.
            if from_device != (answers or tells) and kind != MessageType.PING.name:
                return ""
        return f"the controller at {end}"

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Found:
        if not isinstance(network, Segment) or network.protocol != "UDP":
            yield from super().feed(packet, network)
            return
        ports, messages = {network.source.port, network.destination.port}, _SimpleMessages()
        data = network.payload
        if SIMPLE_MESSAGE_RT_PORT not in ports or network.cut or len(data) < PREFIX_BYTES:
            return
        if messages.begins(data):
            self.packets += 1
            messages.byte_order = detect_byte_order(data)
            decoded = messages.decode(data, Direction.FROM_DEVICE)
            yield message_in(packet, network, decoded)


class _RtdePackets(Conversation):
    """RTDE packets, split by their size. Data packets are decoded by the agreed recipe."""

    head_bytes = 3

    def __init__(self) -> None:
        self._asked: dict[rtde.PacketType, list[tuple[str, ...]]] = {}
        self._recipes: dict[tuple[Direction, int], rtde.Recipe] = {}

    def restart(self) -> None:
        self._asked.clear()
        self._recipes.clear()

    def begins(self, data: bytes) -> bool:
        at = 0
        while len(data) - at >= self.head_bytes:
            size, kind = struct.unpack_from(">HB", data, at)
            if size < self.head_bytes or kind not in RTDE_KINDS:
                return False
            at += size
        return True

    def measure(self, data: bytearray) -> Measured:
        size = struct.unpack_from(">H", data)[0]
        return Measured(size) if size >= self.head_bytes else Measured(None, "a size below 3")

    def decode(self, data: bytes, direction: Direction) -> Decoded:
        from_device = direction is Direction.FROM_DEVICE
        read = rtde.read_reply if from_device else rtde.read_request
        value = read(data[2], data[self.head_bytes :])
        if isinstance(value, rtde.MalformedPayload):
            return Decoded(None, "RTDE", value.reason)
        title = f"RTDE {rtde.PacketType(data[2]).name}"
        if isinstance(value, rtde.Data):
            return self._data(value, direction, f"{title} recipe {value.recipe}")
        remarks: tuple[str, ...] = ()
        if isinstance(value, rtde.RecipeSetup):
            self._asked[value.kind] = [*self._asked.get(value.kind, ()), value.names][-PENDING:]
        elif isinstance(value, rtde.SetupReply):
            remarks = self._agreed(value)
        return Decoded(value, title, remarks=remarks)

    def _agreed(self, reply: rtde.SetupReply) -> tuple[str, ...]:
        asked = self._asked.get(reply.kind)
        if not asked:
            return ("ANSWERS NO REQUEST",)
        names = asked.pop(0)
        way = (
            Direction.FROM_DEVICE if reply.kind == rtde.PacketType.OUTPUTS else Direction.TO_DEVICE
        )
        if len(names) != len(reply.types):
            return (f"{len(reply.types)} TYPES FOR {len(names)} VARIABLES",)
        refused = _refused(names, reply.types)
        if not refused and reply.recipe:
            try:
                self._recipes[way, reply.recipe] = rtde.Recipe(reply.recipe, names, reply.types)
            except ValueError:
                return ("A RECIPE TOO LONG FOR A PACKET",)
        return tuple(f"REFUSED {each}" for each in refused)

    def _data(self, data: rtde.Data, direction: Direction, title: str) -> Decoded:
        recipe = self._recipes.get((direction, data.recipe))
        if recipe is None:
            return Decoded(data, title, remarks=("RECIPE NOT IN THE CAPTURE",))
        values = recipe.unpack(data.values)
        if values is None:
            return Decoded(None, "RTDE", "values that are not of their recipe's types")
        # The controller's clock shows the missing packages.
        time_s, sequence = values.get("timestamp"), None
        if isinstance(time_s, float) and abs(time_s) < LARGEST_TIME_S:
            sequence = round(1e3 * time_s) % 2**32
        return Decoded(values, title, sequence=sequence)


def _refused(names: Sequence[str], types: Sequence[str]) -> list[str]:
    """Return the variables that the controller gives no type."""
    return [f"{n} {t}" for n, t in zip(names, types, strict=True) if t not in rtde.TYPES]


class Rtde(StreamDissector):
    """Universal Robots' RTDE, on TCP ports."""

    name = "RTDE"
    page = "universal-robots.md"
    options = (
        Numbers(
            "rtde_ports",
            "rtde-port",
            "PORT",
            "Another TCP port of RTDE",
            "TCP port",
            usual=frozenset(RTDE_PORTS),
        ),
    )
    conversation = _RtdePackets

    def recognized(self, messages: Sequence[Message], end: Endpoint, other: Endpoint) -> str:
        data: list[tuple[str, int, int]] = []
        for message in messages:
            value = message.decoded.value
            if message.decoded.title.startswith("RTDE DATA"):
                data.append((message.where, message.data[3], len(message.data)))
            elif isinstance(value, rtde.RecipeSetup):
                if not all(name.isidentifier() for name in value.names):
                    return ""
            elif isinstance(value, rtde.SetupReply) and not value.types:
                return ""
        agreed = len(messages) > len(data)
        stream = (
            len(set(data)) == 1 and len(data) >= LEAST_DATA and data[0][0].startswith(f"{end} >")
        )
        return f"the robot at {end}" if agreed or stream else ""


def subcode_name(result: int, subcode: int) -> str:
    """Return the name of a reply's subcode, which depends on its result.

    CHECK_MOTION_READY answers FALSE with a NOT_READY subcode, so both tables count there.
    """
    not_ready = NotReadySubcode
    if result == MotionResult.INVALID or (
        result != MotionResult.NOT_READY and subcode < not_ready.UNSPECIFIED
    ):
        return codes.name_of(InvalidSubcode, subcode)
    return codes.name_of(not_ready, subcode)
