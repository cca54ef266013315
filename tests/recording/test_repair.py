"""`cardan net record --repair`: a complete file from a truncated or damaged one."""

import struct
import tracemalloc

import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError

from cardan.errors import CaptureError
from cardan.recording.mcap_file import RecordReader, RecordWriter
from cardan.recording.repair import repair, repaired_name
from tests.recording.test_mcap_file import CHUNK, begun, flipped, messages, records_of


@pytest.fixture
def file(tmp_path):
    """Record of three chunks, truncated after the last one."""
    path = tmp_path / "record.mcap"
    writer = begun(path)
    whole = path.read_bytes()
    writer.finish()
    path.write_bytes(whole)
    return path


def cut_in_its_last_chunk(path):
    data = path.read_bytes()
    *_, last = (at for at, opcode, _ in records_of(data) if opcode == CHUNK)
    path.write_bytes(data[: last + 500])


def test_a_file_that_was_cut_off_is_whole_again(file):
    cut_in_its_last_chunk(file)
    with pytest.raises(ReaderError), Reader(file):
        pass
    with file.open("rb") as stream, pytest.raises(McapError):
        make_reader(stream).get_summary()

    report = repair(file, repaired_name(file))
    assert report.path == file.with_name("record-repaired.mcap")
    assert report.messages == 200
    (reported,) = report.problems
    assert reported.startswith("the file ends early: it was cut off while it was written (byte ")
    assert report.lines()[-1] == f"{report.path}: 200 messages, with an index"
    reader = RecordReader(report.path)
    assert list(reader) == list(messages())[:200]
    assert reader.problems == []
    with Reader(report.path) as bag:
        assert bag.message_count == 200
        assert len(list(bag.messages())) == 200
    with report.path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        assert reader.get_summary().statistics.message_count == 200
        assert [each.data for each in reader.iter_attachments()] == [b"{}"]
        assert [each.metadata for each in reader.iter_metadata()] == [{"cardan": "1"}]


def test_what_is_damaged_is_left_out_and_reported(file):
    data = file.read_bytes()
    _, second, _ = (at for at, opcode, _ in records_of(data) if opcode == CHUNK)
    file.write_bytes(flipped(data, second + 300))
    report = repair(file, repaired_name(file))
    rest = list(messages())
    assert list(RecordReader(report.path)) == rest[:100] + rest[200:]
    assert report.problems[0].startswith(f"the file is damaged at byte {second} a chunk is left")


def test_a_damaged_attachment_is_left_out_and_reported(file):
    data = file.read_bytes()
    file.write_bytes(flipped(data, data.index(b"configuration.json")))
    report = repair(file, repaired_name(file))
    assert report.messages == 300
    assert "1 attachments or metadata are damaged, and left out" in report.problems
    with report.path.open("rb") as stream:
        assert list(make_reader(stream).iter_attachments()) == []


def test_messages_of_others_are_kept(tmp_path):
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data")
        channel = writer.register_channel("/talk", "ros1", schema)
        writer.add_message(writer.register_channel("/free", "json", 0), 1, b"{}", 1)
        for number in range(20):
            writer.add_message(channel, number, b"\1\0\0\0a", number, number)
        writer.finish()
    whole = repair(path, tmp_path / "whole.mcap")
    assert whole.complete
    assert whole.lines() == [
        "nothing was wrong with the file: there was nothing to repair",
        f"{whole.path}: 21 messages, with an index",
    ]
    with whole.path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros1"
        rows = list(reader.iter_messages(topics=["/talk"]))
    assert len(rows) == 20
    assert (rows[0][0].encoding, rows[0][1].message_encoding) == ("ros1msg", "ros1")
    assert [each.sequence for _, _, each in rows] == list(range(20))


def test_the_file_is_not_taken_into_memory(tmp_path):
    path = tmp_path / "long.mcap"
    writer = RecordWriter(path)
    first = next(messages())
    for number in range(400):
        data = struct.pack("<I", number) * 25_000
        writer.add(first._replace(data=data, sequence=number))
    writer.finish()
    tracemalloc.start()
    try:
        assert repair(path, tmp_path / "whole.mcap").messages == 400
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()


def test_nothing_is_overwritten_and_nothing_is_made_of_what_is_none(file, tmp_path):
    with pytest.raises(CaptureError, match="exists: choose another name"):
        repair(file, file)
    other = tmp_path / "other"
    other.write_bytes(b"[session]\n")
    with pytest.raises(CaptureError, match="is not an MCAP file"):
        repair(other, tmp_path / "new.mcap")
    assert not (tmp_path / "new.mcap").exists()
