"""Decoded messages of a MotoROS client, their pieces and answers, for the checks."""

from __future__ import annotations

import bisect
import math
import operator
from collections import deque
from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple, TypeVar

from cardan.conform.motoros_driver.scenario import port_of
from cardan.conform.streams import ChannelReaders
from cardan.conform.timeline import Kind, TimelinePhase, Traffic, WireEvent, WireTimeline
from cardan.protocols.simple_message import codec, codes, framing, messages as m
from cardan.protocols.simple_message.codes import MessageType as T, MotionCommand as C

B = TypeVar("B")

_END_NO_TRAJECTORY = frozenset((0, C.CHECK_MOTION_READY, C.CHECK_QUEUE_CNT))
"""Commands of MOTION_CTRL that end no trajectory, and 0 of other messages."""
VELOCITY_TYPES = frozenset((T.MOTO_JOINT_VELOCITY, T.MOTO_JOINT_VELOCITY_EX))


class Answered(NamedTuple):
    """Answer to a request: the next message back on its wire."""

    number: int
    time_s: float
    message: m.Message


class Said(NamedTuple):
    """A message of the client."""

    place: int
    """Index among all of them."""
    number: int
    """Number of the event that completed it."""
    time_s: float
    channel: str
    message: m.Message
    raw: bytes
    owed: int
    """Earlier requests on its connection without an answer yet."""
    answered: Answered | None = None

    @property
    def is_topic(self) -> bool:
        """True for a speed sent as a topic, which gets no answer."""
        topic = self.message.comm_type == codes.CommType.TOPIC
        return topic and self.message.msg_type in VELOCITY_TYPES

    @property
    def answer(self) -> m.Body | None:
        """Body of the answer."""
        return None if self.answered is None else self.answered.message.body

    @property
    def reply(self) -> m.MotionReply | None:
        """The answer, if it is a motion reply."""
        return self.answer if isinstance(self.answer, m.MotionReply) else None

    @property
    def command(self) -> int:
        """Command of a MOTION_CTRL; 0 for others."""
        body = self.message.body
        return body.command if isinstance(body, m.MotionCtrl) else 0

    @property
    def point(self) -> m.JointTrajPtFull | None:
        """Trajectory point; of several groups the first group's."""
        body = self.message.body
        if isinstance(body, m.JointTrajPtFullEx) and body.points:
            first = body.points[0]
            return m.JointTrajPtFull(first.group, body.sequence, *first[1:])
        return body if isinstance(body, m.JointTrajPtFull) else None

    @property
    def velocity(self) -> m.JointVelocity | None:
        """Speeds; of several groups the first group's."""
        body = self.message.body
        if isinstance(body, m.JointVelocityEx) and body.commands:
            first = body.commands[0]
            return m.JointVelocity(first.group, body.sequence, *first[1:])
        return body if isinstance(body, m.JointVelocity) else None


SaidPoint = tuple[Said, m.JointTrajPtFull]
SaidSpeeds = tuple[Said, m.JointVelocity]
Neighbors = tuple[Said, m.JointTrajPtFull, Said, m.JointTrajPtFull]
"""Two consecutive points of a trajectory, each after its message."""


class DriverConnection(NamedTuple):
    """A connection of the client."""

    channel: str
    number: int
    closed_s: float
    """Infinite if it was open at the end."""
    ended: int
    """Number of the event that closed it; -1: none."""
    by_us: bool

    @property
    def port(self) -> str:
        """ "motion", "state" or "io"."""
        return port_of(self.channel)


