"""Recorder on a bus: complete records that other programs can read, and reported gaps."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter

import pytest
from mcap.reader import NonSeekingReader
from rosbags.rosbag2 import Reader

from cardan.bus.node import BusNode, gid_of
from cardan.bus.options import BusOptions
from cardan.demos.pauses import Pauses
from cardan.errors import CaptureError, OptionError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.zenoh import LATCHED_QOS, PUBLISHER, Attachment
from cardan.recording.mcap_file import RecordReader, RecordWriter
from cardan.recording.recorder import QUEUE_MESSAGES, Recorder
from cardan.recording.verify import verify
from tests.recording.sessions import (
    NODE,
    STRING,
    live_session,
    session_file,
)
from tests.recording.test_mcap_file import read_on
from tests.serving import free_endpoint
from tests.waiting import until

TEXT = codec_of(STRING)
CARDAN = (sys.executable, "-m", "cardan")
LATE_AT_EACH = 4
"""Places that may be as late as this computer: both Zenoh nodes, the recorder and its writer."""
AGAIN_S = 0.5
"""Time until an unheard motion request is repeated; a repeat restarts the motion."""


def recorder_on(endpoint, path, arms=()):
    return Recorder(BusOptions(router="", listen=(endpoint,)), path, arms)


def node_at(endpoint, name="talker", namespace="/"):
    return BusNode(BusOptions(router=endpoint), name, namespace)


def text(number):
    return TEXT.encode({"data": str(number)})


def put_all(publisher, count, first=0):
    until(lambda: publisher.heard)
    for number in range(first, first + count):
        publisher.put(text(number), 1_000 + number)


def topics_of(recorder):
    """Return the topics with a recorded message."""
    return {topic.name for topic in list(recorder._topics.values()) if topic is not None}


def names_in(path):
    return Counter(message.topic.name for message in RecordReader(path))


@pytest.mark.matrix
def test_every_message_of_every_topic_also_of_one_that_appears_later(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "all.mcap"
    recorder = recorder_on(endpoint, path)
    with recorder, node_at(endpoint) as node:
        put_all(node.publisher("/first", STRING), 500)
        put_all(node.publisher("/later", STRING), 300)
        until(lambda: recorder._messages >= 800)
        report = recorder.close()
    assert (report.messages, report.topics, report.dropped, report.lost) == (800, 2, 0, 0)
    assert report.complete
    assert names_in(path) == {"/first": 500, "/later": 300}
    first = [each for each in RecordReader(path) if each.topic.name == "/first"]
    assert [each.data for each in first] == [text(number) for number in range(500)]
    assert [each.publish_ns for each in first] == [1_000 + number for number in range(500)]
    assert [each.sequence for each in first] == list(range(1, 501))
    assert first[0].topic.publishers == ("/talker",)
    stamps = [each.log_ns for each in RecordReader(path)]
    assert stamps == sorted(stamps)


@pytest.mark.matrix
def test_what_was_latched_before_is_there_once(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "latched.mcap"
    with BusNode(BusOptions(router="", listen=(endpoint,)), "before") as node:
        publisher = node.publisher("/robot_description", STRING, LATCHED_QOS)
        publisher.put(text(1), 7)
        recorder = Recorder(BusOptions(router=endpoint), path)
        with recorder:
            until(lambda: recorder._messages == 1)
            publisher.put(text(2), 8)
            until(lambda: recorder._messages == 2)
            recorder.close()
    found = list(RecordReader(path))
    assert [each.data for each in found] == [text(1), text(2)]
    assert found[0].topic.latched


@pytest.mark.matrix
def test_arms_by_name_and_what_all_share(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "left.mcap"
    recorder = recorder_on(endpoint, path, ["/left"])
    with recorder, node_at(endpoint) as node:
        put_all(node.publisher("/left/server/pose", STRING), 5)
        put_all(node.publisher("/tf", STRING), 5)
        other = node.publisher("/right/server/pose", STRING)
        other.put(text(0), 1)
        assert not other.heard
        until(lambda: recorder._messages >= 10)
        recorder.close()
    assert names_in(path) == {"/left/server/pose": 5, "/tf": 5}


@pytest.mark.matrix
def test_a_type_that_cardan_does_not_know_is_recorded_and_named(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "strange.mcap"
    recorder = recorder_on(endpoint, path)
    mark = "RIHS01_" + "12" * 32
    with recorder, node_at(endpoint) as node:
        publisher = node.declare_publisher(
            f"0/strange/strange_msgs::msg::dds_::Thing_/{mark}", LATCHED_QOS
        )
        publisher.put(b"\0\1\0\0abc")
        node.declare_publisher("0/no/topic/of/ros", LATCHED_QOS).put(b"x")
        until(lambda: recorder._messages == 1)
        report = recorder.close()
    assert report.unknown == (("strange_msgs/msg/Thing", mark),)
    assert any("strange_msgs/msg/Thing: its definition is not known" in s for s in report.lines())
    (message,) = RecordReader(path)
    assert message.topic[:3] == ("/strange", "strange_msgs/msg/Thing", mark)


WHOLE = {
    *(f"{NODE}/{topic}" for topic in ("configuration", "controller_log", "raw/robot")),
    *(f"{NODE}/{topic}" for topic in ("state/pose", "state/status")),
    *("/joint_states", "/tf", "/tf_static", "/robot_description", "/diagnostics"),
}


@pytest.mark.real
def test_a_session_is_recorded_whole(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "session.mcap"
    recorder = recorder_on(endpoint, path)
    with recorder:
        with live_session(endpoint) as session:
            until(lambda: session.snapshot.loop.cycles > 400)
            # Some topics are published once a second, and only to subscribers.
            until(lambda: topics_of(recorder) >= WHOLE, "every topic")
        report = recorder.close()
    assert report.complete, report.lines()
    assert names_in(path).keys() >= WHOLE
    for message in RecordReader(path):
        assert message.topic.publishers == (NODE,)
        assert isinstance(codec_of(message.topic.type_name).decode(message.data), dict)
    raw = [
        codec_of(each.topic.type_name).decode(each.data)
        for each in RecordReader(path)
        if each.topic.name == f"{NODE}/raw/robot"
    ]
    assert {each["direction"] for each in raw} == {0, 1}
    with Reader(path) as bag:
        assert bag.message_count == report.messages
    with path.open("rb") as stream:
        attachments = {each.name: each.data for each in NonSeekingReader(stream).iter_attachments()}
    described = json.loads(attachments[f"{NODE[1:]}.configuration.json"])
    assert described["tables"]["arm"]["model"] == "ur5"
    assert described["versions"]["cardan"]
    # The recorder began before the session, which makes the first cycle replayable.
    (verified,) = verify(path)
    assert verified.same
    assert not verified.ended
    assert verified.cycles >= 400


@pytest.mark.matrix
def test_a_session_that_a_program_moved_is_replayed_up_to_there(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "moved.mcap"
    recorder = recorder_on(endpoint, path)
    with recorder:
        with live_session(endpoint) as session, node_at(endpoint, "program") as node:
            x, y, z, *turn = until(lambda: session.snapshot.robot.pose)
            pose = {
                "position": {"x": x, "y": y, "z": z - 0.01},
                "orientation": dict(zip("wxyz", turn, strict=True)),
            }
            publisher = node.publisher(f"{NODE}/command/movl", "geometry_msgs/msg/Pose")
            data = codec_of("geometry_msgs/msg/Pose").encode(pose)

            sent_s = [0.0]

            def begun():
                """The recorder also hears the publisher, perhaps before the session does."""
                now_s = time.monotonic()
                if session.controller.at_rest and now_s - sent_s[0] > AGAIN_S:
                    publisher.put(data, 1)
                    sent_s[0] = now_s
                return session.snapshot.tracking.path_m > 0.009

            until(begun)
        report = recorder.close()
    assert names_in(path)[f"{NODE}/command/movl"] >= 1
    (verified,) = verify(path)
    assert verified.same
    assert verified.cycles > 0
    if not report.lost:
        assert verified.ended.startswith(
            f"not replayed from cycle {verified.cycles + 1} on: verb movl of 'ros2 /program'"
        )


@pytest.mark.real
def test_a_recorder_that_is_killed_has_lost_less_than_a_second(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "killed.mcap"
    with BusNode(BusOptions(router="", listen=(endpoint,)), "talker") as node:
        publisher = node.publisher("/count", STRING)
        process = subprocess.Popen(
            [
                *CARDAN,
                "net",
                "record",
                "-o",
                str(path),
                "--session",
                session_file(tmp_path, endpoint),
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout.readline() == f"READY {path}\n"
            until(lambda: publisher.heard)
            end_s = time.monotonic() + 2.5
            number = 0
            with Pauses() as pauses:
                while time.monotonic() < end_s:
                    number += 1
                    publisher.put(text(number), time.time_ns())
                    time.sleep(0.001)
        finally:
            killed_ns = time.time_ns()
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            process.stdout.close()
    reader = RecordReader(path)
    found = list(reader)
    assert reader.cut_off
    assert [each.sequence for each in found] == list(range(1, len(found) + 1))
    late_s = LATE_AT_EACH * pauses.longest_s
    assert killed_ns - found[-1].log_ns < 1e9 * (1.0 + late_s), late_s
    with path.open("rb") as stream:
        rows = read_on(stream)
    assert [message.log_time for _, _, message in rows] == [each.log_ns for each in found]


class Sample:
    """Stand-in for Zenoh's sample."""

    attachment = None
    key_expr = "0/flood/std_msgs::msg::dds_::String_/RIHS01_00"

    class payload:  # noqa: N801 - Zenoh's name
        @staticmethod
        def to_bytes():
            return b"\0\1\0\0\1\0\0\0\0"


