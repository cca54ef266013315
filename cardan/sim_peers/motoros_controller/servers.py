"""The three servers of the simulated controller: connections, framing, replies, states.

Sans-I/O: input is bytes with their time, output is pieces to write; a shell has the sockets.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from cardan.protocols.simple_message.codec import wire
from cardan.protocols.simple_message.codes import (
    CommType,
    InvalidSubcode,
    MessageType,
    MotionResult,
)
from cardan.protocols.simple_message.framing import (
    LONGEST_PREFIX_OF_MOTOROS,
    ByteOrder,
    FrameReader,
)
from cardan.protocols.simple_message.messages import (
    MAX_GROUPS,
    ZEROS,
    JointFeedback,
    JointFeedbackEx,
    MalformedMessage,
    Message,
    MotionReply,
    Raw,
    reply,
    topic,
)
from cardan.sim_peers.base import TimedActions
from cardan.sim_peers.motoros_controller.controller import MotorosController
from cardan.sim_peers.motoros_controller.faults import FAULT_ALARM, STATE_PAUSE_EVERY_S
from cardan.sim_peers.motoros_controller.io_image import (
    BIT_AND_GROUP_TYPES,
    REGISTER_TYPES,
    IoImage,
)
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.tcp_servers import ServerConnection, TcpServers, TimedAction

PortKind = Literal["motion", "state", "io"]
PORT_KINDS: tuple[PortKind, ...] = ("motion", "state", "io")
"""In the order of their port numbers."""
CONNECTIONS: Mapping[PortKind, int] = {"motion": 1, "state": 4, "io": 1}
"""Number of simultaneous clients of each port."""

FIN_WAIT_S = 0.05
"""Time that a server waits before it frees the place of a client that has left."""
RECEIVE_BYTES = 552
"""MotoROS's receive buffer, which limits the length of a message."""
WAITING_MESSAGES = 64
"""Number of unhandled messages at which reading stops; TCP then slows the client down."""
_MESSAGES_A_TURN = 32

_PREFIX_BYTES, _TOP_BYTES, _EX_BYTES, _POINT_BYTES = 4, 16, 24, 132

_T = MessageType
_VELOCITY_TYPES = frozenset((_T.MOTO_JOINT_VELOCITY, _T.MOTO_JOINT_VELOCITY_EX))
_VELOCITY_MODE_TYPES = _VELOCITY_TYPES | {_T.MOTO_VELOCITY_INFO}
_EX_TYPES = frozenset((_T.MOTO_JOINT_TRAJ_PT_FULL_EX, _T.MOTO_JOINT_VELOCITY_EX))
_SEQUENCE_AT: Mapping[int, int] = {
    _T.MOTO_MOTION_CTRL: 20,
    _T.JOINT_TRAJ_PT_FULL: 20,
    _T.MOTO_JOINT_TRAJ_PT_FULL_EX: 20,
    _T.MOTO_SELECT_TOOL: 24,
    _T.MOTO_JOINT_VELOCITY: 20,
    _T.MOTO_JOINT_VELOCITY_EX: 20,
}
"""Offset of the sequence in messages whose reply repeats it."""
_COMMAND_AT = 24

_NOT_SERVED = frozenset(
    (_T.ROBOT_STATUS, _T.JOINT_FEEDBACK, _T.MOTO_MOTION_REPLY, _T.MOTO_JOINT_FEEDBACK_EX)
)
"""Messages of known length on which the motion server closes the connection."""
_MOTION_TYPES = (
    BIT_AND_GROUP_TYPES
    | _NOT_SERVED
    | {
        _T.PING,
        _T.JOINT_TRAJ_PT_FULL,
        _T.MOTO_MOTION_CTRL,
        _T.MOTO_JOINT_TRAJ_PT_FULL_EX,
        _T.MOTO_SELECT_TOOL,
        _T.MOTO_GET_DH_PARAMETERS,
    }
)


@dataclass
class ServerCounters:
    """Counters of the servers since the start."""

    accepted: int = 0
    refused: int = 0
    """Connections closed at once, because the arm was moving."""
    replaced: int = 0
    """Connections that a newer one replaced."""
    failed: int = 0
    """Connections closed because their data could not be split into messages."""
    messages: int = 0
    malformed: int = 0
    """Messages of a wrong length, answered MSGSIZE."""
    pipelined: int = 0
    """Requests that arrived before the previous reply; MotoROS may lose them."""
    pieces: int = 0
    """Reads that ended inside a message; MotoROS loses it."""
    unread: int = 0
    """Reads on the state port, which MotoROS never examines."""
    replies: int = 0
    dropped_replies: int = 0
    state_cycles: int = 0


