"""Whole ROS graph for servers: any topic and service, by callbacks. Not for a control loop."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

from cardan.bus.network import (
    Answered,
    Asked,
    Failure,
    Handle,
    Heard,
    NetworkError,
    PublisherHandle,
    ServiceInfo,
    Topic,
)
from cardan.bus.node import BusNode, ServiceRequest, Urgency, gid_of, words_of, zenoh_module
from cardan.bus.options import BusOptions
from cardan.common.context import enter, leave
from cardan.errors import DriverError
from cardan.protocols.ros2.graph import Graph
from cardan.protocols.ros2.interfaces import InterfaceError, revised
from cardan.protocols.ros2.names import RosNameError
from cardan.protocols.ros2.zenoh import (
    CLIENT,
    DEFAULT_QOS,
    LATCHED_QOS,
    PUBLISHER,
    SERVICE,
    SUBSCRIPTION,
    Attachment,
    Entity,
)

_DeclaredT = TypeVar("_DeclaredT", bound="_Declared")

PICTURES = frozenset(
    {
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/PointCloud2",
    }
)
"""Types of which one message fills a slow link: they are sent last and dropped first. Any other
message from a server's client may be a command."""

LONGEST_CALL_S = 3600.0
"""Longest wait for the reply to a call without a time limit."""