@pytest.mark.matrix
def test_what_comes_faster_than_it_is_written_is_dropped_and_counted(tmp_path, monkeypatch):
    blocked, going = threading.Event(), threading.Event()
    add = RecordWriter.add

    def slow(self, message):
        blocked.set()
        assert going.wait(30.0)
        add(self, message)

    monkeypatch.setattr(RecordWriter, "add", slow)
    recorder = recorder_on(free_endpoint(), tmp_path / "flood.mcap")
    with recorder:
        recorder._hear(Sample)
        assert blocked.wait(10.0)
        for _ in range(QUEUE_MESSAGES + 100):
            recorder._hear(Sample)
        going.set()
        report = recorder.close()
    assert report.dropped == 100
    assert report.messages == QUEUE_MESSAGES + 1
    assert not report.complete
    assert "100 messages dropped: they came faster than they were written" in report.lines()


@pytest.mark.matrix
def test_messages_that_did_not_arrive_are_counted(tmp_path):
    endpoint = free_endpoint()
    recorder = recorder_on(endpoint, tmp_path / "lost.mcap")
    with recorder, node_at(endpoint) as node:
        publisher = node.publisher("/count", STRING)
        put_all(publisher, 3)
        publisher._sequence += 5
        publisher.put(text(3), 1)
        until(lambda: recorder._messages == 4)
        report = recorder.close()
    assert report.lost == 5
    assert not report.complete


