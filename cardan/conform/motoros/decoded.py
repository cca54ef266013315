"""Decoded MotoROS messages of a timeline, and requests with their replies, for the checks."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from cardan.conform.streams import ChannelReaders
from cardan.conform.timeline import Kind, Traffic, WireEvent, WireTimeline
from cardan.protocols.simple_message import codec, framing, messages as m


class ReceivedMessage(NamedTuple):
    """A message of the controller."""

    number: int
    """Number of the event that completed it."""
    begun_s: float
    time_s: float
    channel: str
    message: m.Message
    raw: bytes


B = TypeVar("B")


class MotorosExchange(NamedTuple):
    """A request of the suite, and the next message on its wire."""

    number: int
    time_s: float
    channel: str
    request: m.Message | None
    """None: the data were deliberately invalid, or a part of a message."""
    raw: bytes
    reply: ReceivedMessage | None

    @property
    def body(self) -> m.Body | None:
        """Body of the request."""
        return None if self.request is None else self.request.body

    @property
    def motion(self) -> m.MotionReply | None:
        """The reply, if it is a motion reply."""
        body = None if self.reply is None else self.reply.message.body
        return body if isinstance(body, m.MotionReply) else None


class MotorosTraffic(Traffic):
    """The messages of a timeline."""

    def __init__(self, timeline: WireTimeline) -> None:
        super().__init__(timeline)
        self.heard: list[ReceivedMessage] = []
        self.asked: list[MotorosExchange] = []
        self.order: framing.ByteOrder | None = None
        streams = ChannelReaders(lambda _: framing.FrameReader(), self._failed)
        open_requests: dict[str, tuple[int, WireEvent]] = {}
        for index, event in enumerate(timeline):
            channel = event.channel
            if event.kind is Kind.OPENED:
                streams.begin(channel)
            if event.kind is not Kind.DATA:
                continue
            if event.sent:
                self._exchange(open_requests.pop(channel, None), None)
                open_requests[channel] = index, event
                continue
            for begun_s, frame in streams.whole(index, event):
                order = streams.reader(channel).byte_order or framing.ByteOrder.LITTLE
                self.order = self.order or order
                message = codec.wire(order).decode(frame)
                if isinstance(message, m.MalformedMessage):
                    self._failed(index, channel, message.reason)
                    continue
                heard = ReceivedMessage(index, begun_s, event.time_s, channel, message, frame)
                self.heard.append(heard)
                self._exchange(open_requests.pop(channel, None), heard)
        for left in open_requests.values():
            self._exchange(left, None)
        self.asked.sort()

    def _failed(self, index: int, channel: str, reason: str) -> None:
        self.unread.append((index, f"{channel}: {reason}"))

    def _exchange(self, asked: tuple[int, WireEvent] | None, reply: ReceivedMessage | None) -> None:
        if asked is None:
            return
        number, sent = asked
        request = codec.wire(self.order or framing.ByteOrder.LITTLE).decode(sent.data)
        known = None if isinstance(request, m.MalformedMessage) else request
        self.asked.append(
            MotorosExchange(number, sent.time_s, sent.channel, known, sent.data, reply)
        )

    def exchanges(self, phase: str) -> list[MotorosExchange]:
        """Return the requests of a phase."""
        return self.within(self.asked, phase)

    def requests(self, kind: type, phase: str = "", **fields: int) -> list[MotorosExchange]:
        """Return the requests of a phase (empty: any) with a body of `kind` with these fields."""
        return [
            each
            for each in (self.exchanges(phase) if phase else self.asked)
            if isinstance(each.body, kind)
            and all(getattr(each.body, name) == value for name, value in fields.items())
        ]

    def _bodies(self, kind: type[B], phase: str) -> list[tuple[ReceivedMessage, B]]:
        found = self.within(self.heard, phase) if phase else self.heard
        return [(e, e.message.body) for e in found if isinstance(e.message.body, kind)]

    def statuses(self, phase: str = "") -> list[tuple[ReceivedMessage, m.RobotStatus]]:
        """Return the messages of a phase with a robot status, and it; empty: all."""
        return self._bodies(m.RobotStatus, phase)

    def feedback(self, phase: str = "") -> list[tuple[ReceivedMessage, m.JointFeedback]]:
        """Return the messages of a phase with joint feedback of group 0, and it; empty: all."""
        return [each for each in self._bodies(m.JointFeedback, phase) if each[1].group == 0]
