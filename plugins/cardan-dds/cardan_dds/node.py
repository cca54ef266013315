"""ROS 2 nodes on DDS: their announcement, and a node with topics for a loop."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from cardan.bus.dds_options import DdsOptions
from cardan.bus.node import Received
from cardan.bus.transports import OtherNode
from cardan.common.context import enter, leave
from cardan.errors import DriverError
from cardan.protocols.ros2.interfaces import InterfaceError, full_name
from cardan.protocols.ros2.names import checked_name, dds_type
from cardan.protocols.ros2.type_hash import type_hash
from cardan.protocols.ros2.zenoh import DEFAULT_QOS, Attachment, Qos
from cardan_dds.cyclone import Participant, Reader, Sample, Waiter, Writer
from cardan_dds.wire import (
    BARE_NODE,
    DISCOVERY_TOPIC,
    DISCOVERY_TYPE,
    GID_BYTES,
    HUMBLE_GID_BYTES,
    TOPIC,
    Announcement,
    DdsGraph,
    Endpoint,
    NodeInfo,
    dds_topic,
    dds_type_of,
    exact,
    user_data,
)

MAX_WRITERS = 64
"""Writers of a topic whose messages are counted."""

HANDLE_BYTES = 8
"""Size of a writer's instance handle, which is its GID in attachments."""

ANNOUNCED_QOS = Qos(transient_local=True, depth=1)


def topic_user_data(type_name: str) -> bytes:
    """Return the user data of an endpoint: the hash of its type; empty for a type that Cardan does
    not know."""
    try:
        return user_data({"typehash": type_hash(full_name(type_name))})
    except InterfaceError:
        return b""


def gid_bytes(options: DdsOptions) -> int:
    """Return the length of ids in announcements, bytes."""
    return HUMBLE_GID_BYTES if options.dds_distribution == "humble" else GID_BYTES


class Announcer:
    """Announces the nodes of a participant, all of them with each change. From any thread."""

    def __init__(self, participant: Participant) -> None:
        """Raises DriverError."""
        self._participant = participant
        self._gid_bytes = gid_bytes(participant.options)
        self._lock = threading.Lock()
        self._nodes: dict[str, tuple[set[bytes], set[bytes]]] = {}
        """GUIDs of readers and writers by full names of nodes."""
        self._writer = participant.writer(
            DISCOVERY_TOPIC,
            dds_type(DISCOVERY_TYPE),
            ANNOUNCED_QOS,
            topic_user_data(DISCOVERY_TYPE),
        )

    def add(self, node: str, *entities: Reader | Writer) -> None:
        """Add a node, or endpoints of it that exist already."""
        with self._lock:
            sides = self._nodes.setdefault(node, (set(), set()))
            for each in entities:
                sides[isinstance(each, Writer)].add(each.guid)
            self._tell()

    def remove(self, node: str, *entities: Reader | Writer) -> None:
        """Remove endpoints before they are closed; without any, remove the node."""
        with self._lock:
            sides = self._nodes.get(node)
            if sides is None:
                return
            for each in entities:
                sides[isinstance(each, Writer)].discard(each.guid)
            if not entities:
                del self._nodes[node]
            self._tell()

    def close(self) -> None:
        """Remove all nodes."""
        with self._lock:
            self._nodes.clear()
            self._tell()

    def _tell(self) -> None:
        nodes = (
            NodeInfo(name, tuple(sorted(readers)), tuple(sorted(writers)))
            for name, (readers, writers) in self._nodes.items()
        )
        reported = Announcement(self._participant.guid, tuple(nodes))
        self._writer.write(reported.encode(self._gid_bytes))


