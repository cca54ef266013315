"""Record files: read by other programs, and the rest of a truncated one."""

import contextlib
import io
import struct
import tracemalloc

import lz4.frame
import pytest
import zstandard
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from cardan.errors import CaptureError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import full_text, known_types
from cardan.protocols.ros2.messages import completed, default_message
from cardan.protocols.ros2.type_hash import type_hash
from cardan.recording.mcap_file import (
    MAX_CHUNK_BYTES,
    RecordedMessage,
    RecordedTopic,
    RecordReader,
    RecordWriter,
    known_definition,
)
from tests.examples import examples
from tests.recording.sessions import NS

TYPES = [
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseStamped",
    "cardan_msgs/msg/RawPacket",
    "cardan_msgs/msg/ArmStatus",
    "tf2_msgs/msg/TFMessage",
    "std_msgs/msg/String",
    "rcl_interfaces/msg/Log",
]
STRANGE = RecordedTopic("/strange", "strange_msgs/msg/Thing", "RIHS01_" + "ab" * 32, False, ())


def topic_of(type_name, latched=False):
    name = type_name.rpartition("/")[2].lower()
    return RecordedTopic(f"/arm/{name}", type_name, type_hash(type_name), latched, ("/arm/node",))


def messages():
    for number in range(300):
        type_name = TYPES[number % len(TYPES)]
        data = codec_of(type_name).encode(default_message(type_name))
        stamp_ns = NS + number * 1_000_000
        yield RecordedMessage(
            topic_of(type_name, type_name.endswith("String")), stamp_ns, stamp_ns - 7, number, data
        )


def read_on(stream):
    """Return the messages that mcap's own reader finds in a file without an end."""
    rows = []
    with contextlib.suppress(EndOfFile):
        rows.extend(NonSeekingReader(stream).iter_messages(log_time_order=False))
    return rows


def begun(path):
    """Return the writer of a record at `path` that has all messages, in three chunks."""
    writer = RecordWriter(path)
    writer.attach("configuration.json", "{}", NS)
    writer.describe("cardan", {"cardan": "1"})
    for number, message in enumerate(messages()):
        writer.add(message)
        if number % 100 == 99:
            writer.flush()
    return writer


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "record.mcap"
    begun(path).finish()
    return path


def test_what_was_written_is_read(file):
    assert list(RecordReader(file)) == list(messages())
    assert not RecordReader(file).cut_off


def test_mcaps_own_reader_reads_it(file):
    with file.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        rows = list(reader.iter_messages())
        assert len(rows) == 300
        for (schema, channel, message), ours in zip(rows, messages(), strict=True):
            assert schema.name == ours.topic.type_name
            assert schema.encoding == "ros2msg"
            assert schema.data.decode() == full_text(ours.topic.type_name)
            assert channel.topic == ours.topic.name
            assert channel.message_encoding == "cdr"
            assert channel.metadata["topic_type_hash"] == ours.topic.type_hash
            assert (message.log_time, message.publish_time) == (ours.log_ns, ours.publish_ns)
            assert (message.sequence, message.data) == (ours.sequence, ours.data)
        assert [each.name for each in reader.iter_attachments()] == ["configuration.json"]
        assert [each.name for each in reader.iter_metadata()] == ["cardan"]
        statistics = reader.get_summary().statistics
        assert statistics.message_count == 300
        assert statistics.channel_count == len(TYPES)


def test_rosbags_reads_it_as_ros2_bag_does(file):
    store = get_typestore(Stores.EMPTY)
    with Reader(file) as bag:
        assert bag.message_count == 300
        assert set(bag.topics) == {topic_of(name).name for name in TYPES}
        for connection in bag.connections:
            if connection.msgtype not in store.types:
                found = get_types_from_msg(connection.msgdef.data, connection.msgtype)
                new = {name: each for name, each in found.items() if name not in store.types}
                store.register(new)
        for connection, stamp_ns, data in bag.messages():
            assert stamp_ns >= NS
            store.deserialize_cdr(data, connection.msgtype)
        latched = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in bag.connections}
    assert latched["/arm/string"] == "TRANSIENT_LOCAL"
    assert latched["/arm/jointstate"] == "VOLATILE"


def test_rosbags_understands_the_definition_of_every_type_that_cardan_knows():
    store = get_typestore(Stores.EMPTY)
    for name in known_types():
        if "/msg/" not in name:
            continue
        found = get_types_from_msg(full_text(name), name)
        store.register({key: each for key, each in found.items() if key not in store.types})
        data = codec_of(name).encode(completed(name, {}))
        store.deserialize_cdr(data, name)


