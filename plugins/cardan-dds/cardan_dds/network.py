"""The whole ROS graph of a DDS domain for servers: the `Network` of cardan.bus.network over DDS.

A single thread waits for all readers and for discovery, and runs the callbacks. Services follow
rmw_cyclonedds: a header before each request and reply.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

from cardan.bus.dds_options import DdsOptions
from cardan.bus.network import (
    Answered,
    Asked,
    Failure,
    Handle,
    Heard,
    NetworkError,
    ServiceInfo,
    Topic,
)
from cardan.common.context import enter, leave
from cardan.errors import DriverError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import InterfaceError, full_name
from cardan.protocols.ros2.names import RosNameError, checked_name
from cardan.protocols.ros2.refusals import refusal
from cardan.protocols.ros2.type_hash import type_hash
from cardan.protocols.ros2.zenoh import PARAMETERS_QOS, Qos
from cardan_dds.cyclone import (
    Participant,
    Reader,
    Sample,
    Waiter,
    Writer,
    type_is_usable,
)
from cardan_dds.node import Announcer, GraphReader, topic_user_data
from cardan_dds.wire import (
    BARE_NODE,
    CYCLONE,
    HEADER_SENDERS,
    REPLY,
    REQUEST,
    TOPIC,
    WAYS_OUT,
    Endpoint,
    ServicePacket,
    dds_topic,
    dds_type_of,
    exact,
    service_id,
    user_data,
)

LONGEST_CALL_S = 3600.0
"""Longest wait for the reply to a call without a time limit."""

DEPTH = 100
"""Messages of a topic that wait for this process; beyond it the oldest are lost."""

LATCHED_DEPTH = 32
"""Messages of a latched topic that are kept for late subscribers: if several nodes of the other
side publish a topic, each one's newest."""

LOOK_S = 0.01
"""Period of checks for the other side of a service; rmw_cyclonedds's value."""

REPLY_WAIT_S = 0.1
"""Longest wait of a reply for its client's reader; rmw_cyclonedds's value."""

IDLE_S = 1.0
"""Longest sleep of the thread."""

END_TIMEOUT_S = 2.0
"""Longest wait for the thread's end: it may be in a callback."""

HeardFrom = Callable[[bytes, int, "Endpoint | None"], None]
"""Message, its time, and its writer; None: unknown."""

AskedBy = Callable[[bytes, Answered, "Endpoint | None"], None]
"""Request, callback for its reply, and writer of the request."""

_log = logging.getLogger(__name__)

_GivenT = TypeVar("_GivenT", bound="_Given")


