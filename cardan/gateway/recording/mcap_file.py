"""MCAP files as ROS 2 has them: profile ``ros2``, messages in CDR, schemas as .msg texts.

Sources: the MCAP specification (mcap.dev/spec) and its registry's profile "ros2"; channel metadata
as rosbag2 writes it.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, cast

from cardan import __version__
from cardan.errors import CaptureError
from cardan.extras import missing_extra
from cardan.files import SupportsRead, open_file, read_up_to
from cardan.protocols.ros2.interfaces import InterfaceError, full_text
from cardan.protocols.ros2.type_hash import UNSUPPORTED, type_hash
from cardan.shortage import shortage

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

PROFILE, ENCODING, SCHEMA_ENCODING = "ros2", "cdr", "ros2msg"

_QOS_KEY, _HASH_KEY, _PUBLISHERS_KEY = "offered_qos_profiles", "topic_type_hash", "publishers"

MAX_CHUNK_BYTES = 64 * 2**20
"""Most that a chunk may unpack to: programs write chunks of 1 to 16 MiB, and some bytes of a
damaged one can unpack to thousands of times as many."""

_MAGIC = b"\x89MCAP0\r\n"

_FOREVER = "sec: 9223372036\n    nsec: 854775807"


class RecordedTopic(NamedTuple):
    """A topic of a record."""

    name: str
    type_name: str
    """In full: "geometry_msgs/msg/PoseStamped"."""
    type_hash: str
    """Empty where the record does not say."""
    latched: bool
    publishers: tuple[str, ...]
    """Full names of the nodes that published it, as far as they were known when it began; empty in
    records that others made."""


class RecordedMessage(NamedTuple):
    """A message of a record."""

    topic: RecordedTopic
    log_ns: int
    """When it was recorded, ns since the epoch."""
    publish_ns: int
    """When it was published, by its sender's clock, ns since the epoch."""
    sequence: int
    data: bytes
    """CDR with its encapsulation."""


def _installed() -> None:
    try:
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise missing_extra("a record", "mcap", "record", error) from error


def known_definition(type_name: str, mark: str) -> str:
    """The text of a message's definition; empty where Cardan does not know the type, or the sender
    has another type of that name, by its hash."""
    try:
        if mark not in ("", UNSUPPORTED, type_hash(type_name)):
            return ""
        return full_text(type_name)
    except InterfaceError:
        return ""


class RecordWriter:
    """Writes a record. For one thread."""

    def __init__(self, path: Path) -> None:
        """Raises CaptureError where there is a file already or none can be made."""
        _installed()
        from mcap.writer import Writer

        try:
            self._file: BinaryIO = path.open("xb")
        except FileExistsError:
            raise CaptureError(f"{path} exists: choose another name, or delete it") from None
        except OSError as error:
            raise CaptureError(f"{path} cannot be written: {error.strerror or error}") from None
        self._writer: Any = Writer(self._file)
        self._writer.start(PROFILE, f"cardan {__version__}")
        self._schemas: dict[tuple[str, str], int] = {}
        self.topics: dict[RecordedTopic, int] = {}
        """Those written so far, and their channels."""
        self.unknown: dict[str, str] = {}
        """Types without a definition, and their hashes."""

    def add(self, message: RecordedMessage) -> None:
        """Write a message; what it needs is written before it. Raises OSError."""
        topic = message.topic
        channel = self.topics.get(topic)
        if channel is None:
            channel = self.topics[topic] = self._writer.register_channel(
                topic.name, ENCODING, self._schema_of(topic), _metadata(topic)
            )
        self._writer.add_message(
            channel,
            message.log_ns,
            message.data,
            message.publish_ns,
            message.sequence & 0xFFFFFFFF,
        )

    def _schema_of(self, topic: RecordedTopic) -> int:
        key = topic.type_name, topic.type_hash
        if key not in self._schemas:
            text = known_definition(*key)
            if not text:
                self.unknown[topic.type_name] = topic.type_hash
            encoding = SCHEMA_ENCODING if text else ""
            self._schemas[key] = self._writer.register_schema(
                topic.type_name, encoding, text.encode()
            )
        return self._schemas[key]

    def attach(self, name: str, text: str, now_ns: int) -> None:
        """Add a JSON text as an attachment. Raises OSError."""
        self._writer.add_attachment(0, now_ns, name, "application/json", text.encode())

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        """Add a record of metadata. Raises OSError."""
        self._writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """Give all so far to the system: a reader finds it even if this process is killed. Raises
        OSError."""
        self._writer.flush()

    @property
    def bytes(self) -> int:
        """Size of the file so far, without what `flush` would still write."""
        return self._file.tell()

    def finish(self) -> None:
        """Write the index and close the file. Raises OSError."""
        try:
            self._writer.finish()
        finally:
            self._file.close()


