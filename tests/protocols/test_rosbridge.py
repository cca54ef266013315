"""rosbridge v2 without I/O: operations, fragments, encodings, delivery, types and parameters."""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import revised
from cardan.protocols.ros2.messages import MessageError, Stamp, completed, json_text

cbor2 = pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.gateway.servers.parameters import parameter_name  # noqa: E402
from cardan.gateway.servers.send_queue import MAX_CONTROL_FRAMES, Due, SendQueue, TopicQueue  # noqa: E402
from cardan.protocols.rosbridge import forms, rosapi  # noqa: E402
from cardan.protocols.rosbridge.delivery import (  # noqa: E402
    Delivery,
    Subscriptions,
)
from cardan.protocols.rosbridge.forms import EncodedMessage, UnreadableError, fragments  # noqa: E402
from cardan.protocols.rosbridge.fragments import (  # noqa: E402
    LIFETIME_S,
    MAX_OPERATIONS,
    MAX_PARTS,
    Defragmenter,
)
from cardan.protocols.rosbridge.operations import (  # noqa: E402
    Advertise,
    CallService,
    Fragment,
    Publish,
    RefusedOperation,
    SendActionGoal,
    Subscribe,
    Unsubscribe,
    parse_operation,
)
from cardan.protocols.rosbridge.png import png_of  # noqa: E402
from cardan.protocols.rosbridge.session import MAX_PUBLICATIONS_PER_S, RosbridgeSession  # noqa: E402


def parsed(**fields):
    return parse_operation(json.dumps(fields))


# -- operations -----------------------------------------------------------------------------------


def test_what_clients_send_is_understood():
    assert parsed(
        op="advertise",
        id="a:1",
        topic="/t",
        type="geometry_msgs/Twist",
        latch=False,
        queue_size=100,
    ) == Advertise("a:1", "/t", "geometry_msgs/Twist", False)
    assert parsed(op="publish", topic="/t", msg={"x": 1}) == Publish(
        None, "/t", {"x": 1}, "", False
    )
    assert parsed(
        op="subscribe", id="s", topic="/t", type="p/A", throttle_rate=20, queue_length=3
    ) == Subscribe("s", "/t", "p/A", 20.0, 3, "none", 0)
    assert parsed(op="call_service", id=7, service="/stop", args=[1]) == CallService(
        7, "/stop", [1], "none", 0, 0.0
    )
    assert parsed(
        op="send_action_goal", id="g", action="/move", action_type="p/A", args={}, feedback=True
    ) == SendActionGoal("g", "/move", "p/A", {}, True)


def test_null_is_as_good_as_absent():
    assert parsed(
        op="subscribe", id=None, topic="/t", type=None, throttle_rate=None, compression=None
    ) == Subscribe(None, "/t", "", 0.0, 0, "none", 0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[]", "JSON object"),
        ('{"op":"publish","topic":"/t","msg":{"x":NaN}}', "JSON has no NaN"),
        ("[" * 100_000, "not JSON"),
        ("1" * 10_000, "not JSON"),
        ('{"id":"1"}', "op: unknown operation None"),
        ('{"op":"fly","id":"1"}', "op: unknown operation 'fly'"),
        ('{"op":["x"]}', "op: unknown operation ['x']"),
        ('{"op":"subscribe"}', "topic: takes a name"),
        ('{"op":"subscribe","topic":""}', "topic: takes a name"),
        (json.dumps({"op": "subscribe", "topic": "x" * 256}), "topic: takes a name"),
        ('{"op":"subscribe","topic":"/t","throttle_rate":-1}', "throttle_rate: takes a number"),
        ('{"op":"subscribe","topic":"/t","throttle_rate":true}', "throttle_rate: takes a number"),
        ('{"op":"subscribe","topic":"/t","throttle_rate":1e999}', "throttle_rate: takes a number"),
        ('{"op":"subscribe","topic":"/t","queue_length":0.5}', "queue_length: takes a whole"),
        ('{"op":"subscribe","topic":"/t","compression":"zip"}', "none, png, cbor, cbor-raw, not"),
        ('{"op":"call_service","service":"/s","compression":"cbor-raw"}', "none, png, cbor, not"),
        ('{"op":"advertise","topic":"/t"}', "type: takes a name"),
        ('{"op":"advertise","topic":"/t","type":"a/B","latch":1}', "latch: takes true or false"),
        ('{"op":"fragment","id":"f","num":3,"total":3,"data":""}', "num: counts from 0"),
        ('{"op":"fragment","id":"f","num":0,"total":3}', "data: takes a text"),
        ('{"op":"set_level","level":"loud"}', "level: takes error, warning, info, none"),
        ('{"op":"auth","id":{}}', "id: takes a text"),
        (json.dumps({"op": "auth", "id": "x" * 1001}), "id: has more than 1000"),
    ],
)
def test_what_is_no_operation_is_refused_with_a_reason(text, reason):
    refused = parse_operation(text)
    assert isinstance(refused, RefusedOperation)
    assert reason in refused.reason


