"""Bridge between the bus and a DDS domain: topics of the bus out, commands in, services of the bus.

The graph of the bus decides: topics published on the bus are published on DDS, topics subscribed to
on the bus are subscribed to on DDS, services offered on the bus are offered on DDS. Both sides
ignore the bridge's own publications, which prevents loops.

The bridge has no queue: a message is forwarded in the thread that received it, into the bounded
queues of DDS and Zenoh, in order for each publisher. A topic is subscribed to on the bus only while
it has a subscriber on DDS; a latched topic stays subscribed after its first subscriber.
"""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable

from cardan.bus.dds_options import SERVER_NODE
from cardan.bus.network import Answered, Failure, Handle, NetworkError, PublisherHandle, Topic
from cardan.bus.zenoh_network import BusNetwork
from cardan.errors import DriverError
from cardan.gateway.arm.backlog import Delays, is_stale
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.pause_detector import StandStill
from cardan.protocols.ros2.names import RosNameError, checked_name
from cardan.types import NEVER_S
from cardan_dds.network import DdsNetwork
from cardan_dds.wire import Endpoint

MOST_CLIENTS = 64
"""Most nodes on DDS whose commands are forwarded: each is a node on the bus."""

NAMED_WITHIN_S = 1.0
"""How long the messages of a writer wait for the name of its node, without being forwarded: ROS 2
announces it when the writer is made. A writer outside ROS 2 has none."""

MOST_BYTES = 10_000_000
"""Largest message that is forwarded to the bus, the same as for rosbridge."""

MOST_CALLS = 64
"""Most calls of one participant that wait for replies; more are refused."""

HANDED_ON_S = 0.3
"""Time after a pause of this process in which messages count as sent before its end: the time that
DDS takes to deliver those buffered by the system."""

_log = logging.getLogger(__name__)


class _Out:
    """Topic of the bus on DDS."""

    def __init__(self, topic: Topic, publisher: PublisherHandle) -> None:
        self.type, self.latched = topic.type, topic.latched
        self.publisher = publisher
        self.heard: Handle | None = None
        """Subscription on the bus while the topic has a subscriber on DDS; a latched topic keeps it
        after its first subscriber."""

    def quiet(self) -> None:
        """Unsubscribe on the bus, because no subscriber is left on DDS."""
        heard, self.heard = self.heard, None
        if heard is not None:
            heard.close()

    def close(self) -> None:
        self.quiet()
        self.publisher.close()


class _Client:
    """Node on DDS as a node of the same name on the bus: its requests without end are ended with
    its participant."""

    def __init__(self, network: BusNetwork) -> None:
        self.network = network
        self.publishers: dict[bytes, PublisherHandle] = {}
        """Publishers by the GUIDs of its writers."""
        self.calls = 0