def _metadata(topic: RecordedTopic) -> dict[str, str]:
    durability = "transient_local" if topic.latched else "volatile"
    profile = (
        "- history: keep_last\n  depth: 10\n  reliability: reliable\n"
        f"  durability: {durability}\n"
        f"  deadline:\n    {_FOREVER}\n  lifespan:\n    {_FOREVER}\n"
        f"  liveliness: automatic\n  liveliness_lease_duration:\n    {_FOREVER}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )
    return {
        _QOS_KEY: profile,
        _HASH_KEY: topic.type_hash,
        _PUBLISHERS_KEY: " ".join(topic.publishers),
    }


class Place(NamedTuple):
    """Where in a record reading can begin, too."""

    log_ns: int
    """Of the first message from there on."""
    offset: int


PLACE_NS = 500_000_000
"""Shortest time between two places that are remembered."""

MOST_PLACES = 100_000
"""That are remembered: of 14 h."""


class RecordReader:
    """Reads a record from its beginning, one that was cut off too.

    ::

        for message in RecordReader(path):
            print(message.topic.name)

    It remembers places on the way, from which it can be read again: ``reader.messages(place)``.
    """

    def __init__(self, path: Path) -> None:
        _installed()
        self.path = path
        self.cut_off = ""
        """Why the file has no end, once it was read; empty where it has one."""
        self.left_out = 0
        """Messages that are not in CDR."""
        self.places: list[Place] = []
        """In the order of the file; as far as it was read from its beginning."""
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, RecordedTopic] = {}

    def __iter__(self) -> Iterator[RecordedMessage]:
        """All messages in the order of the file. Raises CaptureError for what is no MCAP file."""
        return self.messages()

    def messages(self, place: Place | None = None) -> Iterator[RecordedMessage]:
        """Those from a place of `places` on, in the order of the file; None: all. Raises
        CaptureError for what is no MCAP file."""
        from mcap.records import Channel, Message, Schema
        from mcap.stream_reader import StreamReader

        schemas, topics, places = self._schemas, self._topics, self.places
        if place is None:
            schemas.clear()
            topics.clear()
            places.clear()
        self.cut_off, self.left_out = "", 0
        try:
            stream = open_file(self.path)
        except OSError as error:
            why = error.strerror or error
            raise CaptureError(f"{self.path} cannot be read: {why}") from None
        with stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                raise CaptureError(f"{self.path} is no MCAP file")
            stream.seek(0 if place is None else place.offset)
            pieces = cast(BinaryIO, _InPieces(stream))
            raw = StreamReader(pieces, skip_magic=place is not None, emit_chunks=True).records
            records = _unpacked(raw, stream.tell)
            while True:
                # A file that was cut off ends anywhere, within a compressed chunk too.
                try:
                    offset, record = next(records, (0, None))
                except Exception as error:
                    if shortage(error):
                        raise
                    self.cut_off = f"it was cut off while it was written ({error!r:.80})"
                    return
                if record is None:
                    return
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    if record.message_encoding == ENCODING:
                        topics[record.id] = _topic(record, schemas.get(record.schema_id, ""))
                elif isinstance(record, Message):
                    if place is None and _is_news(places, offset, record.log_time):
                        places.append(Place(record.log_time, offset))
                    topic = topics.get(record.channel_id)
                    if topic is None:
                        self.left_out += 1
                        continue
                    yield RecordedMessage(
                        topic, record.log_time, record.publish_time, record.sequence, record.data
                    )


class _InPieces:
    """A file that is read in pieces: a damaged length would have that much memory taken."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        """At most `size` bytes."""
        return read_up_to(self._file, size)


def _is_news(places: list[Place], offset: int, log_ns: int) -> bool:
    if not places:
        return True
    far = log_ns >= places[-1].log_ns + PLACE_NS
    return far and offset != places[-1].offset and len(places) < MOST_PLACES


def _unpacked(
    records: Iterator[McapRecord], tell: Callable[[], int]
) -> Iterator[tuple[int, McapRecord]]:
    """The same with what is in its chunks in their place, each with the offset at which reading it
    begins."""
    from mcap.records import Chunk

    while True:
        offset = tell()
        record = next(records, None)
        if record is None:
            return
        if isinstance(record, Chunk):
            for each in _records(record):
                yield offset, each
        else:
            yield offset, record


def _records(chunk: Chunk) -> list[McapRecord]:
    """What is in a chunk. The lengths that it and its compressed frame declare are not believed:
    mcap's own unpacking takes the memory for them first."""
    import lz4.frame
    import zstandard
    from mcap.stream_reader import breakup_chunk

    packed = BytesIO(chunk.data)
    with contextlib.ExitStack() as stack:
        stream: SupportsRead
        if chunk.compression == "zstd":
            stream = stack.enter_context(zstandard.ZstdDecompressor().stream_reader(packed))
        elif chunk.compression == "lz4":
            stream = stack.enter_context(lz4.frame.open(packed))
        else:
            return breakup_chunk(chunk)
        data = read_up_to(stream, MAX_CHUNK_BYTES + 1)
    if len(data) > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk of more than {MAX_CHUNK_BYTES >> 20} MiB")
    return breakup_chunk(dataclasses.replace(chunk, compression="", data=data))


def _topic(channel: Any, type_name: str) -> RecordedTopic:
    metadata = channel.metadata
    profile = metadata.get(_QOS_KEY, "")
    latched = "durability: transient_local" in profile or "durability: 1\n" in profile
    return RecordedTopic(
        channel.topic,
        type_name,
        metadata.get(_HASH_KEY, ""),
        latched,
        tuple(metadata.get(_PUBLISHERS_KEY, "").split()),
    )
