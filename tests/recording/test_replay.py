"""Replay: the same messages with the same spacing, and no commands to an arm without a request."""

import contextlib
import math
import tempfile
import threading
from pathlib import Path

import pytest
from mcap.writer import Writer as McapWriter

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.errors import CaptureError, OptionError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan.protocols.ros2.type_hash import type_hash
from cardan.protocols.ros2.zenoh import DEFAULT_QOS, LATCHED_QOS
from cardan.recording.mcap_file import (
    RecordedMessage,
    RecordedTopic,
    RecordReader,
    RecordWriter,
)
from cardan.recording.replay import (
    COMMANDS_WORDS,
    ReplayReport,
    Schedule,
    arms_of,
    replay,
    until_damage,
    why_held_back,
)
from tests.recording.sessions import NODE, NS, STRING, live_session
from tests.serving import free_endpoint
from tests.waiting import done_again, until

RESULT = "cardan_msgs/msg/CommandResult"
POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Twist"
ARM = (NODE,)
OTHER = ("/somebody",)


def topic(name, type_name=STRING, publishers=ARM, latched=False):
    return RecordedTopic(name, type_name, type_hash(type_name), latched, publishers)


CONFIGURATION = topic(f"{NODE}/configuration", latched=True)
STATE = topic(f"{NODE}/state/pose", POSE)
JOG = topic(f"{NODE}/command/twist", TWIST, OTHER)
STOP = topic(f"{NODE}/command/stop", "std_msgs/msg/Empty", OTHER)
GO = topic(f"{NODE}/command/movl", "geometry_msgs/msg/Pose", OTHER)
JOINTS_OF_ANOTHER = topic("/joint_commands", "std_msgs/msg/Float64MultiArray", ("/driver",))
CAMERA = RecordedTopic("/camera", "sensor_msgs/msg/Image", "RIHS01_" + "56" * 32, False, OTHER)


def write(path, rows):
    """Write a file; `rows`: time in s, topic, message."""
    writer = RecordWriter(path)
    for number, (stamp_s, where, message) in enumerate(rows, 1):
        data = codec_of(where.type_name).encode(completed(where.type_name, message))
        now_ns = NS + round(stamp_s * NS)
        writer.add(RecordedMessage(where, now_ns, now_ns, number, data))
    writer.finish()
    return path