def test_a_refusal_knows_what_it_was_about():
    refused = parsed(op="call_service", id="c:1", service="/stop", timeout="soon")
    assert (refused.op, refused.id, refused.name) == ("call_service", "c:1", "/stop")


@given(
    st.text()
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    ).map(json.dumps)
)
def test_nothing_that_is_sent_raises(text):
    parse_operation(text)


@given(
    st.sampled_from(["subscribe", "publish", "advertise", "call_service", "fragment", "set_level"]),
    st.dictionaries(
        st.sampled_from(
            ["id", "topic", "service", "type", "num", "total", "data", "level", "args"]
        ),
        st.none() | st.booleans() | st.integers() | st.text() | st.lists(st.integers()),
    ),
)
def test_no_field_raises(op, fields):
    RosbridgeSession(1000).receive(json.dumps({**fields, "op": op}), 0.0)


# -- fragments ------------------------------------------------------------------------------------


def part(number, total, data, identity="f"):
    return Fragment(identity, number, total, data)


def test_an_operation_is_put_together_in_any_order():
    whole = Defragmenter(100)
    assert whole.add(part(2, 3, "c"), 0.0) is None
    assert whole.add(part(0, 3, "a"), 1.0) is None
    assert whole.add(part(0, 3, "twice"), 1.0) is None
    assert whole.add(part(1, 3, "b"), 2.0) == "abc"
    assert whole.add(part(0, 1, "again"), 3.0) == "again"


def test_an_operation_that_is_not_complete_in_time_is_dropped():
    whole = Defragmenter(100)
    assert whole.add(part(0, 2, "old"), 0.0) is None
    assert whole.add(part(1, 2, "late"), LIFETIME_S) is None
    assert whole.add(part(0, 2, "new"), LIFETIME_S) == "newlate"


def test_what_is_kept_is_bounded():
    whole = Defragmenter(10)
    assert "more than 10 characters" in whole.add(part(0, 2, "x" * 11), 0.0).reason
    assert whole.add(part(0, 2, "x" * 10), 0.0) is None, "refused parts are not kept"
    assert "more than 10 characters" in whole.add(part(0, 2, "x", "other"), 0.0).reason
    assert "parts" in whole.add(part(0, MAX_PARTS + 1, ""), 0.0).reason
    many = Defragmenter(10)
    for number in range(MAX_OPERATIONS):
        assert many.add(part(0, 2, "", number), 0.0) is None
    assert "more than 16" in many.add(part(0, 2, "", "one more"), 0.0).reason


def test_an_operation_has_one_number_of_parts():
    whole = Defragmenter(10)
    assert whole.add(part(0, 2, "a"), 0.0) is None
    assert whole.add(part(1, 3, "b"), 0.0).reason.endswith("had 2 parts, and has 3 now")


def test_a_session_takes_fragments_but_none_in_fragments():
    session = RosbridgeSession(1000)
    text = json.dumps({"op": "unsubscribe", "topic": "/t"})
    for number in (0, 1):
        data = text[:10] if number == 0 else text[10:]
        given_ = {"op": "fragment", "id": "f", "num": number, "total": 2, "data": data}
        asked = session.receive(json.dumps(given_), 0.0)
    assert asked == Unsubscribe(None, "/t")
    inner = json.dumps({"op": "fragment", "id": "i", "num": 0, "total": 1, "data": text})
    outer = json.dumps({"op": "fragment", "id": "o", "num": 0, "total": 1, "data": inner})
    assert "cannot consist of fragments" in session.receive(outer, 0.0).reason


