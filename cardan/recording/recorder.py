"""Recorder of the bus: all messages of all topics, also of topics that appear later."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import logging
import platform
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cardan import __version__
from cardan.bus.node import BusNode, gid_of, zenoh_module
from cardan.bus.options import BusOptions
from cardan.common.resource_errors import shortage
from cardan.common.serving import interruptible
from cardan.errors import DriverError, OptionError
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.names import RosNameError, checked_name, type_of_dds
from cardan.protocols.ros2.type_hash import UNSUPPORTED
from cardan.protocols.ros2.zenoh import (
    DEFAULT_QOS,
    LATCHED_QOS,
    PUBLISHER,
    SUBSCRIPTION,
    Attachment,
    Entity,
)
from cardan.recording.arms import CONFIGURATION
from cardan.recording.mcap_file import RecordedMessage, RecordedTopic, RecordWriter
from cardan.types import NEVER_S

NAME = "cardan_recorder"

_log = logging.getLogger(__name__)

FLUSH_S = 0.5
"""Flush period of the file, s: a killed recorder loses less than 1 s, data in transit included."""

QUEUE_MESSAGES, QUEUE_BYTES = 20_000, 256 << 20
"""Most messages and bytes queued for the disk; beyond it the newest are dropped and counted."""

SHARED_TOPICS = ("tf", "tf_static", "diagnostics", "rosout")
"""Topics that all arms share, recorded whichever arms are chosen."""

GRAPH_S = 2.0
"""Longest wait of a topic's first message for its publisher in the graph during start-up, s."""

JOINING_S = 3.0
"""Duration of the start-up, s: on a busy computer the graph is complete within a second."""

LATE_GRAPH_S = 0.3
"""The same wait afterwards, s: all later messages wait, too, and are lost with the process."""

MAX_ENDPOINTS = 64
"""Most endpoints remembered per topic: programs that publish once come and go."""

_WAIT_S = 0.1

_END_NS = 1 << 63
"""Latest time that a clock can have."""

_STRING = codec_of("std_msgs/msg/String")


class Report(NamedTuple):
    """Summary of a finished record."""

    messages: int
    topics: int
    dropped: int
    """Messages dropped because they arrived faster than the disk could write."""
    lost: int
    """Messages missing in their publishers' sequence numbers."""
    unknown: tuple[tuple[str, str], ...]
    """Types without a definition in the file, and their hashes."""
    error: str
    """Reason why it ended early; empty if it did not."""

    def lines(self) -> list[str]:
        """Return the summary as lines of text."""
        said = [f"{self.messages} messages of {self.topics} topics"]
        if not self.messages:
            said.append(
                "no message was received: `cardan net list` shows the nodes that are there, and "
                "what to do if there are none"
            )
        said += [
            f"{name}: its definition is not known: the file has its raw bytes only ({mark})"
            for name, mark in self.unknown
        ]
        if self.dropped:
            said.append(f"{self.dropped} messages dropped: they came faster than they were written")
        if self.lost:
            said.append(f"{self.lost} messages were published and did not arrive here")
        if self.error:
            said.append(self.error)
        return said

    @property
    def complete(self) -> bool:
        """True if the file has all that was published."""
        return not (self.dropped or self.lost or self.error or not self.messages)


class _Heard(NamedTuple):
    key: str
    data: bytes
    attachment: bytes
    log_ns: int


