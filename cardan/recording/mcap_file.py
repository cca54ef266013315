"""Reader and writer of ROS 2's MCAP files: profile ``ros2``, messages in CDR, schemas as .msg
texts.

Sources: the MCAP specification (mcap.dev/spec) and its registry's profile "ros2"; channel metadata
as rosbag2 writes it.
"""

from __future__ import annotations

import bisect
import contextlib
import dataclasses
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, TypeAlias

from cardan import __version__
from cardan.common.extras import missing_extra
from cardan.common.files import SupportsRead, open_file, read_up_to
from cardan.common.resource_errors import shortage
from cardan.errors import CaptureError
from cardan.protocols.ros2.interfaces import InterfaceError, full_text
from cardan.protocols.ros2.type_hash import UNSUPPORTED, type_hash

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk, Message, Schema


class OtherRecord(NamedTuple):
    """A header, attachment or metadata record."""

    opcode: int
    body: bytes


Record: TypeAlias = "Schema | Channel | Message | OtherRecord"

PROFILE, ENCODING, SCHEMA_ENCODING = "ros2", "cdr", "ros2msg"

_QOS_KEY, _HASH_KEY, _PUBLISHERS_KEY = "offered_qos_profiles", "topic_type_hash", "publishers"

MAX_CHUNK_BYTES = 64 * 2**20
"""Largest uncompressed chunk that is accepted: programs write 1 to 16 MiB, and a few bytes of a
damaged one can unpack to thousands of times as many."""

MOST_DAMAGE = 20
"""Most damaged parts of a file that are reported."""

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
"""Head of each record: opcode and length in bytes."""
_FOOTER_BYTES: Final = 9 + 20 + len(_MAGIC)
_PRIVATE: Final = 0x80
"""First opcode reserved for other programs."""

_FOREVER = "sec: 9223372036\n    nsec: 854775807"


class RecordedTopic(NamedTuple):
    """A topic of a record."""

    name: str
    type_name: str
    """Full type name: "geometry_msgs/msg/PoseStamped"."""
    type_hash: str
    """Type hash; empty if the record has none."""
    latched: bool
    publishers: tuple[str, ...]
    """Full names of the publishing nodes, as known at its start; empty in other programs'
    records."""


class RecordedMessage(NamedTuple):
    """A message of a record."""

    topic: RecordedTopic
    log_ns: int
    """When it was recorded, ns since the epoch."""
    publish_ns: int
    """When it was published, by its sender's clock, ns since the epoch."""
    sequence: int
    data: bytes
    """CDR with its encapsulation header."""


def _installed() -> None:
    try:
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise missing_extra("a record", "mcap", "record", error) from error


