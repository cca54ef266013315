"""A ROS 2 node on the Zenoh bus, as rmw_zenoh makes one: publishers, subscriptions, services.

Messages wait in bounded channels of Zenoh's own threads until a loop polls them; no callback into
Python.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import re
import threading
import time
from collections.abc import Callable, Sequence
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from cardan.bus.options import BusOptions
from cardan.bus.reconnecting import Reconnector
from cardan.bus.tls import tls_obstacle
from cardan.common.context import enter, leave
from cardan.common.extras import missing_extra
from cardan.common.files import expanded
from cardan.common.inbox import Inbox, InboxEmptyError
from cardan.errors import ConfigurationError, DriverError, below
from cardan.protocols.ros2.interfaces import service_type
from cardan.protocols.ros2.names import checked_name
from cardan.protocols.ros2.zenoh import (
    ATTACHMENT,
    CLIENT,
    DEFAULT_QOS,
    LIVELINESS,
    NODE,
    PUBLISHER,
    SERVICE,
    SUBSCRIPTION,
    Attachment,
    Entity,
    Qos,
    data_key,
    endpoint_hash,
    strange_key,
    token_pattern,
)

if TYPE_CHECKING:  # Sessions without a bus do not need the package.
    import zenoh

MAX_REQUESTS = 32
"""Largest number of waiting requests to a service; beyond it the oldest get no reply."""

MAX_TOKENS = 16_384
"""Largest number of waiting tokens: more than all nodes of a large robot have, because a lost token
would keep a departed node in the graph."""

LEASE_MS = 2000
"""Zenoh lease: time without a sign of life after which peers drop this session. A source keeps its
authority as long without renewal. Zenoh sends a sign of life four times in it."""

CLIENT_CONNECT_MS = 5000
"""Longest wait of a client for its router, without which it cannot begin: a router started at the
same time takes two seconds on a small computer."""

RETRY_MS = 200, 2000
"""First and longest pause between attempts to connect."""

CALL_TIMEOUT_S = 5.0
"""Longest wait for a service's reply, unless the caller sets another."""

AT_ONCE_S = 1e-3
"""Shortest time between messages of which the second is processed in Zenoh's thread, too."""

TX_BATCHES = 16
"""Number of 64 kB batches that wait for a link, the largest that Zenoh allows: with its default of
two, a link that stalls for 40 ms loses messages of a session that is recorded."""

SEND_BYTES = 32_768
"""Size of a link's buffer in the kernel, which doubles it: its content is sent before any command.
With the kernel's default, 2 MB and more of images precede a reply, 8 s at 2 Mbit/s."""

_log = logging.getLogger(__name__)

_GID_BYTES = 16
_PLACE = re.compile(r" at \S*\.rs:\d+\.?")
"""Place in Zenoh's sources that raised an error."""
_NETWORK = "the network"


class Urgency(Enum):
    """Priority on a full link; by the names of Zenoh's priorities."""

    COMMAND = "INTERACTIVE_HIGH"
    """Commands, and calls of services with their replies."""
    STATE = "DATA"
    """Default of ROS 2 nodes."""
    PICTURE = "BACKGROUND"

    @property
    def priority(self) -> Any:
        """Return Zenoh's priority."""
        return getattr(zenoh_module().Priority, self.value)


class Received(NamedTuple):
    """A message that a subscription received."""

    data: bytes
    """CDR with its encapsulation."""
    key: str
    """Key expression; its last two parts are the sender's type and type hash."""
    attachment: Attachment | None
    stamp: Any = None
    """Zenoh's timestamp, None if it has none."""

    @property
    def zid(self) -> str:
        """Return the id of the Zenoh session that stamped it; empty if none did."""
        return "" if self.stamp is None else str(self.stamp.get_id())


class TokenWatch:
    """Liveliness tokens on the bus: the present ones, and changes."""

    def __init__(self, node: BusNode, key: str) -> None:
        zenoh = zenoh_module()
        ring = zenoh.handlers.RingChannel(MAX_TOKENS)
        self._put = zenoh.SampleKind.PUT
        self._watcher = node.declare_watcher(key, ring)
        self._try_recv = self._watcher.handler.try_recv

    def poll(self) -> tuple[str, bool] | None:
        """Return the next token that has appeared (True) or vanished (False), or None."""
        sample = self._try_recv()
        return None if sample is None else (str(sample.key_expr), sample.kind == self._put)