class BusNetwork:
    """Node with a view of the whole graph; base of the servers.

    ::

    with BusNetwork(BusOptions(), "rosbridge") as network:
            network.subscribe("/joint_states", None, heard)
    """

    def __init__(self, options: BusOptions, name: str, deaf: bool = False) -> None:
        """`deaf`: ignore messages of itself and its parts."""
        self.node = BusNode(options, name)
        self._deaf = deaf
        self.changes = 0
        """Number of changes of the graph."""
        self._graph = Graph()
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._topics: dict[str, Topic] | None = None
        self._services: dict[str, ServiceInfo] | None = None
        """Copies of the graph's tables until it changes: a client that subscribes to all topics of
        a robot reads them once for each."""
        self._watches: set[_Watch] = set()
        self._making = threading.Lock()
        self._given: weakref.WeakSet[_Declared] = weakref.WeakSet()
        """Declarations on the bus whose handles are still held."""
        self._clients: dict[tuple[str, str], _Client] = {}

    def open(self) -> None:
        """Join the bus. Raises ExtraMissingError, ConfigurationError, or DriverError."""
        self.node.open()
        self.node.watch_graph(self._watch)

    def close(self) -> None:
        """Leave the bus, and close all open endpoints. Never raises; may be called twice."""
        for each in tuple(self._given):
            each.close()
        self._clients.clear()
        self.node.close()

    def part(self, name: str, namespace: str = "/") -> BusNetwork:
        """Return the same network as a separate node for a client of a server, open until it is
        closed. A motion without end that the client requests ends with the client and not with the
        server. Close the network itself after it."""
        return _Part(self, name, namespace)

    __enter__ = enter
    __exit__ = leave

    def _watch(self, token: str, there: bool) -> None:
        with self._changed:
            self._topics = self._services = None
            if there:
                self._graph.add(token)
            else:
                self._graph.remove(token)
            self.changes += 1
            self._changed.notify_all()
            gone = [watch.gone for watch in self._watches if watch.left(self._graph)]
        for each in gone:
            each()

    # -- the graph -------------------------------------------------------------------------------

    def wait_for_service(self, service: str, timeout_s: float) -> bool:
        """Wait until a node offers `service`; False if none does in time."""
        with self._changed:
            return self._changed.wait_for(lambda: self._graph.servers(service), timeout_s) != []

    def watch_service(self, service: str, gone: Callable[[], None]) -> Handle:
        """Call `gone`, in any thread, when the last server of `service` has left."""
        with self._lock:
            there = bool(self._graph.servers(service))
            watch = _Watch(self._watches, self._lock, service, gone, there)
            self._watches.add(watch)
        return self._registered(_Declared(watch))

    def wait_for_publisher(self, topic: str, timeout_s: float) -> bool:
        """Wait until a node publishes `topic`; False if none does in time."""
        with self._changed:
            return self._changed.wait_for(lambda: self._graph.publishers(topic), timeout_s) != []

    def topics(self) -> Mapping[str, Topic]:
        """Return all topics by name."""
        with self._lock:
            if self._topics is None:
                publishers = self._graph.by_name(PUBLISHER)
                subscribers = self._graph.by_name(SUBSCRIPTION)
                self._topics = {
                    name: _topic(type_name, publishers.get(name, ()), subscribers.get(name, ()))
                    for name, type_name in self._graph.topics().items()
                }
            return self._topics

    def others(self) -> tuple[Mapping[str, Topic], Mapping[str, ServiceInfo]]:
        """Return the topics and services of other processes alone."""
        ends: dict[str, list[Entity]] = {}
        servers: dict[str, list[Entity]] = {}
        with self._lock:
            for each in self._graph.entities(PUBLISHER, SUBSCRIPTION, SERVICE):
                if each.zid != self.node.zid:
                    retained = servers if each.kind == SERVICE else ends
                    retained.setdefault(each.name, []).append(each)
        topics = {}
        for name, there in ends.items():
            publishers = [each for each in there if each.kind == PUBLISHER]
            subscribers = [each for each in there if each.kind == SUBSCRIPTION]
            topics[name] = _topic(there[0].type_name, publishers, subscribers)
        services = {
            name: ServiceInfo(there[0].type_name, _nodes(there)) for name, there in servers.items()
        }
        return topics, services

    def wants_history(self, topic: str) -> bool:
        """Return True if another process subscribes to `topic` as to a latched one."""
        with self._lock:
            there = self._graph.subscribers(topic)
        return any(each.qos.transient_local for each in there if each.zid != self.node.zid)

    def having(self, node: str) -> list[str]:
        """Return the ids of the other Zenoh sessions that have a node of this full name."""
        with self._lock:
            own = self.node.zid
            there = {each.zid for each in self._graph.entities() if each.full_node == node}
        return sorted(there - {own})

    def services(self) -> Mapping[str, ServiceInfo]:
        """Return all services by name."""
        with self._lock:
            if self._services is None:
                self._services = {
                    name: ServiceInfo(servers[0].type_name, _nodes(servers))
                    for name, servers in self._graph.by_name(SERVICE).items()
                }
            return self._services

    def nodes(self) -> Sequence[str]:
        """Return the full names of all nodes."""
        with self._lock:
            return self._graph.nodes()

    def lonely(self) -> bool:
        """Return True if no node of another process was met."""
        with self._lock:
            return len(self._graph.sessions()) < 2

    # -- endpoints -------------------------------------------------------------------------------

    def subscribe(self, topic: str, type_name: str | None, heard: Heard) -> Handle:
        """Call `heard` with each message of `topic`, also of a later revision of the type. Raises
        NetworkError."""
        with self._lock:
            senders = self._graph.publishers(topic)
        qos = LATCHED_QOS if any(each.qos.transient_local for each in senders) else DEFAULT_QOS
        if type_name is None and senders:
            type_name = senders[0].type_name
        entities: dict[str, Entity | None] = {}
        for each in filter(None, (type_name, revised(type_name or ""))):
            entity, key = self._entity(
                SUBSCRIPTION, topic, each, senders, latched=bool(qos.transient_local)
            )
            entities.setdefault(key, entity)
        if not entities:
            entities[f"{self.node.options.domain}{topic}/*/*"] = None

        def hear(sample: Any) -> None:
            attachment = sample.attachment
            meta = None if attachment is None else Attachment.decode(attachment.to_bytes())
            heard(sample.payload.to_bytes(), time.time_ns() if meta is None else meta.source_ns)

        declared = []
        for key, found in entities.items():
            declare = partial(self.node.declare_subscriber, key, hear, qos, deaf=self._deaf)
            declared.append(self._do(declare))
            if found is not None:
                declared.append(self._do(partial(self.node.declare_token, found)))
        return self._registered(_Declared(*declared))

    def advertise(
        self, topic: str, type_name: str, latched: bool, mark: str = ""
    ) -> PublisherHandle:
        """Return a publisher of `topic`; `mark`: type hash of a type that neither Cardan nor
        another node knows. Raises NetworkError."""
        with self._lock:
            others = [*self._graph.publishers(topic), *self._graph.subscribers(topic)]
        entity, key = self._entity(PUBLISHER, topic, type_name, others, latched, mark)
        urgency = Urgency.PICTURE if type_name in PICTURES else Urgency.COMMAND
        declared = self._do(lambda: self.node.declare_publisher(key, entity.qos, urgency=urgency))
        token = self._do(lambda: self.node.declare_token(entity))
        return self._registered(_Sender(declared, token, gid_of(entity, self.node.options.domain)))

    def call(
        self,
        service: str,
        type_name: str,
        request: bytes,
        answered: Answered,
        timeout_s: float | None,
    ) -> None:
        """Call a service; `answered` is called once, with a Failure if no reply arrives in
        `timeout_s`. Raises NetworkError."""
        client = self._client(service, type_name)
        attachment = Attachment(next(client.sequences), time.time_ns(), client.gid).encode()
        call = _Call(service, answered)
        handler = zenoh_module().handlers.Callback(call.take, call.end)
        wait_s = LONGEST_CALL_S if timeout_s is None else timeout_s
        self._do(lambda: self.node.ask(client.key, request, attachment, wait_s, handler))

    def _client(self, service: str, type_name: str) -> _Client:
        """Return the client of a service, which stays on the bus: its token shows the server that
        the client is still there."""
        with self._making:
            client = self._clients.get((service, type_name))
            if client is None:
                with self._lock:
                    servers = self._graph.servers(service)
                entity, key = self._entity(CLIENT, service, type_name, servers, latched=False)
                token = self._do(lambda: self.node.declare_token(entity))
                client = _Client(key, gid_of(entity, self.node.options.domain), token)
                self._clients[service, type_name] = client
            return client

    def serve(self, service: str, type_name: str, asked: Asked) -> Handle:
        """Offer a service; `asked` is called with each request. Raises NetworkError."""
        entity, key = self._entity(SERVICE, service, type_name, (), latched=False)

        def take(query: Any) -> None:
            request = ServiceRequest(query, key)

            def answer(reply: bytes | Failure) -> None:
                if isinstance(reply, Failure):
                    request.refuse(reply.reason)
                else:
                    request.reply(reply, time.time_ns())

            asked(request.data, answer)

        declared = self._do(lambda: self.node.declare_queryable(key, take))
        token = self._do(lambda: self.node.declare_token(entity))
        return self._registered(_Declared(declared, token))

    def _registered(self, given: _DeclaredT) -> _DeclaredT:
        self._given.add(given)
        return given

    def _entity(
        self,
        kind: str,
        name: str,
        type_name: str,
        others: Sequence[Entity],
        latched: bool,
        mark: str = "",
    ) -> tuple[Entity, str]:
        """Return a new endpoint; for a type unknown to Cardan, with the hash that others use."""
        qos = LATCHED_QOS if latched else DEFAULT_QOS
        try:
            return self.node.endpoint(kind, name, type_name, qos, mark)
        except InterfaceError as error:
            marks = [each.type_hash for each in others if each.type_name == type_name]
            if not marks:
                raise NetworkError(str(error)) from None
            return self.node.endpoint(kind, name, type_name, qos, marks[0])
        except RosNameError as error:
            raise NetworkError(str(error)) from None

    def _do(self, declare: Any) -> Any:
        try:
            return declare()
        except (DriverError, zenoh_module().ZError) as error:
            raise NetworkError(words_of(error)) from None