def is_mcap(path: Path) -> bool:
    """True if a file begins with MCAP's magic bytes; False also if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except OSError:
        return False


def known_definition(type_name: str, mark: str) -> str:
    """Return the text of a message's definition; empty if the type is unknown, or if its hash shows
    that the sender has another type of that name."""
    try:
        if mark not in ("", UNSUPPORTED, type_hash(type_name)):
            return ""
        return full_text(type_name)
    except InterfaceError:
        return ""


class RecordWriter:
    """Writer of a record. Not thread-safe."""

    def __init__(self, path: Path) -> None:
        """Create the file. Raises CaptureError if it exists or cannot be made."""
        _installed()
        from mcap.writer import Writer

        try:
            self._file: BinaryIO = path.open("xb")
        except FileExistsError:
            raise CaptureError(f"{path} exists: choose another name, or delete it") from None
        except OSError as error:
            raise CaptureError(f"{path} cannot be written: {error.strerror or error}") from None
        self._writer: Any = Writer(self._file, enable_data_crcs=True)
        self._writer.start(PROFILE, f"cardan {__version__}")
        self._schemas: dict[tuple[str, str], int] = {}
        self.topics: dict[RecordedTopic, int] = {}
        """Channels by topic."""
        self.unknown: dict[str, str] = {}
        """Types without a known definition, and their hashes."""

    def add(self, message: RecordedMessage) -> None:
        """Write a message, after its schema and channel if they are new. Raises OSError."""
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
        """Hand all data to the system, so that it survives this process. Raises OSError."""
        self._writer.flush()

    @property
    def bytes(self) -> int:
        """Size of the file so far, without unflushed data."""
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


class RecordPosition(NamedTuple):
    """Position in a record at which reading can begin."""

    log_ns: int
    """Log time of the first message from there on, ns."""
    offset: int


PLACE_NS = 500_000_000
"""Shortest time between two remembered positions, ns."""

MOST_PLACES = 100_000
"""Most remembered positions: those of 14 h."""


class RecordReader:
    """Reads a record from its beginning, also one that was cut off or is damaged.

    ::

        for message in RecordReader(path):
            print(message.topic.name)

    Positions remembered on the way can be read from again: ``reader.messages(place)``.
    """

    def __init__(self, path: Path) -> None:
        _installed()
        self.path = path
        self.cut_off = ""
        """Reason why the end of the file is missing, known once it was read; "" if it has one."""
        self.damage: list[str] = []
        """Damaged parts before the newest message that were skipped, in words; MOST_DAMAGE at
        most."""
        self.left_out: dict[str, int] = {}
        """Count of skipped messages by encoding (not CDR); "": their topic is not described."""
        self.places: list[RecordPosition] = []
        """Remembered positions in the order of the file, as far as it was read from its
        beginning."""
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, RecordedTopic] = {}
        self._others: dict[int, str] = {}
        """Encodings of the channels that are not ROS 2 topics."""

    def __iter__(self) -> Iterator[RecordedMessage]:
        """Yield all messages in the order of the file. Raises CaptureError if it is not an
        MCAP file."""
        return self.messages()

    @property
    def problems(self) -> list[str]:
        """Problems of the file as far as it was read, in words."""
        damaged = [f"the file is damaged {each}" for each in self.damage]
        others = [
            f"{count} messages are left out: they are in {encoding!r:.30}, and only those of ROS 2 "
            f"({ENCODING}) are read"
            if encoding
            else f"{count} messages are left out: their topics are not described before them"
            for encoding, count in self.left_out.items()
        ]
        ended = [f"the file ends early: {self.cut_off}"] if self.cut_off else []
        return damaged + others + ended

    def messages(self, place: RecordPosition | None = None) -> Iterator[RecordedMessage]:
        """Yield messages in the order of the file from a remembered place on; None: all. Raises
        CaptureError if the file is not an MCAP file."""
        from mcap.records import Channel, Message, Schema

        schemas, topics, others, places = self._schemas, self._topics, self._others, self.places
        if place is None:
            schemas.clear()
            topics.clear()
            others.clear()
            places.clear()
        self.left_out = {}
        for offset, record in self._read(place):
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                if record.message_encoding == ENCODING:
                    topics[record.id] = _topic(record, schemas.get(record.schema_id, ""))
                else:
                    others[record.id] = record.message_encoding or "no encoding"
            elif isinstance(record, Message):
                if place is None and _is_news(places, offset, record.log_time):
                    places.append(RecordPosition(record.log_time, offset))
                topic = topics.get(record.channel_id)
                if topic is None:
                    encoding = others.get(record.channel_id, "")
                    self.left_out[encoding] = self.left_out.get(encoding, 0) + 1
                    continue
                yield RecordedMessage(
                    topic, record.log_time, record.publish_time, record.sequence, record.data
                )

    def records(self) -> Iterator[Record]:
        """Yield all records before the summary, in the order of the file, without indexes and
        private records. Raises CaptureError if the file is not an MCAP file."""
        for _, record in self._read(None):
            yield record

    def _read(self, place: RecordPosition | None) -> Iterator[tuple[int, Record]]:
        self.cut_off, self.damage = "", []
        try:
            stream = open_file(self.path)
        except OSError as error:
            why = error.strerror or error
            raise CaptureError(f"{self.path} cannot be read: {why}") from None
        with stream:
            if read_up_to(stream, len(_MAGIC)) != _MAGIC:
                raise CaptureError(f"{self.path} is not an MCAP file")
            yield from self._records(stream, place)

    def _damaged(self, offset: int, why: str) -> None:
        if len(self.damage) < MOST_DAMAGE:
            self.damage.append(f"at byte {offset} {why}")

    def _records(
        self, stream: BinaryIO, place: RecordPosition | None
    ) -> Iterator[tuple[int, Record]]:
        """Yield records, also those in chunks, each with the offset at which reading it begins."""
        from mcap.opcode import Opcode
        from mcap.records import Message

        end = _End.of(stream)
        at = len(_MAGIC) if place is None else place.offset
        crc, count, known = zlib.crc32(_MAGIC), 0, False
        while True:
            offset, why, lost = at, "", False
            try:
                stream.seek(offset)
                head = read_up_to(stream, _HEAD.size)
                opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
                body = read_up_to(stream, length)
            except OSError as error:
                if shortage(error):
                    raise
                self._damaged(offset, f"it cannot be read: {error.strerror or error}")
                return
            at = offset + len(head) + len(body)
            records: list[Record] = []
            if len(head) < _HEAD.size or len(body) < length:
                if not end.finished:
                    missing = f"byte {at} is its last, in a record of {length} bytes"
                    self.cut_off = f"it was cut off while it was written ({missing})"
                    return
                why, lost = f"a record of {length} bytes is longer than the file", True
            elif opcode == Opcode.DATA_END:
                self._check_end(offset, body, crc if place is None else None, count, end)
                self._check_footer(stream, at, end)
                return
            else:
                try:
                    records = _records_in(opcode, body)
                except _LostError as error:
                    why, lost = str(error), True
                except Exception as error:
                    if shortage(error):
                        raise
                    said = str(error) if isinstance(error, _ChunkError) else "it cannot be unpacked"
                    why = f"a chunk is left out ({said})"
            following = end.chunk_after(offset)
            if following is not None and following < at:
                why, lost, records = why or "a record is longer than it was", True, []
            if why:
                self._damaged(offset, why)
                if lost and following is None:
                    return
                if not known:
                    # Topics described in the damaged part are described again at the end.
                    known = True
                    records = end.topics
                if lost and following is not None:
                    at = following
            crc = zlib.crc32(body, zlib.crc32(head, crc))
            for record in records:
                count += isinstance(record, Message)
                yield offset, record

    def _check_end(self, offset: int, body: bytes, crc: int | None, count: int, end: _End) -> None:
        """Check the CRC and the message count of the data. `crc`: None if not all was read."""
        if self.damage or crc is None:
            return
        if len(body) < 4 or struct.unpack_from("<I", body)[0] not in (0, crc):
            self._damaged(offset, "the CRC of all data is another")
        elif end.messages not in (None, count):
            self._damaged(offset, f"there are to be {end.messages} messages before, not {count}")

    def _check_footer(self, stream: BinaryIO, offset: int, end: _End) -> None:
        from mcap.opcode import Opcode

        if end.finished and not end.whole:
            self._damaged(offset, "the summary's CRC is another")
        elif not end.finished:
            size, at = stream.seek(0, os.SEEK_END), offset
            opcode = length = 0
            while opcode != Opcode.FOOTER and at + _HEAD.size <= size:
                stream.seek(at)
                opcode, length = _HEAD.unpack(read_up_to(stream, _HEAD.size))
                at += _HEAD.size + length
            if opcode == Opcode.FOOTER and at + len(_MAGIC) <= size:
                self._damaged(at, "its end is another")
            else:
                self.cut_off = "it was cut off while it was written (in its summary)"


class _LostError(ValueError):
    """The start of the next record is not known."""


class _ChunkError(ValueError):
    """Error in a chunk, in words."""


class _End(NamedTuple):
    """Summary section of a file."""

    finished: bool
    """True if the file has the end of a finished one."""
    whole: bool
    """True if the summary can be read and its CRC matches."""
    chunks: tuple[int, ...]
    """Offsets of the chunks, ascending."""
    topics: list[Record]
    """All schemas and channels."""
    messages: int | None
    """Number of messages; None if not recorded."""

    def chunk_after(self, offset: int) -> int | None:
        """Offset of the next chunk; None if unknown or at the end."""
        index = bisect.bisect_right(self.chunks, offset)
        return self.chunks[index] if index < len(self.chunks) else None

    @classmethod
    def of(cls, stream: BinaryIO) -> _End:
        """Read the summary of a file."""
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import EndOfFile
        from mcap.opcode import Opcode
        from mcap.records import Channel, ChunkIndex, Schema, Statistics

        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - _FOOTER_BYTES))
        footer = read_up_to(stream, _FOOTER_BYTES)
        if len(footer) < _FOOTER_BYTES or not footer.endswith(_MAGIC):
            return cls(False, False, (), [], None)
        head, said = footer[: -len(_MAGIC) - 4], footer[-len(_MAGIC) - 4 : -len(_MAGIC)]
        opcode, length, start, _ = struct.unpack("<BQQQ", head)
        broken = cls(True, False, (), [], None)
        if opcode != Opcode.FOOTER or length != 20 or start > size - _FOOTER_BYTES:
            return broken
        if not start:
            return cls(True, True, (), [], None)
        stream.seek(start)
        summary = read_up_to(stream, min(size - _FOOTER_BYTES - start, MAX_CHUNK_BYTES))
        (crc,) = struct.unpack("<I", said)
        if crc not in (0, zlib.crc32(head, zlib.crc32(summary))):
            return broken
        chunks: list[int] = []
        topics: list[Record] = []
        messages, at = None, 0
        try:
            while at < len(summary):
                opcode, length = _HEAD.unpack_from(summary, at)
                body = ReadDataStream(BytesIO(summary[at + _HEAD.size : at + _HEAD.size + length]))
                at += _HEAD.size + length
                if opcode == Opcode.CHUNK_INDEX:
                    chunks.append(ChunkIndex.read(body).chunk_start_offset)
                elif opcode == Opcode.STATISTICS:
                    messages = Statistics.read(body).message_count
                elif opcode == Opcode.SCHEMA:
                    topics.append(Schema.read(body))
                elif opcode == Opcode.CHANNEL:
                    topics.append(Channel.read(body))
        except (ValueError, OverflowError, struct.error, EndOfFile):
            return broken
        return cls(True, True, tuple(sorted(chunks)), topics, messages)


def _is_news(places: list[RecordPosition], offset: int, log_ns: int) -> bool:
    if not places:
        return True
    far = log_ns >= places[-1].log_ns + PLACE_NS
    return far and offset != places[-1].offset and len(places) < MOST_PLACES


def _records_in(opcode: int, body: bytes) -> list[Record]:
    """Unpack a record of the data section. Raises _LostError or any error of mcap and zstd or
    lz4."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import EndOfFile
    from mcap.opcode import Opcode
    from mcap.records import Channel, Chunk, Message, Schema

    if opcode == Opcode.CHUNK:
        return _unpacked(Chunk.read(ReadDataStream(BytesIO(body))))
    if opcode == Opcode.MESSAGE_INDEX:
        if len(body) < 6 or len(body) != 6 + struct.unpack_from("<I", body, 2)[0]:
            raise _LostError("an index of messages has another length than it says")
        return []
    if opcode in (Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA):
        return [OtherRecord(opcode, body)]
    if opcode >= _PRIVATE:
        return []
    stream = ReadDataStream(BytesIO(body))
    try:
        if opcode == Opcode.SCHEMA:
            return [Schema.read(stream)]
        if opcode == Opcode.CHANNEL:
            return [Channel.read(stream)]
        if opcode == Opcode.MESSAGE:
            return [Message.read(stream, len(body))]
    except (ValueError, OverflowError, struct.error, EndOfFile):
        raise _LostError("a record cannot be read: a length or a text in it is wrong") from None
    raise _LostError(f"a record is of an unknown kind, {opcode}")


def _unpacked(chunk: Chunk) -> list[Record]:
    """Unpack a chunk. Raises _ChunkError for a wrong CRC. The lengths that the chunk and its
    compressed frame declare are not trusted: mcap's own unpacking allocates them first."""
    import lz4.frame
    import zstandard
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import breakup_chunk

    packed = BytesIO(chunk.data)
    with contextlib.ExitStack() as stack:
        stream: SupportsRead = packed
        if chunk.compression == "zstd":
            stream = stack.enter_context(zstandard.ZstdDecompressor().stream_reader(packed))
        elif chunk.compression == "lz4":
            stream = stack.enter_context(lz4.frame.open(packed))
        elif chunk.compression:
            raise _ChunkError(f"an unknown compression, {chunk.compression!r:.20}")
        data = read_up_to(stream, MAX_CHUNK_BYTES + 1)
    if len(data) > MAX_CHUNK_BYTES:
        raise _ChunkError(f"a chunk of more than {MAX_CHUNK_BYTES >> 20} MiB")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise _ChunkError("its CRC is another")
    records = breakup_chunk(dataclasses.replace(chunk, compression="", data=data))
    return [each for each in records if isinstance(each, (Schema, Channel, Message))]


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