@dataclass(eq=False, kw_only=True)
class _Connection(ServerConnection[PortKind]):
    reader: FrameReader
    frames: deque[bytes] = field(default_factory=deque)
    """Messages that wait to be handled."""
    owed: int = 0
    """Number of unanswered requests."""
    last_reply: bytes = b""
    logged: set[str] = field(default_factory=set)
    """Events already logged about this client."""
    finished: bool = False
    """Its FIN has come; data before it is still handled."""
    gone_s: float = math.inf
    """When its place is given up."""


class MotorosServers(TcpServers[PortKind, _Connection]):
    """The servers of a `MotorosController`."""

    kinds = PORT_KINDS
    never_read = frozenset({"state"})

    def __init__(self, controller: MotorosController, options: MotorosControllerOptions) -> None:
        super().__init__(controller.events, options.faults, options.seed)
        self.controller = controller
        self.options = options
        self.state_period_s = options.state_period_s
        self.counters = ServerCounters()
        self.io = IoImage(controller.signals)
        order = ByteOrder.BIG if options.big_endian else ByteOrder.LITTLE
        self._order = order
        self._wire = wire(order)
        self._top = struct.Struct(f"{order.value}4i")
        self._word = struct.Struct(f"{order.value}i")
        known: dict[PortKind, frozenset[MessageType]] = {
            "motion": _MOTION_TYPES | (_VELOCITY_MODE_TYPES if options.velocity_mode else set()),
            "io": BIT_AND_GROUP_TYPES | REGISTER_TYPES,
        }
        self._lengths: dict[PortKind, dict[int, int]] = {
            kind: {each: self._wire.request_bytes(each) for each in types}
            for kind, types in known.items()
        }
        self._slots: dict[PortKind, list[_Connection | None]] = {
            kind: [None] * count for kind, count in CONNECTIONS.items()
        }
        self._busy = False

    def behave(self, faults: Mapping[str, float]) -> None:
        super().behave(faults)
        self._drop_share = faults.get("drop-reply", 0.0)
        self._stale_share = faults.get("stale-reply", 0.0)
        self._pause_s = faults.get("state-pause", 0.0)
        self._merge = faults.get("merge", 0.0) > 0.0
        self._strict = faults.get("strict-recv", 0.0) > 0.0

    # -- called by the shell ----------------------------------------------------------------------

    def takes(self, connection: int) -> bool:
        if not super().takes(connection):
            return False
        found = self._connections[connection]
        return not found.finished and len(found.frames) < WAITING_MESSAGES

    def eof(self, connection: int, now_s: float) -> None:
        self._go(now_s)
        found = self._connections.get(connection)
        if found is not None and not self._silent:
            found.finished = True
            self._handle()

    def advance(self, now_s: float) -> None:
        super().advance(now_s)
        self._handle()

    # -- time -------------------------------------------------------------------------------------

    def _due(self) -> Iterator[float]:
        yield self.controller.next_s
        if self._busy:
            yield self._now_s
        if not self._silent:
            if any(self._slots["state"]):
                yield self._next_state_s
            yield from (each.gone_s for each in self._connections.values())

    def _go(self, now_s: float) -> None:
        super()._go(now_s)
        for each in tuple(self._connections.values()):
            if now_s >= each.gone_s:
                self._drop(each, "its client has gone")

    def _live(self) -> None:
        now_s = self._now_s
        for due_s, action in self._timed.due(now_s):
            self._now_s = due_s
            self.controller.advance(due_s)
            action()
        self._now_s = now_s
        self.controller.advance(now_s)
        if self._state_due():
            self._publish()

    def _plan(self) -> TimedActions[TimedAction]:
        controller, faults = self.controller, self.options.faults
        actions: dict[str, TimedAction] = {
            **self._network_actions(),
            "estop": lambda: controller.emergency_stop(self._now_s),
            "alarm": lambda: controller.alarm(FAULT_ALARM, self._now_s),
            "teach": lambda: controller.mode("teach", self._now_s),
            "hold": lambda: controller.hold(True, self._now_s),
            "servo-off": lambda: controller.servo(False, self._now_s),
            "pfl": lambda: controller.collaborative_stop(self._now_s),
        }
        others: list[tuple[float, TimedAction]] = []
        if "fsu" in faults:
            others.append((0.0, lambda: controller.speed_limit(faults["fsu"], self._now_s)))
        return TimedActions(faults, actions, *others, start_s=self._now_s)

    # -- connections ------------------------------------------------------------------------------

    def _refuses(self, kind: PortKind) -> str:
        slots, controller = self._slots[kind], self.controller
        full = None not in slots
        if (full and controller.moving_data) or (kind == "motion" and controller.velocity_moves):
            self.counters.refused += 1
            return "the arm moves"
        if full:
            oldest = slots[0]
            assert oldest is not None
            self.counters.replaced += 1
            self._drop(oldest, "another client takes its place")
        return ""

    def _met(self, kind: PortKind, number: int) -> _Connection:
        reader = FrameReader(self._order, LONGEST_PREFIX_OF_MOTOROS)
        connection = _Connection(number, kind, reader=reader)
        slots = self._slots[kind]
        slots[slots.index(None)] = connection
        self.counters.accepted += 1
        return connection

    def _greet(self, connection: _Connection) -> None:
        controller = self.controller
        controller.connections.add(connection.kind)
        if connection.kind == "motion":
            controller.replies.clear()
            controller.connected(self._now_s)

    def _received(self, connection: _Connection, data: bytes) -> None:
        if connection.finished:
            return
        if connection.kind == "state":
            self.counters.unread += 1
            self._note_once(connection, "unread", "sent to the state port, which is never read")
            return
        if self._strict:
            for at in range(0, len(data), RECEIVE_BYTES):
                self._take_strictly(connection, data[at : at + RECEIVE_BYTES])
        else:
            reader = connection.reader
            reader.feed(data)
            while (frame := reader.take()) is not None:
                self._take(connection, frame)
            if reader.pending_bytes:
                self.counters.pieces += 1
                self._note_once(
                    connection, "pieces", "a message came in pieces; MotoROS would lose it"
                )
        self._handle()

    def _parted(self, connection: _Connection) -> None:
        kind, controller = connection.kind, self.controller
        slots = self._slots[kind]
        slots[slots.index(connection)] = None
        if not any(slots):
            controller.connections.discard(kind)
        if kind == "motion":
            controller.replies.clear()
            controller.close_requested = False
            if connection.gone_s == math.inf:
                controller.disconnected(self._now_s)

    def _end(self, connection: _Connection) -> None:
        """End the connection here if all its received data are handled."""
        if connection.reader.failure:
            self.counters.failed += 1
            self._drop(connection, connection.reader.failure)
        elif connection.finished and connection.gone_s == math.inf:
            if connection.kind == "state":
                self._drop(connection, "its client has gone")
                return
            connection.gone_s = self._now_s + FIN_WAIT_S
            if connection.kind == "motion":
                self.controller.disconnected(self._now_s)

    def _note_once(self, connection: _Connection, key: str, text: str) -> None:
        if key not in connection.logged:
            connection.logged.add(key)
            self._note(f"{connection.kind}: connection {connection.number}: {text}")

    # -- received messages ------------------------------------------------------------------------

    def _take(self, connection: _Connection, frame: bytes) -> None:
        self.counters.messages += 1
        _, msg_type, comm_type, _ = self._header(frame)
        if self._answers(connection.kind, msg_type, comm_type):
            if connection.owed:
                self.counters.pipelined += 1
                self._note_once(
                    connection,
                    "pipelined",
                    "a request came before the reply to the one before; MotoROS may lose it",
                )
            connection.owed += 1
        connection.frames.append(frame)

    def _take_strictly(self, connection: _Connection, chunk: bytes) -> None:
        """Handle the data of one recv as MotoROS does: by the type's length, not the prefix."""
        while True:
            needed = self._needed(connection.kind, chunk)
            if needed is None or len(chunk) <= needed:
                if needed is not None and len(chunk) < needed:
                    self.counters.pieces += 1
                    self._note_once(connection, "pieces", "a part of a message is dropped")
                    self._take(connection, chunk)
                else:
                    self._take(connection, self._prefixed(chunk))
                return
            self._take(connection, self._prefixed(chunk[:needed]))
            chunk = chunk[needed:]
            rest = self._needed(connection.kind, chunk)
            if len(chunk) < _TOP_BYTES or (rest is not None and len(chunk) < rest):
                self.counters.pieces += 1
                self._note_once(
                    connection, "corruption", "a message and a part: MotoROS's memory is hit"
                )
                return

    def _needed(self, kind: PortKind, chunk: bytes) -> int | None:
        """Return the required length of the message at the start of `chunk`; None: unknown type."""
        if len(chunk) < _TOP_BYTES:
            return _TOP_BYTES
        msg_type = self._header(chunk)[1]
        needed = self._lengths[kind].get(msg_type)
        if msg_type in _EX_TYPES and needed is not None:
            groups = MAX_GROUPS
            if len(chunk) >= _TOP_BYTES + _PREFIX_BYTES:
                groups = self._word.unpack_from(chunk, _TOP_BYTES)[0]
            if not 0 <= groups <= MAX_GROUPS:
                return len(chunk)
            needed += groups * _POINT_BYTES
            if len(chunk) == _EX_BYTES + MAX_GROUPS * _POINT_BYTES:
                return len(chunk)
        return needed

    def _prefixed(self, frame: bytes) -> bytes:
        return self._word.pack(len(frame) - _PREFIX_BYTES) + frame[_PREFIX_BYTES:]

    def _header(self, frame: bytes) -> tuple[int, int, int, int]:
        """Return length after the prefix, type, communication type and reply code; 0 if cut off."""
        found: tuple[int, int, int, int] = self._top.unpack_from(frame.ljust(_TOP_BYTES, b"\0"))
        return found

    def _answers(self, kind: PortKind, msg_type: int, comm_type: int) -> bool:
        if kind == "io":
            return True
        if msg_type in _VELOCITY_TYPES and self.options.velocity_mode:
            return comm_type not in (CommType.TOPIC, CommType.SERVICE_REPLY)
        return comm_type != CommType.SERVICE_REPLY

    # -- messages are handled ---------------------------------------------------------------------

    def _handle(self) -> None:
        """Handle as many waiting messages as a turn allows, one at a time."""
        self._busy = False
        if self._silent:
            self.controller.replies.clear()
            return
        controller = self.controller
        found = self._slots["motion"][0]
        self._collect(found)
        if found is not None:
            for _ in range(_MESSAGES_A_TURN):
                if controller.blocked or not found.frames:
                    break
                self._motion(found, found.frames.popleft())
                self._collect(found)
                if controller.close_requested:
                    self._drop(found, "the controller ends it")
                    break
            else:
                self._busy = bool(found.frames)
            if not (found.frames or controller.blocked or found.number not in self._connections):
                self._end(found)
        found = self._slots["io"][0]
        if found is not None:
            for _ in range(min(_MESSAGES_A_TURN, len(found.frames))):
                self._io(found, found.frames.popleft())
            if found.frames:
                self._busy = True
            else:
                self._end(found)
        for each in self._slots["state"]:
            if each is not None:
                self._end(each)

    def _collect(self, connection: _Connection | None) -> None:
        """Send the controller's replies."""
        replies = self.controller.replies
        if connection is not None:
            for message in replies:
                self._reply(connection, message)
        replies.clear()

    def _motion(self, connection: _Connection, frame: bytes) -> None:
        _, msg_type, comm_type, reply_code = self._header(frame)
        velocity_mode = self.options.velocity_mode
        message = self._wire.decode(self._trimmed(frame, msg_type))
        known = self._lengths["motion"]
        unknown = msg_type not in known
        if isinstance(message, MalformedMessage):
            self.counters.malformed += 1
            self._note_once(connection, f"malformed {msg_type}", message.reason)
            if len(frame) < _TOP_BYTES or not (unknown or msg_type in _NOT_SERVED):
                refusal = self._invalid(frame, InvalidSubcode.MSGSIZE)
                self.controller.remember(refusal)
                if self._answers("motion", msg_type, comm_type):
                    self._reply(connection, refusal)
                return
            message = Message(msg_type, comm_type, reply_code, Raw(frame[_TOP_BYTES:]))
        if msg_type in BIT_AND_GROUP_TYPES:
            answer = self.io.answer(message)
        elif msg_type in REGISTER_TYPES or (msg_type in _VELOCITY_MODE_TYPES and not velocity_mode):
            answer = self._invalid(frame, InvalidSubcode.MSGTYPE)
        else:
            self.controller.motion(message, self._now_s)
            return
        if answer is None:
            return
        self.controller.remember(answer)
        if comm_type != CommType.SERVICE_REPLY:
            self._reply(connection, answer)

    def _trimmed(self, frame: bytes, msg_type: int) -> bytes:
        """Cut a frame of several groups' points, which may have room for all groups, to its own."""
        if (
            msg_type == _T.MOTO_JOINT_TRAJ_PT_FULL_EX
            and len(frame) == _EX_BYTES + MAX_GROUPS * _POINT_BYTES
        ):
            groups = self._word.unpack_from(frame, _TOP_BYTES)[0]
            if 0 <= groups < MAX_GROUPS:
                return self._prefixed(frame[: _EX_BYTES + groups * _POINT_BYTES])
        return frame

    def _invalid(self, frame: bytes, subcode: InvalidSubcode) -> Message:
        """Reply INVALID, with the sequence and command of the message if it has them."""
        msg_type = self._header(frame)[1]
        at = _SEQUENCE_AT.get(msg_type)
        body = MotionReply(-1, -1, msg_type, MotionResult.INVALID, subcode)
        if at is not None and subcode == InvalidSubcode.MSGSIZE:
            # Missing bytes are zero in the buffer, and so is the group of such a reply.
            buffer = frame.ljust(_COMMAND_AT + _PREFIX_BYTES, b"\0")
            body = body._replace(group=0, sequence=self._word.unpack_from(buffer, at)[0])
            if msg_type == _T.MOTO_MOTION_CTRL:
                body = body._replace(command=self._word.unpack_from(buffer, _COMMAND_AT)[0])
        return reply(body)

    def _io(self, connection: _Connection, frame: bytes) -> None:
        """Answer a message of this port, whatever its communication type."""
        message = self._wire.decode(frame)
        msg_type = self._header(frame)[1]
        served = msg_type in self._lengths["io"]
        answer = None
        if isinstance(message, MalformedMessage):
            self.counters.malformed += 1
            self._note_once(connection, f"malformed {msg_type}", message.reason)
        else:
            answer = self.io.answer(message)
        if answer is None:
            wrong_size = served or len(frame) < _TOP_BYTES
            subcode = InvalidSubcode.MSGSIZE if wrong_size else InvalidSubcode.MSGTYPE
            # MotoROS sends its I/O refusals as motion replies, in the first two words.
            answer = reply(MotionReply(MotionResult.INVALID, subcode, 0, 0, 0))
        self._reply(connection, answer)

    # -- messages go out --------------------------------------------------------------------------

    def _reply(self, connection: _Connection, message: Message) -> None:
        data = self._wire.encode(message)
        if self._happens(self._drop_share):
            self.counters.dropped_replies += 1
            connection.owed = max(0, connection.owed - 1)
            return
        before, connection.last_reply = connection.last_reply, data
        if before and self._happens(self._stale_share):
            data = before
        self._later(connection, data)

    def _send(self, connection: _Connection, data: bytes) -> None:
        connection.owed = max(0, connection.owed - 1)
        self.counters.replies += 1
        super()._send(connection, data)

    def _publish(self) -> None:
        """Send a state cycle to every client of the state port."""
        clients = [each for each in self._slots["state"] if each is not None]
        if not clients or self._silent or self._paused():
            return
        controller = self.controller
        self.counters.state_cycles += 1
        feedback = [controller.feedback(group) for group in range(controller.groups)]
        messages = [topic(each) for each in feedback]
        if len(feedback) > 1:
            nothing = JointFeedback(0, 0, 0.0, ZEROS, ZEROS, ZEROS)
            filled = (*feedback, *[nothing] * (MAX_GROUPS - len(feedback)))
            messages.append(topic(JointFeedbackEx(len(feedback), filled)))
        messages.append(topic(controller.status()))
        pieces = [self._wire.encode(message) for message in messages]
        if self._happens(self._garbage_share):
            pieces.insert(0, self._junk(pieces[0]))
        if self._merge:
            pieces = [b"".join(pieces)]
        for client in clients:
            for piece in pieces:
                self._put(client, piece)

    def _paused(self) -> bool:
        if not self._pause_s:
            return False
        elapsed_s = self._now_s - self._start_s
        return elapsed_s >= STATE_PAUSE_EVERY_S and elapsed_s % STATE_PAUSE_EVERY_S < self._pause_s

    def _junk(self, piece: bytes) -> bytes:
        kind = self._random.randrange(4)
        if kind == 0:
            return piece[: self._random.randrange(1, len(piece))]
        if kind == 1:
            return b"HTTP/1.1 400 Bad Request\r\n\r\n"
        if kind == 2:
            return self._word.pack(len(piece) - _PREFIX_BYTES) + self._random.randbytes(
                len(piece) - _PREFIX_BYTES
            )
        return self._random.randbytes(self._random.randrange(1, 400))