@pytest.mark.matrix
def test_a_full_disk_ends_the_record_and_is_said(tmp_path, monkeypatch):
    def full(self):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RecordWriter, "flush", full)
    recorder = recorder_on(free_endpoint(), tmp_path / "full.mcap")
    with recorder:
        until(lambda: recorder.failed)
        report = recorder.close()
    assert "full.mcap cannot be written: No space left on device" in report.error
    assert not report.complete


@pytest.mark.matrix
def test_a_file_that_exists_is_refused_and_the_bus_left(tmp_path):
    path = tmp_path / "there.mcap"
    path.touch()
    with pytest.raises(CaptureError, match="exists"):
        recorder_on(free_endpoint(), path).open()


def test_what_is_no_name_of_an_arm_is_refused(tmp_path):
    with pytest.raises(OptionError, match="ARM"):
        recorder_on(free_endpoint(), tmp_path / "a.mcap", ["left arm"])


class Strange:
    """Sample from a sender that breaks the rules."""

    def __init__(self, key, sequence=1, source_ns=1):
        self.key_expr = key
        self.payload = self.attachment = self
        self.data = [text(1), Attachment(sequence, source_ns, bytes(16)).encode()]

    def to_bytes(self):
        return self.data.pop(0)


STRANGE = [
    Strange("0/odd/std_msgs::msg::dds_::String_/RIHS01_0", -5, -7),
    Strange("0/odd/std_msgs::msg::dds_::String_/RIHS01_0", 2**63 - 1, 2**63 - 1),
    Strange("0/odd/configuration/odd_msgs::msg::dds_::MyString_/RIHS01_0"),
    Strange("0/odd/configuration/std_msgs::msg::dds_::String_/RIHS01_0"),
    Strange("0/configuration/std_msgs::msg::dds_::String_/TypeHashNotSupported"),
]