class DdsPublisher:
    """Publisher of messages of one type on one topic."""

    def __init__(self, writer: Writer, closed: Callable[[Writer], None]) -> None:
        self._writer, self._closed = writer, closed

    def put(self, data: bytes | bytearray, _now_ns: int) -> None:
        """Publish an encoded message; DDS gives it its time. Never waits for a reader."""
        self._writer.write(data)

    def put_as(self, _sequence: int, data: bytes | bytearray, now_ns: int) -> None:
        """Publish without `_sequence`: DDS numbers messages itself."""
        self.put(data, now_ns)

    @property
    def heard(self) -> bool:
        """True if there is a subscriber."""
        return bool(self._writer.matched())

    def close(self) -> None:
        """Leave the graph."""
        self._closed(self._writer)


class GraphReader:
    """Reads discovered endpoints and announced nodes into a graph. It has no thread."""

    def __init__(self, participant: Participant) -> None:
        """Raises DriverError."""
        self.graph = DdsGraph()
        self._gid_bytes = gid_bytes(participant.options)
        self._discovery = participant.discovery()
        self._announced = participant.reader(
            DISCOVERY_TOPIC,
            dds_type(DISCOVERY_TYPE),
            ANNOUNCED_QOS._replace(keep_all=True),
            topic_user_data(DISCOVERY_TYPE),
        )
        self.conditions = (*self._discovery.conditions, self._announced.condition)
        """Conditions for a waiter: data can be read."""

    def take(self) -> Discovered:
        """Return new discoveries, which the graph does not have yet."""
        return Discovered(
            list(self._discovery.endpoints()), self._announced.take(), self._discovery.departed()
        )

    def learn(self, found: Discovered) -> None:
        """Add new discoveries to the graph."""
        for each in found.changes:
            if isinstance(each, Endpoint):
                self.graph.add(each)
            else:
                self.graph.remove(each)
        for sample in found.announced:
            reported = Announcement.decode(sample.data, self._gid_bytes)
            if reported is not None:
                self.graph.announce(reported)
        for guid in found.departed:
            self.graph.forget(guid)

    def look(self) -> None:
        """Take new discoveries and add them to the graph."""
        self.learn(self.take())

    def writer(self, gid: bytes) -> str:
        """Return the full name of the node with the writer `gid` of attachments; empty: not
        announced."""
        endpoint = self.graph.by_handle(int.from_bytes(gid[:HANDLE_BYTES], "little"))
        name = "" if endpoint is None else self.graph.node_of(endpoint)
        return "" if name == BARE_NODE else name

    def close(self) -> None:
        """Stop discovery."""
        self._discovery.close()
        self._announced.close()


class Discovered(NamedTuple):
    """New discoveries on DDS."""

    changes: list[Endpoint | bytes]
    """Endpoints, and the GUIDs of removed ones."""
    announced: list[Sample]
    departed: list[bytes]
    """GUIDs of participants."""


class DdsSubscription:
    """Subscription to one topic for a thread that sleeps until a message arrives."""

    def __init__(
        self,
        node: DdsNode,
        topic: str,
        type_name: str,
        reader: Reader,
        waiter: Waiter,
        closed: Callable[[Reader], None],
    ) -> None:
        self._type, self._reader, self._waiter, self._closed = type_name, reader, waiter, closed
        self._key = f"{node.options.number}{topic}/{dds_type(type_name)}/-"
        self._retained: deque[Received] = deque()
        self._counts: dict[int, itertools.count[int]] = {}
        self._woken = False
        waiter.add(reader.condition, 1)

    def wait(self, timeout_s: float) -> Received | None:
        """Return the oldest message in the queue, or the next one; None on a time-out."""
        end_s = time.monotonic() + timeout_s
        while not self._retained:
            self._take()
            left_s = end_s - time.monotonic()
            if self._retained or left_s <= 0.0 or self._woken:
                break
            self._waiter.wait(left_s)
        self._woken = False
        return self._retained.popleft() if self._retained else None

    def poll(self) -> Received | None:
        """Return the oldest message in the queue, or None."""
        return self.wait(0.0)

    def wake(self) -> None:
        """End a wait in another thread, without a message."""
        self._woken = True
        self._waiter.wake()

    def _take(self) -> None:
        """Number each writer's messages: DDS delivers them once and in order."""
        for sample in self._reader.take():
            counted = self._counts.get(sample.writer)
            if counted is None:
                if len(self._counts) >= MAX_WRITERS:
                    self._counts.pop(next(iter(self._counts)))
                counted = self._counts[sample.writer] = itertools.count(1)
            number = next(counted)
            gid = sample.writer.to_bytes(HANDLE_BYTES, "little").ljust(GID_BYTES, b"\0")
            attachment = Attachment(number, sample.source_ns, gid)
            self._retained.append(Received(exact(self._type, sample.data), self._key, attachment))

    def close(self) -> None:
        """Leave the graph."""
        self._waiter.remove(self._reader.condition)
        self._closed(self._reader)
        self._waiter.close()