class Publisher:
    """Publisher of messages of one type on one topic. For one thread."""

    def __init__(self, node: BusNode, entity: Entity, key: str, *, express: bool = False) -> None:
        self.entity = entity
        self._attachment = bytearray(ATTACHMENT.size)
        self._gid = gid_of(entity, node.options.domain)
        self._sequence = 0
        # For a session: messages that wait for a link are sent in batches. It costs up to 1 ms.
        urgency = Urgency.COMMAND if express else Urgency.STATE
        self._publisher = node.declare_publisher(key, entity.qos, express, urgency)
        self._reliable = self._publisher
        if not entity.qos.reliable:
            reliable = entity.qos._replace(reliable=True)
            self._reliable = node.declare_publisher(key, reliable, express, urgency)
        self._gone = contextlib.suppress(zenoh_module().ZError)
        """The bus was closed while another thread still publishes."""
        self._token = node.declare_token(entity)

    def put(self, data: bytes | bytearray, now_ns: int) -> None:
        """Publish an encoded message; `now_ns`: time since the epoch. Never waits for a reader."""
        self._sequence += 1
        self.put_as(self._sequence, data, now_ns)

    def put_as(self, sequence: int, data: bytes | bytearray, now_ns: int) -> None:
        """Publish with a given sequence number, for a simulated network that loses, repeats or
        reorders messages."""
        self._put(self._publisher, sequence, data, now_ns)

    def put_reliably(self, data: bytes | bytearray, now_ns: int) -> None:
        """Publish reliably a message that no later one replaces, on a best-effort publisher. It may
        overtake earlier ones."""
        self._sequence += 1
        self._put(self._reliable, self._sequence, data, now_ns)

    def _put(self, publisher: Any, sequence: int, data: bytes | bytearray, now_ns: int) -> None:
        attachment = self._attachment
        ATTACHMENT.pack_into(attachment, 0, sequence, now_ns, _GID_BYTES, self._gid)
        with self._gone:
            publisher.put(data, attachment=attachment)

    @property
    def heard(self) -> bool:
        """Return True if there is a subscriber; always true for a latched topic."""
        status = getattr(self._publisher, "matching_status", None)
        return status is None or bool(status.matching)

    def close(self) -> None:
        """Leave the graph."""
        self._token.undeclare()
        self._publisher.undeclare()
        if self._reliable is not self._publisher:
            self._reliable.undeclare()


class Subscription:
    """Subscription to one topic, whatever type the senders declare."""

    def __init__(self, node: BusNode, entity: Entity, key: str, depth: int) -> None:
        self.entity = entity
        ring = zenoh_module().handlers.RingChannel(depth)
        self._subscriber = node.declare_subscriber(key, ring, entity.qos)
        self._try_recv = self._subscriber.handler.try_recv
        self._token = node.declare_token(entity)

    def poll(self) -> Received | None:
        """Return the oldest message in the queue, or None."""
        sample = self._try_recv()
        return None if sample is None else _received(sample)

    def close(self) -> None:
        """Leave the graph."""
        self._token.undeclare()
        self._subscriber.undeclare()


def _received(sample: Any) -> Received:
    attachment = sample.attachment
    return Received(
        sample.payload.to_bytes(),
        str(sample.key_expr),
        None if attachment is None else Attachment.decode(attachment.to_bytes()),
        sample.timestamp,
    )