@given(st.text(min_size=1), st.integers(1, 20))
def test_what_is_fragmented_comes_together(text, size):
    parts = fragments(text, size)
    if len(text) <= size:
        assert parts == (text,)
        return
    whole = Defragmenter(10_000)
    answers = [whole.add(parse_operation(each), 0.0) for each in parts]
    assert answers[:-1] == [None] * (len(parts) - 1)
    assert answers[-1] == text


def test_a_tiny_fragment_size_does_not_make_a_flood():
    assert len(fragments("x" * 1_000_000, 1)) == forms.MAX_FRAGMENTS


# -- sessions -------------------------------------------------------------------------------------


def test_status_messages_come_only_after_a_level_was_set():
    session = RosbridgeSession(1000)
    assert session.status("error", "i", "no") is None
    session.receive('{"op":"set_level","level":"warning"}', 0.0)
    assert json.loads(session.status("error", "i", "no")) == {
        "op": "status", "id": "i", "level": "error", "msg": "no",
    }  # fmt: skip
    assert session.status("warning", None, "") is not None
    assert session.status("info", None, "") is None
    session.receive('{"op":"set_level","level":"none"}', 0.0)
    assert session.status("error", None, "") is None


def test_a_flood_of_publications_is_refused_for_the_rest_of_the_second():
    session = RosbridgeSession(1000)
    text = json.dumps({"op": "publish", "topic": "/t", "msg": {}})
    asked = [session.receive(text, 0.5) for _ in range(MAX_PUBLICATIONS_PER_S + 1)]
    assert isinstance(asked[-2], Publish)
    assert isinstance(asked[-1], RefusedOperation)
    assert isinstance(session.receive('{"op":"unsubscribe","topic":"/t"}', 0.6), Unsubscribe)
    assert isinstance(session.receive(text, 1.5), Publish)


def test_binary_frames_are_refused():
    assert "JSON text" in RosbridgeSession(1000).receive(b"\xa0", 0.0).reason


# -- messages -------------------------------------------------------------------------------------


def test_a_header_without_a_stamp_has_the_time_that_is_given():
    now = Stamp.of_ns(12_000_000_034)
    pose = "geometry_msgs/msg/PoseStamped"
    for given_ in ({}, {"header": {}}, {"header": {"stamp": "now"}}):
        assert completed(pose, given_, now)["header"]["stamp"] == {"sec": 12, "nanosec": 34}
    own = {"header": {"stamp": {"secs": 1, "nsecs": 2}}}
    assert completed(pose, own, now)["header"]["stamp"] == {"sec": 1, "nanosec": 2}
    assert completed(pose, {})["header"]["stamp"] == {"sec": 0, "nanosec": 0}
    point = "trajectory_msgs/msg/JointTrajectoryPoint"
    after = completed(point, {"time_from_start": {"secs": 3, "nsecs": 4}})["time_from_start"]
    assert after == {"sec": 3, "nanosec": 4}
    with pytest.raises(MessageError, match=r"header\.stamp"):
        completed(pose, {"header": {"stamp": "now"}})


def test_json_has_null_for_what_is_no_number_and_base64_for_bytes():
    imu = "sensor_msgs/msg/JointState"
    message = completed(imu, {"position": [math.inf, 1.5]})
    assert json.loads(json_text(imu, message))["position"] == [None, 1.5]
    uuid = completed("unique_identifier_msgs/msg/UUID", {"uuid": list(range(16))})
    said = json.loads(json_text("unique_identifier_msgs/msg/UUID", uuid))
    assert base64.b64decode(said["uuid"]) == bytes(range(16))
    assert json_text(
        "std_srvs/srv/Trigger_Request", {"structure_needs_at_least_one_member": 0}
    ) == ("{}")


def test_a_bool_is_no_number_and_an_integer_is_a_float():
    twist = "geometry_msgs/msg/Twist"
    assert completed(twist, {"linear": {"x": 1}})["linear"]["x"] == 1.0
    with pytest.raises(MessageError, match=r"linear\.x: takes a number"):
        completed(twist, {"linear": {"x": True}})
    with pytest.raises(MessageError, match=r"linear\.foo: .* has no such field"):
        completed(twist, {"linear": {"foo": 1}})


# -- forms ----------------------------------------------------------------------------------------

JOINTS = "sensor_msgs/msg/JointState"


