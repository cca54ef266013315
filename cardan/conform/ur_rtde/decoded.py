"""Decoded packets, packages and lines of a Universal Robots controller, for the checks."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

from cardan.conform.streams import ChannelReaders
from cardan.conform.timeline import Kind, Traffic, UnaskedError, WireEvent, WireTimeline
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
"""Channels: the tested connection, another client's, and a client's with protocol version 1."""
PRIMARY, SECONDARY, REALTIME = "primary", "secondary", "realtime"
"""The client interfaces."""
REVERSE = "reverse"
"""Port of the suite, to which its program on the controller connects."""
TOKEN = re.compile(r"write_output_integer_register\(\d+, (\d{2,})\)")
"""The first register write of a program, with the token that shows that it runs."""
_OF_A_VERSION = frozenset((rtde.PacketType.OUTPUTS, rtde.PacketType.DATA, rtde.PacketType.TEXT))
"""Packets whose format depends on the version of RTDE."""
_NAME = re.compile(r"def (\w+)\(\)")
_READERS: Mapping[str, Callable[[], Any]] = {
    PRIMARY: PackageReader,
    SECONDARY: PackageReader,
    REALTIME: RealtimeReader,
    "dashboard": DashboardReader,
}
"""Message readers of the channels that are not RTDE."""


class ReceivedPacket(NamedTuple):
    """A packet of the controller."""

    number: int
    """Number of the event that completed it."""
    begun_s: float
    time_s: float
    channel: str
    reply: rtde.Reply
    raw: bytes


class RtdeExchange(NamedTuple):
    """A request of the suite, and its reply."""

    number: int
    time_s: float
    channel: str
    asked: rtde.ControlRequest | rtde.RecipeSetup
    reply: ReceivedPacket | None


Answered = tuple[RtdeExchange, rtde.RecipeSetup, rtde.SetupReply]
"""A request for a recipe, and its answer."""


class Values(dict[str, Any]):
    """Values of a package by name. UnaskedError for a name that its recipe does not have."""

    def __missing__(self, name: str) -> NoReturn:
        raise UnaskedError(name)


class DataPackage(NamedTuple):
    """A data package, by the names of its recipe."""

    number: int
    time_s: float
    values: Values


class OutputStream(NamedTuple):
    """Data packages from a start to a pause, or to the end."""

    channel: str
    start_s: float
    end_s: float
    states: list[DataPackage]


class ReceivedPackage(NamedTuple):
    """A package of the primary or the secondary interface."""

    number: int
    time_s: float
    package: PrimaryPackage
    message: RobotMessage | None


class RealtimePacket(NamedTuple):
    """A packet of the real-time interface."""

    number: int
    time_s: float
    packet: bytes


class DashboardLine(NamedTuple):
    """A request to the dashboard server and its answer; before any request, the greeting."""

    number: int
    time_s: float
    request: int
    """Number of the request's event."""
    asked: str
    said: str | None


class SentProgram(NamedTuple):
    """A program or a line that we sent."""

    number: int
    time_s: float
    channel: str
    name: str
    token: int
    """0: it has none."""


class _Connection:
    """State of an open RTDE connection."""

    def __init__(self, version: int) -> None:
        self.ours = rtde.PacketReader()
        self.version = version
        self.open: list[tuple[int, float, rtde.ControlRequest | rtde.RecipeSetup]] = []
        self.outputs: rtde.Recipe | None = None
        self.inputs: dict[int, rtde.Recipe] = {}
        self.stream: list[DataPackage] | None = None
        self.stream_s = 0.0