class Bridge:
    """Bridge between an open bus and an open DDS domain, both deaf. `follow` is for one thread."""

    def __init__(self, bus: BusNetwork, dds: DdsNetwork, allowed: Allowed) -> None:
        self.counts: Counter[str] = Counter()
        """"out", "in": forwarded messages; "calls"; "refused": messages and calls that were not
        forwarded; "stale": those that waited during a pause of this process, and messages that were
        too long on their way from DDS."""
        self._bus, self._dds, self._allowed = bus, dds, allowed
        self._lock = threading.Lock()
        self._outs: dict[str, _Out] = {}
        self._ins: dict[str, tuple[str, Handle]] = {}
        """Types and subscriptions on DDS."""
        self._services: dict[str, tuple[str, Handle]] = {}
        self._clients: dict[tuple[bytes, str], _Client] = {}
        """Clients by the GUIDs of their participants and their names; an unnamed node has an empty
        one."""
        self._unnamed: dict[bytes, float] = {}
        """Time of discovery of writers whose nodes are unknown, by GUID."""
        self._numbers = itertools.count(1)
        self._said: set[str] = set()
        self._seen = (-1, -1)
        self._standstill = StandStill(self._stood_still)
        self._stale_until_s = NEVER_S
        dds.watch_departures(self._depart)

    def follow(self) -> None:
        """Bridge the present graphs; call it more often than the longest tolerated pause of the
        bridge. Raises DriverError if another bridge does the same."""
        self._standstill.look()
        seen = self._bus.changes, self._dds.changes
        if seen == self._seen:
            return
        self._seen = seen
        self._check_alone()
        topics, services = self._bus.others()
        self._follow_outs({name: each for name, each in topics.items() if each.publishers})
        self._follow_ins({name: each for name, each in topics.items() if each.subscribers})
        wanted = {name: each.type for name, each in services.items() if self._allowed.service(name)}
        self._follow_each(self._services, wanted, self._serve)
        there = self._dds.participants()
        for participant, _ in tuple(self._clients):
            if participant not in there:
                self._depart(participant)

    def close(self) -> None:
        """Remove the bridge from both sides. May be called twice."""
        for out in self._outs.values():
            out.close()
        for given in (self._ins, self._services):
            for _, handle in given.values():
                handle.close()
            given.clear()
        self._outs.clear()
        with self._lock:
            clients, self._clients = self._clients, {}
        for client in clients.values():
            client.network.close()

    def _check_alone(self) -> None:
        """Check for a second bridge: two between the same networks would forward each other's
        messages."""
        on_dds, on_bus = self._dds.having(f"/{SERVER_NODE}"), self._bus.having(f"/{SERVER_NODE}")
        if on_bus and any(guid < self._dds.guid for guid in on_dds):
            raise DriverError(
                "another `cardan net server dds` joins the same bus and DDS domain: messages "
                "would circulate between the two; end one of them"
            )

    # -- out ---------------------------------------------------------------------------------------

    def _follow_outs(self, topics: dict[str, Topic]) -> None:
        for name, out in tuple(self._outs.items()):
            topic = topics.get(name)
            if topic is None or (topic.type, topic.latched) != (out.type, out.latched):
                del self._outs[name]
                out.close()
        for name, topic in topics.items():
            if not self._allowed.topic(name) or not topic.type:
                continue
            try:
                out = self._outs.get(name) or self._begin_out(name, topic)
                _, readers = self._dds.others(name)
                if not readers:
                    # A new subscription would repeat the latched message that DDS already keeps.
                    if not out.latched:
                        out.quiet()
                elif out.heard is None:
                    out.heard = self._bus.subscribe(name, topic.type, self._passing(out.publisher))
            except NetworkError as error:
                self._say(f"{name} is not forwarded to DDS: {error}")

    def _begin_out(self, name: str, topic: Topic) -> _Out:
        out = _Out(topic, self._dds.advertise(name, topic.type, topic.latched))
        self._outs[name] = out
        return out

    def _passing(self, publisher: PublisherHandle) -> Callable[[bytes, int], None]:
        def passed(cdr: bytes, _stamp_ns: int) -> None:
            self.counts["out"] += 1
            publisher.publish(cdr)

        return passed

    # -- in ----------------------------------------------------------------------------------------

    def _stood_still(self, seconds: float) -> None:
        self._stale_until_s = time.monotonic() + HANDED_ON_S
        _log.warning(
            "this bridge stalled for %.1f s: messages that came from DDS meanwhile are dropped",
            seconds,
        )

    def _stale(self, name: str) -> bool:
        """Return True if a message received now may have waited during a pause of this process, and
        its sender may be gone; a stop is never stale. From any thread."""
        if name.endswith("/stop"):
            return False
        return time.monotonic() < self._stale_until_s or self._standstill.standing

    def _follow_ins(self, topics: dict[str, Topic]) -> None:
        wanted = {name: each.type for name, each in topics.items() if self._allowed.topic(name)}
        self._follow_each(self._ins, wanted, self._subscribe)
        there: set[bytes] = set()
        for name, (type_name, _) in self._ins.items():
            writers, _ = self._dds.others(name)
            for writer in writers:
                there.add(writer.guid)
                ros = writer.ros
                if ros is not None and ros.type_name != type_name:
                    other = ros.type_name or writer.type_name
                    self._say(
                        f"{name} takes {type_name}: what is published there as {other} is not "
                        "passed on"
                    )
                else:
                    self._publisher(writer, name, type_name)
        with self._lock:
            gone = [
                client.publishers.pop(guid)
                for client in self._clients.values()
                for guid in tuple(client.publishers)
                if guid not in there
            ]
            for guid in self._unnamed.keys() - there:
                del self._unnamed[guid]
        for publisher in gone:
            publisher.close()

    def _subscribe(self, name: str, type_name: str) -> Handle:
        # An old command must not be repeated when the bridge restarts.
        history = self._bus.wants_history(name)
        delays = Delays()

        def waited_s(stamp_ns: int, writer: Endpoint | None) -> float:
            """Return the transit time of a message beyond the shortest of its writer, s."""
            if writer is None or stamp_ns <= 0:
                return 0.0
            return delays.hear(writer.guid, stamp_ns * 1e-9, time.monotonic())

        def passed(cdr: bytes, stamp_ns: int, writer: Endpoint | None) -> None:
            publisher = None
            if not history and (is_stale(name, waited_s(stamp_ns, writer)) or self._stale(name)):
                self.counts["stale"] += 1
                return
            if len(cdr) > MOST_BYTES:
                self._say(f"{name}: a message of more than {MOST_BYTES} bytes is not passed on")
            elif writer is not None:
                # A client that stops an arm need not announce its name first.
                stops = name.endswith("/stop")
                publisher = self._publisher(writer, name, type_name, stops)
            if publisher is None:
                self.counts["refused"] += 1
                return
            self.counts["in"] += 1
            publisher.publish(cdr, max(0, stamp_ns))

        return self._dds.subscribe_from(name, type_name, passed, history)

    def _publisher(
        self, writer: Endpoint, name: str, type_name: str, at_once: bool = False
    ) -> PublisherHandle | None:
        """Return a DDS writer's publisher on the bus; None if there can be none, or while the
        writer waits for its node's name, unless `at_once`. From any thread."""
        node = self._dds.node_of(writer)
        with self._lock:
            if not (node or at_once or self._nameless(writer.guid)):
                return None
            client = self._client(writer.participant, node)
            if client is None:
                return None
            publisher = client.publishers.get(writer.guid)
            if publisher is None:
                try:
                    publisher = client.network.advertise(name, type_name, writer.transient_local)
                except NetworkError as error:
                    self._say(f"{name} is not forwarded to the bus: {error}")
                    return None
                client.publishers[writer.guid] = publisher
            return publisher

    def _nameless(self, writer: bytes) -> bool:
        """Return True if a writer has no node, and none is awaited. Call it with the lock."""
        now_s = time.monotonic()
        return now_s - self._unnamed.setdefault(writer, now_s) > NAMED_WITHIN_S

    # -- participants ------------------------------------------------------------------------------

    def _client(self, participant: bytes, node: str) -> _Client | None:
        """Return a DDS node's node on the bus; None if there are too many. Call it with the
        lock."""
        client = self._clients.get((participant, node))
        if client is None:
            if len(self._clients) >= MOST_CLIENTS:
                self._say(
                    f"more than {MOST_CLIENTS} nodes on DDS send: messages of further nodes are "
                    "dropped"
                )
                return None
            try:
                namespace, _, name = checked_name(node).rpartition("/")
            except RosNameError:
                namespace, name = "", f"dds_client_{next(self._numbers)}"
            try:
                network = self._bus.part(name, namespace or "/")
            except DriverError as error:  # The bus is closed.
                self._say(str(error))
                return None
            client = self._clients[participant, node] = _Client(network)
        return client

    def _depart(self, participant: bytes) -> None:
        """Handle the departure of a participant. From any thread."""
        with self._lock:
            gone = [self._clients.pop(key) for key in tuple(self._clients) if key[0] == participant]
        for client in gone:
            client.network.close()

    # -- services ----------------------------------------------------------------------------------

    def _serve(self, service: str, type_name: str) -> Handle:
        def asked(request: bytes, answered: Answered, caller: Endpoint | None) -> None:
            client = None
            if self._stale(service):
                self.counts["stale"] += 1
                answered(Failure("the bridge stalled meanwhile; ask again"))
                return
            if caller is not None:
                node = self._dds.node_of(caller)
                with self._lock:
                    client = self._client(caller.participant, node)
            if client is None or client.calls >= MOST_CALLS:
                self.counts["refused"] += 1
                answered(Failure("too many clients, or too many calls at once"))
                return
            counted = client
            counted.calls += 1
            self.counts["calls"] += 1

            def over(reply: bytes | Failure) -> None:
                counted.calls -= 1
                answered(reply)

            try:
                client.network.call(service, type_name, request, over, None)
            except NetworkError as error:
                over(Failure(str(error)))

        return self._dds.serve_to(service, type_name, asked)

    # -- both --------------------------------------------------------------------------------------

    def _follow_each(
        self,
        given: dict[str, tuple[str, Handle]],
        wanted: dict[str, str],
        begin: Callable[[str, str], Handle],
    ) -> None:
        """Open the wanted names with types, and close everything else."""
        for name, (type_name, handle) in tuple(given.items()):
            if wanted.get(name) != type_name:
                del given[name]
                handle.close()
        for name, type_name in wanted.items():
            if name not in given and type_name:
                try:
                    given[name] = type_name, begin(name, type_name)
                except NetworkError as error:
                    self._say(f"{name} is not available on DDS: {error}")

    def _say(self, words: str) -> None:
        """Log a message once."""
        if words not in self._said:
            self._said.add(words)
            _log.warning("%s", words)