@pytest.fixture
def nobody_is_found(monkeypatch):
    """Skip the search for publishers, which these tests do not need."""
    monkeypatch.setattr("cardan.recording.recorder.GRAPH_S", 0.0)


def test_no_message_ends_a_record(nobody_is_found, tmp_path):
    path = tmp_path / "a.mcap"
    with Recorder(BusOptions(router=""), path) as recorder:
        for each in STRANGE:
            recorder._hear(each)
        report = recorder.close()
    assert report.error == ""
    assert report.messages == len(STRANGE) == len(list(RecordReader(path)))


def test_who_publishes_a_latched_topic_is_distinguished(tmp_path):
    path, key = tmp_path / "a.mcap", "0/tf_static/std_msgs::msg::dds_::String_/RIHS01_0"
    with Recorder(BusOptions(router=""), path) as recorder:
        heard = []
        for number in range(2):
            entity, _ = recorder._node.endpoint(PUBLISHER, "/tf_static", STRING, LATCHED_QOS)
            entity = entity._replace(node=f"arm_{number}")
            recorder._see(entity.token(0), True)
            sample = Strange(key)
            sample.data[1] = Attachment(1, 1, gid_of(entity, 0)).encode()
            heard.append(sample)
        for each in heard:
            recorder._hear(each)
        report = recorder.close()
    assert [each.topic.publishers for each in RecordReader(path)] == [("/arm_0",), ("/arm_1",)]
    assert (report.messages, report.topics) == (2, 1)


def test_a_fault_in_writing_ends_the_record_and_is_said(nobody_is_found, tmp_path, monkeypatch):
    with Recorder(BusOptions(router=""), tmp_path / "a.mcap") as recorder:
        monkeypatch.setattr(RecordWriter, "add", lambda *_: [][0])
        recorder._hear(Strange("0/odd/std_msgs::msg::dds_::String_/RIHS01_0"))
        until(lambda: recorder.failed)
        why = "cannot be written: an internal error, IndexError, as its log says"
        assert why in recorder.close().error


def test_a_clock_that_is_set_back_holds_up_nothing(tmp_path):
    recorder = Recorder(BusOptions(router=""), tmp_path / "a.mcap")
    began_s = time.monotonic()
    tomorrow_ns = time.time_ns() + 86_400 * 10**9
    key = "0/odd/std_msgs::msg::dds_::String_/RIHS01_0"
    assert recorder._topic_of(key, tomorrow_ns).name == "/odd"
    assert time.monotonic() - began_s < 10.0