def test_a_type_that_is_not_known_is_written_without_a_definition(tmp_path):
    path = tmp_path / "strange.mcap"
    writer = RecordWriter(path)
    writer.add(RecordedMessage(STRANGE, NS, NS, 1, b"\0\1\0\0abc"))
    writer.finish()
    assert writer.unknown == {STRANGE.type_name: STRANGE.type_hash}
    assert next(iter(RecordReader(path))).topic == STRANGE
    with path.open("rb") as stream:
        schema, channel, _ = next(iter(make_reader(stream).iter_messages()))
    assert (schema.name, schema.encoding, schema.data) == (STRANGE.type_name, "", b"")
    assert channel.metadata["topic_type_hash"] == STRANGE.type_hash
    with Reader(path) as bag:
        assert bag.topics["/strange"].msgtype == STRANGE.type_name


def test_another_definition_of_a_known_name_is_not_passed_off_as_ours():
    name = "std_msgs/msg/String"
    assert known_definition(name, type_hash(name)) == full_text(name)
    assert known_definition(name, "") == full_text(name)
    assert known_definition(name, "RIHS01_" + "00" * 32) == ""


def test_a_file_that_was_cut_off_anywhere_gives_what_is_whole(file, tmp_path):
    data = file.read_bytes()
    whole = list(messages())
    counts = set()
    for length in [*range(8, 1200, 7), *range(1200, len(data), 97)]:
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[:length])
        reader = RecordReader(cut)
        found = list(reader)
        assert found == whole[: len(found)]
        assert reader.cut_off
        counts.add(len(found))
    assert {0, 100, 200, 300} <= counts


def test_a_damaged_length_takes_no_memory(tmp_path):
    """A metadata record whose name claims a length of 4 GB."""
    path = tmp_path / "damaged.mcap"
    record = struct.pack("<I", 0xF0000000) + b"cardan"
    path.write_bytes(b"\x89MCAP0\r\n\x0c" + struct.pack("<Q", len(record)) + record)
    reader = RecordReader(path)
    tracemalloc.start()
    try:
        assert list(reader) == []
        assert tracemalloc.get_traced_memory()[1] < 1 << 22
    finally:
        tracemalloc.stop()
    assert reader.cut_off


def chunk_of(compression: str, packed: bytes, unpacked_bytes: int) -> bytes:
    body = struct.pack("<QQQI", 0, 0, unpacked_bytes, 0)
    body += struct.pack("<I", len(compression)) + compression.encode()
    body += struct.pack("<Q", len(packed)) + packed
    return b"\x89MCAP0\r\n\x06" + struct.pack("<Q", len(body)) + body


ZSTD_OF_3_GB = bytes.fromhex("28b52ffd a0 000000b0 010000".replace(" ", ""))
"""Frame without data that claims a size of 3 GB (RFC 8878, 3.1.1.1)."""


@pytest.mark.parametrize(
    ("compression", "packed"),
    [
        ("zstd", ZSTD_OF_3_GB),
        ("zstd", zstandard.compress(bytes(200_000_000))),
        ("lz4", lz4.frame.compress(bytes(200_000_000))),
    ],
)
def test_a_chunk_takes_no_more_memory_than_a_chunk_may(tmp_path, compression, packed):
    path = tmp_path / "damaged.mcap"
    path.write_bytes(chunk_of(compression, packed, 0xB0000000))
    reader = RecordReader(path)
    tracemalloc.start()
    try:
        assert list(reader) == []
        assert tracemalloc.get_traced_memory()[1] < 3 * MAX_CHUNK_BYTES
    finally:
        tracemalloc.stop()
    assert reader.cut_off


@pytest.mark.parametrize(
    "options",
    [
        *({"compression": each, "chunk_size": 2000} for each in CompressionType),
        {"enable_crcs": False},
    ],
    ids=str,
)
def test_chunks_of_every_compression_and_without_a_crc_are_read(tmp_path, options):
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start("ros2")
        schema = writer.register_schema(TYPES[-2], "ros2msg", b"string data")
        channel = writer.register_channel("/talk", "cdr", schema)
        for number in range(100):
            writer.add_message(channel, number, codec_of(TYPES[-2]).encode({"data": "a"}), number)
        writer.finish()
    reader = RecordReader(path)
    assert [each.log_ns for each in reader] == list(range(100))
    assert not reader.damage


def test_mcaps_non_seeking_reader_reads_one_that_was_flushed(tmp_path):
    path = tmp_path / "flushed.mcap"
    writer = RecordWriter(path)
    for message in messages():
        writer.add(message)
    writer.flush()
    rows = read_on(io.BytesIO(path.read_bytes()))
    assert len(rows) == 300
    writer.finish()


@pytest.mark.parametrize("data", [b"", b"[session]\n", b"\x89PNG\r\n\x1a\n" + bytes(50)])
def test_what_is_no_mcap_file_is_refused(tmp_path, data):
    path = tmp_path / "other"
    path.write_bytes(data)
    with pytest.raises(CaptureError, match="is not an MCAP file"):
        list(RecordReader(path))