class DdsNode(OtherNode):
    """Node with its own participant, for drivers and simulated robots: the part of BusNode's
    interface that they need.

    ::

    with DdsNode(DdsOptions(), "driver") as node:
            states = node.waiting_subscription("/joint_states", "sensor_msgs/msg/JointState", 10)
            received = states.wait(0.1)
    """

    def __init__(self, options: DdsOptions, name: str) -> None:
        self.options, self.full_name = options, checked_name(f"/{name}")
        self._participant: Participant | None = None
        self._announcer: Announcer | None = None

    def open(self) -> None:
        """Join DDS. Raises ExtraMissingError, ConfigurationError, or DriverError."""
        if self._participant is None:
            self._participant = Participant(self.options)
            self._announcer = Announcer(self._participant)
            self._announcer.add(self.full_name)

    def close(self) -> None:
        """Leave DDS, and delete all endpoints. May be called twice."""
        announcer, self._announcer = self._announcer, None
        participant, self._participant = self._participant, None
        if announcer is not None:
            announcer.close()
        if participant is not None:
            participant.close()

    __enter__ = enter
    __exit__ = leave

    def publisher(self, name: str, type_name: str, qos: Qos = DEFAULT_QOS) -> DdsPublisher:
        """Return a publisher of a topic. Raises InterfaceError, RosNameError or DriverError."""
        participant, announcer = self._opened()
        writer = participant.writer(*self._names(name, type_name), qos, topic_user_data(type_name))
        announcer.add(self.full_name, writer)
        return DdsPublisher(writer, self._close)

    def waiting_subscription(
        self, name: str, type_name: str, depth: int, qos: Qos = DEFAULT_QOS
    ) -> DdsSubscription:
        """Return a subscription that keeps the newest `depth` messages of publishers of any
        reliability. Raises InterfaceError, RosNameError or DriverError."""
        participant, announcer = self._opened()
        # Only a reliable latched subscription gets messages published earlier.
        retained = qos._replace(depth=depth, reliable=qos.transient_local)
        names = self._names(name, type_name)
        reader = participant.reader(*names, retained, topic_user_data(type_name))
        announcer.add(self.full_name, reader)
        return DdsSubscription(
            self, checked_name(name), type_name, reader, participant.waiter(), self._close
        )

    def graph_reader(self) -> GraphReader:
        """Return a reader of the participants, writers and readers on DDS. Raises DriverError."""
        return GraphReader(self._opened()[0])

    def _names(self, name: str, type_name: str) -> tuple[str, str]:
        full = checked_name(name, self.full_name)
        return dds_topic(TOPIC, full), dds_type_of(TOPIC, full_name(type_name))

    def _opened(self) -> tuple[Participant, Announcer]:
        if self._participant is None or self._announcer is None:
            raise DriverError("DDS is not open: use the node in a with statement, or open() it")
        return self._participant, self._announcer

    def _close(self, entity: Reader | Writer) -> None:
        with contextlib.suppress(DriverError):
            self._opened()[1].remove(self.full_name, entity)
        entity.close()