class DdsNetwork:
    """Node with a view of the whole graph of a DDS domain.

    ::

    with DdsNetwork(DdsOptions(), "server") as network:
            network.subscribe("/joint_states", None, heard)
    """

    def __init__(self, options: DdsOptions, name: str, deaf: bool = False) -> None:
        """`deaf`: it does not receive its own publications."""
        self.options, self.full_name = options, checked_name(f"/{name}")
        self._deaf = deaf
        self._shared: _Hub | None = None
        self._given: list[_Given] = []
        """Open publishers, subscriptions and services on DDS."""
        self._clients: dict[tuple[str, str], _Client] = {}
        self._making = threading.Lock()

    def open(self) -> None:
        """Join DDS. Raises ExtraMissingError, ConfigurationError, or DriverError."""
        if self._shared is None:
            self._shared = _Hub(self.options, self._deaf)
            self._shared.announcer.add(self.full_name)

    def close(self) -> None:
        """Leave DDS, and close everything still open there. Never raises; may be called twice."""
        self._leave()
        hub, self._shared = self._shared, None
        if hub is not None:
            hub.close()

    def _leave(self) -> None:
        for each in (*self._given, *self._clients.values()):
            each.close()
        self._clients.clear()

    def part(self, name: str) -> DdsNetwork:
        """Return the same network as a separate node, until it is closed."""
        return _Part(self, name)

    __enter__ = enter
    __exit__ = leave

    @property
    def hub(self) -> _Hub:
        """Participant. Raises NetworkError if it is closed."""
        if self._shared is None:
            raise NetworkError("DDS is not open: use the network in a with statement")
        return self._shared

    # -- the graph -------------------------------------------------------------------------------

    def topics(self, others: bool = False) -> Mapping[str, Topic]:
        """Return all topics by name; `others`: only those of other participants."""
        hub = self.hub
        with hub.lock:
            found = {}
            for name in hub.graph.names(TOPIC):
                writers, readers = hub.sides(TOPIC, name, others)
                types = [ros.type_name for each in (*writers, *readers) if (ros := each.ros)]
                if types:
                    found[name] = Topic(
                        next(filter(None, types), ""),
                        hub.nodes_of(writers),
                        hub.nodes_of(readers),
                        any(each.transient_local for each in writers),
                    )
            return found

    def services(self, others: bool = False) -> Mapping[str, ServiceInfo]:
        """Return all services by name."""
        hub = self.hub
        with hub.lock:
            found = {}
            for name in hub.graph.names(REQUEST):
                _, servers = hub.sides(REQUEST, name, others)
                types = [ros.type_name for each in servers if (ros := each.ros)]
                if types:
                    found[name] = ServiceInfo(types[0], hub.nodes_of(servers))
            return found

    def nodes(self) -> Sequence[str]:
        """Return the full names of all nodes."""
        hub = self.hub
        with hub.lock:
            return hub.graph.nodes()

    @property
    def guid(self) -> bytes:
        """GUID of its participant."""
        return self.hub.participant.guid

    @property
    def changes(self) -> int:
        """Number of changes of the graph."""
        return self.hub.changes

    def others(self, topic: str) -> tuple[list[Endpoint], list[Endpoint]]:
        """Return other participants' writers and readers of a topic."""
        hub = self.hub
        with hub.lock:
            return hub.sides(TOPIC, topic, others=True)

    def node_of(self, endpoint: Endpoint) -> str:
        """Return the full name of the node that has an endpoint; empty until it is announced."""
        hub = self.hub
        with hub.lock:
            name = hub.graph.node_of(endpoint)
        return "" if name == BARE_NODE else name

    def participants(self) -> set[bytes]:
        """Return the GUIDs of the participants that have anything."""
        hub = self.hub
        with hub.lock:
            return hub.graph.participants()

    def having(self, node: str) -> list[bytes]:
        """Return the GUIDs of the other participants that have a node of this full name."""
        hub = self.hub
        with hub.lock:
            return [each for each in hub.graph.having_node(node) if each != self.guid]

    def wait_for_service(self, service: str, timeout_s: float) -> bool:
        """Wait until `service` is offered; False on a time-out."""
        hub = self.hub
        with hub.changed:
            return hub.changed.wait_for(
                lambda: hub.graph.having(REQUEST, service, writes=False), timeout_s
            ) not in ([], False)

    def watch_departures(self, departed: Callable[[bytes], None]) -> None:
        """Call `departed` with the GUID of each participant that leaves or dies; a dead one is
        reported at the end of its lease (10 s by ROS 2's settings)."""
        self.hub.departures.append(departed)

    # -- endpoints -------------------------------------------------------------------------------

    def subscribe(self, topic: str, type_name: str | None, heard: Heard) -> Handle:
        """Call `heard` with each message of `topic`. Raises NetworkError."""
        return self.subscribe_from(topic, type_name, lambda data, ns, _from: heard(data, ns))

    def subscribe_from(
        self, topic: str, type_name: str | None, heard: HeardFrom, history: bool = True
    ) -> Handle:
        """Subscribe with the sender of each message; without `history` ignore messages published
        before. Raises NetworkError."""
        given = _Subscription(self.hub, self.full_name, _checked(topic), type_name, heard, history)
        return self._retained(given)

    def advertise(self, topic: str, type_name: str, latched: bool) -> _Sender:
        """Return a publisher. Raises NetworkError."""
        qos = Qos(transient_local=latched, depth=LATCHED_DEPTH if latched else DEPTH)
        return self._retained(_Sender(self.hub, self.full_name, _checked(topic), type_name, qos))

    def call(
        self,
        service: str,
        type_name: str,
        request: bytes,
        answered: Answered,
        timeout_s: float | None,
    ) -> None:
        """Call a service of a Cyclone DDS node; `answered` is called once, with a Failure if no
        reply arrives in `timeout_s`, or if a server uses another DDS, to which nothing is sent.
        Raises NetworkError."""
        with self._making:
            client = self._clients.get((service, type_name))
            if client is None:
                client = _Client(self.hub, self.full_name, _checked(service), type_name)
                self._clients[service, type_name] = client
        client.call(request, answered, LONGEST_CALL_S if timeout_s is None else timeout_s)

    def serve(self, service: str, type_name: str, asked: Asked) -> Handle:
        """Offer a service. DDS has no message for a failure: the client gets the refusal of the
        service's own type, or no reply if Cardan does not know the type. Raises NetworkError."""
        return self.serve_to(service, type_name, lambda data, answer, _by: asked(data, answer))

    def serve_to(self, service: str, type_name: str, asked: AskedBy) -> Handle:
        """Offer a service, with the client of each request. Raises NetworkError."""
        checked = _checked(service)
        return self._retained(_Server(self.hub, self.full_name, checked, type_name, asked))

    def _retained(self, given: _GivenT) -> _GivenT:
        with self._making:
            self._given = [each for each in self._given if not each.closed]
            self._given.append(given)
        return given