class _Part(BusNetwork):
    """Node beside another one, which watches the graph for both."""

    def __init__(self, whole: BusNetwork, name: str, namespace: str) -> None:
        super().__init__(whole.node.options, name, whole._deaf)
        self.node = BusNode(whole.node.options, name, namespace, beside=whole.node)
        self._whole = whole
        self._graph, self._lock, self._changed = whole._graph, whole._lock, whole._changed
        self._watches = whole._watches
        self.open()

    def open(self) -> None:
        """Appear on the bus. Raises DriverError."""
        self.node.open()

    def topics(self) -> Mapping[str, Topic]:
        """Return all topics by name."""
        return self._whole.topics()

    def services(self) -> Mapping[str, ServiceInfo]:
        """Return all services by name."""
        return self._whole.services()


def _topic(type_name: str, publishers: Sequence[Entity], subscribers: Sequence[Entity]) -> Topic:
    latched = any(each.qos.transient_local for each in publishers)
    return Topic(type_name, _nodes(publishers), _nodes(subscribers), latched)


def _nodes(entities: Sequence[Entity]) -> tuple[str, ...]:
    return tuple(sorted({each.full_node for each in entities}))


class _Declared:
    """Declarations of a Zenoh session, undeclared together."""

    def __init__(self, *declared: Any) -> None:
        self._declared = list(declared)

    def close(self) -> None:
        """Undeclare them; may be called twice."""
        while self._declared:
            with contextlib.suppress(zenoh_module().ZError):  # The session is closed already.
                self._declared.pop().undeclare()