class UrTraffic(Traffic):
    """The bytes of a timeline."""

    def __init__(self, timeline: WireTimeline) -> None:
        super().__init__(timeline)
        self.heard: list[ReceivedPacket] = []
        self.asked: list[RtdeExchange] = []
        self.states: list[DataPackage] = []
        """States of the tested connection."""
        self.strays: list[tuple[int, float, str]] = []
        """Data packages without a start before."""
        self.streams: list[OutputStream] = []
        self.recipes: dict[int, rtde.Recipe] = {}
        """Recipe of each data package of the tested connection, by its event's number."""
        self.commands: list[DataPackage] = []
        """Inputs that we wrote, by the names of their recipe."""
        self.primary: list[ReceivedPackage] = []
        """Packages of the primary interface."""
        self.secondary: list[ReceivedPackage] = []
        self.samples: list[RealtimePacket] = []
        self.lines: list[DashboardLine] = []
        self.uploads: list[SentProgram] = []
        self.opened: list[str] = []
        self.old: set[str] = set()
        """Channels that use an older version of RTDE."""
        self.called: list[tuple[int, WireEvent]] = []
        """Connections and data of our programs at our port."""
        self._connections: dict[str, _Connection] = {}
        self._streams = ChannelReaders(
            lambda channel: _READERS.get(channel, rtde.PacketReader)(),
            lambda number, _, reason: self.unread.append((number, reason)),
        )
        self._asked_line = (0, 0.0, "")
        self._answered = False
        for number, event in enumerate(timeline):
            self._take(number, event)
        for channel in tuple(self._connections):
            self._over(channel, timeline.end_s)
        self._unanswered_line()
        self.asked.sort(key=lambda each: each.number)

    # -- events -----------------------------------------------------------------------------------

    def _take(self, number: int, event: WireEvent) -> None:
        channel = event.channel
        if channel.startswith(REVERSE):
            if channel != REVERSE and not event.sent:
                self.called.append((number, event))
        elif event.kind is Kind.OPENED:
            self.opened.append(channel)
            self._streams.begin(channel)
            if channel.startswith(RTDE):
                # A controller uses the oldest version until another is agreed on. Traffic before a
                # capture's beginning is unknown.
                self._connections[channel] = _Connection(
                    rtde.VERSION if event.note else rtde.VERSIONS[0]
                )
        elif event.kind in (Kind.CLOSED, Kind.REFUSED):
            self._over(channel, event.time_s)
        elif event.kind is Kind.DATA:
            if channel == "dashboard":
                self._dashboard(number, event)
            elif event.sent and channel not in self._connections:
                self._uploaded(number, event)
            elif channel in (PRIMARY, SECONDARY):
                into = self.primary if channel == PRIMARY else self.secondary
                for _, found in self._streams.whole(number, event):
                    into.append(ReceivedPackage(number, event.time_s, found, read_message(found)))
            elif channel == REALTIME:
                for _, found in self._streams.whole(number, event):
                    self.samples.append(RealtimePacket(number, event.time_s, found))
            elif channel in self._connections:
                connection = self._connections[channel]
                if event.sent:
                    self._sent(number, event, connection)
                else:
                    self._received(number, event, connection)

    def _over(self, channel: str, now_s: float) -> None:
        connection = self._connections.pop(channel, None)
        if connection is None:
            return
        self._stream_ends(channel, connection, now_s)
        for number, time_s, asked in connection.open:
            self.asked.append(RtdeExchange(number, time_s, channel, asked, None))

    def _stream_ends(self, channel: str, connection: _Connection, now_s: float) -> None:
        if connection.stream is not None:
            stream = OutputStream(channel, connection.stream_s, now_s, connection.stream)
            self.streams.append(stream)
            connection.stream = None

    # -- RTDE -------------------------------------------------------------------------------------

    def _sent(self, number: int, event: WireEvent, connection: _Connection) -> None:
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
                    self.commands.append(DataPackage(number, event.time_s, Values(values)))

    def _received(self, number: int, event: WireEvent, connection: _Connection) -> None:
        for begun_s, (kind, payload) in self._streams.whole(number, event):
            reply = rtde.read_reply(kind, payload, connection.version)
            if isinstance(reply, rtde.MalformedPayload):
                self.unread.append((number, reply.reason))
                continue
            raw = rtde.packet(rtde.PacketType(kind), payload)
            heard = ReceivedPacket(number, begun_s, event.time_s, event.channel, reply, raw)
            self.heard.append(heard)
            if connection.version != rtde.VERSION and kind in _OF_A_VERSION:
                self.old.add(event.channel)
            if isinstance(reply, rtde.Data):
                self._data(heard, reply, connection)
            else:
                self._reply(heard, connection)

    def _data(self, heard: ReceivedPacket, data: rtde.Data, connection: _Connection) -> None:
        recipe = connection.outputs
        if recipe is None or data.recipe != (recipe.number or 0):
            self.unread.append((heard.number, f"a data package of recipe {data.recipe}"))
            return
        values = recipe.unpack(data.values)
        if values is None:
            size = len(data.values)
            self.unread.append((heard.number, f"a data package of {size} bytes, not {recipe.size}"))
            return
        state = DataPackage(heard.number, heard.time_s, Values(values))
        if connection.stream is None:
            self.strays.append((heard.number, heard.time_s, heard.channel))
        else:
            connection.stream.append(state)
        if heard.channel == RTDE:
            self.states.append(state)
            self.recipes[heard.number] = recipe

    def _reply(self, heard: ReceivedPacket, connection: _Connection) -> None:
        reply = heard.reply
        if isinstance(reply, rtde.TextMessage):
            return
        kind = getattr(reply, "kind", rtde.PacketType.CONTROLLER_VERSION)
        place = next((n for n, each in enumerate(connection.open) if each[2].kind is kind), None)
        if place is None:
            return
        number, time_s, asked = connection.open.pop(place)
        self.asked.append(RtdeExchange(number, time_s, heard.channel, asked, heard))
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

    def _uploaded(self, number: int, event: WireEvent) -> None:
        text = event.data.decode("utf-8", "replace")
        name, token = _NAME.search(text), TOKEN.search(text)
        known = name.group(1) if name else "", int(token.group(1)) if token else 0
        self.uploads.append(SentProgram(number, event.time_s, event.channel, *known))

    def _dashboard(self, number: int, event: WireEvent) -> None:
        if event.sent:
            self._unanswered_line()
            words = event.data.decode("utf-8", "replace").strip()
            self._asked_line, self._answered = (number, event.time_s, words), False
            return
        for _, line in self._streams.whole(number, event):
            request, _, words = self._asked_line
            self.lines.append(DashboardLine(number, event.time_s, request, words, line))
            self._answered = True

    def _unanswered_line(self) -> None:
        number, time_s, words = self._asked_line
        if words and not self._answered:
            self.lines.append(DashboardLine(number, time_s, number, words, None))

    # -- queries ----------------------------------------------------------------------------------

    def during(self, *names: str) -> list[DataPackage]:
        """Return the states of these phases."""
        return self.within(self.states, *names)

    def sent_during(self, *names: str) -> list[DataPackage]:
        """Return the commands of these phases."""
        return self.within(self.commands, *names)

    def messages(self, *kinds: MessageKind, during: Sequence[str] = ()) -> list[RobotMessage]:
        """Return the primary interface's messages of these kinds; in these phases, or in all."""
        found = self.within(self.primary, *during) if during else self.primary
        return [each.message for each in found if each.message and each.message.kind in kinds]

    def exchanges(self, kind: rtde.PacketType, *names: str) -> list[RtdeExchange]:
        """Return the requests of a kind in these phases; without any, in all."""
        return [
            each
            for each in self.asked
            if each.asked.kind is kind and (not names or self.inside(each.number, *names))
        ]

    def setups(self, kind: rtde.PacketType, *names: str) -> list[Answered]:
        """Return the answered requests for recipes."""
        return [
            (each, each.asked, each.reply.reply)
            for each in self.exchanges(kind, *names)
            if isinstance(each.asked, rtde.RecipeSetup)
            and each.reply is not None
            and isinstance(each.reply.reply, rtde.SetupReply)
        ]

    def said(self, asked: str) -> list[DashboardLine]:
        """Return the dashboard server's answers to a request; `said` is None where it had none."""
        return [each for each in self.lines if each.asked == asked]