class _Part(DdsNetwork):
    """Node beside another one in its participant."""

    def __init__(self, whole: DdsNetwork, name: str) -> None:
        super().__init__(whole.options, name)
        self._shared = whole.hub
        self._shared.announcer.add(self.full_name)

    def close(self) -> None:
        """Remove the node and its endpoints from DDS. Never raises; may be called twice."""
        self._leave()
        hub, self._shared = self._shared, None
        if hub is not None:
            hub.announcer.remove(self.full_name)


class _Hub:
    """Participant with its graph, and the thread that waits for all its readers."""

    def __init__(self, options: DdsOptions, deaf: bool) -> None:
        """Raises ExtraMissingError, ConfigurationError, or DriverError."""
        self.participant = Participant(options)
        self.deaf = deaf
        self.lock = threading.RLock()
        self.changed = threading.Condition(self.lock)
        self.departures: list[Callable[[bytes], None]] = []
        self.announcer = Announcer(self.participant)
        self._ids = itertools.count(1)
        self._inputs: dict[int, _Given] = {}
        self._followers: tuple[_Given, ...] = ()
        self._waiter: Waiter = self.participant.waiter()
        self._graph_reader = GraphReader(self.participant)
        self.graph = self._graph_reader.graph
        self._discovering: set[int] = set()
        """Numbers of the conditions for changes of the graph."""
        for condition in self._graph_reader.conditions:
            number = next(self._ids)
            self._discovering.add(number)
            self._waiter.add(condition, number)
        self.changes = 0
        self._urgent = False
        self._warned = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="dds", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave DDS. May be called twice."""
        if self._closed:
            return
        self._closed = True
        self._waiter.wake()
        if threading.current_thread() is not self._thread:
            self._thread.join(END_TIMEOUT_S)
        self.announcer.close()
        self._waiter.close()
        self._graph_reader.close()
        self.participant.close()

    # -- for endpoints, from any thread ------------------------------------------------------------

    def next_id(self) -> int:
        """Return a number that is unique in this participant."""
        return next(self._ids)

    def listen(self, number: int, given: _Given, reader: Reader) -> None:
        """Pass a reader's messages to `given`."""
        self._inputs[number] = given
        self._waiter.add(reader.condition, number)

    def unlisten(self, number: int, reader: Reader) -> None:
        """Stop the calls for this reader."""
        self._inputs.pop(number, None)
        if not self._closed:
            self._waiter.remove(reader.condition)

    def wake(self) -> None:
        """Wake the thread to look for due work."""
        self._urgent = True
        self._waiter.wake()

    def follow(self, given: _Given) -> None:
        """Notify `given` of changes of the graph, and of time, until it is closed."""
        with self.lock:
            self._followers = (*self._followers, given)

    def unfollow(self, given: _Given) -> None:
        """Stop notifying `given`."""
        with self.lock:
            self._followers = tuple(each for each in self._followers if each is not given)

    def sides(
        self, prefix: str, name: str, others: bool = False
    ) -> tuple[list[Endpoint], list[Endpoint]]:
        """Return the writers and the readers of a ROS name; `others`: without local ones. Call it
        with the lock."""
        own = self.participant.guid if others else b""
        writers, readers = (
            [each for each in self.graph.having(prefix, name, side) if each.participant != own]
            for side in (True, False)
        )
        return writers, readers

    def nodes_of(self, endpoints: Sequence[Endpoint]) -> tuple[str, ...]:
        """Return the full names of the nodes that have these. Call it with the lock."""
        return tuple(sorted({self.graph.node_of(each) for each in endpoints}))

    def by_handle(self, handle: int) -> Endpoint | None:
        """Return the endpoint with this instance handle."""
        with self.lock:
            return self.graph.by_handle(handle)

    def writer_of(self, sample: Sample) -> Endpoint | None:
        """Return the writer of a sample. In the thread."""
        writer = self.by_handle(sample.writer)
        if writer is None and self._discover():
            writer = self.by_handle(sample.writer)
        return writer

    def make_writer(self, prefix: str, name: str, type_name: str, qos: Qos, user: bytes) -> Writer:
        """Return a writer. Raises NetworkError."""
        with _errors_translated():
            return self.participant.writer(*self._names(prefix, name, type_name), qos, user)

    def make_reader(self, prefix: str, name: str, type_name: str, qos: Qos, user: bytes) -> Reader:
        """Return a reader. Raises NetworkError."""
        with _errors_translated():
            names = self._names(prefix, name, type_name)
            return self.participant.reader(*names, qos, user, self.deaf and prefix == TOPIC)

    def _names(self, prefix: str, name: str, type_name: str) -> tuple[str, str]:
        type_text = dds_type_of(prefix, full_name(type_name))
        why = type_is_usable(self.participant, type_text)
        if why:
            raise InterfaceError(why)
        return dds_topic(prefix, name), type_text

    # -- the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._closed:
            numbers = self._waiter.wait(min(due_s - time.monotonic(), IDLE_S))
            if self._closed:
                return
            try:
                if not self._discovering.isdisjoint(numbers):
                    self._discover()
                for number in numbers:
                    given = self._inputs.get(number)
                    if given is not None:
                        given.receive()
                now_s = time.monotonic()
                if self._urgent or now_s >= due_s:
                    self._urgent = False
                    due_s = min((now_s + IDLE_S, *(each.look(now_s) for each in self._followers)))
            except Exception:
                _log.exception("fault in a DDS sample; the server continues")

    def _discover(self) -> bool:
        """Process DDS's discoveries; return True if there were any."""
        found = self._graph_reader.take()
        if not any(found):
            return False
        with self.changed:
            self._graph_reader.learn(found)
            for each in found.changes:
                if isinstance(each, Endpoint):
                    self._warn_of(each)
            self.changes += 1
            self.changed.notify_all()
        for follower in self._followers:
            follower.adapt()
        for guid in found.departed:
            for tell in tuple(self.departures):
                tell(guid)
        return True

    def _warn_of(self, endpoint: Endpoint) -> None:
        """Report a client that local servers cannot answer, once."""
        if self._warned or not endpoint.writes or endpoint.vendor in HEADER_SENDERS:
            return
        ros = endpoint.ros
        if ros is None or ros.prefix != REQUEST:
            return
        own = self.participant.guid
        if any(each.participant == own for each in self.graph.having(REQUEST, ros.name, False)):
            self._warned = True
            _log.warning(
                "a client of %s is of %s, and gets no answer: %s",
                ros.name,
                endpoint.vendor or "an unknown DDS",
                WAYS_OUT,
            )


