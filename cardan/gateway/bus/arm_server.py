"""Serves one arm to the bus: takes commands from topics and services, and answers each of them.

The loop only passes packets on; the session's request worker decodes, carries out and answers, in
its threads.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from cardan.bus.node import BusNode, Received, ServiceRequest
from cardan.errors import CardanError, MotionRefusedError
from cardan.gateway.arm.backlog import PROVEN_S, STREAMED_S, Delays, late_words
from cardan.gateway.arm.requests import (
    MotionNote,
    PacketError,
    Request,
    decode_request,
    encode_error,
    encode_note,
    encode_reply,
)
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.verb_table import CHANGING, ENDLESS, SEQUENCED, preset_of
from cardan.gateway.arm.vocab import Begins, vocab_text
from cardan.gateway.bus.actions import Ahead, ArmAction
from cardan.gateway.bus.arm_parameters import ArmParameters
from cardan.gateway.bus.arm_topics import OK, WARN, DiagnosticStatus
from cardan.gateway.bus.commands import (
    ACTIONS,
    ASK_SERVICE,
    ASK_TYPE,
    MOTIONS_TOPIC,
    MOTIONS_TYPE,
    SERVICES,
    TOPICS,
    ActionCommand,
    Asks,
    Instant,
    ServiceCommand,
    TopicCommand,
)
from cardan.gateway.bus.liveliness import UNKNOWN, LivelinessMonitor, Presence
from cardan.gateway.bus.serving import Results, key_end
from cardan.gateway.bus.sources import STREAM_RETENTION_S, Source, Sources, Unnamed
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.zenoh import Attachment
from cardan.types import NEVER_S, Twist, Wrench

MAX_ENDS = 32
"""Most ends of motions that wait for a request of their source, which rarely has more than one."""

AT_ONCE = 8
"""Most messages of one endpoint that are passed on in one cycle."""

TOKENS_AT_ONCE = 32
"""Most liveliness tokens that are taken in one cycle: 0.2 ms of it, and a graph of 1000 endpoints
in 0.13 s at 250 Hz."""

CONTEST_SHOWN_S = 5.0
"""Time for which the diagnostics, published once a second, warn of two sources that stream at
once."""

GOALS_PERIOD_S = 0.01
"""Period of checks for goals and parameters: a check costs 0.5 µs for each of their many services,
and a delay of 10 ms goes unnoticed."""

MAX_SENDERS = 64
"""Publishers of a topic whose sequence numbers are remembered."""

Offer = Callable[[Any, Any, float], None]
"""`offer(client, packet, now_s)` of the worker of requests."""


HELD_AT_MOST = 32
"""Most packets that wait for their sender's token: the oldest is passed on without it."""

_Input = tuple[Callable[[], Any], Any]
"""A poll, and the client of the worker that takes its packets."""


class _Held(NamedTuple):
    """A packet that waits for its sender's token."""

    client: Any
    packet: Received | ServiceRequest
    came_s: float
    until_s: float

    @property
    def stream(self) -> tuple[Any, bytes]:
        """Key that distinguishes its publisher's packets from others."""
        return self.client, b"" if self.packet.attachment is None else self.packet.attachment.gid