class WaitingSubscription:
    """Subscription to one topic for a thread that sleeps until a message arrives.

    Zenoh's channels block without a timeout or not at all. Thus Zenoh's thread puts each message
    into an inbox, at a cost of some µs, and the reader waits for the inbox. It wakes within 0.13 ms
    (p50) of publication on loopback, 0.7 ms (p99); polling every 0.2 ms takes twice as long.
    """

    handler: Callable[[Received], object] | None = None
    """Takes a message in Zenoh's thread, without the delay of the waiting one, whose wait ends
    without it. It must be quick and not raise. Messages that follow another one within AT_ONCE_S
    are queued as ever: a flood costs Zenoh's thread some µs each, and its newest ones count."""

    def __init__(self, node: BusNode, entity: Entity, key: str, depth: int) -> None:
        self.entity = entity
        self._inbox: Inbox[Any] = Inbox(max(1, depth))
        self._heard_s = 0.0
        # Not indirect: one thread less to wake.
        handler = zenoh_module().handlers.Callback(self._hear, indirect=False)
        self._subscriber = node.declare_subscriber(key, handler, entity.qos)
        self._token = node.declare_token(entity)

    def _hear(self, sample: Any) -> None:
        """Keep the newest messages; runs in a thread of Zenoh."""
        heard_s, self._heard_s = self._heard_s, time.monotonic()
        handler = self.handler
        if handler is not None and self._heard_s >= heard_s + AT_ONCE_S and not self._inbox:
            handler(_received(sample))
            sample = None
        self._inbox.put(sample)

    def wait(self, timeout_s: float) -> Received | None:
        """Return the oldest message in the queue, or the next one; None if none arrives in time."""
        try:
            sample = self._inbox.get(timeout_s)
        except InboxEmptyError:
            return None
        return None if sample is None else _received(sample)

    def poll(self) -> Received | None:
        """Return the oldest message in the queue, or None."""
        return self.wait(0.0)

    def wake(self) -> None:
        """End a wait in another thread, without a message."""
        self._inbox.put(None)

    def close(self) -> None:
        """Leave the graph."""
        self._token.undeclare()
        self._subscriber.undeclare()


class MatchedEndpoints:
    """Publishers, subscribers or servers of one name, by the liveliness tokens of the bus.

    A node that closes or dies is removed at once; a node whose computer vanishes, at the end of its
    lease.
    """

    def __init__(self, node: BusNode, kind: str, name: str) -> None:
        self._own = node.zid
        self._there: dict[str, Entity] = {}
        self._tokens = TokenWatch(node, token_pattern(node.options.domain, kind, name))

    def others(self) -> list[Entity]:
        """Return the present endpoints of other processes. Never blocks."""
        while (change := self._tokens.poll()) is not None:
            token, there = change
            entity = Entity.parse(token)
            if not there:
                self._there.pop(token, None)
            elif entity is not None and entity.zid != self._own:
                self._there[token] = entity
        return list(self._there.values())


class ServiceRequest:
    """Request to a service; `reply` answers it once, from any thread."""

    def __init__(self, query: Any, key: str) -> None:
        self._query, self._key = query, key
        payload, attachment = query.payload, query.attachment
        self.data = b"" if payload is None else payload.to_bytes()
        """CDR of the request, with its encapsulation."""
        self.attachment = None if attachment is None else Attachment.decode(attachment.to_bytes())

    def reply(self, data: bytes, now_ns: int) -> None:
        """Answer with an encoded response; without effect if the client is gone."""
        asked = self.attachment or Attachment(0, 0, bytes(_GID_BYTES))
        attachment = Attachment(asked.sequence, now_ns, asked.gid).encode()
        with contextlib.suppress(zenoh_module().ZError):
            self._query.reply(self._key, data, attachment=attachment)
            self._query.drop()

    def refuse(self, reason: str) -> None:
        """Reply that this is not a valid request of the service."""
        with contextlib.suppress(zenoh_module().ZError):
            self._query.reply_err(reason.encode())
            self._query.drop()


class Service:
    """Offers a service."""

    def __init__(self, node: BusNode, entity: Entity, key: str) -> None:
        self.entity = entity
        self._key = key
        ring = zenoh_module().handlers.RingChannel(MAX_REQUESTS)
        self._queryable = node.declare_queryable(key, ring)
        self._try_recv = self._queryable.handler.try_recv
        # A node that sees the token may call at once; it is declared last.
        self._token = node.declare_token(entity)

    def poll(self) -> ServiceRequest | None:
        """Return the oldest waiting request, or None."""
        query = self._try_recv()
        return None if query is None else ServiceRequest(query, self._key)

    def close(self) -> None:
        """Leave the graph; open requests get no answer."""
        self._token.undeclare()
        self._queryable.undeclare()