class _Given:
    """DDS entities of a handle, until it is closed."""

    def __init__(self, hub: _Hub, node: str) -> None:
        self._hub, self._node = hub, node
        self._entities: list[Reader | Writer] = []
        self._numbers: list[tuple[int, Reader]] = []
        self.closed = False

    def receive(self) -> None:
        """Read available data. In the thread."""

    def adapt(self) -> None:
        """Adapt to changes of the graph. In the thread."""

    def look(self, _now_s: float) -> float:
        """Do due work; return when to look again, by the monotonic clock. In the thread."""
        return float("inf")

    def close(self) -> None:
        """Delete it from DDS; no callback follows. May be called twice."""
        self.closed = True
        self._hub.unfollow(self)
        self._drop()

    def _have(self, *entities: Reader | Writer) -> None:
        self._entities += entities
        self._hub.announcer.add(self._node, *entities)
        for each in entities:
            if isinstance(each, Reader):
                number = self._hub.next_id()
                self._numbers.append((number, each))
                self._hub.listen(number, self, each)

    def _drop(self) -> None:
        entities, self._entities = self._entities, []
        numbers, self._numbers = self._numbers, []
        if entities:
            self._hub.announcer.remove(self._node, *entities)
        for number, reader in numbers:
            self._hub.unlisten(number, reader)
        for each in entities:
            each.close()


