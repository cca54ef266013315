"""Connection of a client to the Foxglove server: its own foxglove-sdk server, and a relay.

The SDK serves topics, services, assets and the graph. Its callbacks must not wait, and it does not
distinguish clients; thus parameters and the reasons of refusals are answered here. The queue for a
slow client is bounded as in every server: the newest message of each topic wins.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import json
import logging
import secrets
import socket
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.typing import Subprotocol

from cardan.bus.network import Handle, Network, NetworkError, ServiceInfo, Topic
from cardan.common.extras import missing_extra
from cardan.errors import DriverError, shown
from cardan.gateway.arm.backlog import STALE_S, is_stale, stale_words
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.calls import CallError, Mailbox, ServiceCaller
from cardan.gateway.servers.connection import SendLoop, ready
from cardan.gateway.servers.graph import definition
from cardan.gateway.servers.parameters import REFUSALS as PARAMETER_REFUSALS, NodeParameters
from cardan.gateway.servers.publishing import Advertisements, RefusedError
from cardan.gateway.servers.read_only import READING_SERVICES
from cardan.gateway.servers.send_queue import LATCHED_DEPTH, TopicQueue
from cardan.gateway.servers.subscriptions import SharedSubscriptions, TopicSubscription
from cardan.gateway.servers.web import ListenerConnection
from cardan.protocols.rate import MAX_PUBLICATIONS_PER_S, RateLimit
from cardan.protocols.ros2.cdr import CdrError, MalformedCdr, Message, codec_of
from cardan.protocols.ros2.interfaces import InterfaceError, full_text, service_type
from cardan.protocols.ros2.messages import MessageError, Stamp, completed
from cardan.protocols.ros2.names import RosNameError
from cardan.protocols.ros2.parameters import content_of
from cardan_foxglove import protocol
from cardan_foxglove.assets import Packages
from cardan_foxglove.protocol import CDR, JSON, ROS2MSG

CLOCK, CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
"""Topic of the time of a simulation or a replay."""

BACKLOG = 256
"""Frames that the SDK queues for the relay, which reads them at once."""

MAX_CALLS = 100
"""Most unanswered calls of a client, and most requests for parameters."""

MAX_SUBSCRIPTIONS = 1000
"""Most subscriptions of a client."""

MAX_REPORTED = 1000
"""Most refusals that are remembered, to avoid repeated reports."""

INTRODUCTION_S = 5.0
"""Longest wait for the SDK's server to identify its client."""

_CHANNEL = 2**32 - 1
"""Channel of the introduction; it is unadvertised before the client may use the number."""

_REFUSALS = (
    RefusedError,
    InterfaceError,
    MessageError,
    RosNameError,
    CdrError,
    NetworkError,
    CallError,
    ValueError,
)

_log = logging.getLogger(__name__)
_library_log = logging.getLogger(f"{__name__}.websockets")
_library_log.setLevel(logging.CRITICAL)


def sdk() -> Any:
    """The package of the server. Raises ExtraMissingError."""
    try:
        import foxglove
        import foxglove.websocket
    except ImportError as error:
        raise missing_extra("the Foxglove server", "foxglove-sdk", "foxglove", error) from error
    return foxglove


class AdvertisedGraph(NamedTuple):
    """Topics and services visible to clients."""

    topics: Mapping[str, Topic]
    services: Mapping[str, ServiceInfo]


class Pace(NamedTuple):
    """Pace of a topic's messages to a client."""

    throttle_s: float
    queue_length: int


NEWEST, ALL = Pace(0.0, 0), Pace(0.0, LATCHED_DEPTH)


class FoxgloveSubscription(TopicSubscription[int, Any]):
    """Topic that is forwarded to the SDK's channels of all clients, by the channels' numbers."""

    def _hear(self, cdr: bytes, stamp_ns: int) -> None:
        for channel in list(self.receivers.values()):
            channel.log(cdr, stamp_ns)