class _Watch:
    """Listener for the departure of a service's last server. It uses the graph: a subscription may
    miss a token that appears while it is declared."""

    def __init__(
        self,
        watches: set[_Watch],
        lock: threading.Lock,
        service: str,
        gone: Callable[[], None],
        there: bool,
    ) -> None:
        self._watches, self._lock = watches, lock
        self._service, self._there = service, there
        self.gone = gone

    def left(self, graph: Graph) -> bool:
        """Return True if the last one has left by this change of the graph."""
        before, self._there = self._there, bool(graph.servers(self._service))
        return before and not self._there

    def undeclare(self) -> None:
        """Stop watching."""
        with self._lock:
            self._watches.discard(self)


class _Sender(_Declared):
    """Publisher for any thread."""

    def __init__(self, publisher: Any, token: Any, gid: bytes) -> None:
        super().__init__(publisher, token)
        self._publisher, self._gid = publisher, gid
        self._sequences = itertools.count(1)
        self._lock = threading.Lock()

    def publish(self, cdr: bytes, sent_ns: int = 0) -> None:
        """Publish a message."""
        with self._lock:
            attachment = Attachment(next(self._sequences), sent_ns or time.time_ns(), self._gid)
            self._publisher.put(cdr, attachment=attachment.encode())


class _Client:
    """Client of a service."""

    def __init__(self, key: str, gid: bytes, token: Any) -> None:
        self.key, self.gid = key, gid
        self.sequences = itertools.count(1)
        self._token = token  # Zenoh removes it from the bus with its last reference.


class _Call:
    """Call that waits for its reply."""

    def __init__(self, service: str, answered: Answered) -> None:
        self._service, self._answered = service, answered
        self._over = False

    def take(self, reply: Any) -> None:
        """Handle a reply."""
        if self._over:
            return
        self._over = True
        if reply.ok is not None:
            self._answered(reply.ok.payload.to_bytes())
        else:
            words = reply.err.payload.to_bytes().decode("utf-8", "replace")
            self._answered(Failure(f"{self._service}: {words[:300]}"))

    def end(self) -> None:
        """Handle the end of replies."""
        if not self._over:
            self._over = True
            self._answered(
                Failure(f"{self._service}: no reply: no server offers it, or it is late")
            )