class _Sender(_Given):
    """Publisher for any thread."""

    def __init__(self, hub: _Hub, node: str, topic: str, type_name: str, qos: Qos) -> None:
        super().__init__(hub, node)
        self._writer = hub.make_writer(TOPIC, topic, type_name, qos, topic_user_data(type_name))
        self._have(self._writer)

    @property
    def heard(self) -> bool:
        """True if there is a subscriber."""
        return not self.closed and bool(self._writer.matched())

    def publish(self, cdr: bytes, sent_ns: int = 0) -> None:
        """Publish a message; DDS gives it its time."""
        if not self.closed:
            self._writer.write(cdr)


class _Subscription(_Given):
    """Subscription whose reader fits the present publishers: their type if none was given, best
    effort if one of them is, latched if all are."""

    def __init__(
        self,
        hub: _Hub,
        node: str,
        topic: str,
        type_name: str | None,
        heard: HeardFrom,
        history: bool,
    ) -> None:
        super().__init__(hub, node)
        self._topic, self._asked, self._heard = topic, type_name, heard
        self._history = history
        self._type = ""
        self._form: tuple[str, bool, bool] | None = None
        self._reader: Reader | None = None
        self._fitting = threading.Lock()
        # The thread adapts to a publisher that is found meanwhile.
        hub.follow(self)
        try:
            self.adapt()
        except NetworkError:
            self.close()
            raise

    def adapt(self) -> None:
        with self._fitting:
            if not self.closed:
                self._fit()

    def _fit(self) -> None:
        with self._hub.lock:
            writers = self._hub.sides(TOPIC, self._topic, others=self._hub.deaf)[0]
        types = [ros.type_name for each in writers if (ros := each.ros) and ros.type_name]
        type_name = self._asked or next(iter(types), "")
        if not type_name:
            return
        reliable = all(each.reliable for each in writers)
        latched = self._history and bool(writers) and all(each.transient_local for each in writers)
        form = type_name, reliable, latched
        if form == self._form:
            return
        self._form, self._type = form, type_name
        self._reader = None
        self._drop()
        # Only reliable readers get latched messages.
        qos = Qos(reliable or latched, latched, DEPTH)
        self._reader = self._hub.make_reader(
            TOPIC, self._topic, type_name, qos, topic_user_data(type_name)
        )
        self._have(self._reader)

    def close(self) -> None:
        with self._fitting:
            super().close()

    def receive(self) -> None:
        reader = self._reader
        for sample in () if reader is None else reader.take():
            if self.closed:
                return
            data = _exact(self._type, sample.data)
            self._heard(data, sample.source_ns, self._hub.writer_of(sample))


