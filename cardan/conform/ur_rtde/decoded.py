"""What judges of a Universal Robots controller look at: packets, packages and lines of a timeline,
decoded once."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

from cardan.conform.timeline import Event, Kind, Timeline, Traffic, UnaskedError
from cardan.protocols.ur import rtde
from cardan.protocols.ur.dashboard import DashboardReader
from cardan.protocols.ur.primary import (
    MessageKind,
    PackageReader,
    PrimaryPackage,
    RobotMessage,
    read_message,
)
from cardan.protocols.ur.realtime import RealtimeReader

RTDE, SECOND, OLD = "rtde", "rtde-2", "rtde-1"
"""Channels: the connection that is judged, another client's beside it, and that of a client that
speaks version 1 of the protocol."""
PRIMARY, SECONDARY, REALTIME = "primary", "secondary", "realtime"
"""The client interfaces."""
REVERSE = "reverse"
"""A port of ours, which a program of ours comes to."""
TOKEN = re.compile(r"write_output_integer_register\(\d+, (\d{2,})\)")
"""In a program: what it writes first, so that it is known to run."""
_OF_A_VERSION = frozenset((rtde.PacketType.OUTPUTS, rtde.PacketType.DATA, rtde.PacketType.TEXT))
"""What has another form in another version of RTDE."""
_NAME = re.compile(r"def (\w+)\(\)")
_READERS: Mapping[str, Callable[[], Any]] = {
    PRIMARY: PackageReader,
    SECONDARY: PackageReader,
    REALTIME: RealtimeReader,
    "dashboard": DashboardReader,
}
"""What cuts a channel's bytes, where it is not RTDE."""


class Heard(NamedTuple):
    """A packet of the controller's."""

    number: int
    """Of the event that completed it."""
    begun_s: float
    time_s: float
    channel: str
    reply: rtde.Reply
    raw: bytes


class Exchange(NamedTuple):
    """A request of ours, and its reply."""

    number: int
    time_s: float
    channel: str
    asked: rtde.ControlRequest | rtde.RecipeSetup
    reply: Heard | None


Answered = tuple[Exchange, rtde.RecipeSetup, rtde.SetupReply]
"""A request for a recipe, and what it was answered."""


class Values(dict[str, Any]):
    """Of a package, by their names. UnaskedError for one that its recipe does not have."""

    def __missing__(self, name: str) -> NoReturn:
        raise UnaskedError(name)


class State(NamedTuple):
    """A data package, by the names of its recipe."""

    number: int
    time_s: float
    values: Values


class OutputStream(NamedTuple):
    """Data packages from a start to a pause, or to the end."""

    channel: str
    start_s: float
    end_s: float
    states: list[State]


class Told(NamedTuple):
    """A package of the primary or the secondary interface."""

    number: int
    begun_s: float
    time_s: float
    package: PrimaryPackage
    message: RobotMessage | None


class Sample(NamedTuple):
    """A packet of the real-time interface."""

    number: int
    time_s: float
    packet: bytes


class Line(NamedTuple):
    """A request to the dashboard server, and what it said; before any request, its greeting."""

    number: int
    time_s: float
    request: int
    """Number of the request's event."""
    asked: str
    said: str | None


class Upload(NamedTuple):
    """A program of ours, or a line."""

    number: int
    time_s: float
    channel: str
    name: str
    token: int
    """0: it has none."""


class _Connection:
    """What is known of an RTDE connection while it is open."""

    def __init__(self, version: int) -> None:
        self.ours = rtde.PacketReader()
        self.version = version
        self.open: list[tuple[int, float, rtde.ControlRequest | rtde.RecipeSetup]] = []
        self.outputs: rtde.Recipe | None = None
        self.inputs: dict[int, rtde.Recipe] = {}
        self.stream: list[State] | None = None
        self.stream_s = 0.0