class ArmServer:
    """The commands of one arm on the bus.

    `poll` is for the loop's thread and never blocks; the rest happens in the threads of `offer`.
    """

    def __init__(
        self,
        node: BusNode,
        offer: Offer,
        *,
        source: str = "ros2",
        owner: Callable[[], str] = lambda: "",
        endless_without_watch: bool = False,
        topics: Sequence[TopicCommand] = TOPICS,
        services: Sequence[ServiceCommand] = SERVICES,
        actions: Sequence[ActionCommand] = ACTIONS,
        full: Callable[[], bool] = lambda: False,
    ) -> None:
        """`node` is open. `source`: first word of their names in the arm's authority, `owner`: the
        source that has it now. `full`: whether no packets should be taken for now."""
        self._full = full
        self.now_s = NEVER_S
        """Time of the newest poll."""
        self._owner = owner
        self.refused = 0
        """Count of malformed messages and requests: wrong type, wrong length."""
        self.late = 0
        """Count of messages that came twice, or after a newer one of the same publisher."""
        self.inhibited = ""
        """Reason why only stops are taken; empty: all commands are."""
        self.contested = 0
        """Count of streamed messages refused because another source has the authority."""
        self._contest = ""
        self._contest_s = NEVER_S
        self._liveliness = LivelinessMonitor(node.zid)
        self.sources = Sources(source, self._liveliness, owner)
        self._tokens = node.watch_tokens()
        self._endless_without_watch = endless_without_watch
        self._arrived: list[tuple[Any, Any]] = []
        self.lost = 0
        """Count of messages displaced by newer ones of the same publisher."""
        self._node, self._offer = node, offer
        self._ids = itertools.count(1)
        self._results = Results(node)
        self._telling = threading.Lock()
        self._inputs: list[_Input] = []
        self._held: list[_Held] = []
        """Held packets in order of arrival."""
        self.unnamed = Unnamed()
        self._notes = node.publisher(f"~/{MOTIONS_TOPIC}", MOTIONS_TYPE)
        asked = node.service(f"~/{ASK_SERVICE}", ASK_TYPE)
        self._inputs.append((asked.poll, _PacketClient(self)))
        self._stops: list[_Input] = []
        self._streamed: set[Any] = set()
        """Clients whose newest packet alone counts."""
        for command in topics:
            subscription = node.subscription(command.topic, command.type_name, command.depth)
            inputs = self._stops if command.verb == "stop" else self._inputs
            client = _TopicClient(self, command)
            inputs.append((subscription.poll, client))
            if command.verb in SEQUENCED:
                self._streamed.add(client)
        for service in services:
            server = node.service(service.service, service.type_name)
            inputs = self._stops if service.verb == "stop" else self._inputs
            inputs.append((server.poll, _ServiceClient(self, service)))
        self._actions = [ArmAction(node, self, action) for action in actions]
        self.parameters = ArmParameters(node, self)
        self._rare_inputs: list[_Input] = list(self.parameters.inputs)
        for each in self._actions:
            self._rare_inputs += [each.offers, each.results]
        self._never_wait = {client for _, client in self._stops}
        self._never_wait |= {each.cancels[1] for each in self._actions}
        self._rare_due_s = -math.inf

    def poll(self, now_s: float) -> None:
        """Pass on packets that have arrived, only stops while the worker is full, and update the
        known clients."""
        self.now_s = now_s
        rare = now_s >= self._rare_due_s
        self._collect(self._stops)
        if self._arrived:
            self.sources.spend()
            # Held commands came first, and stops follow them at once.
            self._let_go(lambda _held: True)
            if not self._full():
                self._pass_on_before_stops()
        if rare:
            self._rare_due_s = now_s + GOALS_PERIOD_S
            for each in self._actions:
                self._collect_cancels(each)
        if self._arrived:
            self._pass_on()
        if not self._full():
            self._collect(self._inputs)
            if rare:
                self._collect(self._rare_inputs)
        # After the packets: their senders' tokens were there before.
        self._take_tokens()
        if self._held:
            self._let_go(lambda held: self._liveliness.knows(held.packet) or now_s >= held.until_s)
        if self._arrived:
            self._pass_on()

    def _pass_on_before_stops(self) -> None:
        """Pass on packets that arrived with a stop, whose order is unknown, so that the stop ends
        their motions; without those that its sender sent after it, by its own clock."""
        stops, self._arrived = self._arrived, []
        self._collect((*self._inputs, *self._rare_inputs))
        self._take_tokens()
        after = []
        for client, packet in self._arrived:
            if all(self._is_later(packet, stop) for _, stop in stops):
                after.append((client, packet))
            else:
                self._offer(client, packet, self.now_s)
        self._arrived = [*stops, *after]

    def _is_later(
        self, packet: Received | ServiceRequest, before: Received | ServiceRequest
    ) -> bool:
        """Return whether one node sent both, and `packet` later."""
        one, other = packet.attachment, before.attachment
        if one is None or other is None or one.source_ns <= other.source_ns:
            return False
        node = self._liveliness.node(one.gid)
        return node is not None and node is self._liveliness.node(other.gid)

    def _take_tokens(self) -> None:
        for _ in range(TOKENS_AT_ONCE):
            change = self._tokens.poll()
            if change is None:
                break
            self._liveliness.take(*change, self.now_s)

    def _collect_cancels(self, action: ArmAction) -> None:
        """Collect the cancellations of an action's goals. Goals that are there by then arrived
        before or with them: they are accepted first, and begin afterwards, unless they are
        canceled."""
        arrived, self._arrived = self._arrived, []
        self._collect((action.cancels,))
        cancels, self._arrived = self._arrived, []
        if cancels:
            client = action.offers[1]
            held = [(client, each.packet) for each in self._held if each.client is client]
            self._collect((action.offers,))
            ahead = [(client, Ahead(packet)) for _, packet in (*held, *self._arrived)]
            cancels = [*ahead, *cancels, *self._arrived]
        self._arrived = [*arrived, *cancels]

    def _pass_on(self) -> None:
        """Offer packets that have arrived, without those that wait for their sender's token."""
        now_s = self.now_s
        for client, packet in self._arrived:
            at_once = client in self._never_wait or isinstance(packet, Ahead)
            until_s = NEVER_S if at_once else self._named_s(packet)
            if until_s <= now_s:
                self._offer(client, packet, now_s)
            else:
                self._hold(_Held(client, packet, now_s, until_s))
        self._arrived.clear()

    def _named_s(self, packet: Received | ServiceRequest) -> float:
        """Return the time until which `packet` waits for its sender's token."""
        if self._liveliness.knows(packet):
            return NEVER_S
        gid = b"" if packet.attachment is None else packet.attachment.gid
        zid = packet.zid if isinstance(packet, Received) else ""
        return self.unnamed.until_s((gid, zid), self.now_s)

    def _hold(self, held: _Held) -> None:
        """Hold a packet; of a stream only the newest is held."""
        if held.client in self._streamed:
            self._held = [each for each in self._held if each.stream != held.stream]
        if len(self._held) >= HELD_AT_MOST:
            oldest = self._held.pop(0)
            self._offer(oldest.client, oldest.packet, oldest.came_s)
        self._held.append(held)

    def _let_go(self, ready: Callable[[_Held], bool]) -> None:
        """Offer held packets that are `ready`, by their time of arrival."""
        held, self._held = self._held, []
        for each in held:
            if ready(each):
                self._offer(each.client, each.packet, each.came_s)
            else:
                self._held.append(each)

    def _collect(self, inputs: Sequence[_Input]) -> None:
        for poll, client in inputs:
            for _ in range(AT_ONCE):
                packet = poll()
                if packet is None:
                    break
                self._arrived.append((client, packet))

    def watched(self, request: Request, packet: Received | ServiceRequest) -> Request:
        """Return `request`; a motion without end gets a check whether the sender of `packet` is
        still on the bus. Raises PacketError if such a check is impossible, and for commands while
        the server is `inhibited`. From any thread."""
        if self.inhibited and request.verb in CHANGING - {"release"}:
            refusal = MotionRefusedError(f"{request.verb}: {self.inhibited}")
            raise PacketError(str(refusal), request.id) from refusal
        if request.verb not in ENDLESS:
            return request
        client = self._client(packet)
        if client is not None:
            return request._replace(there=client.there)
        if self._endless_without_watch:
            return request
        why = MotionRefusedError(f"{request.verb}: {UNKNOWN}")
        raise PacketError(str(why), request.id) from why

    def _client(self, packet: Received | ServiceRequest) -> Presence | None:
        """Identify the client: a message's publisher, a request's node, because programs make
        clients for one call; for a publisher that old releases of rmw_zenoh name at random, its
        session."""
        liveliness, attachment = self._liveliness, packet.attachment
        if isinstance(packet, Received):
            known = None if attachment is None else liveliness.endpoint(attachment.gid)
            return known or liveliness.session(packet.zid)
        return None if attachment is None else liveliness.node(attachment.gid)

    def source(self, packet: Received | ServiceRequest) -> str:
        """Return the name of the sender of `packet` in the arm's authority. In the thread that
        decodes."""
        return self.sources.of(packet, self.now_s).name

    def contested_by(self, source: str) -> str:
        """Return the other source that has the authority; empty: none, or `source` itself."""
        owner = self._owner()
        return "" if owner == source else owner

    def contest(self, words: str) -> None:
        """Count a streamed message that another source blocked."""
        self.contested += 1
        self._contest, self._contest_s = words, self.now_s

    def part(self) -> DiagnosticStatus:
        """Return the diagnostics of the commands."""
        contested = self.now_s - self._contest_s < CONTEST_SHOWN_S
        counts = {
            "refused": self.refused,
            "late": self.late,
            "displaced": self.lost,
            "contested": self.contested,
        }
        words = ", ".join(f"{count} {word}" for word, count in counts.items() if count)
        return DiagnosticStatus(
            "commands",
            WARN if contested or self.refused else OK,
            self._contest if contested else words or "all read",
            values=counts,
        )

    @property
    def running(self) -> bool:
        """True while the goal of an action moves the arm."""
        return any(action.running for action in self._actions)

    def report(self, now: Instant, now_ns: int) -> None:
        """Publish the progress of the goals that move the arm."""
        for action in self._actions:
            action.tell(now, now_ns)

    def offer(self, client: Any, packet: Any) -> None:
        """Queue another packet of a client. From any thread."""
        self._offer(client, packet, self.now_s)

    def key_end(self, type_name: str) -> str:
        """Return the end of the keys of messages of this type."""
        return key_end(self._node.key_of("/", type_name))

    def next_id(self) -> int:
        """Id of the next request."""
        return next(self._ids)

    def tell(
        self, command: str, sequence: int, outcome: str, reason: str = "", source: str = ""
    ) -> None:
        """Publish the outcome of a command of `source` that arrived on a topic. From any thread."""
        with self._telling:
            self._results.put(command, sequence, outcome, reason, source)

    def note(self, packet: bytes) -> None:
        """Publish the state of a motion. From any thread."""
        data = codec_of(MOTIONS_TYPE).encode({"data": packet.decode()})
        with self._telling:
            self._notes.put(data, time.time_ns())


