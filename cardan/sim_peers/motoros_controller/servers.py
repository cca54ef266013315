"""The three servers of the simulated controller: connections, framing, replies, states.

Sans-I/O: bytes come in with the time, pieces to write go out; a shell has the sockets.
"""

from __future__ import annotations

import math
import random
import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from cardan.protocols.simple_message import (
    LONGEST_PREFIX_OF_MOTOROS,
    MAX_GROUPS,
    ZEROS,
    ByteOrder,
    CommType,
    FrameReader,
    InvalidSubcode,
    JointFeedback,
    JointFeedbackEx,
    Malformed,
    Message,
    MessageType,
    MotionReply,
    MotionResult,
    Raw,
    reply,
    topic,
    wire,
)
from cardan.sim_peers.base import TimedActs
from cardan.sim_peers.motoros_controller.controller import MotorosController
from cardan.sim_peers.motoros_controller.io_image import (
    BIT_AND_GROUP_TYPES,
    REGISTER_TYPES,
    IoImage,
)
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.server_faults import FAULT_ALARM, STATE_PAUSE_EVERY_S

PortKind = Literal["motion", "state", "io"]
PORT_KINDS: tuple[PortKind, ...] = ("motion", "state", "io")
"""In the order of their port numbers."""
CONNECTIONS: Mapping[PortKind, int] = {"motion": 1, "state": 4, "io": 1}
"""How many each port serves at once."""

FIN_WAIT_S = 0.05
"""A server waits this long before it gives up the place of a client that has gone."""
RECEIVE_BYTES = 552
"""MotoROS's receive buffer: the longest message it can take."""
WAITING_MESSAGES = 64
"""Unhandled messages at which nothing more is read; TCP then slows the client down."""
_MESSAGES_A_TURN = 32
_SPLIT_S = 0.001
"""Delay of the second piece of a message that is written in two."""
_KEPT_EVENTS = 10_000

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
"""Where messages that are answered with their own sequence have it."""
_COMMAND_AT = 24

_IO_BYTES: Mapping[int, int] = {
    _T.MOTO_READ_IO_BIT: 20,
    _T.MOTO_WRITE_IO_BIT: 24,
    _T.MOTO_READ_IO_GROUP: 20,
    _T.MOTO_WRITE_IO_GROUP: 24,
}
_REGISTER_BYTES: Mapping[int, int] = {_T.MOTO_READ_MREGISTER: 20, _T.MOTO_WRITE_MREGISTER: 24}
_MOTION_BYTES: Mapping[int, int] = {
    _T.PING: 16,
    _T.ROBOT_STATUS: 44,
    _T.JOINT_TRAJ_PT_FULL: 152,
    _T.JOINT_FEEDBACK: 148,
    _T.MOTO_MOTION_CTRL: 68,
    _T.MOTO_MOTION_REPLY: 76,
    _T.MOTO_JOINT_TRAJ_PT_FULL_EX: 24,
    _T.MOTO_JOINT_FEEDBACK_EX: 548,
    _T.MOTO_SELECT_TOOL: 28,
    _T.MOTO_GET_DH_PARAMETERS: 16,
    **_IO_BYTES,
}
_VELOCITY_BYTES: Mapping[int, int] = {
    _T.MOTO_JOINT_VELOCITY: 152,
    _T.MOTO_JOINT_VELOCITY_EX: 24,
    _T.MOTO_VELOCITY_INFO: 20,
}
_NOT_SERVED = frozenset(
    (_T.ROBOT_STATUS, _T.JOINT_FEEDBACK, _T.MOTO_MOTION_REPLY, _T.MOTO_JOINT_FEEDBACK_EX)
)
"""The motion server knows their lengths, and closes the connection on them."""