class _Client(_Given):
    """Client of a service, which stays on DDS: matching takes longer than a call."""

    def __init__(self, hub: _Hub, node: str, service: str, type_name: str) -> None:
        super().__init__(hub, node)
        with _errors_translated():
            self._response = f"{full_name(type_name, 'srv')}_Response"
        self._service = service
        users = _service_users(hub, "clientid", type_name)
        self._reader = hub.make_reader(REPLY, service, type_name, PARAMETERS_QOS, users[1])
        self._writer = hub.make_writer(REQUEST, service, type_name, PARAMETERS_QOS, users[0])
        self._id = self._writer.handle
        self._sequences = itertools.count(1)
        self._lock = threading.Lock()
        self._unsent: dict[int, bytes] = {}
        self._waiting: dict[int, tuple[Answered, float]] = {}
        """By request: callback for the reply, and its deadline."""
        self._have(self._reader, self._writer)
        hub.follow(self)

    def call(self, request: bytes, answered: Answered, timeout_s: float) -> None:
        """Send a request as soon as a server is present."""
        with self._lock:
            number = next(self._sequences)
            self._waiting[number] = answered, time.monotonic() + timeout_s
            self._unsent[number] = ServicePacket(self._id, number, request).encode()
        self._hub.wake()

    def look(self, now_s: float) -> float:
        refusal = self._refusal() if self._unsent else ""
        if refusal:
            for number in tuple(self._unsent):
                self._answer(number, Failure(refusal))
        elif self._unsent and self._met():
            with self._lock:
                packets, self._unsent = self._unsent, {}
            for packet in packets.values():
                self._writer.write(packet)
        with self._lock:
            late = [number for number, (_, end_s) in self._waiting.items() if end_s <= now_s]
            due_s = min((end_s for _, end_s in self._waiting.values()), default=float("inf"))
        for number in late:
            words = "no reply: no server offers it, or late"
            self._answer(number, Failure(f"{self._service}: {words}"))
        return min(due_s, now_s + LOOK_S) if self._unsent else due_s

    def _refusal(self) -> str:
        """Return why a request must not be sent; empty if it may. A server of another DDS would
        take the header for the beginning of the request."""
        with self._hub.lock:
            servers = self._hub.graph.having(REQUEST, self._service, writes=False)
        for each in servers:
            if each.vendor != CYCLONE:
                other = each.vendor or "an unknown DDS"
                return f"{self._service} is not called, as its server is of {other}: {WAYS_OUT}"
        return ""

    def _met(self) -> bool:
        """Return True if a server has met both endpoints of this client: earlier requests are
        lost."""
        find = self._hub.by_handle
        writers = [each for each in map(find, self._reader.matched()) if each is not None]
        for server in map(find, self._writer.matched()):
            if server is None or server.vendor != CYCLONE:
                continue
            if any(server.belongs(each, "serviceid") for each in writers):
                return True
        return False

    def receive(self) -> None:
        for sample in self._reader.take():
            packet = ServicePacket.decode(sample.data)
            if packet is not None and packet.client == self._id:
                self._answer(packet.sequence, _exact(self._response, packet.cdr))

    def _answer(self, number: int, reply: bytes | Failure) -> None:
        with self._lock:
            self._unsent.pop(number, None)
            answered, _ = self._waiting.pop(number, (None, 0.0))
        if answered is not None:
            answered(reply)

    def close(self) -> None:
        super().close()
        for number in tuple(self._waiting):
            self._answer(number, Failure(f"{self._service}: the network was closed"))