class _PacketClient:
    """Programs that send packets, each as a source of its own name."""

    def __init__(self, server: ArmServer) -> None:
        self._server = server
        self._request = codec_of(f"{ASK_TYPE}_Request")
        self._response = codec_of(f"{ASK_TYPE}_Response")
        self._waiting: dict[int, tuple[ServiceRequest, int, str]] = {}
        """Waiting requests, with their ids and sources."""
        self._unreported: deque[MotionNote] = deque(maxlen=MAX_ENDS)
        """Ends of motions that are in no reply yet: a publication may arrive later than a reply
        that was sent after it."""

    def decode(self, packet: ServiceRequest) -> Request:
        """Decode the request in a service's request. Raises PacketError."""
        number = self._server.next_id()
        self._waiting[number] = packet, 0, ""
        message = self._request.decode(packet.data)
        if isinstance(message, MalformedCdr):
            self._server.refused += 1
            raise PacketError(message.reason, number)
        try:
            request = decode_request(message["request"].encode())
        except PacketError as error:
            self._server.refused += 1
            self._waiting[number] = packet, error.request or 0, ""
            raise PacketError(str(error), number) from error.__cause__
        self._waiting[number] = packet, request.id, request.source
        if request.verb in CHANGING:
            why = self._server.sources.claim(request.source, packet, self._server.now_s)
            if why:
                raise PacketError(why, number) from MotionRefusedError(f"{request.verb}: {why}")
        # A time since which it waited would be of another computer's clock.
        return self._server.watched(request._replace(id=number, since_s=None), packet)

    def done(self, request: Request, result: Any) -> None:
        """Respond with the reply."""
        self._respond(request.id, lambda number, ended: encode_reply(number, result, ended))

    def refused(self, number: int | None, error: CardanError) -> None:
        """Respond that it was refused, and why."""
        self._respond(number, lambda asked, ended: encode_error(asked, error, ended))

    def ended(self, note: MotionNote) -> None:
        """Publish that a motion has ended, and add it to the next reply to its source."""
        self._unreported.append(note)
        self._server.note(encode_note(note))

    def _respond(
        self, number: int | None, encode: Callable[[int, list[MotionNote]], bytes]
    ) -> None:
        waiting, asked, source = self._waiting.pop(number or 0, (None, 0, ""))
        if waiting is not None:
            ended = [note for note in tuple(self._unreported) if note.source == source]
            for note in ended:
                with contextlib.suppress(ValueError):  # Another thread has reported it.
                    self._unreported.remove(note)
            reply = {"reply": encode(asked, ended).decode()}
            waiting.reply(self._response.encode(reply), time.time_ns())