FoxgloveSubscriptions = SharedSubscriptions[FoxgloveSubscription]


def shared_subscriptions(network: Network) -> FoxgloveSubscriptions:
    """Return the subscriptions of a server."""
    return SharedSubscriptions(partial(FoxgloveSubscription, network))


class _Channel(NamedTuple):
    """Topic that the client sees."""

    topic: Topic
    channel: Any


class _Published(NamedTuple):
    """Channel that the client publishes on."""

    topic: str
    encoding: str


class FoxgloveConnection:
    """Connected client in an event loop; leaving the ``async with`` removes all that it had."""

    def __init__(
        self,
        connection: ListenerConnection,
        peer: str,
        network: Network,
        caller: ServiceCaller,
        mailbox: Mailbox,
        subscriptions: FoxgloveSubscriptions,
        allowed: Allowed,
        packages: Packages,
        counts: Counter[str],
        shown: AdvertisedGraph,
        *,
        max_bytes: int,
        service_timeout_s: float,
    ) -> None:
        """`network`: of this client alone. `max_bytes`: limit of unread messages other than
        publications."""
        self._connection, self._peer = connection, peer
        self._network, self._caller, self._mailbox = network, caller, mailbox
        self._shared_subscriptions, self._counts, self._packages = subscriptions, counts, packages
        self._allowed = allowed
        self._first = shown
        self._service_timeout_s = service_timeout_s
        self._loop = asyncio.get_running_loop()
        self._sender: SendLoop[Pace, bytes] = SendLoop(
            connection, peer, max_bytes, counts, lambda _stream, frame: (frame,)
        )
        self._parameters = NodeParameters(network, caller, allowed)
        self._in_order = asyncio.Lock()
        self._advertised = Advertisements(network, allowed)
        self._published: dict[int, _Published] = {}
        self._publications = RateLimit(MAX_PUBLICATIONS_PER_S)
        self._channels: dict[str, _Channel] = {}
        self._topic_of: dict[int, str] = {}
        self._joined: dict[int, FoxgloveSubscription] = {}
        self._late_calls: dict[int, float] = {}
        """Waiting time, s, of calls that waited too long to be executed, by their numbers."""
        self._services: dict[str, str] = {}
        self._graph: AdvertisedGraph | None = None
        self._streams: dict[int, TopicQueue[Pace, bytes]] = {}
        self._time: TopicQueue[Pace, bytes] = TopicQueue("time", NEWEST)
        self._clock: Handle | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._calls: set[concurrent.futures.Future[bytes]] = set()
        self._reported: dict[str, str] = {}
        self._logged = False
        self._gone = False
        self._introduced = asyncio.Event()
        self._name = secrets.token_hex(16)
        """Secret that identifies the relay among the clients of the SDK's server."""
        self._id: int | None = None
        """The SDK's id of the relay's connection to its server."""

    async def __aenter__(self) -> FoxgloveConnection:
        foxglove = sdk()
        capability = foxglove.websocket.Capability
        capabilities = [
            capability.ClientPublish,
            capability.ConnectionGraph,
            capability.Parameters,
            capability.Services,
        ]
        if CLOCK in self._first.topics:
            capabilities.append(capability.Time)
        self._context = foxglove.Context()
        host = _hidden_address()
        try:
            self._server = foxglove.start_server(
                name="Cardan",
                host=host,
                port=0,
                capabilities=capabilities,
                server_listener=_Listener(self),
                supported_encodings=[CDR, JSON],
                asset_handler=self._packages.read,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except (OSError, RuntimeError) as error:
            raise DriverError(f"foxglove-sdk's server does not start: {error}") from None
        try:
            self.show(self._first)
            self._inner = await _connected(host, self._server.port)
            await self._sender.__aenter__()
            self._start(self._pump())
            await self._introduce()
            if CLOCK in self._first.topics:
                self._clock = self._network.subscribe(CLOCK, CLOCK_TYPE, self._hear_clock)
        except BaseException:
            self._leave()
            raise
        return self

    async def __aexit__(self, *_exception: object) -> None:
        self._leave()
        await self._sender.__aexit__()
        # Without a close handshake, which an ended SDK server does not answer.
        self._inner.transport.abort()
        await self._inner.wait_closed()

    async def _introduce(self) -> None:
        """Identify the relay to the SDK's server: any other client has bypassed the access control
        of the listener."""
        await self._inner.send(protocol.advertise(_CHANNEL, self._name))
        try:
            await asyncio.wait_for(self._introduced.wait(), INTRODUCTION_S)
        except asyncio.TimeoutError:
            raise DriverError("foxglove-sdk's server does not answer") from None
        await self._inner.send(protocol.unadvertise(_CHANNEL))

    # -- what passes -----------------------------------------------------------------------------

    async def relay(self) -> None:
        """Relay the client's messages until it disconnects."""
        async for frame in self._connection:
            await self._receive(frame)

    async def _receive(self, frame: str | bytes) -> None:
        if isinstance(frame, bytes):
            published = protocol.published_channel(frame)
            if published is not None and self._publications.exceeded(self._loop.time()):
                self._refuse(
                    f"channel {published}",
                    f"more than {MAX_PUBLICATIONS_PER_S} messages in a second; the others are lost",
                )
                return
            if published is not None and self._is_stale(published):
                self._counts["stale"] += 1
                return
            called = protocol.call_number(frame)
            if called is not None:
                self._note_late(called)
        else:
            asked = protocol.parse_operation(frame)
            waited_s = self._connection.waited_s
            if isinstance(asked, protocol.GetParameters):
                self._ask(self._get_parameters(asked))
                return
            if isinstance(asked, protocol.SetParameters) and is_stale("", waited_s):
                self._counts["stale"] += 1
                self._refuse("parameters", stale_words("setting parameters", waited_s))
                return
            if isinstance(asked, protocol.SetParameters):
                self._ask(self._set_parameters(asked))
                return
            if isinstance(asked, protocol.Subscribe) and not self._expect(asked):
                return
            if isinstance(asked, protocol.Unsubscribe):
                for number in asked.ids:
                    stream = self._streams.pop(number, None)
                    if stream is not None:
                        self._sender.outbox.forget(stream)
        try:
            await self._inner.send(frame)
        except ConnectionClosed:
            await self._close("the server of the SDK has ended")

    def _is_stale(self, channel: int) -> bool:
        known = self._published.get(channel)
        return known is not None and is_stale(known.topic, self._connection.waited_s)

    def _note_late(self, number: int) -> None:
        """Record how long a service call waited, until the SDK has read it."""
        waited_s = self._connection.waited_s
        if waited_s > STALE_S:
            if len(self._late_calls) > MAX_CALLS:
                del self._late_calls[next(iter(self._late_calls))]
            self._late_calls[number] = waited_s
        else:
            self._late_calls.pop(number, None)

    def _expect(self, asked: protocol.Subscribe) -> bool:
        """Prepare for the messages of subscriptions; return False if there are too many."""
        if len(self._streams) + len(asked.subscriptions) > MAX_SUBSCRIPTIONS:
            self._refuse("subscribe", f"more than {MAX_SUBSCRIPTIONS} subscriptions")
            return False
        for number, channel in asked.subscriptions:
            topic = self._topic_of.get(channel, "")
            shown_one = self._channels.get(topic)
            latched = shown_one is not None and shown_one.topic.latched
            self._streams.setdefault(number, TopicQueue(topic, ALL if latched else NEWEST))
        return True

    async def _pump(self) -> None:
        """Relay the SDK's frames. Frames that must not be dropped wait for the client; of messages
        only the newest waits."""
        try:
            async for frame in self._inner:
                if isinstance(frame, bytes):
                    number = protocol.subscription_of(frame)
                    is_time = protocol.is_time(frame)
                    if number is not None or is_time:
                        stream = self._time if is_time else self._streams.get(number or 0)
                        if stream is not None:
                            self._offer(stream, frame)
                        continue
                self._sender.send(frame)
                await self._sender.calm()
        except ConnectionClosed:
            pass
        if not self._gone:
            await self._close("the server of the SDK has ended")

    def _offer(self, stream: TopicQueue[Pace, bytes], frame: bytes) -> None:
        sender = self._sender
        if sender.outbox.offer(stream, frame, self._loop.time(), sender.free):
            sender.put(ready(frame))
        else:
            sender.wake()

    async def _close(self, reason: str) -> None:
        """Close the connection, which ends all else."""
        if not self._gone:
            _log.warning("%s is closed: %s", self._peer, reason)
            await self._connection.close(1011, reason)

    def _refuse(self, identity: str, reason: str) -> None:
        """Report a refusal to the client, once."""
        self._counts["refused"] += 1
        if self._reported.get(identity) == reason:
            return
        if len(self._reported) >= MAX_REPORTED:
            self._reported.clear()
        self._reported[identity] = reason
        _log.log(logging.DEBUG if self._logged else logging.WARNING, "%s: %s", self._peer, reason)
        self._logged = True
        self._sender.send(protocol.status(protocol.ERROR, reason, identity))

    def tell_refused(self, command: str, reason: str) -> None:
        """Report to the client that an arm has refused its command."""
        if not self._gone:
            self._refuse(f"command {command}", reason)

    # -- what there is on the network ------------------------------------------------------------

    def show(self, now: AdvertisedGraph) -> None:
        """Show exactly these topics and services to the client."""
        if self._gone:
            return
        self._show_topics(now.topics)
        self._show_services(now.services)
        graph = sdk().ConnectionGraph()
        for name, topic in now.topics.items():
            graph.set_published_topic(name, list(topic.publishers))
            graph.set_subscribed_topic(name, list(topic.subscribers))
        for name, service in now.services.items():
            graph.set_advertised_service(name, list(service.servers))
        self._server.publish_connection_graph(graph)

    def _show_topics(self, topics: Mapping[str, Topic]) -> None:
        for name, before in list(self._channels.items()):
            now = topics.get(name)
            if now is None or now.type != before.topic.type:
                del self._channels[name]
                self._unsubscribe(before.channel.id())
                del self._topic_of[before.channel.id()]
                before.channel.close()
                continue
            self._channels[name] = before._replace(topic=now)
            if now.latched and not before.topic.latched:
                self._rejoin(before.channel.id())
        for name, topic in topics.items():
            text = "" if name in self._channels else definition(topic.type)
            if text:
                schema = sdk().Schema(name=topic.type, encoding=ROS2MSG, data=text.encode())
                # Without the SDK's class Channel, which keeps each one for ever.
                channel = self._context._create_channel(name, message_encoding=CDR, schema=schema)
                self._channels[name] = _Channel(topic, channel)
                self._topic_of[channel.id()] = name

    def _show_services(self, services: Mapping[str, ServiceInfo]) -> None:
        gone = [name for name, kind in self._services.items() if _type_of(services, name) != kind]
        if gone:
            self._server.remove_services(gone)
        for name in gone:
            del self._services[name]
        new = []
        for name, service in services.items():
            if name in self._services:
                continue
            made = self._service(name, service.type)
            if made is not None:
                self._services[name] = service.type
                new.append(made)
        if new:
            self._server.add_services(new)

    def _service(self, name: str, type_name: str) -> Any:
        """Return a service for the SDK; None for a type that Cardan does not know."""
        foxglove = sdk()
        try:
            kind = service_type(type_name)
            request, response = (
                foxglove.MessageSchema(
                    encoding=CDR,
                    schema=foxglove.Schema(
                        name=each, encoding=ROS2MSG, data=full_text(each).encode()
                    ),
                )
                for each in (kind.request, kind.response)
            )
        except InterfaceError:
            return None
        return foxglove.Service(
            name,
            schema=foxglove.ServiceSchema(type_name, request=request, response=response),
            handler=partial(self._called, name, type_name),
        )

    # -- topics to the client --------------------------------------------------------------------

    def _subscribe(self, channel_id: int) -> None:
        name = self._topic_of.get(channel_id)
        if name is None or channel_id in self._joined:
            return
        topic, channel = self._channels[name]
        self._joined[channel_id] = self._shared_subscriptions.join(
            name, topic.type, topic.latched, channel_id, channel
        )

    def _unsubscribe(self, channel_id: int) -> None:
        subscription = self._joined.pop(channel_id, None)
        if subscription is not None:
            self._shared_subscriptions.leave(subscription, channel_id)

    def _rejoin(self, channel_id: int) -> None:
        """Restart a topic that is latched now with its last messages."""
        if channel_id in self._joined:
            self._unsubscribe(channel_id)
            self._subscribe(channel_id)

    def _hear_clock(self, cdr: bytes, _stamp_ns: int) -> None:
        """Store the time; called in any thread."""
        clock = codec_of(CLOCK_TYPE).decode(cdr)
        if not isinstance(clock, MalformedCdr):
            now = clock["clock"]
            self._server.broadcast_time(now["sec"] * 1_000_000_000 + now["nanosec"])

    # -- topics from the client ------------------------------------------------------------------

    def _advertise(self, number: int, name: str, encoding: str, type_name: str) -> None:
        if encoding not in (CDR, JSON):
            raise RefusedError(f"{name}: {shown(encoding)} is not read here; {CDR} and {JSON} are")
        topic = self._advertised.topic(name)
        self._advertised.add(topic, type_name, False, number)
        self._published[number] = _Published(topic, encoding)

    def _unadvertise(self, number: int) -> None:
        published = self._published.pop(number, None)
        if published is not None:
            self._advertised.remove(published.topic, number)

    def _publish(self, number: int, data: bytes) -> None:
        published = self._published.get(number)
        advertised = self._advertised.get(published.topic) if published else None
        if published is None or advertised is None:
            raise RefusedError(f"nothing is advertised as channel {number}")
        codec = codec_of(advertised.type)
        # Later ones may have been forwarded since, until the SDK returns this one.
        since_ns = self._connection.since_ns
        if published.encoding == JSON:
            try:
                fields = json.loads(data)
            except (ValueError, RecursionError):
                raise RefusedError(f"{published.topic}: {shown(data)} is not JSON") from None
            data = codec.encode(completed(advertised.type, fields, Stamp.of_ns(since_ns)))
        elif isinstance(found := codec.decode(data), MalformedCdr):
            raise RefusedError(f"{published.topic}: no {advertised.type}: {found.reason}")
        advertised.publisher.publish(data, since_ns)

    # -- services --------------------------------------------------------------------------------

    def _called(self, name: str, type_name: str, request: Any) -> bytes:
        """Call a service; runs in a thread of the SDK that may wait. The SDK reports exceptions."""
        if request.client_id != self._id:
            self._mailbox.put(self._intruded)
            raise CallError("connect by the server's own address")
        if self._gone:
            raise CallError("the client has left")
        waiting = self._call(name, type_name, request.payload, request.call_id)
        call = asyncio.run_coroutine_threadsafe(waiting, self._loop)
        self._calls.add(call)
        try:
            return call.result()
        except concurrent.futures.CancelledError:
            raise CallError(f"{name}: the client has left") from None
        finally:
            self._calls.discard(call)

    async def _call(self, name: str, type_name: str, data: bytes, number: int) -> bytes:
        waited_s = self._late_calls.pop(number, 0.0)
        if type_name not in READING_SERVICES and is_stale(name, waited_s):
            self._counts["stale"] += 1
            raise CallError(stale_words(name, waited_s))
        if len(self._calls) > MAX_CALLS:
            raise CallError(f"{MAX_CALLS} calls have no answer yet; no more are taken")
        kind = service_type(type_name)
        request = codec_of(kind.request).decode(data)
        if isinstance(request, MalformedCdr):
            raise CallError(f"{name}: no {kind.request}: {request.reason}")
        response = await self._caller.start(name, type_name, request, self._service_timeout_s)
        return codec_of(kind.response).encode(response)

    # -- parameters ------------------------------------------------------------------------------

    def _ask(self, answering: Coroutine[Any, Any, None]) -> None:
        if len(self._tasks) > MAX_CALLS:
            answering.close()
            self._refuse("parameters", f"{MAX_CALLS} requests for parameters have no answer yet")
            return
        self._start(self._next(answering))

    async def _next(self, answering: Coroutine[Any, Any, None]) -> None:
        """Answer requests one after the other, which keeps the order of changes of a parameter."""
        try:
            async with self._in_order:
                await answering
        except _REFUSALS as error:
            self._refuse("parameters", str(error))
        finally:
            answering.close()

    async def _get_parameters(self, asked: protocol.GetParameters) -> None:
        names = [protocol.network_name(each) for each in asked.names]
        values = await self._values(names or await self._parameters.names())
        self._sender.send(protocol.parameter_values(_entries(values), asked.id))

    async def _set_parameters(self, asked: protocol.SetParameters) -> None:
        names = []
        for given in asked.parameters:
            name = protocol.network_name(given.name)
            try:
                present = await self._parameters.value(name)
                value = protocol.given_value(given, present["type"])
                result = await self._parameters.change(name, value)
                if not result["successful"]:
                    raise RefusedError(result["reason"] or "the node refused it")
            except _REFUSALS as error:
                self._refuse(f"parameter {given.name}", f"{given.name}: {error}")
            names.append(name)
        values = await self._values(names)
        self._sender.send(protocol.parameter_values(_entries(values), asked.id))

    async def _values(self, names: Sequence[str]) -> dict[str, Message]:
        """Return the values of these parameters; report unavailable ones to the client."""
        of_node: dict[str, list[str]] = {}
        for name in names:
            try:
                of_node.setdefault(self._parameters.checked(name)[0], []).append(name)
            except ValueError as error:
                self._refuse(f"parameter {name}", str(error))
        found = await asyncio.gather(*map(self._values_of, of_node.values()))
        return {name: value for each in found for name, value in each.items()}

    async def _values_of(self, names: Sequence[str]) -> dict[str, Message]:
        try:
            return await self._parameters.values_of(names)
        except PARAMETER_REFUSALS as error:
            self._refuse(f"parameter {names[0]}", str(error))
            return {}

    def tell_parameters(self, node: str, parameters: Sequence[Message]) -> None:
        """Send changed parameters of a node that the client subscribed to."""
        reported = []
        for each in parameters:
            name = protocol.client_name(node, each["name"])
            if self._allowed.parameter(f"{node}:{each['name']}") and protocol.parameter_entry(
                name, each["value"]
            ):
                content = content_of(each["value"])
                reported.append(
                    sdk().Parameter(
                        name,
                        value=list(content) if isinstance(content, tuple) else content,
                    )
                )
        if reported and not self._gone:
            self._server.publish_parameter_values(reported)

    # -- what the SDK says, in threads of its own ------------------------------------------------

    def heard(self, client: Any, act: Callable[..., None], identity: str, *given: Any) -> None:
        """Pass a request of the SDK's server to the loop, if it comes from the relay."""
        if client.id == self._id:
            self._mailbox.put(partial(self._do, act, identity, *given))
        else:
            self._mailbox.put(self._intruded)

    def met(self, client: Any, topic: str) -> bool:
        """Return True if a client advertises the relay's secret name."""
        if self._id is not None or not secrets.compare_digest(topic.encode(), self._name.encode()):
            return False
        self._id = client.id
        self._mailbox.put(self._introduced.set)
        return True

    def _do(self, act: Callable[..., None], identity: str, *given: Any) -> None:
        if self._gone:
            return
        try:
            act(*given)
        except _REFUSALS as error:
            self._refuse(identity, str(error))
        except Exception:
            _log.exception("%s failed: internal error of this server", self._peer)

    def _intruded(self) -> None:
        if not self._gone:
            self._counts["denied"] += 1
            self._start(self._close("a client connected past the server's own address"))

    # -- the end ---------------------------------------------------------------------------------

    def _start(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (fault := task.exception()) is not None:
            _log.error("%s failed: internal error of this server", self._peer, exc_info=fault)

    def _leave(self) -> None:
        """Remove all that the client had from the network, and end its server."""
        if self._gone:
            return
        self._gone = True
        self._sender.close()
        for task in tuple(self._tasks):
            task.cancel()
        for call in tuple(self._calls):
            call.cancel()
        self._advertised.close()
        for channel_id in tuple(self._joined):
            self._unsubscribe(channel_id)
        if self._clock is not None:
            self._clock.close()
        for each in self._channels.values():
            each.channel.close()
        self._server.stop()


class _Listener:
    """Callbacks of the SDK, called in its own threads; none of them waits."""

    def __init__(self, client: FoxgloveConnection) -> None:
        self._client = client

    def on_subscribe(self, client: Any, channel: Any) -> None:
        act = self._client._subscribe
        self._client.heard(client, act, channel.topic, channel.id)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        act = self._client._unsubscribe
        self._client.heard(client, act, channel.topic, channel.id)

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        if self._client.met(client, channel.topic):
            return
        given = (channel.id, channel.topic, channel.encoding, channel.schema_name)
        self._client.heard(client, self._client._advertise, channel.topic, *given)

    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
        act = self._client._unadvertise
        self._client.heard(client, act, f"channel {client_channel_id}", client_channel_id)

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        act = self._client._publish
        self._client.heard(client, act, f"channel {client_channel_id}", client_channel_id, data)

    def on_get_parameters(self, client: Any, names: Any, request_id: Any = None) -> list[Any]:
        return []

    def on_set_parameters(self, client: Any, parameters: Any, request_id: Any = None) -> list[Any]:
        return []

    def on_parameters_subscribe(self, names: Any) -> None:
        pass

    def on_parameters_unsubscribe(self, names: Any) -> None:
        pass

    def on_connection_graph_subscribe(self) -> None:
        pass

    def on_connection_graph_unsubscribe(self) -> None:
        pass


def _hidden_address() -> str:
    """Return an unguessable loopback address: one of 10^12 together with the port."""
    return f"127.{'.'.join(str(1 + secrets.randbelow(254)) for _ in range(3))}"


async def _connected(host: str, port: int) -> ClientConnection:
    """Connect as a client to a server of the SDK."""
    sock = socket.socket()
    sock.setblocking(False)
    try:
        await asyncio.get_running_loop().sock_connect(sock, (host, port))
        # An own socket keeps a proxy from being used for this machine.
        return await connect(
            f"ws://{host}:{port}",
            sock=sock,
            subprotocols=[Subprotocol(protocol.SUBPROTOCOLS[0])],
            compression=None,
            max_size=None,
            ping_interval=None,
            logger=_library_log,
        )
    except (OSError, WebSocketException) as error:
        sock.close()
        raise DriverError(f"foxglove-sdk's server cannot be reached: {error}") from None


def _type_of(services: Mapping[str, ServiceInfo], name: str) -> str:
    service = services.get(name)
    return service.type if service else ""


def _entries(values: Mapping[str, Message]) -> list[dict[str, Any]]:
    """Return parameters in the form for clients."""
    found = []
    for name, value in values.items():
        node, _, parameter = name.partition(":")
        entry = protocol.parameter_entry(protocol.client_name(node, parameter), value)
        if entry is not None:
            found.append(entry)
    return found
