"""Requests on the motion connection: one at a time, every reply checked."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

from cardan.common.histogram import LatencyHistogram
from cardan.protocols.simple_message.codes import (
    CommType,
    MessageType,
    MotionCommand,
    MotionResult,
    name_of,
)
from cardan.protocols.simple_message.messages import (
    ZEROS,
    Joints,
    JointTrajPtFull,
    JointVelocity,
    MalformedMessage,
    Message,
    MotionCtrl,
    MotionReply,
    VelocityInfo,
    VelocityInfoRequest,
    request,
)

MotorosRequest = MotionCtrl | JointTrajPtFull | JointVelocity | VelocityInfoRequest
Answer = MotionReply | VelocityInfo
Then = Callable[[Answer, float], None]
"""Called with the reply and the time of its reception."""

SEQUENCES = 1 << 31

SLOW = frozenset(
    {
        MotionCommand.START_SERVOS,
        MotionCommand.STOP_SERVOS,
        MotionCommand.RESET_ALARM,
        MotionCommand.START_TRAJ_MODE,
        MotionCommand.START_VEL_MODE,
    }
)
"""Commands that wait for the robot: they have the long timeout, and no effect on the latencies."""


class _Asked(NamedTuple):
    body: MotorosRequest
    command: int
    """Value that the reply must name: a MotionCommand or the type of the message."""
    sequence: int
    then: Then
    slow: bool


class MotionRequests:
    """Queue of requests, because MotoROS loses bytes of a request sent before the previous reply.

    A reply is trusted only if it names the command and the sequence number of its request: MotoROS
    answers an unknown command with the previous reply.
    """

    def __init__(self, group: int, timeout_s: float = 0.5, slow_timeout_s: float = 12.0) -> None:
        self.group = group
        self.latency = LatencyHistogram()
        """Latencies of replies, except those that wait for the robot."""
        self.results: Counter[int] = Counter()
        """Replies by MotionResult."""
        self._timeout_s, self._slow_timeout_s = timeout_s, slow_timeout_s
        self._waiting: deque[_Asked] = deque()
        self._asked: _Asked | None = None
        self.asked_s = -math.inf
        self._sequence = 0

    @property
    def idle(self) -> bool:
        """True when no request is pending or queued."""
        return self._asked is None and not self._waiting

    @property
    def deadline_s(self) -> float:
        """Time at which the awaited reply is overdue, s; infinite while none is awaited."""
        asked = self._asked
        if asked is None:
            return math.inf
        return self.asked_s + (self._slow_timeout_s if asked.slow else self._timeout_s)

    # -- requests ----------------------------------------------------------------------------------

    def ask(self, body: JointTrajPtFull | JointVelocity | VelocityInfoRequest, then: Then) -> None:
        """Queue a request; `then` is called with its reply."""
        if isinstance(body, VelocityInfoRequest):
            kind, sequence = MessageType.MOTO_VELOCITY_INFO, -1
        elif isinstance(body, JointVelocity):
            kind, sequence = MessageType.MOTO_JOINT_VELOCITY, body.sequence
        else:
            kind, sequence = MessageType.JOINT_TRAJ_PT_FULL, body.sequence
        self._waiting.append(_Asked(body, kind, sequence, then, False))

    def control(self, command: MotionCommand, then: Then, data: Joints = ZEROS) -> None:
        """Queue a MOTION_CTRL with its own sequence number."""
        self._sequence = (self._sequence + 1) % SEQUENCES
        body = MotionCtrl(self.group, self._sequence, command, data)
        self._waiting.append(_Asked(body, command, self._sequence, then, command in SLOW))

    def drop(self) -> None:
        """Discard queued requests; an awaited reply will be checked and dropped."""
        self._waiting.clear()
        if self._asked is not None:
            self._asked = self._asked._replace(then=_ignore)

    def reset(self) -> None:
        """Restart for a new connection."""
        self._waiting.clear()
        self._asked = None

    def take(self, now_s: float) -> Message | None:
        """Return the request to send now; None while a reply is awaited or nothing is queued."""
        if self._asked is not None or not self._waiting:
            return None
        self._asked = asked = self._waiting.popleft()
        self.asked_s = now_s
        return request(asked.body)

    # -- replies ----------------------------------------------------------------------------------

    def received(self, message: Message | MalformedMessage, now_s: float) -> str:
        """Process received messages; return why this connection cannot be trusted any more, or
        ""."""
        asked = self._asked
        if isinstance(message, MalformedMessage):
            return f"a bad message: {message.reason}"
        if asked is None:
            return f"{name_of(MessageType, message.msg_type)} that was not asked for"
        body = message.body
        wrong = self._mismatch(asked, message)
        if wrong or not isinstance(body, (MotionReply, VelocityInfo)):
            return wrong
        self._asked = None
        if not asked.slow:
            self.latency.add(now_s - self.asked_s)
        if isinstance(body, MotionReply):
            self.results[body.result] += 1
        asked.then(body, now_s)
        return ""

    def _mismatch(self, asked: _Asked, message: Message) -> str:
        name = _name(asked.command)
        body = message.body
        if message.comm_type != CommType.SERVICE_REPLY:
            return f"the answer to {name} is not a reply: its comm_type is {message.comm_type}"
        if isinstance(body, VelocityInfo) and isinstance(asked.body, VelocityInfoRequest):
            return ""
        if not isinstance(body, MotionReply):
            return f"the answer to {name} is {name_of(MessageType, message.msg_type)}"
        # The controller sends "group -1, sequence -1" if it did not understand the request.
        not_understood = body.result == MotionResult.INVALID and body.sequence == -1
        own_type = body.command == request(asked.body).msg_type
        if not_understood and own_type:
            return ""
        if body.command != asked.command:
            return f"the answer to {name} is to {_name(body.command)}"
        if body.sequence != asked.sequence:
            return f"the answer to {name} {asked.sequence} has sequence number {body.sequence}"
        return ""

    def overdue(self, now_s: float) -> str:
        """Return a message about a request that was not answered in time; "" if there is none."""
        asked = self._asked
        if asked is None or now_s < self.deadline_s:
            return ""
        return f"no reply to {_name(asked.command)} for {now_s - self.asked_s:.1f} s"


def _ignore(answer: Answer, now_s: float) -> None:
    """Accept a reply that is no longer needed."""


def _name(command: int) -> str:
    known = command in set(MotionCommand)
    return name_of(MotionCommand if known else MessageType, command)