def sample(type_name=JOINTS, stamp_ns=3_000_000_004, **fields):
    return EncodedMessage(
        type_name, codec_of(type_name).encode(completed(type_name, fields)), stamp_ns
    )


def test_json_is_encoded_once_for_all():
    each = sample(name=["a"], position=[1])
    assert each.frames("/joints", "none")[0] is each.frames("/joints", "none")[0]
    said = json.loads(each.frames("/joints", "none")[0])
    assert (said["op"], said["topic"], said["msg"]["position"]) == ("publish", "/joints", [1.0])


def test_cbor_has_typed_arrays():
    (frame,) = sample(name=["a"], position=[1, math.nan]).frames("/joints", "cbor")
    message = cbor2.loads(frame)["msg"]
    assert message["name"] == ["a"]
    assert message["position"].tag == 86
    first, second = struct.unpack("<2d", message["position"].value)
    assert first == 1.0
    assert math.isnan(second)
    (frame,) = sample("sensor_msgs/msg/Joy", axes=[0.5], buttons=[-1]).frames("/joy", "cbor")
    message = cbor2.loads(frame)["msg"]
    assert (message["axes"].tag, message["axes"].value) == (85, struct.pack("<f", 0.5))
    assert (message["buttons"].tag, message["buttons"].value) == (78, struct.pack("<i", -1))


def test_cbor_raw_has_the_bytes_of_the_network_whatever_they_are():
    (frame,) = EncodedMessage(None, b"\x00\x01\x00\x00rest", 3_000_000_004).frames("/t", "cbor-raw")
    assert cbor2.loads(frame) == {
        "op": "publish",
        "topic": "/t",
        "msg": {"secs": 3, "nsecs": 4, "bytes": b"\x00\x01\x00\x00rest"},
    }


@pytest.mark.parametrize("later", [False, True])
def test_a_message_of_a_later_revision_has_all_its_fields(later):
    name = "control_msgs/action/FollowJointTrajectory_FeedbackMessage"
    kind = revised(name) if later else name
    given = {"joint_names": ["a"], **({"index": 7} if later else {})}
    each = EncodedMessage(name, codec_of(kind).encode(completed(kind, {"feedback": given})), 0)
    for message in (
        json.loads(each.frames("/f", "none")[0])["msg"],
        cbor2.loads(each.frames("/f", "cbor")[0])["msg"],
    ):
        assert message["feedback"]["joint_names"] == ["a"]
        assert message["feedback"].get("index") == (7 if later else None)


def test_bytes_that_are_no_message_are_said_to_be_none():
    with pytest.raises(UnreadableError, match="too few"):
        EncodedMessage(JOINTS, b"\x00\x01\x00\x00", 0).frames("/t", "none")
    with pytest.raises(UnreadableError, match="not known"):
        EncodedMessage(None, b"\x00\x01\x00\x00", 0).frames("/t", "none")