class DriverTraffic(Traffic):
    """The messages of a timeline in which we are the controller."""

    def __init__(self, timeline: WireTimeline) -> None:
        super().__init__(timeline)
        self.said: list[Said] = []
        self.disordered: list[tuple[int, str]] = []
        """Messages in the other byte order."""
        self.pieces: list[tuple[int, str]] = []
        """Reads that were not one message each."""
        self.strays: list[int] = []
        """Numbers of events with data to the state port."""
        self.links: list[DriverConnection] = []
        self.feedback: list[tuple[int, m.JointFeedback]] = []
        """Reported feedback of group 0, with the number of the event."""
        self.statuses: list[tuple[int, m.RobotStatus]] = []
        """Reported status, with the number of the event."""
        self._readers: dict[str, framing.FrameReader] = {}
        self._ours = ChannelReaders(lambda _: framing.FrameReader(), lambda *_: None)
        self._waiting: dict[str, deque[int]] = {}
        self._orders = [
            (number, order)
            for number, event in enumerate(timeline)
            if event.sent and event.kind is Kind.DATA and port_of(event.channel) == "state"
            for order in [framing.detect_byte_order(event.data[:4].ljust(4, b"\0"))]
            if order is not None and len(event.data) >= 16
        ]
        """The controller's byte order, as its states have it, each with the number of the event."""
        open_links: dict[str, DriverConnection] = {}
        for number, event in enumerate(timeline):
            channel = event.channel
            if channel == port_of(channel):
                continue
            if event.kind is Kind.OPENED:
                link = DriverConnection(channel, number, math.inf, -1, False)
                open_links[channel] = link
            elif event.kind is Kind.CLOSED and channel in open_links:
                link = open_links.pop(channel)
                by_us = event.sent
                self.links.append(link._replace(closed_s=event.time_s, ended=number, by_us=by_us))
            elif event.kind is Kind.DATA:
                if event.sent:
                    self._sent(number, event)
                else:
                    self._heard(number, event)
        self.links += open_links.values()
        self.links.sort(key=lambda each: each.number)

    def _heard(self, number: int, event: WireEvent) -> None:
        channel, data = event.channel, event.data
        if port_of(channel) == "state":
            self.strays.append(number)
            return
        first = self._orders[0][1] if self._orders else framing.ByteOrder.LITTLE
        order = newest(self._orders, number) or first
        reader = self._readers.get(channel)
        if reader is None:
            found = framing.detect_byte_order(data)
            if found is not None and found is not order:
                self.disordered.append((number, data[:8].hex(" ")))
            reader = self._readers[channel] = framing.FrameReader(found or order)
        order = reader.byte_order or order
        begun = bool(reader.pending_bytes)
        reader.feed(data)
        frames = []
        while (frame := reader.take()) is not None:
            frames.append(frame)
        pieces = begun or bool(reader.pending_bytes) or len(frames) > 1
        topics = True
        for frame in frames:
            message = codec.wire(order).decode(frame)
            if isinstance(message, m.MalformedMessage):
                self.unread.append((number, message.reason))
                topics = False
                continue
            waiting = self._waiting.setdefault(channel, deque())
            index, owed = len(self.said), len(waiting)
            said = Said(index, number, event.time_s, channel, message, frame, owed)
            self.said.append(said)
            if not said.is_topic:
                topics = False
                if message.comm_type != codes.CommType.SERVICE_REPLY:
                    waiting.append(index)
        if pieces and not (topics and frames):
            self.pieces.append((number, f"{len(frames)} messages in a piece of {len(data)} bytes"))
        if reader.failure:
            self.unread.append((number, reader.failure))
            del self._readers[channel]

    def _sent(self, number: int, event: WireEvent) -> None:
        channel = event.channel
        for _, frame in self._ours.whole(number, event):
            order = self._ours.reader(channel).byte_order or framing.ByteOrder.LITTLE
            message = codec.wire(order).decode(frame)
            if isinstance(message, m.MalformedMessage):
                continue
            if port_of(channel) == "state":
                body = message.body
                if isinstance(body, m.JointFeedback) and body.group == 0:
                    self.feedback.append((number, body))
                elif isinstance(body, m.RobotStatus):
                    self.statuses.append((number, body))
                continue
            waiting = self._waiting.get(channel)
            if waiting:
                index = waiting.popleft()
                said = self.said[index]
                self.said[index] = said._replace(answered=Answered(number, event.time_s, message))

    # -- queries ----------------------------------------------------------------------------------

    def named(self, *names: str) -> list[TimelinePhase]:
        """Return the phases of these names, of each controller in turn."""
        return [phase for name, phase in self.phases.items() if name.partition(" ")[2] in names]

    def during(self, *names: str) -> list[Said]:
        """Return the client's messages in phases of these names."""
        return self.within(self.said, *(phase.name for phase in self.named(*names)))

    def after(self, phase: TimelinePhase, seconds: float) -> list[Said]:
        """Return the client's messages in a phase after its first `seconds`."""
        since_s = phase.start_s + seconds
        return [s for s in self.said if phase.first <= s.number < phase.end and s.time_s > since_s]

    @cached_property
    def motion(self) -> dict[str, list[Said]]:
        """Messages on each connection to the motion port."""
        found: dict[str, list[Said]] = {
            each.channel: [] for each in self.links if each.port == "motion"
        }
        for each in self.said:
            if each.channel in found:
                found[each.channel].append(each)
        return found

    @cached_property
    def points(self) -> list[SaidPoint]:
        """All points, including repeated ones."""
        return [(each, point) for each in self.said if (point := each.point) is not None]

    @cached_property
    def velocities(self) -> list[SaidSpeeds]:
        """All speeds."""
        return [(each, body) for each in self.said if (body := each.velocity) is not None]

    def neighbors(self) -> Iterator[Neighbors]:
        """Yield consecutive accepted points of one trajectory."""
        for messages in self.motion.values():
            before: SaidPoint | None = None
            for said in messages:
                point = said.point
                if point is None:
                    if said.command not in _END_NO_TRAJECTORY:
                        before = None
                    continue
                if said.reply is None or said.reply.result != 0:
                    continue
                if before is not None and point.sequence != 0:
                    yield (*before, said, point)
                before = said, point


def newest(found: list[tuple[int, B]], number: int) -> B | None:
    """Return the last item with a number below `number`."""
    place = bisect.bisect_left(found, number, key=operator.itemgetter(0))
    return found[place - 1][1] if place else None