class _Sender:
    """A publisher of a topic."""

    def __init__(self, key: tuple[bytes, str] = (b"", "")) -> None:
        self.key = key
        """Its GID, and the Zenoh session of its messages' timestamps: the same GID with another
        session is another publisher."""
        self.source: Source | None = None
        """The program that it belongs to."""
        self.sequence, self.source_ns = -1, -1
        self.clock_runs = False
        """True once the stamps of its messages were seen to change."""
        self.heard_s = NEVER_S
        """Time of its newest message."""
        self.reported = ""
        """Last reason or outcome of its stream on the result topic."""
        self.note = ""
        """Remark, published with the next accepted command."""


PUBLISHED_S = 0.05
"""Largest difference of a stamp to the time of publication on the bus at which it counts as made
then, as by a server for a client without stamps: it does not show how long the client kept the
message."""

NO_STAMP = "its stamp is zero: it counts as sent when it arrived"


class _TopicClient:
    """A topic as a client of the worker: its answers are messages on the result topic. For a
    stream, whose commands come many times a second, only changes and the first answer after a
    silence are published."""

    def __init__(self, server: ArmServer, command: TopicCommand) -> None:
        self._server, self._command = server, command
        types = ((command.type_name, command.value), *command.also)
        self._delays = Delays()
        """Delays of publishers of a stream, by their stamps of sending."""
        self._types = {server.key_end(name): (codec_of(name), value) for name, value in types}
        self._streamed = command.verb in SEQUENCED
        self._senders: dict[tuple[bytes, str], _Sender] = {}
        self._asked: dict[int, tuple[int, _Sender]] = {}
        """Senders and their sequence numbers, by request and later by motion."""
        self._nobody = _Sender()

    def decode(self, packet: Received) -> Request | None:
        """Decode the request in a message; None for a repeated one. Raises PacketError."""
        server, command = self._server, self._command
        attachment, waited_s = packet.attachment, 0.0
        if attachment is None:
            sequence, sender = 0, self._sender((b"", packet.zid))
        else:
            sequence, sender = attachment.sequence, self._sender((attachment.gid, packet.zid))
            if not attachment.follows(sender.sequence, sender.source_ns):
                server.late += 1
                if not command.always:
                    return None
            if 0 <= sender.sequence < sequence - 1:
                self._note_lost(sender, sender.sequence + 1, sequence - 1)
            if self._streamed:
                sent_s = attachment.source_ns * 1e-9
                waited_s = self._delays.hear(sender.key, sent_s, server.now_s)
                sender.clock_runs |= 0 <= sender.source_ns < attachment.source_ns
            sender.sequence, sender.source_ns = sequence, attachment.source_ns
        silent_s = server.now_s - sender.heard_s
        source = self._source(sender, packet)
        number = server.next_id()
        self._asked[number] = sequence, sender
        if silent_s < command.apart_s:
            raise PacketError(
                f"{command.verb}: its publisher repeats it, so it does not re-arm: send it "
                f"once, {command.apart_s:g} s after the one before",
                number,
            )
        codec, value_of = self._types.get(key_end(packet.key), (None, command.value))
        if codec is None:
            message: Message | MalformedCdr = MalformedCdr(self._wrong_type(packet.key))
        else:
            message = codec.decode(packet.data)
        if isinstance(message, MalformedCdr):
            server.refused += 1
            raise PacketError(f"{command.verb}: {message.reason}", number)
        try:
            value = value_of(message)
        except CardanError as error:
            raise PacketError(str(error), number) from error
        if self._streamed and not source.stream(sender.key, server.now_s):
            why = MotionRefusedError(
                f"{command.verb}: another publisher of {source.name!r} streams; only one at a "
                "time may"
            )
            server.contest(str(why))
            raise PacketError(str(why), number) from why
        if isinstance(value, Asks):
            return self._asked_for(value, number, source.name)
        request = Request(number, source.name, command.verb, value)
        if command.begins and (not command.dated or (attachment and attachment.source_ns > 0)):
            request = request._replace(begins=self._begins(source, value))
        if command.stamped and "header" in message:
            stamp_s = _seconds(message["header"]["stamp"])
            sender.note = "" if stamp_s else NO_STAMP
            request = request._replace(stamp_s=stamp_s or None)
        if self._streamed and not _asks_nothing(value):
            if sender.clock_runs and waited_s > STREAMED_S:
                why = MotionRefusedError(f"{command.verb}: {late_words(waited_s)}")
                raise PacketError(str(why), number) from why
            self._check_connection(source, request, attachment)
        return server.watched(request, packet)

    def _check_connection(
        self, source: Source, request: Request, attachment: Attachment | None
    ) -> None:
        """Raise PacketError for a packet that may have waited for its sender's connection:
        libraries keep such messages. A sender's own stamp shows it, and the arm checks that."""
        connected_s = source.connected_s(self._server.now_s)
        if connected_s >= PROVEN_S:
            return
        stamp_s = request.stamp_s
        if stamp_s is not None and attachment is not None:
            published_s = attachment.source_ns * 1e-9
            if abs(published_s - stamp_s) > PUBLISHED_S:
                return
        owner = self._server.contested_by(source.name)
        if owner:
            preset = vocab_text(preset_of(request.verb))
            why = MotionRefusedError(f"{preset}: {owner!r} has authority over the arm")
            self._server.contest(str(why))
        else:
            why = MotionRefusedError(
                f"{request.verb}: {source.name!r} has been connected for {connected_s:.2f} s, so "
                "this may have waited until it was: what its sender gave no stamp counts after "
                f"{PROVEN_S:g} s"
            )
        raise PacketError(str(why), request.id) from why

    def _asked_for(self, asks: Asks, number: int, source: str) -> Request | None:
        request = Request(number, source, asks.verb)
        if asks.verb:
            return request
        self.done(request, None)
        return None

    def _begins(self, source: Source, value: Any) -> Begins:
        """Return the treatment of a streamed command while none is chosen."""
        now_s = self._server.now_s
        if _asks_nothing(value):
            source.rest(now_s)
            return Begins.REST
        return Begins.NEW if source.may_begin(now_s) else Begins.GOING_ON

    def _sender(self, key: tuple[bytes, str]) -> _Sender:
        sender = self._senders.pop(key, None)
        if sender is None:
            if len(self._senders) >= MAX_SENDERS:
                self._senders.pop(next(iter(self._senders)))
            sender = _Sender(key)
        self._senders[key] = sender
        return sender

    def _source(self, sender: _Sender, packet: Received) -> Source:
        """Return the source of the publisher `sender`, which keeps it until it was silent."""
        server = self._server
        if server.now_s - sender.heard_s > STREAM_RETENTION_S:
            sender.reported, sender.source = "", None
        sender.heard_s = server.now_s
        if sender.source is None or sender.source.identity.presence is None:
            # The token of a node may come after its first message.
            sender.source = server.sources.of(packet, server.now_s)
        return server.sources.heard(sender.source, server.now_s)

    def _note_lost(self, sender: _Sender, first: int, last: int) -> None:
        """Report displaced messages; not for a stream, whose newest message counts."""
        server, verb = self._server, self._command.verb
        server.lost += last - first + 1
        if not self._streamed:
            numbers = f"{verb}: numbers {first} to {last}"
            reason = f"{numbers} were lost on their way, or replaced by newer ones"
            server.tell(verb, last, "refused", reason, _name(sender))

    def _wrong_type(self, key: str) -> str:
        type_name, mark = key.split("/")[-2:]
        return f"it takes {' or '.join(self._types)}, not {type_name} of {mark}"

    def done(self, request: Request, result: Any) -> None:
        """Report that a command was accepted, or a streamed one refused."""
        sequence, sender = self._pop(request.id)
        if isinstance(result, MotionNote):
            if result.outcome is Outcome.RUNNING:
                self._asked[-result.id] = sequence, sender
            note = _both(result.note, sender.note)
            self._server.tell(request.verb, sequence, "accepted", note, request.source)
        elif not self._streamed:
            verb = request.verb or self._command.verb
            self._server.tell(verb, sequence, "done", source=request.source)
        else:
            if not result:
                if sender.source is not None:
                    sender.source.spend()
            elif self._server.contested_by(request.source):
                self._server.contest(str(result))
            self._tell_change(sender, sequence, str(result or ""))

    def refused(self, number: int | None, error: CardanError) -> None:
        """Report that a command was refused, and why."""
        sequence, sender = self._pop(number or 0)
        if self._streamed:
            self._tell_change(sender, sequence, str(error))
        else:
            self._server.tell(self._command.verb, sequence, "refused", str(error), _name(sender))

    def ended(self, note: MotionNote) -> None:
        """Report that a motion has ended."""
        sequence, _ = self._pop(-note.id)
        outcome = "done" if note.outcome is Outcome.DONE else "aborted"
        self._server.tell(note.verb, sequence, outcome, note.reason, note.source)

    def _pop(self, number: int) -> tuple[int, _Sender]:
        return self._asked.pop(number, (0, self._nobody))

    def _tell_change(self, sender: _Sender, sequence: int, reason: str) -> None:
        reported = reason or "accepted"
        if reported != sender.reported:
            sender.reported = reported
            outcome = "refused" if reason else "accepted"
            reported = reason or sender.note
            self._server.tell(self._command.verb, sequence, outcome, reported, _name(sender))