def in_chunks(path, damage=True):
    """Write a record of 300 messages in three chunks, the second one damaged."""
    writer = RecordWriter(path)
    data = codec_of(TWIST).encode(completed(TWIST, {}))
    ends = []
    for number in range(300):
        writer.add(RecordedMessage(JOG, NS + number, NS + number, number, data))
        if number % 100 == 99:
            writer.flush()
            ends.append(writer.bytes)
    writer.finish()
    if damage:
        whole = bytearray(path.read_bytes())
        whole[(ends[0] + ends[1]) // 2 - 800] ^= 1
        path.write_bytes(whole)
    return path


@pytest.mark.parametrize("damage", [False, True])
def test_commands_end_where_a_record_is_damaged(tmp_path, damage):
    path = in_chunks(tmp_path / "r.mcap", damage)
    reader = RecordReader(path)
    assert [each.sequence for each in reader] == [
        number for number in range(300) if not damage or not 100 <= number < 200
    ]
    assert len(reader.problems) == damage
    assert len(list(until_damage(RecordReader(path)))) == (100 if damage else 300)


def test_what_is_wrong_with_the_file_is_part_of_the_report():
    report = ReplayReport(3, ("/a",), {}, ("the file is damaged at byte 7 a chunk",))
    assert report.lines()[1:] == ["the file is damaged at byte 7 a chunk"]
    assert not report.complete
    assert ReplayReport(3, ("/a",), {}).complete
    assert not ReplayReport(0, (), {}).complete


# -- steps of its time ---------------------------------------------------------------------------


def due(tmp_path, times_s, longest_pause_s=60.0):
    """Return the due times of messages with these times, and the reported text."""
    path = write(tmp_path / "r.mcap", [(at_s, JOG, {}) for at_s in times_s])
    schedule = Schedule(longest_pause_s)
    return [at_s for at_s, _ in schedule.of(RecordReader(path))], schedule.steps


def test_a_clock_that_was_set_back_is_not_waited_for(tmp_path):
    times_s, reported = due(tmp_path, [3600.0, 0.0])
    assert times_s == [0.0, 0.0]
    (words,) = reported
    assert words.startswith("its clock steps by -3600.0 s after 0.0 s, and replay does not wait")


def test_what_follows_a_step_keeps_its_spacing(tmp_path):
    times_s, reported = due(tmp_path, [7200.0, 7200.5, 0.0, 0.5, 1.0])
    assert times_s == pytest.approx([0.0, 0.5, 0.5, 1.0, 1.5])
    assert len(reported) == 1
    (tmp_path / "r.mcap").unlink()
    times_s, reported = due(tmp_path, [0.0, 0.5, 7200.0, 7200.5])
    assert times_s == pytest.approx([0.0, 0.5, 0.5, 1.0])
    assert "--longest-pause" in reported[0]


def test_a_step_that_the_next_message_does_not_confirm_is_not_waited_for(tmp_path):
    times_s, reported = due(tmp_path, [0.0, 0.5, 20.0, 1.0])
    assert times_s == pytest.approx([0.0, 0.5, 0.5, 0.5])
    assert len(reported) == 2


def test_pauses_and_messages_that_are_written_late_are_no_steps(tmp_path):
    times_s, reported = due(tmp_path, [0.0, 20.0, 19.5, 30.0])
    assert (times_s, reported) == (pytest.approx([0.0, 20.0, 19.5, 30.0]), [])
    (tmp_path / "r.mcap").unlink()
    times_s, reported = due(tmp_path, [0.0, 4000.0], longest_pause_s=5000.0)
    assert (times_s, reported) == ([0.0, 4000.0], [])


def test_steps_are_reported_one_by_one_up_to_some(tmp_path):
    _, reported = due(tmp_path, [0.0, 1000.0] * 8)
    assert len(reported) == 6
    assert reported[-1] == "and 10 more steps of its time"


def listening(endpoint):
    return BusNode(BusOptions(router="", listen=(endpoint,)), "listener")


def quietly(*_):
    pass


# -- commands that are held back -----------------------------------------------------------------


@pytest.mark.parametrize("shown", [STATE, CONFIGURATION, CAMERA, topic("/tf", publishers=ARM)])
def test_what_an_arm_showed_and_pictures_are_published(shown):
    arms = arms_of([CONFIGURATION, STATE, JOG])
    assert arms == {NODE}
    assert why_held_back(shown, arms, None) == ""


@pytest.mark.parametrize(
    "commanding",
    [
        JOG,
        STOP,
        JOINTS_OF_ANOTHER,
        topic("/joy", "sensor_msgs/msg/Joy", ("/joy_node",)),
        topic("/joint_states", "sensor_msgs/msg/JointState", ("/another_robot",)),
        topic("/joint_states", "sensor_msgs/msg/JointState", (NODE, "/another_robot")),
        topic("/delta_twist_cmds", "geometry_msgs/msg/TwistStamped", ()),
        STATE._replace(publishers=()),
    ],
)
def test_what_may_command_something_is_held_back(commanding):
    why = why_held_back(commanding, frozenset({NODE}), None)
    assert why == "it may command something: no arm of the record published it to show its state"


# -- on the bus ----------------------------------------------------------------------------------


@pytest.mark.matrix
def test_messages_come_with_their_spacing_under_their_names(tmp_path):
    endpoint = free_endpoint()
    rows = [(0.0, CONFIGURATION, {"data": "{}"})]
    rows += [(0.05 * n, STATE, {"header": {"frame_id": str(n)}}) for n in range(1, 21)]
    rows += [(1.01, JOG, {})]
    path = write(tmp_path / "r.mcap", rows)
    said, heard = [], []
    with listening(endpoint) as node:
        states = node.subscription(STATE.name, POSE, 100)
        jogs = node.subscription(JOG.name, TWIST, 100)
        report = replay(path, BusOptions(router=endpoint), rate=2.0, say=said.append)

        def received():
            while (message := states.poll()) is not None:
                heard.append(message)
            return len(heard) == 20

        until(received)
        assert jogs.poll() is None
    assert report.messages == 21
    assert report.topics == (CONFIGURATION.name, STATE.name)
    assert [codec_of(POSE).decode(each.data)["header"]["frame_id"] for each in heard] == [
        str(n) for n in range(1, 21)
    ]
    times_s = [1e-9 * each.attachment.source_ns for each in heard]
    # On a busy computer a message may be late, but none is early, and the schedule is kept.
    assert all(b - times_s[0] > 0.025 * n - 0.02 for n, b in enumerate(times_s))
    assert times_s[-1] - times_s[0] > 0.45
    assert said == [
        f"not published: {JOG.name}: it may command something: no arm of the record published it "
        "to show its state (--commands)"
    ]


@pytest.mark.matrix
def test_topics_can_be_chosen(tmp_path):
    endpoint = free_endpoint()
    path = write(tmp_path / "r.mcap", [(0.0, CONFIGURATION, {"data": "{}"}), (0.0, STATE, {})])
    with listening(endpoint):
        report = replay(path, BusOptions(router=endpoint), topics=["*/state/*"], say=quietly)
    assert report.topics == (STATE.name,)
    assert report.messages == 1


@pytest.mark.matrix
def test_types_that_cardan_does_not_know_are_replayed_with_their_hash(tmp_path):
    endpoint, mark = free_endpoint(), "RIHS01_" + "34" * 32
    strange = RecordedTopic(f"{NODE}/strange", "strange_msgs/msg/Thing", mark, False, ARM)
    path = tmp_path / "r.mcap"
    writer = RecordWriter(path)
    data = codec_of(STRING).encode({"data": "{}"})
    writer.add(RecordedMessage(CONFIGURATION, NS, NS, 1, data))
    writer.add(RecordedMessage(strange, NS, NS, 1, b"\0\1\0\0abc"))
    writer.finish()
    heard, there = [], threading.Event()

    def hear(sample):
        heard.append((str(sample.key_expr), sample.payload.to_bytes()))
        there.set()

    with listening(endpoint) as node:
        key = f"0{strange.name}/**"
        retained = node.declare_subscriber(key, hear, DEFAULT_QOS)
        replay(path, BusOptions(router=endpoint), say=quietly)
        assert there.wait(10.0)
        retained.undeclare()
    assert heard == [(f"0{strange.name}/strange_msgs::msg::dds_::Thing_/{mark}", b"\0\1\0\0abc")]


@pytest.mark.matrix
@pytest.mark.parametrize("together", [False, True], ids=["told apart", "one topic of both"])
def test_a_later_subscription_gets_the_last_message_of_each_who_published(tmp_path, together):
    endpoint, both = free_endpoint(), ("/left/arm", "/right/arm")
    publishers = [both, both] if together else [both[:1], both[1:]]
    fixed = [topic("/tf_static", "tf2_msgs/msg/TFMessage", each, True) for each in publishers]
    frames = [
        {"transforms": [{"header": {"frame_id": frame_id}}]} for frame_id in ("left", "right")
    ]
    rows = [(0.0, CONFIGURATION, {"data": "{}"})]
    rows += [(0.0, where, message) for where, message in zip(fixed, frames, strict=True)]
    rows.append((6.0, STATE, {}))  # keeps the replay open
    path = write(tmp_path / "r.mcap", rows)
    with listening(endpoint) as node:
        replaying = threading.Thread(
            target=replay, args=(path, BusOptions(router=endpoint)), kwargs={"say": quietly}
        )
        replaying.start()
        first = node.subscription("/tf_static", "tf2_msgs/msg/TFMessage", 10, LATCHED_QOS)
        until(first.poll)
        until(first.poll)
        later = node.subscription("/tf_static", "tf2_msgs/msg/TFMessage", 10, LATCHED_QOS)
        found = [until(later.poll) for _ in range(2)]
        replaying.join()
    decoded = [codec_of("tf2_msgs/msg/TFMessage").decode(each.data) for each in found]
    assert {each["transforms"][0]["header"]["frame_id"] for each in decoded} == {"left", "right"}


@pytest.mark.matrix
def test_what_somebody_publishes_now_is_held_back(tmp_path):
    endpoint = free_endpoint()
    path = write(tmp_path / "r.mcap", [(0.0, CONFIGURATION, {"data": "{}"}), (0.0, STATE, {})])
    with listening(endpoint) as node:
        live = node.publisher(STATE.name, POSE)
        report = replay(path, BusOptions(router=endpoint), say=quietly)
        live.close()
    assert report.held_back == {STATE.name: "/listener publishes it now"}


def test_a_rate_that_is_none_is_refused(tmp_path):
    with pytest.raises(OptionError, match="--rate"):
        replay(tmp_path / "r.mcap", BusOptions(), rate=0.0)
    with pytest.raises(OptionError, match="--longest-pause"):
        replay(tmp_path / "r.mcap", BusOptions(), longest_pause_s=math.nan)


def test_an_empty_record_and_topics_that_are_not_there(tmp_path):
    with pytest.raises(CaptureError, match="has no messages"):
        replay(write(tmp_path / "empty.mcap", []), BusOptions())
    path = write(tmp_path / "r.mcap", [(0.0, STATE, {})])
    with pytest.raises(OptionError, match=f"--topics.*{STATE.name}"):
        replay(path, BusOptions(), topics=["/none"])


def others_record(path, encodings):
    """Write an MCAP file with a message in each of these encodings."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("")
        for number, encoding in enumerate(encodings):
            schema = writer.register_schema(STRING, "ros2msg", b"string data")
            channel = writer.register_channel(f"/talk_{number}", encoding, schema)
            writer.add_message(channel, NS + number, codec_of(STRING).encode({"data": "a"}), NS)
        writer.finish()
    return path


def test_a_record_of_ros_1_or_json_alone_says_what_it_is(tmp_path):
    path = others_record(tmp_path / "r.mcap", ["ros1", "ros1", "json"])
    with pytest.raises(CaptureError) as refused:
        replay(path, BusOptions())
    assert str(refused.value) == (
        f"{path} has no messages; 2 messages are left out: they are in 'ros1', and only those of "
        "ROS 2 (cdr) are read; 1 messages are left out: they are in 'json', and only those of ROS "
        "2 (cdr) are read"
    )


def test_messages_in_another_encoding_are_reported(tmp_path):
    reader = RecordReader(others_record(tmp_path / "r.mcap", ["cdr", "json"]))
    assert [each.topic.name for each in reader] == ["/talk_0"]
    (reported,) = reader.problems
    assert reported.startswith("1 messages are left out: they are in 'json'")


# -- a live robot --------------------------------------------------------------------------------


def going(path, session, jogs):
    """Write a record in which a client sent an arm 3 cm down, after another one had jogged it
    `jogs` times."""
    x, y, z, *turn = until(lambda: session.snapshot.robot.pose)
    pose = {
        "position": {"x": x, "y": y, "z": z - 0.03},
        "orientation": dict(zip("wxyz", turn, strict=True)),
    }
    rows = [(0.0, CONFIGURATION, {"data": "{}"})]
    rows += [(0.02 * n, JOG, {"linear": {"z": -0.05}}) for n in range(jogs)]
    rows += [(0.5, GO, pose)]
    return write(path, rows)


@contextlib.contextmanager
def asked(tmp_path, commands, jogs=20, **tables):
    """Replay such a record to a live session; yield the session and its answers."""
    endpoint = free_endpoint()
    network = {"router": "", "listen": [endpoint]}
    with (
        live_session(endpoint, network=network, **tables) as session,
        BusNode(BusOptions(router=endpoint), "watcher") as node,
    ):
        results = node.subscription(f"{NODE}/result", RESULT, 100)
        path = going(Path(tempfile.mkdtemp(dir=tmp_path)) / "go.mcap", session, jogs)
        said, reported = [], []
        report = replay(path, BusOptions(router=endpoint), commands=commands, say=said.append)

        def answers():
            while (message := results.poll()) is not None:
                reported.append(codec_of(RESULT).decode(message.data))
            return reported

        yield session, report, said, answers


@pytest.mark.real
def test_no_replay_moves_a_live_arm_unasked(tmp_path):
    with asked(tmp_path, commands=False) as (session, report, _, answers):
        cycles = session.snapshot.loop.cycles
        until(lambda: session.snapshot.loop.cycles > cycles + 50)
        assert {JOG.name, GO.name} < set(report.held_back)
        assert not answers()
        assert session.snapshot.tracking.path_m == 0.0


@pytest.mark.matrix
def test_commands_that_are_asked_for_are_refused_where_their_source_is_not_to_move_the_arm(
    tmp_path,
):
    authority = {"policy": "named", "named": "the other program"}

    def refused():
        with asked(tmp_path, commands=True, authority=authority) as (
            session,
            report,
            said,
            answers,
        ):
            until(lambda: any(each["command"] == "movl" for each in answers()))
            assert session.snapshot.tracking.path_m == 0.0
            return {each["command"]: each for each in answers()}, report, said

    reported, report, said = done_again(refused, reason=lambda answer: answer[0]["movl"]["reason"])
    assert report.messages == 22
    assert said == [COMMANDS_WORDS]
    assert {each["outcome"] for each in reported.values()} == {"refused"}
    assert "authority over the arm is reserved" in reported["movl"]["reason"]


@pytest.mark.matrix
def test_commands_that_are_asked_for_move_an_arm_that_takes_them_from_anybody(tmp_path):
    # Without a jog: its acceptance would depend on the sender's time on the bus, and it would move
    # the arm.
    ended = {"done", "aborted", "refused"}

    def moved():
        with asked(tmp_path, commands=True, jogs=0) as (session, _, _, answers):

            def result():
                reported = {each["command"]: each for each in answers()}
                return (
                    reported if reported.get("movl", {"outcome": ""})["outcome"] in ended else None
                )

            reported = until(result, "the motion's end")
            outcomes = {name: each["outcome"] for name, each in reported.items()}
            return outcomes, reported["movl"]["reason"], session.snapshot.tracking.path_m

    reported, _, path_m = done_again(moved, reason=lambda answer: answer[1])
    assert reported == {"movl": "done"}
    assert path_m > 0.029