class _Server(_Given):
    """Offers a service."""

    def __init__(self, hub: _Hub, node: str, service: str, type_name: str, asked: AskedBy) -> None:
        super().__init__(hub, node)
        self._service, self._asked = service, asked
        with _errors_translated():
            self._type = full_name(type_name, "srv")
        self._request = f"{self._type}_Request"
        users = _service_users(hub, "serviceid", type_name)
        self._writer = hub.make_writer(REPLY, service, type_name, PARAMETERS_QOS, users[1])
        self._reader = hub.make_reader(REQUEST, service, type_name, PARAMETERS_QOS, users[0])
        self._lock = threading.Lock()
        self._replies: list[tuple[bytes, Endpoint, float]] = []
        """Replies whose clients have no reader yet, and their deadlines."""
        self._have(self._writer, self._reader)
        hub.follow(self)

    def receive(self) -> None:
        for sample in self._reader.take():
            client = self._hub.writer_of(sample)
            packet = ServicePacket.decode(sample.data)
            if self.closed or client is None or packet is None:
                continue
            if client.vendor not in HEADER_SENDERS:
                continue  # Its requests have no header; a warning was logged when it appeared.
            self._ask(packet, client)

    def _ask(self, packet: ServicePacket, client: Endpoint) -> None:
        over = threading.Lock()

        def answer(reply: bytes | Failure) -> None:
            if not over.acquire(blocking=False):
                return
            if isinstance(reply, Failure):
                _log.warning("%s is refused: %s", self._service, reply.reason)
                refused = self._refusal(reply.reason)
                if refused is None:
                    return
                reply = refused
            self._reply(packet._replace(cdr=reply).encode(), client)

        self._asked(_exact(self._request, packet.cdr), answer, client)

    def _refusal(self, reason: str) -> bytes | None:
        """Return the response for a refusal; None for a type that Cardan does not know."""
        try:
            response = refusal(self._type, reason)
            return codec_of(f"{self._type}_Response").encode(response)
        except InterfaceError:
            return None

    def _reply(self, data: bytes, client: Endpoint) -> None:
        """Send a reply. From any thread."""
        if self.closed:
            return
        if self._met(client):
            self._writer.write(data)
            return
        with self._lock:
            self._replies.append((data, client, time.monotonic() + REPLY_WAIT_S))
        self._hub.wake()

    def _met(self, client: Endpoint) -> bool:
        """Return True if the client's reader is matched; a client without an id cannot be
        awaited."""
        if not client.property_of("clientid"):
            return True
        readers = map(self._hub.by_handle, self._writer.matched())
        return any(each is not None and client.belongs(each, "clientid") for each in readers)

    def look(self, now_s: float) -> float:
        with self._lock:
            replies, self._replies = self._replies, []
        for data, client, end_s in replies:
            if self._hub.by_handle(client.handle) is None:
                continue  # The client has left.
            if self._met(client) or now_s >= end_s:
                self._writer.write(data)
            else:
                with self._lock:
                    self._replies.append((data, client, end_s))
        return now_s + LOOK_S if self._replies else float("inf")


def _service_users(hub: _Hub, key: str, type_name: str) -> tuple[bytes, bytes]:
    """Return the user data of a service's request endpoint, and of its reply endpoint."""
    own = service_id(hub.participant.guid, hub.next_id())
    found = []
    for part in ("Request", "Response"):
        try:
            mark = type_hash(f"{full_name(type_name, 'srv')}_{part}")
        except InterfaceError:
            mark = ""
        found.append(user_data({key: own, "typehash": mark}))
    return found[0], found[1]


def _exact(type_name: str, data: bytes) -> bytes:
    try:
        return exact(type_name, data)
    except InterfaceError:  # Of a type that Cardan does not know the length is unknown.
        return data


def _checked(name: str) -> str:
    try:
        return checked_name(name)
    except RosNameError as error:
        raise NetworkError(str(error)) from None


@contextlib.contextmanager
def _errors_translated() -> Iterator[None]:
    """Raise NetworkError for errors of DDS."""
    try:
        yield
    except (DriverError, InterfaceError) as error:
        raise NetworkError(str(error)) from None