class Recorder:
    """Recorder of the bus from `open` to `close`.

    Zenoh's threads put received messages into a bounded queue; one thread writes them.
    """

    def __init__(self, options: BusOptions, path: Path, arms: Sequence[str] = ()) -> None:
        """Choose the topics by `arms`: their prefixes, which are namespaces of arms or names of
        nodes; empty: all. Raises OptionError."""
        for arm in arms:
            try:
                checked_name(f"/{arm.strip('/')}")
            except RosNameError as error:
                raise OptionError("ARM", arm, str(error)) from None
        self._options, self._path = options, path
        self._arms = [arm.strip("/") for arm in arms]
        self._node = BusNode(options, NAME)
        self._seen: dict[str, list[Entity]] = {}
        """Endpoints of each topic, also those that have left: a node that publishes a message and
        exits is gone before the message is handled."""
        self._saw = threading.Condition()
        self._queue: deque[_Heard] = deque()
        self._queued_bytes = 0
        self._there = threading.Condition()
        self._ending = False
        self._dropped = self._lost = self._messages = self._bytes = 0
        self._error = ""
        self._began_s = NEVER_S
        self._topics: dict[str, RecordedTopic | None] = {}
        """Topics by key; None: not a ROS topic."""
        self._of_one: dict[tuple[str, bytes], RecordedTopic] = {}
        """Latched topics by key and publisher: late subscribers get the last message of each."""
        self._counted: dict[bytes, int] = {}
        """Newest sequence numbers by publisher."""
        self._configured: set[tuple[str, bytes]] = set()
        self._announced: set[str] = set()
        self._handles: list[Any] = []
        self._writer: RecordWriter | None = None
        self._thread = threading.Thread(target=self._write, name="cardan-recorder", daemon=True)

    def __enter__(self) -> Recorder:
        self.open()
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    @property
    def failed(self) -> bool:
        """True once nothing can be written any more."""
        return bool(self._error)

    def figures(self) -> dict[str, int]:
        """Counts so far; "bytes" are those written to the disk."""
        return {
            "bytes": self._bytes,
            "messages": self._messages,
            "dropped": self._dropped,
            "lost": self._lost,
        }

    def open(self) -> None:
        """Start. Raises CaptureError, ExtraMissingError, ConfigurationError or DriverError."""
        self._node.open()
        try:
            self._node.watch_graph(self._see)
            self._writer = RecordWriter(self._path)
            self._describe(self._writer)
        except BaseException:
            self._node.close()
            raise
        self._began_s = time.monotonic()
        self._thread.start()
        node, domain = self._node, self._options.domain
        keys = [f"{domain}/{arm}/**" for arm in self._arms]
        keys += [f"{domain}/{name}/**" for name in SHARED_TOPICS] if keys else [f"{domain}/**"]
        try:
            for key in keys:
                # A subscriber that requests earlier messages of latched topics, too.
                self._handles.append(node.declare_subscriber(key, self._hear, LATCHED_QOS))
        except BaseException:
            self.close()
            raise

    def close(self) -> Report:
        """Stop, and write the messages that have arrived. Never raises; repeated calls are fine."""
        with contextlib.suppress(zenoh_module().ZError):
            while self._handles:
                self._handles.pop().undeclare()
        with self._there:
            self._ending = True
            self._there.notify()
        if self._thread.is_alive():
            self._thread.join()
        self._node.close()
        unknown = () if self._writer is None else tuple(sorted(self._writer.unknown.items()))
        topics = () if self._writer is None else self._writer.topics
        count = len({topic.name for topic in topics})
        return Report(self._messages, count, self._dropped, self._lost, unknown, self._error)

    @staticmethod
    def _describe(writer: RecordWriter) -> None:
        about = {
            "cardan": __version__,
            "python": platform.python_version(),
            "system": platform.platform(),
            "eclipse-zenoh": importlib.metadata.version("eclipse-zenoh"),
        }
        writer.describe("cardan", about)
        writer.attach("recorder.json", json.dumps(about), time.time_ns())

    # -- Zenoh's threads -------------------------------------------------------------------------

    def _see(self, token: str, there: bool) -> None:
        entity = Entity.parse(token) if there else None
        if entity is not None and entity.kind in (PUBLISHER, SUBSCRIPTION):
            with self._saw:
                seen = self._seen.setdefault(entity.name, [])
                seen.append(entity)
                del seen[:-MAX_ENDPOINTS]
                self._saw.notify_all()

    def _hear(self, sample: Any) -> None:
        data = sample.payload.to_bytes()
        attachment = sample.attachment
        encoded = b"" if attachment is None else attachment.to_bytes()
        key = str(sample.key_expr)
        with self._there:
            if len(self._queue) >= QUEUE_MESSAGES or self._queued_bytes > QUEUE_BYTES:
                self._dropped += 1
                return
            self._queued_bytes += len(data)
            self._queue.append(_Heard(key, data, encoded, time.time_ns()))
            if len(self._queue) == 1:
                self._there.notify()

    # -- the writing thread ----------------------------------------------------------------------

    def _write(self) -> None:
        writer = self._writer
        assert writer is not None
        flush_s = time.monotonic() + FLUSH_S
        try:
            while True:
                with self._there:
                    if not self._queue and not self._ending:
                        self._there.wait(_WAIT_S)
                    heard = list(self._queue)
                    self._queue.clear()
                    self._queued_bytes = 0
                    ending = self._ending
                for each in heard:
                    self._add(writer, each)
                if time.monotonic() >= flush_s:
                    writer.flush()
                    self._bytes = writer.bytes
                    self._announce()
                    flush_s = time.monotonic() + FLUSH_S
                if ending and not heard:
                    writer.finish()
                    return
        except Exception as error:
            why = error.strerror if isinstance(error, OSError) else shortage(error)
            if not why:
                _log.exception("writing failed")
                why = f"an internal error, {type(error).__name__}, as its log says"
            self._error = f"{self._path} cannot be written: {why}"
            with self._there:
                self._queue.clear()
            with contextlib.suppress(Exception):  # Flushed messages stay readable.
                writer.finish()

    def _add(self, writer: RecordWriter, heard: _Heard) -> None:
        if heard.key in self._topics:
            topic = self._topics[heard.key]
        else:
            topic = self._topics[heard.key] = self._topic_of(heard.key, heard.log_ns)
        if topic is None:
            return
        attachment = Attachment.decode(heard.attachment)
        sequence = publish_ns = 0
        if attachment is not None:
            if topic.latched:
                topic = self._of_publisher(topic, heard, attachment.gid)
            sequence, publish_ns = attachment.sequence, attachment.source_ns
            if not 0 <= publish_ns < _END_NS:
                publish_ns = 0
            before = self._counted.get(attachment.gid)
            self._counted[attachment.gid] = max(sequence, before or 0)
            if before is not None and sequence > before + 1:
                self._lost += sequence - before - 1
            elif topic.latched and before is not None and sequence <= before:
                return  # A duplicate: received live, and as an earlier message of a latched topic.
        writer.add(
            RecordedMessage(topic, heard.log_ns, publish_ns or heard.log_ns, sequence, heard.data)
        )
        self._messages += 1
        if topic.name.endswith(CONFIGURATION):
            self._attach(writer, topic, heard)

    def _topic_of(self, key: str, first_ns: int) -> RecordedTopic | None:
        _, _, rest = key.partition("/")
        name, _, mark = rest.rpartition("/")
        name, _, dds_type = name.rpartition("/")
        type_name = type_of_dds(dds_type)
        if not name or not type_name:
            return None
        name = f"/{name}"
        # Topics that began at the same time share one wait.
        joining = time.monotonic() - self._began_s < JOINING_S
        longest_s = GRAPH_S if joining else LATE_GRAPH_S
        wait_s = min(longest_s - 1e-9 * (time.time_ns() - first_ns), longest_s)
        with self._saw:
            self._saw.wait_for(lambda: self._publishers(name), wait_s)
            found = self._publishers(name)
        return RecordedTopic(
            name,
            type_name,
            "" if mark == UNSUPPORTED else mark,
            any(each.qos.transient_local for each in found),
            tuple(sorted({each.full_node for each in found})),
        )

    def _of_publisher(self, topic: RecordedTopic, heard: _Heard, gid: bytes) -> RecordedTopic:
        """Return the latched topic of its publisher `gid`; the whole topic if that is unknown."""
        if (found := self._of_one.get((heard.key, gid))) is not None:
            return found
        name, domain = topic.name, self._options.domain

        def nodes() -> list[str]:
            return [
                each.full_node for each in self._publishers(name) if gid_of(each, domain) == gid
            ]

        with self._saw:
            if time.monotonic() - self._began_s < JOINING_S:
                wait_s = GRAPH_S - 1e-9 * (time.time_ns() - heard.log_ns)
                self._saw.wait_for(nodes, min(wait_s, GRAPH_S))
            publishers = tuple(nodes())
        if not publishers:
            return topic
        found = self._of_one[heard.key, gid] = topic._replace(publishers=publishers)
        return found

    def _attach(self, writer: RecordWriter, topic: RecordedTopic, heard: _Heard) -> None:
        """Attach a session's configuration to the file, once."""
        if (topic.name, heard.data) in self._configured or topic.type_name != _STRING.name:
            return
        self._configured.add((topic.name, heard.data))
        message = _STRING.decode(heard.data)
        if not isinstance(message, MalformedCdr):
            name = topic.name[1:].replace("/", ".")
            writer.attach(f"{name}.json", message["data"], heard.log_ns)

    def _publishers(self, topic: str) -> list[Entity]:
        return [each for each in self._seen.get(topic, ()) if each.kind == PUBLISHER]

    def _announce(self) -> None:
        """Announce a subscriber of all topics: some nodes publish only to subscribers."""
        with self._saw:
            new = {name: each for name, (each, *_) in self._seen.items()}
        for name, entity in new.items():
            if name in self._announced or not self._wants(name):
                continue
            self._announced.add(name)
            qos = LATCHED_QOS if entity.qos.transient_local else DEFAULT_QOS
            with contextlib.suppress(DriverError, RosNameError, zenoh_module().ZError):
                ours, _ = self._node.endpoint(
                    SUBSCRIPTION, name, entity.type_name, qos, entity.type_hash
                )
                self._handles.append(self._node.declare_token(ours))

    def _wants(self, name: str) -> bool:
        return not self._arms or name[1:].startswith(tuple(f"{arm}/" for arm in self._arms))


def record(
    options: BusOptions, path: Path, arms: Sequence[str] = (), seconds: float | None = None
) -> Report:
    """Record until `seconds` are over, SIGINT or SIGTERM. Prints READY once recording."""
    with interruptible() as interrupted, Recorder(options, path, arms) as recorder:
        print(f"READY {path}", flush=True)
        end_s = time.monotonic() + (float("inf") if seconds is None else seconds)
        while not recorder.failed and not interrupted.is_set():
            left_s = end_s - time.monotonic()
            if left_s <= 0.0 or interrupted.wait(min(left_s, _WAIT_S)):
                break
        return recorder.close()