class _ServiceClient:
    """A service as a client of the worker: each request gets its response."""

    def __init__(self, server: ArmServer, command: ServiceCommand) -> None:
        self._server, self._command = server, command
        self._request = codec_of(f"{command.type_name}_Request")
        self._response = codec_of(f"{command.type_name}_Response")
        self._waiting: dict[int, ServiceRequest] = {}

    def decode(self, packet: ServiceRequest) -> Request | None:
        """Decode the request in a service's request; None if it requests nothing of the arm. Raises
        PacketError."""
        server, command = self._server, self._command
        number = server.next_id()
        self._waiting[number] = packet
        message = self._request.decode(packet.data)
        if isinstance(message, MalformedCdr):
            server.refused += 1
            raise PacketError(f"{command.verb}: {message.reason}", number)
        try:
            value = command.value(message)
        except CardanError as error:
            raise PacketError(str(error), number) from error
        source = server.source(packet)
        if not isinstance(value, Asks):
            return server.watched(Request(number, source, command.verb, value), packet)
        request = Request(number, source, value.verb)
        if value.verb:
            return request
        self.done(request, None)
        return None

    def done(self, request: Request, result: Any) -> None:
        """Respond; for a motion, that it has begun."""
        if isinstance(result, MotionNote):
            response: Message = {"success": True, "message": result.note}
        else:
            response = self._command.answer(result)
        self._respond(request.id, response)

    def refused(self, number: int | None, error: CardanError) -> None:
        """Respond that it was refused, and why; if the response has no text field, on the result
        topic, too."""
        response = self._command.refusal(error)
        if "message" not in response:
            self._server.tell(self._command.verb, 0, "refused", str(error))
        self._respond(number, response)

    def ended(self, note: MotionNote) -> None:
        """Do nothing: the end of a motion is the answer to `wait` only."""

    def _respond(self, number: int | None, response: Message) -> None:
        waiting = self._waiting.pop(number or 0, None)
        if waiting is not None:
            waiting.reply(self._response.encode(response), time.time_ns())


def _name(sender: _Sender) -> str:
    return "" if sender.source is None else sender.source.name


def _both(*notes: str) -> str:
    return "; ".join(filter(None, notes))


def _seconds(stamp: Message) -> float:
    return float(stamp["sec"] + stamp["nanosec"] * 1e-9)


def _asks_nothing(value: Any) -> bool:
    """Return whether a streamed command requests no motion and no force; a pose always does."""
    if isinstance(value, Twist):
        return not any((*value.linear, *value.angular))
    if isinstance(value, Wrench):
        return not any((*value.force, *value.torque))
    return isinstance(value, (list, tuple)) and not hasattr(value, "_fields") and not any(value)