class Client:
    """Calls a service."""

    def __init__(self, node: BusNode, entity: Entity, key: str) -> None:
        self.entity = entity
        self._node, self._key = node, key
        self._token = node.declare_token(entity)
        self._gid = gid_of(entity, node.options.domain)
        self._sequences = itertools.count(1)

    def call(self, data: bytes, timeout_s: float = CALL_TIMEOUT_S) -> bytes | None:
        """Return the service's encoded response; None if none arrives in time. Blocks."""
        attachment = Attachment(next(self._sequences), time.time_ns(), self._gid).encode()
        return self._node.get(self._key, data, attachment, timeout_s)

    def ask(self, data: bytes, answered: Callable[[bytes], None], timeout_s: float) -> None:
        """Call without waiting, after earlier requests: `answered` gets the response in a thread of
        Zenoh, if one arrives in time."""
        attachment = Attachment(next(self._sequences), time.time_ns(), self._gid).encode()

        def take(reply: Any) -> None:
            if reply.ok is not None:
                answered(bytes(reply.ok.payload.to_bytes()))

        handler = zenoh_module().handlers.Callback(take)
        self._node.ask(self._key, data, attachment, timeout_s, handler)

    def close(self) -> None:
        """Leave the graph."""
        self._token.undeclare()


class BusNode:
    """ROS 2 node with its own Zenoh session.

    ::

    with BusNode(BusOptions(), "gateway") as node:
            pose = node.publisher("/arm/state/pose", "geometry_msgs/msg/PoseStamped")
            pose.put(data, time.time_ns())
    """

    def __init__(
        self,
        options: BusOptions,
        name: str,
        namespace: str = "/",
        beside: BusNode | None = None,
    ) -> None:
        """`namespace`: "/" or "/NAME", before names without a leading slash. `beside`: an open node
        whose Zenoh session this one shares, with the same options."""
        self.options, self.name, self.namespace = options, name, namespace
        self._beside = beside
        self._session: zenoh.Session | None = None
        self._reconnector: Reconnector | None = None
        self._zid = ""
        self._entities: itertools.count[int] = (
            itertools.count(1) if beside is None else beside._entities
        )
        """Numbers of nodes and endpoints, unique in a Zenoh session."""
        self._id = "0" if beside is None else str(next(self._entities))
        self._node_token: Any = None
        self._watchers: list[Any] = []
        self._lock = threading.Lock()

    # -- open and close --------------------------------------------------------------------------

    def open(self) -> None:
        """Join the bus, and appear on it. Raises ExtraMissingError, ConfigurationError, or
        DriverError."""
        self.join()
        if self._node_token is None:
            entity = Entity(self._zid, self._id, self._id, NODE, self.namespace, self.name)
            self._node_token = self.declare_token(entity)

    def join(self) -> None:
        """Join the bus for discovery, without a node token. Raises as `open` does."""
        if self._session is not None:
            return
        if self._beside is not None:
            self._session = self._beside._opened()
        else:
            zenoh = zenoh_module()
            config = zenoh_config(self.options)
            try:
                self._session = zenoh.open(config)
            except zenoh.ZError as error:
                raise DriverError(
                    tls_obstacle(config)
                    or f"the bus cannot be joined: {words_of(error)}{_advice(error)}"
                ) from None
            make_config = partial(zenoh_config, self.options)
            self._reconnector = Reconnector(zenoh, self._session, make_config)
        self._zid = str(self._session.info.zid())

    def close(self) -> None:
        """Leave the bus; close its endpoints first if another node shares the session. Never
        raises; may be called twice."""
        with self._lock:
            session, self._session = self._session, None
            self._node_token = None  # Zenoh removes it from the bus with the last reference.
            reconnector, self._reconnector = self._reconnector, None
        if reconnector is not None:
            reconnector.close()
        if session is not None and self._beside is None:
            close_session(session)

    __enter__ = enter
    __exit__ = leave

    @property
    def zid(self) -> str:
        """Return the id of its Zenoh session, once it is open."""
        return self._zid

    @property
    def full_name(self) -> str:
        """The node's full name."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    # -- endpoints -------------------------------------------------------------------------------

    def publisher(
        self, name: str, type_name: str, qos: Qos = DEFAULT_QOS, *, express: bool = False
    ) -> Publisher:
        """Return a publisher of a topic. `express`: for commands, each sent at once, separately and
        before other messages. Raises InterfaceError or RosNameError."""
        entity, key = self.endpoint(PUBLISHER, name, type_name, qos)
        return Publisher(self, entity, key, express=express)

    def subscription(
        self, name: str, type_name: str, depth: int, qos: Qos = DEFAULT_QOS
    ) -> Subscription:
        """Return a subscription that keeps the newest `depth` messages for `poll`.

        It receives every type on the topic, for an error message about a wrong type. Raises
        InterfaceError or RosNameError.
        """
        entity, _ = self.endpoint(SUBSCRIPTION, name, type_name, qos)
        key = f"{self.options.domain}{entity.name}/*/*"
        return Subscription(self, entity, key, depth)

    def waiting_subscription(
        self, name: str, type_name: str, depth: int, qos: Qos = DEFAULT_QOS
    ) -> WaitingSubscription:
        """Return the same for a thread that waits for messages. In a session's loop only the
        robot's driver uses it. Raises InterfaceError or RosNameError."""
        entity, _ = self.endpoint(SUBSCRIPTION, name, type_name, qos)
        key = f"{self.options.domain}{entity.name}/*/*"
        return WaitingSubscription(self, entity, key, depth)

    def presence(self, kind: str, name: str) -> MatchedEndpoints:
        """Return the nodes with an endpoint of a `kind` (PUBLISHER, SUBSCRIPTION, SERVICE) with
        this name. Raises RosNameError."""
        return MatchedEndpoints(self, kind, self.full_name_of(name))

    def service(self, name: str, type_name: str, qos: Qos = DEFAULT_QOS) -> Service:
        """Return a server of a service. Raises InterfaceError or RosNameError."""
        service_type(type_name)
        entity, key = self.endpoint(SERVICE, name, type_name, qos)
        return Service(self, entity, key)

    def client(self, name: str, type_name: str, qos: Qos = DEFAULT_QOS) -> Client:
        """Return a client of a service. Raises InterfaceError or RosNameError."""
        service_type(type_name)
        entity, key = self.endpoint(CLIENT, name, type_name, qos)
        return Client(self, entity, key)

    def watch_graph(self, changed: Callable[[str, bool], None]) -> None:
        """Call `changed(token, there)` in a thread of Zenoh for each token of the domain, present
        ones first. Not for a process with a control loop."""
        zenoh = zenoh_module()

        def hear(sample: Any) -> None:
            changed(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._watchers.append(self.declare_watcher(f"{LIVELINESS}/{self.options.domain}/**", hear))

    def watch_tokens(self, key: str = "") -> TokenWatch:
        """Return the tokens of a key expression (default: of the domain) for polling, present ones
        first."""
        return TokenWatch(self, key or f"{LIVELINESS}/{self.options.domain}/**")

    def neighbors(self) -> tuple[list[str], list[str]]:
        """Return the ids of the connected routers and peers."""
        info = self._opened().info
        return [str(each) for each in info.routers_zid()], [str(each) for each in info.peers_zid()]

    def endpoint(
        self, kind: str, name: str, type_name: str, qos: Qos, mark: str = ""
    ) -> tuple[Entity, str]:
        """Return a new entity of this node and its key expression. `mark`: type hash of a type that
        Cardan does not know. Raises InterfaceError or RosNameError."""
        full = self.full_name_of(name)
        known = not mark
        mark = mark or endpoint_hash(type_name, self._hashed)
        number = str(next(self._entities))
        entity = Entity(
            self._zid, self._id, number, kind, self.namespace, self.name, full, type_name, mark, qos
        )
        key = self.key_of(full, type_name) if known else strange_key(entity, self.options.domain)
        return entity, key

    def full_name_of(self, name: str) -> str:
        """Return the absolute name for a relative or private one. Raises RosNameError."""
        return checked_name(
            name if name[:1] in "/~" else f"{self.namespace.rstrip('/')}/{name}", self.full_name
        )

    def key_of(self, name: str, type_name: str) -> str:
        """Return the key expression of an absolute name with a type. Raises InterfaceError."""
        return data_key(self.options.domain, name, type_name, self._hashed)

    @property
    def _hashed(self) -> bool:
        return self.options.distribution != "humble"

    # -- Zenoh -----------------------------------------------------------------------------------

    def declare_publisher(
        self, key: str, qos: Qos, express: bool = True, urgency: Urgency = Urgency.STATE
    ) -> Any:
        """Declare Zenoh's publisher; one of latched messages keeps them for late subscribers.
        `express`: each message is sent separately, at once."""
        zenoh = zenoh_module()
        reliability = zenoh.Reliability
        # DROP: a full link loses messages and never blocks the publisher.
        options = {
            # Over TCP and TLS both are the same; QUIC sends best-effort messages in datagrams.
            "reliability": reliability.RELIABLE if qos.reliable else reliability.BEST_EFFORT,
            "congestion_control": zenoh.CongestionControl.DROP,
            "priority": urgency.priority,
            "express": express,
        }
        if not qos.transient_local:
            return self._opened().declare_publisher(key, **options)
        import zenoh.ext as ext

        return ext.declare_advanced_publisher(
            self._opened(),
            key,
            cache=ext.CacheConfig(max_samples=qos.depth),
            publisher_detection=True,
            **options,
        )

    def declare_subscriber(self, key: str, handler: Any, qos: Qos, deaf: bool = False) -> Any:
        """Declare Zenoh's subscriber; for a latched topic, with a query for earlier messages.
        `handler`: Zenoh's channel or a callback. `deaf`: ignore this session's own messages."""
        locality = zenoh_module().Locality
        origin = locality.REMOTE if deaf else locality.ANY
        if not qos.transient_local:
            return self._opened().declare_subscriber(key, handler, allowed_origin=origin)
        import zenoh.ext as ext

        return ext.declare_advanced_subscriber(
            self._opened(),
            key,
            handler,
            allowed_origin=origin,
            history=ext.HistoryConfig(detect_late_publishers=True),
        )

    def declare_queryable(self, key: str, handler: Any) -> Any:
        """Declare Zenoh's queryable. rmw_zenoh queries only those that are declared complete."""
        return self._opened().declare_queryable(key, handler, complete=True)

    def ask(self, key: str, data: bytes, attachment: bytes, timeout_s: float, handler: Any) -> None:
        """Send a request; `handler` is Zenoh's callback for its replies."""
        self._opened().get(
            key,
            handler,
            payload=data,
            attachment=attachment,
            timeout=timeout_s,
            priority=Urgency.COMMAND.priority,
        )

    def get(self, key: str, data: bytes, attachment: bytes, timeout_s: float) -> bytes | None:
        """Return the first reply to a request; None if none arrives in time."""
        replies = self._opened().get(
            key,
            payload=data,
            attachment=attachment,
            timeout=timeout_s,
            priority=Urgency.COMMAND.priority,
        )
        for reply in replies:
            if reply.ok is not None:
                return bytes(reply.ok.payload.to_bytes())
        return None

    def declare_watcher(self, key: str, handler: Any) -> Any:
        """Declare Zenoh's subscriber of liveliness tokens; `handler` as in `declare_subscriber`."""
        return self._opened().liveliness().declare_subscriber(key, handler, history=True)

    def declare_token(self, entity: Entity) -> Any:
        """Declare the liveliness token of an entity, present until it is undeclared."""
        return self.declare_key_token(entity.token(self.options.domain))

    def declare_key_token(self, key: str) -> Any:
        """Declare a liveliness token by its key, present until it is undeclared."""
        return self._opened().liveliness().declare_token(key)

    def _opened(self) -> zenoh.Session:
        if self._session is None:
            raise DriverError("the bus is not open: use the node in a with statement, or open() it")
        return self._session


def zenoh_module() -> Any:
    """Import the package of the bus. Raises ExtraMissingError."""
    try:
        import zenoh
    except ImportError as error:
        raise missing_extra(_NETWORK, "eclipse-zenoh", "network", error) from error
    return zenoh


def zenoh_config(options: BusOptions) -> Any:
    """Return Zenoh's configuration of a session. Raises ConfigurationError."""
    listen = options.listen if options.mode == "peer" else ()
    connect = (options.router,) if options.router else ()
    return _config(options.mode, listen, connect, options.zenoh_config)


def router_config(listen: Sequence[str], connect: Sequence[str], file: str) -> Any:
    """Return Zenoh's configuration of a router; a non-empty `file` is used unchanged instead.
    Raises ConfigurationError."""
    return _config("router", listen, connect, file)


def _config(mode: str, listen: Sequence[str], connect: Sequence[str], file: str) -> Any:
    zenoh = zenoh_module()
    if file:
        with below("zenoh_config"):
            path = expanded(file)
        try:
            return zenoh.Config.from_file(path)
        except zenoh.ZError as error:
            raise ConfigurationError("zenoh_config", words_of(error)) from None
    config = zenoh.Config()
    for key, value in zenoh_settings(mode, listen, connect).items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigurationError(key.split("/")[0], words_of(error)) from None
    return config


def zenoh_settings(mode: str, listen: Sequence[str], connect: Sequence[str]) -> dict[str, object]:
    """Return the Zenoh settings that Cardan sets, by key paths ("listen/endpoints")."""
    return {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        # Retry until the router appears: 0 would try once, and -1 blocks a client.
        "connect/timeout_ms": {"router": -1, "peer": -1, "client": CLIENT_CONNECT_MS},
        "connect/exit_on_failure": {"router": False, "peer": False, "client": True},
        "connect/retry": {
            "period_init_ms": RETRY_MS[0],
            "period_max_ms": RETRY_MS[1],
            "period_increase_factor": 2,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        # Needed by publishers that keep messages for late subscribers; it also identifies a
        # message's sender.
        "timestamping/enabled": True,
        "transport/link/tx/lease": LEASE_MS,
        # Closing waits for pending connections: 10 s if a peer hangs.
        "transport/unicast/open_timeout": LEASE_MS,
        "transport/link/tx/queue/size/data": TX_BATCHES,
        "transport/link/tx/queue/size/interactive_high": TX_BATCHES,
        "transport/link/tcp/so_sndbuf": SEND_BYTES,
        "transport/link/tls/so_sndbuf": SEND_BYTES,
        # Its files stay in /dev/shm, up to 16 MB each, when a process is killed.
        "transport/shared_memory/enabled": False,
    }


def gid_of(entity: Entity, domain: int) -> bytes:
    """Return the unique id (GID) of an endpoint."""
    return gid_of_token(entity.token(domain))


def gid_of_token(token: str) -> bytes:
    """Return the GID of the entity with this token: rmw_zenoh's hash of its key expression."""
    try:
        from xxhash import xxh3_128_intdigest
    except ImportError as error:
        raise missing_extra(_NETWORK, "xxhash", "network", error) from error
    # Low half first, each half with its low byte first, as in rmw_zenoh's liveliness_utils.cpp.
    return xxh3_128_intdigest(token.encode()).to_bytes(_GID_BYTES, "little")


def _advice(error: Exception) -> str:
    if "Unable to connect" in str(error):
        return (
            "; start a router there (`cardan net server router --endpoint ENDPOINT`), and see "
            "that the network lets it be reached; of a paired computer give its file (zenoh_config)"
        )
    if "Address already in use" not in str(error):
        return ""
    return (
        "; another program already listens there, such as the router that a session with [network] "
        "starts: choose another address, or port 0 for any"
    )


def close_session(session: Any) -> None:
    """Close a Zenoh session: an interpreter that ends with an open one hangs. Never raises."""
    try:
        session.close()
    except zenoh_module().ZError as error:  # After 10 s.
        _log.warning("error while leaving the bus: %s", words_of(error))


def words_of(error: Exception) -> str:
    """Return Zenoh's error message, in one line and without the places in its own source code."""
    return _PLACE.sub("", " ".join(str(error).split()))[:300]