@dataclass
class ServerCounters:
    """Counters of the servers since the start."""

    accepted: int = 0
    refused: int = 0
    """Connections closed at once, because the arm was moving."""
    replaced: int = 0
    """Connections that had to make place for a newer one."""
    failed: int = 0
    """Connections closed because what came could not be cut into messages."""
    messages: int = 0
    malformed: int = 0
    """Messages of a wrong length, answered MSGSIZE."""
    pipelined: int = 0
    """Requests that came before the reply to the one before; MotoROS may lose them."""
    pieces: int = 0
    """Reads that ended inside a message; MotoROS loses it."""
    unread: int = 0
    """Reads on the state port, which MotoROS never looks at."""
    replies: int = 0
    dropped_replies: int = 0
    state_cycles: int = 0


@dataclass
class _Connection:
    number: int
    kind: PortKind
    reader: FrameReader
    frames: deque[bytes] = field(default_factory=deque)
    """Messages that wait to be handled."""
    owed: int = 0
    """Requests that came and are not answered yet."""
    late: deque[tuple[float, bytes]] = field(default_factory=deque)
    out: deque[bytes] = field(default_factory=deque)
    last_reply: bytes = b""
    told: set[str] = field(default_factory=set)
    """What was already noted about this client."""
    finished: bool = False
    """Its FIN has come; what it sent before is still handled."""
    gone_s: float = math.inf
    """When its place is given up."""