class UrTraffic(Traffic):
    """The bytes of a timeline."""

    def __init__(self, timeline: Timeline) -> None:
        super().__init__(timeline)
        self.heard: list[Heard] = []
        self.unread: list[tuple[int, str]] = []
        """Numbers of events with what cannot be read, and why."""
        self.asked: list[Exchange] = []
        self.states: list[State] = []
        """Of the connection that is judged."""
        self.strays: list[tuple[int, float, str]] = []
        """Data packages that nothing had been started for."""
        self.streams: list[OutputStream] = []
        self.recipes: dict[int, rtde.Recipe] = {}
        """Of each data package, by its event's number: those of the judged connection."""
        self.commands: list[State] = []
        """What we wrote, by the names of its recipe."""
        self.told: list[Told] = []
        """By the primary interface."""
        self.secondary: list[Told] = []
        self.samples: list[Sample] = []
        self.lines: list[Line] = []
        self.uploads: list[Upload] = []
        self.opened: list[str] = []
        self.ended: list[tuple[int, Event]] = []
        """Connections of ours that the controller closed or refused."""
        self.old: set[str] = set()
        """Channels on which an older version of RTDE is spoken."""
        self.called: list[tuple[int, Event]] = []
        """Programs of ours that came to our port, and what they sent."""
        self._connections: dict[str, _Connection] = {}
        self._readers: dict[str, Any] = {}
        self._begun_s: dict[str, float] = {}
        """When the first bytes came of what is not whole yet, by channels."""
        self._asked_line = (0, 0.0, "")
        self._answered = False
        for number, event in enumerate(timeline):
            self._take(number, event)
        for channel in tuple(self._connections):
            self._over(channel, timeline.end_s)
        self._unanswered_line()
        self.asked.sort(key=lambda each: each.number)

    # -- events -----------------------------------------------------------------------------------

    def _take(self, number: int, event: Event) -> None:
        channel = event.channel
        if channel.startswith(REVERSE):
            if channel != REVERSE and not event.sent:
                self.called.append((number, event))
        elif event.kind is Kind.OPENED:
            self.opened.append(channel)
            self._begin(channel)
            if channel.startswith(RTDE):
                # A controller speaks the oldest until another is agreed on. What was before the
                # beginning of a capture is not known.
                self._connections[channel] = _Connection(
                    rtde.VERSION if event.note else rtde.VERSIONS[0]
                )
        elif event.kind in (Kind.CLOSED, Kind.REFUSED):
            if not event.sent:
                self.ended.append((number, event))
            self._over(channel, event.time_s)
        elif event.kind is Kind.DATA:
            if channel == "dashboard":
                self._dashboard(number, event)
            elif event.sent and channel not in self._connections:
                self._uploaded(number, event)
            elif channel in (PRIMARY, SECONDARY):
                into = self.told if channel == PRIMARY else self.secondary
                for begun_s, found in self._whole(number, event):
                    into.append(Told(number, begun_s, event.time_s, found, read_message(found)))
            elif channel == REALTIME:
                for _, found in self._whole(number, event):
                    self.samples.append(Sample(number, event.time_s, found))
            elif channel in self._connections:
                connection = self._connections[channel]
                if event.sent:
                    self._sent(number, event, connection)
                else:
                    self._received(number, event, connection)

    def _begin(self, channel: str) -> None:
        self._readers[channel] = _READERS.get(channel, rtde.PacketReader)()
        self._begun_s.pop(channel, None)

    def _whole(self, number: int, event: Event) -> Iterator[tuple[float, Any]]:
        """What is whole now of what comes on a channel, and when the first bytes of each came."""
        channel = event.channel
        if channel not in self._readers:
            self._begin(channel)
        reader = self._readers[channel]
        begun_s = self._begun_s.pop(channel, event.time_s)
        reader.feed(event.data)
        while (found := reader.take()) is not None:
            yield begun_s, found
            begun_s = event.time_s
        if reader.pending_bytes:
            self._begun_s[channel] = begun_s
        if reader.failure:
            self.unread.append((number, reader.failure))
            self._begin(channel)

    def _over(self, channel: str, now_s: float) -> None:
        connection = self._connections.pop(channel, None)
        if connection is None:
            return
        self._stream_ends(channel, connection, now_s)
        for number, time_s, asked in connection.open:
            self.asked.append(Exchange(number, time_s, channel, asked, None))

    def _stream_ends(self, channel: str, connection: _Connection, now_s: float) -> None:
        if connection.stream is not None:
            stream = OutputStream(channel, connection.stream_s, now_s, connection.stream)
            self.streams.append(stream)
            connection.stream = None

    # -- RTDE -------------------------------------------------------------------------------------

    def _sent(self, number: int, event: Event, connection: _Connection) -> None:
        connection.ours.feed(event.data)
        while (found := connection.ours.take()) is not None:
            asked: rtde.Asked | rtde.MalformedPayload = rtde.read_request(
                *found, connection.version
            )
            if isinstance(asked, (rtde.ControlRequest, rtde.RecipeSetup)):
                connection.open.append((number, event.time_s, asked))
            elif isinstance(asked, rtde.Data) and asked.recipe in connection.inputs:
                values = connection.inputs[asked.recipe].unpack(asked.values)
                if values is not None and event.channel == RTDE:
                    self.commands.append(State(number, event.time_s, Values(values)))

    def _received(self, number: int, event: Event, connection: _Connection) -> None:
        for begun_s, (kind, payload) in self._whole(number, event):
            reply = rtde.read_reply(kind, payload, connection.version)
            if isinstance(reply, rtde.MalformedPayload):
                self.unread.append((number, reply.reason))
                continue
            raw = rtde.packet(rtde.PacketType(kind), payload)
            heard = Heard(number, begun_s, event.time_s, event.channel, reply, raw)
            self.heard.append(heard)
            if connection.version != rtde.VERSION and kind in _OF_A_VERSION:
                self.old.add(event.channel)
            if isinstance(reply, rtde.Data):
                self._data(heard, reply, connection)
            else:
                self._reply(heard, connection)

    def _data(self, heard: Heard, data: rtde.Data, connection: _Connection) -> None:
        recipe = connection.outputs
        if recipe is None or data.recipe != (recipe.number or 0):
            self.unread.append((heard.number, f"a data package of recipe {data.recipe}"))
            return
        values = recipe.unpack(data.values)
        if values is None:
            size = len(data.values)
            self.unread.append((heard.number, f"a data package of {size} bytes, not {recipe.size}"))
            return
        state = State(heard.number, heard.time_s, Values(values))
        if connection.stream is None:
            self.strays.append((heard.number, heard.time_s, heard.channel))
        else:
            connection.stream.append(state)
        if heard.channel == RTDE:
            self.states.append(state)
            self.recipes[heard.number] = recipe

    def _reply(self, heard: Heard, connection: _Connection) -> None:
        reply = heard.reply
        if isinstance(reply, rtde.TextMessage):
            return
        kind = getattr(reply, "kind", rtde.PacketType.CONTROLLER_VERSION)
        place = next((n for n, each in enumerate(connection.open) if each[2].kind is kind), None)
        if place is None:
            return
        number, time_s, asked = connection.open.pop(place)
        self.asked.append(Exchange(number, time_s, heard.channel, asked, heard))
        if (
            isinstance(reply, rtde.SetupReply)
            and isinstance(asked, rtde.RecipeSetup)
            and reply.recipe
        ):
            try:
                numbered = connection.version != 1 or reply.kind is rtde.PacketType.INPUTS
                recipe = rtde.Recipe(reply.recipe if numbered else None, asked.names, reply.types)
            except ValueError as error:
                self.unread.append((heard.number, f"a recipe that cannot be: {error}"))
                return
            if reply.kind is rtde.PacketType.OUTPUTS:
                connection.outputs = recipe
            else:
                connection.inputs[reply.recipe] = recipe
        elif isinstance(reply, rtde.Accepted) and reply.kind is rtde.PacketType.PAUSE:
            self._stream_ends(heard.channel, connection, heard.time_s)
        elif isinstance(reply, rtde.Accepted) and reply.accepted:
            if reply.kind is rtde.PacketType.START:
                connection.stream, connection.stream_s = [], heard.time_s
            elif isinstance(asked, rtde.ControlRequest):  # for a version
                connection.version = asked.version
                if asked.version != rtde.VERSION:
                    self.old.add(heard.channel)

    # -- client interfaces and dashboard ----------------------------------------------------------

    def _uploaded(self, number: int, event: Event) -> None:
        text = event.data.decode("utf-8", "replace")
        name, token = _NAME.search(text), TOKEN.search(text)
        known = name.group(1) if name else "", int(token.group(1)) if token else 0
        self.uploads.append(Upload(number, event.time_s, event.channel, *known))

    def _dashboard(self, number: int, event: Event) -> None:
        if event.sent:
            self._unanswered_line()
            words = event.data.decode("utf-8", "replace").strip()
            self._asked_line, self._answered = (number, event.time_s, words), False
            return
        for _, line in self._whole(number, event):
            request, _, words = self._asked_line
            self.lines.append(Line(number, event.time_s, request, words, line))
            self._answered = True

    def _unanswered_line(self) -> None:
        number, time_s, words = self._asked_line
        if words and not self._answered:
            self.lines.append(Line(number, time_s, number, words, None))

    # -- looking ----------------------------------------------------------------------------------

    def during(self, *names: str) -> list[State]:
        """The states of these phases."""
        return self.within(self.states, *names)

    def sent_during(self, *names: str) -> list[State]:
        """The commands of these phases."""
        return self.within(self.commands, *names)

    def messages(self, *kinds: MessageKind, during: Sequence[str] = ()) -> list[RobotMessage]:
        """Those of the primary interface, of these kinds; in these phases, or in all."""
        found = self.within(self.told, *during) if during else self.told
        return [each.message for each in found if each.message and each.message.kind in kinds]

    def exchanges(self, kind: rtde.PacketType, *names: str) -> list[Exchange]:
        """Requests of a kind in these phases; without any, in all."""
        return [
            each
            for each in self.asked
            if each.asked.kind is kind and (not names or self.inside(each.number, *names))
        ]

    def setups(
        self, kind: rtde.PacketType, *names: str
    ) -> list[tuple[Exchange, rtde.RecipeSetup, rtde.SetupReply]]:
        """Those requests for recipes that were answered."""
        return [
            (each, each.asked, each.reply.reply)
            for each in self.exchanges(kind, *names)
            if isinstance(each.asked, rtde.RecipeSetup)
            and each.reply is not None
            and isinstance(each.reply.reply, rtde.SetupReply)
        ]

    def said(self, asked: str) -> list[Line]:
        """What the dashboard server answered to a request, each time; None where it did not."""
        return [each for each in self.lines if each.asked == asked]