def unpacked(text):
    """Return the bytes in a PNG of one IDAT chunk without filters."""
    image = base64.b64decode(text)
    assert image.startswith(b"\x89PNG\r\n\x1a\n")
    chunks, at = {}, 8
    while at < len(image):
        (length,) = struct.unpack_from(">I", image, at)
        kind, data = image[at + 4 : at + 8], image[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", image, at + 8 + length)[0] == zlib.crc32(kind + data)
        chunks[kind] = data
        at += 12 + length
    width, height, depth, color = struct.unpack_from(">IIBB", chunks[b"IHDR"])
    assert (depth, color) == (8, 2)
    pixels = zlib.decompress(chunks[b"IDAT"])
    stride = 3 * width + 1
    assert len(pixels) == stride * height
    lines = [pixels[begin : begin + stride] for begin in range(0, len(pixels), stride)]
    assert all(line[0] == 0 for line in lines)
    return width, height, b"".join(line[1:] for line in lines)


@given(st.text())
def test_png_carries_text(text):
    width, _height, data = unpacked(png_of(text))
    assert data.rstrip(b"\n") == text.encode().rstrip(b"\n")
    assert width == max(1, math.isqrt(len(text.encode()) // 3))


def test_a_png_frame_carries_the_operation():
    (frame,) = sample(position=[1]).frames("/t", "png")
    said = json.loads(frame)
    assert said["op"] == "png"
    assert json.loads(unpacked(said["data"])[2])["msg"]["position"] == [1.0]


def test_the_answer_of_a_service_in_its_forms():
    kind, message = "std_srvs/srv/Trigger_Response", {"success": True, "message": "ok"}
    (text,) = forms.service_response("c", "/stop", kind, message)
    whole = {
        "op": "service_response",
        "id": "c",
        "service": "/stop",
        "result": True,
        "values": message,
    }
    assert json.loads(text) == whole
    (binary,) = forms.service_response("c", "/stop", kind, message, "cbor")
    assert cbor2.loads(binary) == whole
    (png,) = forms.service_response("c", "/stop", kind, message, "png")
    assert json.loads(unpacked(json.loads(png)["data"])[2]) == whole
    parts = forms.service_response("c", "/stop", kind, message, "none", 20)
    assert json.loads("".join(json.loads(each)["data"] for each in parts)) == whole


# -- delivery -------------------------------------------------------------------------------------


def subscribe(identity, throttle=0, queue=0, compression="none", size=0, topic="/t"):
    return Subscribe(identity, topic, "", throttle, queue, compression, size)


def test_subscriptions_of_one_topic_are_merged():
    all_ = Subscriptions()
    assert all_.add(subscribe("a", 100, 5)) == Delivery(0.1, 5, "none", 0)
    assert all_.add(subscribe("b", 20, 8, "cbor", 500)) == Delivery(0.02, 5, "cbor", 500)
    assert all_.add(subscribe("c", 50, 9, "cbor-raw")) == Delivery(0.02, 5, "cbor-raw", 500)
    assert all_.add(subscribe("d", 50, 9, size=900)) == Delivery(0.02, 5, "cbor-raw", 500)
    assert all_.remove(Unsubscribe("d", "/t")) == Delivery(0.02, 5, "cbor-raw", 500)
    assert len(all_) == 3
    assert all_.remove(Unsubscribe("b", "/t")) == Delivery(0.05, 5, "cbor-raw", 0)
    assert all_.remove(Unsubscribe("x", "/t")) == Delivery(0.05, 5, "cbor-raw", 0)
    assert all_.remove(Unsubscribe(None, "/t")) is None
    assert all_.remove(Unsubscribe("a", "/t")) is None
    assert not all_.topics()


def stream(throttle_s=0.0, queue=0, topic="/t"):
    return TopicQueue(topic, Delivery(throttle_s, queue, "none", 0))


def test_without_throttle_all_goes_out_at_once():
    outbox, to_client = SendQueue(100), stream()
    assert all(outbox.offer(to_client, sample(), now, True) for now in (0.0, 0.0, 0.001))
    assert outbox.take(1.0) is None
    assert outbox.due_s() is None


def test_a_throttle_without_queue_drops_what_comes_too_early():
    outbox, to_client = SendQueue(100), stream(0.1)
    went = [now for now in range(20) if outbox.offer(to_client, sample(), now * 0.03, True)]
    assert went == [0, 4, 8, 12, 16]
    assert outbox.take(10.0) is None


def test_a_throttle_with_a_queue_keeps_the_last_and_sends_one_per_interval():
    outbox, to_client = SendQueue(100), stream(0.1, 2)
    all_ = [sample() for _ in range(4)]
    assert outbox.offer(to_client, all_[0], 0.0, True)
    for each in all_[1:]:
        assert not outbox.offer(to_client, each, 0.01, True)
    assert outbox.superseded == 1
    assert outbox.due_s() == 0.1
    assert outbox.take(0.09) is None
    assert outbox.take(0.1) == Due(to_client, all_[2])
    assert outbox.take(0.15) is None
    assert outbox.take(0.25) == Due(to_client, all_[3])
    assert outbox.due_s() is None


def test_while_a_client_does_not_read_the_newest_wins():
    outbox, to_client = SendQueue(100), stream()
    all_ = [sample() for _ in range(3)]
    assert not any(outbox.offer(to_client, each, 0.0, False) for each in all_)
    assert outbox.superseded == 2
    assert not outbox.offer(to_client, newest := sample(), 0.0, True), "not before earlier samples"
    assert outbox.take(0.0) == Due(to_client, newest)
    assert outbox.take(0.0) is None


def test_topics_take_turns():
    outbox, one, other = SendQueue(100), stream(queue=9, topic="/a"), stream(queue=9, topic="/b")
    for _ in range(2):
        for each in (one, other):
            outbox.offer(each, sample(), 0.0, False)
    assert [outbox.take(0.0).stream.topic for _ in range(4)] == ["/a", "/b", "/a", "/b"]


def test_control_goes_first_and_is_never_dropped():
    outbox, to_client = SendQueue(10), stream()
    outbox.offer(to_client, sample(), 0.0, False)
    outbox.add_control("0123456789")
    assert outbox.has_control
    assert not outbox.overflowed
    assert not outbox.offer(stream(topic="/other"), sample(), 0.0, True), "not before control"
    assert outbox.take(0.0) == "0123456789"
    assert outbox.take(0.0).stream is to_client
    outbox.add_control("0123456789")
    outbox.add_control("x")
    assert outbox.overflowed
    many = SendQueue(1 << 30)
    for _ in range(MAX_CONTROL_FRAMES + 1):
        assert not many.overflowed
        many.add_control("")
    assert many.overflowed


def test_a_stream_that_is_not_wanted_any_more_has_nothing_left():
    outbox, to_client = SendQueue(100), stream()
    outbox.offer(to_client, sample(), 0.0, False)
    outbox.forget(to_client)
    outbox.forget(to_client)
    assert outbox.take(0.0) is None


# -- rosapi ---------------------------------------------------------------------------------------


def test_typedefs_have_three_part_names_and_all_that_is_in_them():
    first, *others = rosapi.typedefs("geometry_msgs/msg/TwistStamped")
    assert first["type"] == "geometry_msgs/msg/TwistStamped"
    assert first["fieldnames"] == ["header", "twist"]
    assert first["fieldtypes"] == ["std_msgs/msg/Header", "geometry_msgs/msg/Twist"]
    assert first["fieldarraylen"] == [-1, -1]
    assert {each["type"] for each in others} == {
        "builtin_interfaces/msg/Time",
        "std_msgs/msg/Header",
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/Vector3",
    }
    (state, *_) = rosapi.typedefs(JOINTS)
    assert state["fieldarraylen"] == [-1, 0, 0, 0, 0]
    (empty,) = rosapi.typedefs("std_srvs/srv/Trigger_Request")
    assert empty["fieldnames"] == []
    (log, *_) = rosapi.typedefs("rcl_interfaces/msg/Log")
    assert dict(zip(log["constnames"], log["constvalues"], strict=True))["WARN"] == "30"
    assert dict(zip(log["fieldnames"], log["examples"], strict=True))["line"] == "0"


@pytest.mark.parametrize(
    ("text", "present", "kind", "field", "value"),
    [
        ("true", 0, 1, "bool_value", True),
        ("2", 0, 2, "integer_value", 2),
        ("2", 3, 3, "double_value", 2.0),
        ("2.5", 0, 3, "double_value", 2.5),
        ('"tool"', 0, 4, "string_value", "tool"),
        ("[1, 2]", 5, 5, "byte_array_value", b"\x01\x02"),
        ("[true]", 0, 6, "bool_array_value", [True]),
        ("[1, 2]", 0, 7, "integer_array_value", [1, 2]),
        ("[1, 2]", 8, 8, "double_array_value", [1.0, 2.0]),
        ("[1, 2.5]", 0, 8, "double_array_value", [1.0, 2.5]),
        ('["a"]', 0, 9, "string_array_value", ["a"]),
        ("[]", 8, 8, "double_array_value", []),
    ],
)
def test_parameters_as_json(text, present, kind, field, value):
    made = rosapi.parameter_value(text, present)
    assert (made["type"], made[field]) == (kind, value)
    assert json.loads(rosapi.parameter_text(made)) == json.loads(text)


@pytest.mark.parametrize("text", ["", "null", "{}", "[[1]]", '[1, "a"]', "1e999x", str(1 << 70)])
def test_what_is_no_parameter(text):
    with pytest.raises(ValueError, match="is no"):
        rosapi.parameter_value(text, 0)


def test_parameters_are_named_by_node_and_name():
    assert parameter_name("/arm/gateway:frame") == ("/arm/gateway", "frame")
    assert parameter_name("gateway:a.b") == ("/gateway", "a.b")
    for each in ("/frame", ":x", "/node:", ""):
        with pytest.raises(ValueError, match="names no parameter"):
            parameter_name(each)