class MotorosServers:
    """The servers of a `MotorosController`; connections are small integers.

    The first time given is the start, from which the times of faults count.
    """

    def __init__(self, controller: MotorosController, options: MotorosControllerOptions) -> None:
        self.controller = controller
        self.options = options
        self.counters = ServerCounters()
        self.events: deque[tuple[float, str]] = deque(maxlen=_KEPT_EVENTS)
        """(time_s, what happened), the newest of them."""
        self.io = IoImage(controller.signals)
        order = ByteOrder.BIG if options.big_endian else ByteOrder.LITTLE
        self._order = order
        self._wire = wire(order)
        self._top = struct.Struct(f"{order.value}4i")
        self._word = struct.Struct(f"{order.value}i")
        self._lengths: dict[PortKind, Mapping[int, int]] = {
            "motion": {**_MOTION_BYTES, **(_VELOCITY_BYTES if options.velocity_mode else {})},
            "io": {**_IO_BYTES, **_REGISTER_BYTES},
        }
        self._slots: dict[PortKind, list[_Connection | None]] = {
            kind: [None] * count for kind, count in CONNECTIONS.items()
        }
        self._connections: dict[int, _Connection] = {}
        self._count = 0
        self._closing: list[int] = []
        self._aborting: list[int] = []
        self._last_words: list[tuple[int, bytes]] = []
        self._start_s: float | None = None
        self._now_s = 0.0
        self._next_state_s = math.inf
        self._busy = False
        self._silent = False
        self._random = random.Random(options.seed)
        self.behave(options.faults)
        self._timed: TimedActs[Callable[[float], None]] = TimedActs({}, {})

    def behave(self, faults: Mapping[str, float]) -> None:
        """Have these faults of SERVER_FAULTS from now on, and none of the others; what comes at a
        time is planned from the options only."""
        self._drop_share = faults.get("drop-reply", 0.0)
        self._stale_share = faults.get("stale-reply", 0.0)
        self._late_s = faults.get("late", 0.0) * 1e-3
        self._garbage_share = faults.get("garbage", 0.0)
        self._pause_s = faults.get("state-pause", 0.0)
        self._split = faults.get("split", 0.0) > 0.0
        self._merge = faults.get("merge", 0.0) > 0.0
        self._strict = faults.get("strict-recv", 0.0) > 0.0

    # -- what the shell calls ---------------------------------------------------------------------

    @property
    def silent(self) -> bool:
        """Nothing is accepted, read or written any more, as if the cable had been pulled."""
        return self._silent

    @property
    def next_s(self) -> float:
        """When `advance` should be called next."""
        if self._busy:
            return self._now_s
        times = [self.controller.next_s, self._timed.next_s]
        if not self._silent:
            if any(self._slots["state"]):
                times.append(self._next_state_s)
            for each in self._connections.values():
                times.append(each.gone_s)
                if each.late:
                    times.append(each.late[0][0])
                if each.out:
                    times.append(self._now_s + _SPLIT_S)
        return min(times)

    def takes(self, connection: int) -> bool:
        """Whether the server of this connection is ready to read."""
        found = self._connections.get(connection)
        return (
            found is not None
            and not self._silent
            and not found.finished
            and len(found.frames) < WAITING_MESSAGES
        )

    def accepted(self, kind: PortKind, now_s: float) -> int | None:
        """A client has come; the number of its connection, None to close it at once."""
        self._go(now_s)
        slots, controller = self._slots[kind], self.controller
        full = None not in slots
        if (full and controller.moving_data) or (kind == "motion" and controller.velocity_moves):
            self.counters.refused += 1
            self._note(now_s, f"{kind}: a client is refused, the arm moves")
            return None
        if full:
            oldest = slots[0]
            assert oldest is not None
            self.counters.replaced += 1
            self._drop(oldest, now_s, "another client takes its place")
        self._count += 1
        reader = FrameReader(self._order, LONGEST_PREFIX_OF_MOTOROS)
        connection = _Connection(self._count, kind, reader)
        slots[slots.index(None)] = connection
        self._connections[self._count] = connection
        self.counters.accepted += 1
        self._note(now_s, f"{kind}: connection {self._count}")
        controller.connections.add(kind)
        if kind == "motion":
            controller.replies.clear()
            controller.connected(now_s)
        return self._count

    def data(self, connection: int, data: bytes, now_s: float) -> None:
        """What one read of a connection brought. The state port must not be read: tell it what a
        peek shows."""
        self._go(now_s)
        found = self._connections.get(connection)
        if found is None or found.finished or self._silent:
            return
        if found.kind == "state":
            self.counters.unread += 1
            self._note_once(found, now_s, "unread", "sent to the state port, which is never read")
            return
        if self._strict:
            for at in range(0, len(data), RECEIVE_BYTES):
                self._take_strictly(found, data[at : at + RECEIVE_BYTES], now_s)
        else:
            reader = found.reader
            reader.feed(data)
            while (frame := reader.take()) is not None:
                self._take(found, frame, now_s)
            if reader.pending_bytes:
                self.counters.pieces += 1
                self._note_once(
                    found, now_s, "pieces", "a message came in pieces; MotoROS would lose it"
                )
        self._handle(now_s)

    def eof(self, connection: int, now_s: float) -> None:
        """A client has closed its end."""
        self._go(now_s)
        found = self._connections.get(connection)
        if found is not None and not self._silent:
            found.finished = True
            self._handle(now_s)

    def lost(self, connection: int, now_s: float, reason: str) -> None:
        """A connection failed in the shell, or its client does not read."""
        self._go(now_s)
        found = self._connections.get(connection)
        if found is not None:
            self._drop(found, now_s, reason)

    def advance(self, now_s: float) -> None:
        """Everything that is due by `now_s`: the robot, faults, states, late replies."""
        self._go(now_s)
        self._handle(now_s)

    def outgoing(self) -> list[tuple[int, bytes]]:
        """Pieces to write, each with one write, in this order; they are given once."""
        pieces, self._last_words = self._last_words, []
        for each in self._connections.values():
            out = each.out
            for _ in range(min(1, len(out)) if self._split else len(out)):
                pieces.append((each.number, out.popleft()))
        return [] if self._silent else pieces

    def closing(self) -> list[int]:
        """Connections to close, after `outgoing` was written; they are given once."""
        numbers, self._closing = self._closing, []
        return numbers

    def aborting(self) -> list[int]:
        """Connections to reset; they are given once."""
        numbers, self._aborting = self._aborting, []
        return numbers

    # -- time -------------------------------------------------------------------------------------

    def _go(self, now_s: float) -> None:
        if self._start_s is None:
            self._start_s = now_s
            self._next_state_s = now_s + self.options.state_period_s
            self._timed = self._plan(now_s)
        self._now_s = now_s
        for due_s, act in self._timed.due(now_s):
            self.controller.advance(due_s)
            act(due_s)
        self.controller.advance(now_s)
        if now_s >= self._next_state_s:
            period_s = self.options.state_period_s
            missed = math.floor((now_s - self._next_state_s) / period_s)
            self._next_state_s += (missed + 1) * period_s
            self._publish(now_s)
        for each in list(self._connections.values()):
            while each.late and each.late[0][0] <= now_s:
                self._write_reply(each, each.late.popleft()[1])
            if now_s >= each.gone_s:
                self._drop(each, now_s, "its client has gone")

    def _plan(self, start_s: float) -> TimedActs[Callable[[float], None]]:
        """The faults that come at a time, from the start on."""
        controller, faults = self.controller, self.options.faults
        acts: dict[str, Callable[[float], None]] = {
            "silent": self._fall_silent,
            "cut": self._cut,
            "reset": self._reset,
            "estop": controller.emergency_stop,
            "alarm": lambda now_s: controller.alarm(FAULT_ALARM, now_s),
            "teach": lambda now_s: controller.mode("teach", now_s),
            "hold": lambda now_s: controller.hold(True, now_s),
            "servo-off": lambda now_s: controller.servo(False, now_s),
            "pfl": controller.collaborative_stop,
        }
        others: list[tuple[float, Callable[[float], None]]] = []
        if "fsu" in faults:
            others.append((0.0, lambda now_s: controller.speed_limit(faults["fsu"], now_s)))
        return TimedActs(faults, acts, *others, start_s=start_s)

    def _fall_silent(self, now_s: float) -> None:
        self._note(now_s, "fault: silent from now on")
        self._silent = True

    def _cut(self, now_s: float) -> None:
        found = self._slots["motion"][0]
        if found is not None:
            self._drop(found, now_s, "fault: cut")

    def _reset(self, now_s: float) -> None:
        for each in list(self._connections.values()):
            self._drop(each, now_s, "fault: reset", self._aborting)

    # -- connections ------------------------------------------------------------------------------

    def _drop(
        self,
        connection: _Connection,
        now_s: float,
        reason: str,
        into: list[int] | None = None,
    ) -> None:
        kind, number = connection.kind, connection.number
        slots = self._slots[kind]
        slots[slots.index(connection)] = None
        del self._connections[number]
        self._last_words += [(number, piece) for piece in connection.out]
        (self._closing if into is None else into).append(number)
        self._note(now_s, f"{kind}: connection {number} is closed: {reason}")
        if not any(slots):
            self.controller.connections.discard(kind)
        if kind == "motion":
            self.controller.replies.clear()
            self.controller.close_requested = False
            if connection.gone_s == math.inf:
                self.controller.disconnected(now_s)

    def _end(self, connection: _Connection, now_s: float) -> None:
        """All that came is handled; does the connection end here?"""
        if connection.reader.failure:
            self.counters.failed += 1
            self._drop(connection, now_s, connection.reader.failure)
        elif connection.finished and connection.gone_s == math.inf:
            if connection.kind == "state":
                self._drop(connection, now_s, "its client has gone")
                return
            connection.gone_s = now_s + FIN_WAIT_S
            if connection.kind == "motion":
                self.controller.disconnected(now_s)

    def _note(self, now_s: float, text: str) -> None:
        self.events.append((now_s, text))

    def _note_once(self, connection: _Connection, now_s: float, key: str, text: str) -> None:
        if key not in connection.told:
            connection.told.add(key)
            self._note(now_s, f"{connection.kind}: connection {connection.number}: {text}")

    # -- messages come in -------------------------------------------------------------------------

    def _take(self, connection: _Connection, frame: bytes, now_s: float) -> None:
        self.counters.messages += 1
        _, msg_type, comm_type, _ = self._header(frame)
        if self._answers(connection.kind, msg_type, comm_type):
            if connection.owed:
                self.counters.pipelined += 1
                self._note_once(
                    connection,
                    now_s,
                    "pipelined",
                    "a request came before the reply to the one before; MotoROS may lose it",
                )
            connection.owed += 1
        connection.frames.append(frame)

    def _take_strictly(self, connection: _Connection, chunk: bytes, now_s: float) -> None:
        """One recv of MotoROS: the type tells the length, the prefix is not looked at."""
        while True:
            needed = self._needed(connection.kind, chunk)
            if needed is None or len(chunk) <= needed:
                if needed is not None and len(chunk) < needed:
                    self.counters.pieces += 1
                    self._note_once(connection, now_s, "pieces", "a part of a message is dropped")
                    self._take(connection, chunk, now_s)
                else:
                    self._take(connection, self._prefixed(chunk), now_s)
                return
            self._take(connection, self._prefixed(chunk[:needed]), now_s)
            chunk = chunk[needed:]
            rest = self._needed(connection.kind, chunk)
            if len(chunk) < _TOP_BYTES or (rest is not None and len(chunk) < rest):
                self.counters.pieces += 1
                self._note_once(
                    connection, now_s, "corruption", "a message and a part: MotoROS's memory is hit"
                )
                return

    def _needed(self, kind: PortKind, chunk: bytes) -> int | None:
        """How long the message at the start of `chunk` must be; None when its type is unknown."""
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
        """Length after the prefix, type, communication type, reply code; 0 where it is cut."""
        found: tuple[int, int, int, int] = self._top.unpack_from(frame.ljust(_TOP_BYTES, b"\0"))
        return found

    def _answers(self, kind: PortKind, msg_type: int, comm_type: int) -> bool:
        if kind == "io":
            return True
        if msg_type in _VELOCITY_TYPES and self.options.velocity_mode:
            return comm_type not in (CommType.TOPIC, CommType.SERVICE_REPLY)
        return comm_type != CommType.SERVICE_REPLY

    # -- messages are handled ---------------------------------------------------------------------

    def _handle(self, now_s: float) -> None:
        """As many waiting messages as a turn allows, one at a time."""
        self._busy = False
        if self._silent:
            self.controller.replies.clear()
            return
        controller = self.controller
        found = self._slots["motion"][0]
        self._collect(found, now_s)
        if found is not None:
            for _ in range(_MESSAGES_A_TURN):
                if controller.blocked or not found.frames:
                    break
                self._motion(found, found.frames.popleft(), now_s)
                self._collect(found, now_s)
                if controller.close_requested:
                    self._drop(found, now_s, "the controller ends it")
                    break
            else:
                self._busy = bool(found.frames)
            if not (found.frames or controller.blocked or found.number not in self._connections):
                self._end(found, now_s)
        found = self._slots["io"][0]
        if found is not None:
            for _ in range(min(_MESSAGES_A_TURN, len(found.frames))):
                self._io(found, found.frames.popleft(), now_s)
            if found.frames:
                self._busy = True
            else:
                self._end(found, now_s)
        for each in self._slots["state"]:
            if each is not None:
                self._end(each, now_s)

    def _collect(self, connection: _Connection | None, now_s: float) -> None:
        """Send what the controller has answered."""
        replies = self.controller.replies
        if connection is not None:
            for message in replies:
                self._reply(connection, message, now_s)
        replies.clear()

    def _motion(self, connection: _Connection, frame: bytes, now_s: float) -> None:
        _, msg_type, comm_type, reply_code = self._header(frame)
        velocity_mode = self.options.velocity_mode
        message = self._wire.decode(self._trimmed(frame, msg_type))
        known = self._lengths["motion"]
        unknown = msg_type not in known
        if isinstance(message, Malformed):
            self.counters.malformed += 1
            self._note_once(connection, now_s, f"malformed {msg_type}", message.reason)
            if len(frame) < _TOP_BYTES or not (unknown or msg_type in _NOT_SERVED):
                refusal = self._invalid(frame, InvalidSubcode.MSGSIZE)
                self.controller.remember(refusal)
                if self._answers("motion", msg_type, comm_type):
                    self._reply(connection, refusal, now_s)
                return
            message = Message(msg_type, comm_type, reply_code, Raw(frame[_TOP_BYTES:]))
        if msg_type in BIT_AND_GROUP_TYPES:
            answer = self.io.answer(message)
        elif msg_type in REGISTER_TYPES or (msg_type in _VELOCITY_MODE_TYPES and not velocity_mode):
            answer = self._invalid(frame, InvalidSubcode.MSGTYPE)
        else:
            self.controller.motion(message, now_s)
            return
        if answer is None:
            return
        self.controller.remember(answer)
        if comm_type != CommType.SERVICE_REPLY:
            self._reply(connection, answer, now_s)

    def _trimmed(self, frame: bytes, msg_type: int) -> bytes:
        """A point for several groups may come with room for all of them."""
        if (
            msg_type == _T.MOTO_JOINT_TRAJ_PT_FULL_EX
            and len(frame) == _EX_BYTES + MAX_GROUPS * _POINT_BYTES
        ):
            groups = self._word.unpack_from(frame, _TOP_BYTES)[0]
            if 0 <= groups < MAX_GROUPS:
                return self._prefixed(frame[: _EX_BYTES + groups * _POINT_BYTES])
        return frame

    def _invalid(self, frame: bytes, subcode: InvalidSubcode) -> Message:
        """INVALID, with what the message is known by where it has that."""
        msg_type = self._header(frame)[1]
        at = _SEQUENCE_AT.get(msg_type)
        body = MotionReply(-1, -1, msg_type, MotionResult.INVALID, subcode)
        if at is not None and subcode == InvalidSubcode.MSGSIZE:
            # What did not come is zero in the buffer, and so is the group of such a reply.
            buffer = frame.ljust(_COMMAND_AT + _PREFIX_BYTES, b"\0")
            body = body._replace(group=0, sequence=self._word.unpack_from(buffer, at)[0])
            if msg_type == _T.MOTO_MOTION_CTRL:
                body = body._replace(command=self._word.unpack_from(buffer, _COMMAND_AT)[0])
        return reply(body)

    def _io(self, connection: _Connection, frame: bytes, now_s: float) -> None:
        """Every message of this port is answered, whatever its communication type."""
        message = self._wire.decode(frame)
        msg_type = self._header(frame)[1]
        served = msg_type in self._lengths["io"]
        answer = None
        if isinstance(message, Malformed):
            self.counters.malformed += 1
            self._note_once(connection, now_s, f"malformed {msg_type}", message.reason)
        else:
            answer = self.io.answer(message)
        if answer is None:
            wrong_size = served or len(frame) < _TOP_BYTES
            subcode = InvalidSubcode.MSGSIZE if wrong_size else InvalidSubcode.MSGTYPE
            # MotoROS sends its I/O refusals as motion replies, in the first two words.
            answer = reply(MotionReply(MotionResult.INVALID, subcode, 0, 0, 0))
        self._reply(connection, answer, now_s)

    # -- messages go out --------------------------------------------------------------------------

    def _reply(self, connection: _Connection, message: Message, now_s: float) -> None:
        data = self._wire.encode(message)
        if self._drop_share and self._random.random() < self._drop_share:
            self.counters.dropped_replies += 1
            connection.owed = max(0, connection.owed - 1)
            return
        before, connection.last_reply = connection.last_reply, data
        if self._stale_share and before and self._random.random() < self._stale_share:
            data = before
        if self._late_s:
            connection.late.append((now_s + self._late_s, data))
        else:
            self._write_reply(connection, data)

    def _write_reply(self, connection: _Connection, data: bytes) -> None:
        connection.owed = max(0, connection.owed - 1)
        self.counters.replies += 1
        self._write(connection, data)

    def _write(self, connection: _Connection, data: bytes) -> None:
        if self._split and len(data) > 1:
            cut = self._random.randrange(1, len(data))
            connection.out.append(data[:cut])
            connection.out.append(data[cut:])
        else:
            connection.out.append(data)

    def _publish(self, now_s: float) -> None:
        """One state cycle to every client of the state port."""
        clients = [each for each in self._slots["state"] if each is not None]
        if not clients or self._silent or self._paused(now_s):
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
        if self._garbage_share and self._random.random() < self._garbage_share:
            pieces.insert(0, self._junk(pieces[0]))
        if self._merge:
            pieces = [b"".join(pieces)]
        for client in clients:
            for piece in pieces:
                self._write(client, piece)

    def _paused(self, now_s: float) -> bool:
        if not self._pause_s:
            return False
        assert self._start_s is not None
        elapsed_s = now_s - self._start_s
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