@pytest.mark.parametrize("compressed", [False, True])
def test_a_bag_that_others_wrote_is_read(tmp_path, compressed):
    store = get_typestore(Stores.ROS2_JAZZY)
    bag = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    if compressed:
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    message = store.types[TYPES[-2]](data="abc")
    with bag:
        connection = bag.add_connection("/talk", TYPES[-2], typestore=store)
        for number in range(50):
            data = store.serialize_cdr(message, TYPES[-2])
            bag.write(connection, NS + number, data)
    (path,) = (tmp_path / "bag").glob("*.mcap")
    found = list(RecordReader(path))
    assert [each.log_ns for each in found] == [NS + number for number in range(50)]
    assert found[0].topic[:2] == ("/talk", TYPES[-2])
    assert not found[0].topic.publishers
    assert codec_of(TYPES[-2]).decode(found[0].data) == {"data": "abc"}


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(CaptureError, match="cannot be read: No such file"):
        list(RecordReader(tmp_path / "none"))


def test_no_file_is_overwritten(file):
    before = file.read_bytes()
    with pytest.raises(CaptureError, match="exists: choose another name"):
        RecordWriter(file)
    assert file.read_bytes() == before


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(CaptureError, match="cannot be written: No such file"):
        RecordWriter(tmp_path / "none" / "record.mcap")


# -- damage ---------------------------------------------------------------------------------------

CHUNK = 6


def records_of(data):
    """Return offset, opcode and length of each record of a file."""
    at = 8
    while at + 9 <= len(data):
        length = struct.unpack_from("<Q", data, at + 1)[0]
        yield at, data[at], length
        at += 9 + length


def flipped(data, at, bit=0):
    changed = bytearray(data)
    changed[at] ^= 1 << bit
    return bytes(changed)


@pytest.fixture
def read_damaged(tmp_path):
    def read(data):
        path = tmp_path / "damaged.mcap"
        path.write_bytes(data)
        reader = RecordReader(path)
        return reader, list(reader)

    return read


def test_a_damaged_chunk_is_named_and_left_out(file, read_damaged):
    data, whole = file.read_bytes(), list(messages())
    chunks = [(at, length) for at, opcode, length in records_of(data) if opcode == CHUNK]
    assert len(chunks) == 3
    for number, (at, length) in enumerate(chunks):
        rest = whole[: 100 * number] + whole[100 * (number + 1) :]
        for where in range(at + 80, at + 9 + length, 197):
            reader, found = read_damaged(flipped(data, where))
            assert found == rest
            (words,) = reader.damage
            assert words.startswith(f"at byte {at} a chunk is left out (")
            assert not reader.cut_off


def test_no_flipped_bit_is_read_as_other_data(file, read_damaged):
    data, whole = file.read_bytes(), list(messages())
    unnoticed = 0
    for number, where in enumerate(range(8, len(data), 61 * 4 // examples(4))):
        reader, found = read_damaged(flipped(data, where, number % 8))
        assert [each for each in found if each not in whole] == []
        assert not reader.cut_off
        if len(found) < len(whole):
            assert reader.damage
        unnoticed += not reader.damage
    assert unnoticed == 0


def test_a_record_that_was_cut_off_and_is_damaged_says_both(file, read_damaged):
    data = file.read_bytes()
    _, second, third = (at for at, opcode, _ in records_of(data) if opcode == CHUNK)
    reader, found = read_damaged(flipped(data[: third + 50], second + 300))
    assert found == list(messages())[:100]
    assert len(reader.damage) == 1
    assert "cut off" in reader.cut_off


def test_a_damaged_length_is_left_behind(file, read_damaged):
    data = file.read_bytes()
    _, second, _ = (at for at, opcode, _ in records_of(data) if opcode == CHUNK)
    for bit in range(8):
        for byte in (1, 2, 8):
            reader, found = read_damaged(flipped(data, second + byte, bit))
            whole = list(messages())
            assert found in (whole, whole[:100] + whole[200:])
            assert reader.damage
            assert not reader.cut_off


def test_no_exception_of_pythons_is_in_what_is_said_of_a_file(tmp_path):
    """A chunk that claims a compressed size beyond any memory, and similar damage."""
    for packed_bytes in (1 << 63, (1 << 64) - 1, 1 << 40):
        body = struct.pack("<QQQI", 0, 0, 100, 0) + struct.pack("<IQ", 0, packed_bytes) + b"abc"
        path = tmp_path / "damaged.mcap"
        path.write_bytes(b"\x89MCAP0\r\n\x06" + struct.pack("<Q", len(body)) + body)
        reader = RecordReader(path)
        assert list(reader) == []
        assert [each for each in reader.problems if "Error" in each or "EndOfFile" in each] == []
        assert reader.damage == ["at byte 8 a chunk is left out (it cannot be unpacked)"]
