"""What judges of MotoROS look at: the messages of a timeline, and which reply answers what."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from cardan.conform.timeline import Event, Kind, Timeline, Traffic
from cardan.protocols import simple_message as sm


class Heard(NamedTuple):
    """A message of the controller."""

    number: int
    """Of the event that completed it."""
    begun_s: float
    time_s: float
    channel: str
    message: sm.Message
    raw: bytes


B = TypeVar("B")
Status = tuple[Heard, sm.RobotStatus]
"""What was told, and what told it."""


class Unread(NamedTuple):
    """Bytes of the controller that are no message."""

    number: int
    channel: str
    reason: str


class Exchange(NamedTuple):
    """A request of ours, and what came next on its wire."""

    number: int
    time_s: float
    channel: str
    request: sm.Message | None
    """None: what was sent on purpose is no message, or a piece of one."""
    raw: bytes
    reply: Heard | None

    @property
    def body(self) -> sm.Body | None:
        """Of the request."""
        return None if self.request is None else self.request.body

    @property
    def motion(self) -> sm.MotionReply | None:
        """The reply, where it is one of motion."""
        body = None if self.reply is None else self.reply.message.body
        return body if isinstance(body, sm.MotionReply) else None


class MotorosTraffic(Traffic):
    """The messages of a timeline."""

    def __init__(self, timeline: Timeline) -> None:
        super().__init__(timeline)
        self.heard: list[Heard] = []
        self.unread: list[Unread] = []
        self.asked: list[Exchange] = []
        self.ended: list[tuple[int, Event]] = []
        """Connections that the controller closed or refused."""
        self.order: sm.ByteOrder | None = None
        readers: dict[str, sm.FrameReader] = {}
        begun: dict[str, float] = {}
        open_requests: dict[str, tuple[int, Event]] = {}
        for index, event in enumerate(timeline):
            channel = event.channel
            if event.kind in (Kind.CLOSED, Kind.REFUSED) and not event.sent:
                self.ended.append((index, event))
            if event.kind is Kind.OPENED:
                readers.pop(channel, None)
            if event.kind is not Kind.DATA:
                continue
            if event.sent:
                self._unanswered(open_requests.pop(channel, None))
                open_requests[channel] = index, event
                continue
            reader = readers.setdefault(channel, sm.FrameReader())
            if not reader.pending_bytes:
                begun[channel] = event.time_s
            reader.feed(event.data)
            while (frame := reader.take()) is not None:
                self._take(index, event, begun[channel], reader, frame, open_requests)
                begun[channel] = event.time_s
            if reader.failure:
                self.unread.append(Unread(index, channel, reader.failure))
                del readers[channel]
        for left in open_requests.values():
            self._unanswered(left)
        self.asked.sort()

    def _take(
        self,
        index: int,
        event: Event,
        begun_s: float,
        reader: sm.FrameReader,
        frame: bytes,
        open_requests: dict[str, tuple[int, Event]],
    ) -> None:
        order = reader.byte_order or sm.ByteOrder.LITTLE
        self.order = self.order or order
        message = sm.wire(order).decode(frame)
        if isinstance(message, sm.MalformedMessage):
            self.unread.append(Unread(index, event.channel, message.reason))
            return
        heard = Heard(index, begun_s, event.time_s, event.channel, message, frame)
        self.heard.append(heard)
        asked = open_requests.pop(event.channel, None)
        if asked is not None:
            self._exchange(asked, heard)

    def _unanswered(self, asked: tuple[int, Event] | None) -> None:
        if asked is not None:
            self._exchange(asked, None)

    def _exchange(self, asked: tuple[int, Event], reply: Heard | None) -> None:
        number, sent = asked
        request = sm.wire(self.order or sm.ByteOrder.LITTLE).decode(sent.data)
        known = None if isinstance(request, sm.MalformedMessage) else request
        self.asked.append(Exchange(number, sent.time_s, sent.channel, known, sent.data, reply))

    def exchanges(self, phase: str) -> list[Exchange]:
        """What was asked in a phase."""
        return self.within(self.asked, phase)

    def requests(self, kind: type, phase: str = "", **fields: int) -> list[Exchange]:
        """What was asked with a body of a kind that has these fields, in a phase; empty: in any."""
        return [
            each
            for each in (self.exchanges(phase) if phase else self.asked)
            if isinstance(each.body, kind)
            and all(getattr(each.body, name) == value for name, value in fields.items())
        ]

    def _told(self, kind: type[B], phase: str) -> list[tuple[Heard, B]]:
        found = self.within(self.heard, phase) if phase else self.heard
        return [(e, e.message.body) for e in found if isinstance(e.message.body, kind)]

    def statuses(self, phase: str = "") -> list[Status]:
        """Those of a phase; empty: all."""
        return self._told(sm.RobotStatus, phase)

    def feedback(self, phase: str = "", group: int = 0) -> list[tuple[Heard, sm.JointFeedback]]:
        """That of a group in a phase; empty: all."""
        return [each for each in self._told(sm.JointFeedback, phase) if each[1].group == group]
