"""CDR messages: worked vectors, comparison with rosbags, both byte orders, and malicious bytes."""

import math
import struct

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.ros2.cdr import CdrError, MalformedCdr, Template, codec_of
from cardan.protocols.ros2.interfaces import (
    DUMMY_MEMBER,
    FLOATS,
    INTEGERS,
    known_types,
    message_type,
    parse_message,
)
from cardan.protocols.ros2.messages import completed, default_message
from tests.examples import examples

POSE = "geometry_msgs/msg/PoseStamped"
JOINTS = "sensor_msgs/msg/JointState"
ARRAY = "std_msgs/msg/Int32MultiArray"

VECTORS = (
    (
        POSE,
        {
            "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base_link"},
            "pose": {"position": {"x": 1, "y": 2, "z": 3}},
        },
        "00010000 01000000 02000000 0a000000 62617365 5f6c696e 6b000000 00000000 0000f03f 00000000"
        "00000040 00000000 00000840 00000000 00000000 00000000 00000000 00000000 00000000 00000000"
        "0000f03f",
    ),
    (
        JOINTS,
        {
            "header": {"stamp": {"sec": 1, "nanosec": 500_000_000}},
            "name": ["j1", "joint2"],
            "position": [0.5, -1.0],
            "effort": [0.25],
        },
        "00010000 01000000 0065cd1d 01000000 00000000 02000000 03000000 6a310000 07000000 6a6f696e"
        "74320000 02000000 00000000 00000000 0000e03f 00000000 0000f0bf 00000000 01000000 00000000"
        "0000d03f",
    ),
    (ARRAY, {"data": [1, 0]}, "00010000 00000000 00000000 02000000 01000000 00000000"),
    ("std_msgs/msg/Empty", {}, "00010000 00"),
    ("std_msgs/msg/String", {"data": ""}, "00010000 01000000 00"),
    ("std_srvs/srv/Trigger_Response", {"success": True, "message": "ok"},
     "00010000 01000000 03000000 6f6b00"),
    # An empty sequence adds no alignment for its elements: `data_offset` ends at 8, count at 12.
    ("std_msgs/msg/Float64MultiArray", {}, "00010000 00000000 00000000 00000000"),
)  # fmt: skip


@pytest.mark.parametrize(("name", "given", "expected"), VECTORS)
def test_worked_vectors(name, given, expected):
    message = completed(name, given)
    data = bytes.fromhex(expected)
    assert codec_of(name).encode(message) == data
    assert codec_of(name).decode(data) == message


@pytest.mark.parametrize("zeros", [1, 2, 3, 4])
def test_zeros_at_the_end_are_tolerated(zeros):
    for name, message, expected in VECTORS:
        decoded = codec_of(name).decode(bytes.fromhex(expected) + bytes(zeros))
        assert decoded == completed(name, message)


def test_the_byte_of_an_empty_message_may_be_missing():
    assert codec_of("std_msgs/msg/Empty").decode(b"\0\1\0\0") == completed("std_msgs/msg/Empty", {})


def test_the_byte_of_an_empty_message_at_the_end_may_be_missing():
    goal = codec_of("cardan_msgs/action/CompensateGravity_SendGoal_Request")
    message = {"goal_id": {"uuid": bytes(range(16))}, "goal": {DUMMY_MEMBER: 0}}
    data = goal.encode(message)
    assert goal.decode(data) == goal.decode(data[:-1]) == message
    assert isinstance(goal.decode(data[:-2]), MalformedCdr)
    assert isinstance(codec_of("std_srvs/srv/Trigger_Request").decode(data[:3]), MalformedCdr)


def test_big_endian_is_read():
    data = b"\0\0\0\0" + struct.pack(">iI", 1, 2) + struct.pack(">I", 2) + b"a\0" + b"\0\0"
    data += struct.pack(">7d", 1, 2, 3, 0, 0, 0, 1)
    # Alignment counts from the end of the encapsulation: 8 + 4 + 2 is 14, thus two bytes up to 16.
    message = codec_of(POSE).decode(data)
    assert message["header"] == {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "a"}
    assert message["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 3.0}


# -- round trips ----------------------------------------------------------------------------------

_TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)


def values(field):
    """Return a strategy for one element of a field."""
    if field.nested:
        return messages(field.base)
    if field.base == "string":
        return _TEXT.filter(lambda t: not field.most_characters or len(t.encode()) < 12)
    if field.base == "bool":
        return st.booleans()
    if field.base in FLOATS:
        return st.floats(width=32 if field.base == "float32" else 64)
    return st.integers(*INTEGERS[field.base])


def of_field(field):
    if not field.array:
        return values(field)
    count = field.length if field.array == "fixed" else 0
    most = count or min(field.length or 3, 3)
    if field.base in ("uint8", "char", "byte"):
        return st.binary(min_size=count, max_size=most)
    return st.lists(values(field), min_size=count, max_size=most)


def messages(name):
    return st.fixed_dictionaries({f.name: of_field(f) for f in message_type(name).fields})


def same(one, other):
    if isinstance(one, float):
        return one == other or (math.isnan(one) and math.isnan(other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other


PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}


def all_messages():
    for name in known_types():
        kind = name.split("/")[1]
        yield from [name] if kind == "msg" else (f"{name}_{part}" for part in PARTS[kind])


@settings(max_examples=examples(200), deadline=None)
@given(st.data())
def test_every_message_comes_back_as_it_was(data):
    name = data.draw(st.sampled_from(sorted(all_messages())))
    message = data.draw(messages(name))
    encoded = codec_of(name).encode(message)
    assert same(codec_of(name).decode(encoded), message)


def test_rosbags_reads_and_writes_the_same_bytes():
    rosbags = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed: pip install")
    store = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    compared = 0
    for name in all_messages():
        if name not in store.fielddefs or name in ("rmw_dds_common/msg/Gid",):
            continue
        if "rmw_dds_common" in name or "service_msgs" in name:
            continue  # older ones with other lengths
        ours = codec_of(name).encode(example(name))
        theirs = store.deserialize_cdr(ours, name)
        assert bytes(store.serialize_cdr(theirs, name)).rstrip(b"\0") == ours.rstrip(b"\0"), name
        compared += 1
    assert compared > 50


def test_rosbags_reads_and_writes_the_same_bytes_of_yarps_messages():
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed: pip install")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    names = [name for name in all_messages() if name.startswith("yarp_control_msgs/")]
    for name in names:
        known = name.replace("/srv/", "/msg/")  # rosbags has no services
        store.register(typesys.get_types_from_msg(message_type(name).text, known))
        ours = codec_of(name).encode(example(name))
        theirs = store.deserialize_cdr(ours, known)
        assert bytes(store.serialize_cdr(theirs, known)) == ours, name
    assert len(names) == 3 + 2 * 3


def example(name, depth=0):
    """Return a message in which every array has elements."""
    message = default_message(name)
    for number, field in enumerate(message_type(name).fields, 1):
        message[field.name] = example_of(field, number + depth)
    return message


def example_of(field, number):
    def one():
        if field.nested:
            return example(field.base, number)
        if field.base == "string":
            return "abc"[: number % 4]
        return True if field.base == "bool" else float(number) if field.base in FLOATS else number

    if not field.array:
        return one()
    count = field.length if field.array == "fixed" else min(2, field.length or 2)
    if field.base in ("uint8", "char", "byte"):
        return bytes(range(1, count + 1))
    return [one() for _ in range(count)]


# -- malformed bytes ------------------------------------------------------------------------------


@settings(max_examples=examples(300), deadline=None)
@given(st.sampled_from(sorted(all_messages())), st.binary(max_size=120))
def test_any_bytes_are_a_message_or_a_reason(name, data):
    for head in (b"", b"\0\1\0\0", b"\0\0\0\0"):
        decoded = codec_of(name).decode(head + data)
        assert isinstance(decoded, (dict, MalformedCdr))
        if isinstance(decoded, MalformedCdr):
            assert decoded.reason


NESTED = (
    POSE,
    JOINTS,
    "control_msgs/action/FollowJointTrajectory_Goal",
    "rcl_interfaces/srv/SetParameters_Request",
)


@settings(max_examples=examples(200), deadline=None)
@given(st.data())
def test_a_message_that_was_cut_or_changed_is_never_an_error(data):
    name = data.draw(st.sampled_from(NESTED))
    encoded = bytearray(codec_of(name).encode(example(name)))
    at = data.draw(st.integers(0, len(encoded) - 1))
    if data.draw(st.booleans()):
        encoded = encoded[:at]
    else:
        encoded[at] = data.draw(st.integers(0, 255))
    assert isinstance(codec_of(name).decode(bytes(encoded)), (dict, MalformedCdr))


@pytest.mark.parametrize("cut", range(84))
def test_a_pose_that_was_cut_is_no_pose(cut):
    data = codec_of(POSE).encode(completed(POSE, VECTORS[0][1]))
    assert isinstance(codec_of(POSE).decode(data[:cut]), MalformedCdr)


@pytest.mark.parametrize("count", [0xFFFFFFFF, 0x7FFFFFFF, 1 << 20])
def test_counts_that_the_bytes_cannot_hold_take_no_memory(count):
    data = b"\0\1\0\0" + bytes(8) + struct.pack("<I", count) + bytes(64)
    for name in (ARRAY, JOINTS, "tf2_msgs/msg/TFMessage"):
        head = data if name != "tf2_msgs/msg/TFMessage" else data[:4] + data[12:]
        assert isinstance(codec_of(name).decode(head), MalformedCdr)


def test_what_follows_a_message_is_reported():
    data = codec_of(POSE).encode(default_message(POSE))
    assert "too many" in codec_of(POSE).decode(data + b"\1").reason


def test_a_text_with_nul_in_it_is_none():
    """Every decoded message can be encoded, and used as a response."""
    codec = codec_of("std_msgs/msg/String")
    head = b"\0\1\0\0\6\0\0\0"
    assert "NUL" in codec.decode(head + b"j\0\0_1\0").reason
    assert codec.decode(head + b"joint\0") == {"data": "joint"}
    assert codec.decode(head + b"jo\0\0\0\0") == {"data": "jo"}


def test_other_encodings_are_reported():
    body = bytes(56)
    for head in (b"\0\2\0\0", b"\0\6\0\0", b"", b"\0", b"\0\1"):
        assert isinstance(codec_of("geometry_msgs/msg/Pose").decode(head + body[:0]), MalformedCdr)


@pytest.mark.parametrize(
    ("name", "message", "words"),
    [
        ("std_msgs/msg/Int32", {"data": 1 << 31}, "Int32"),
        ("std_msgs/msg/Int32", {"data": "1"}, "Int32"),
        ("std_msgs/msg/Int32", {}, "missing"),
        ("std_msgs/msg/Int32", 3, "not a message"),
        ("std_msgs/msg/String", {"data": "a\0b"}, "NUL"),
        ("std_msgs/msg/String", {"data": 1}, "not a text"),
        ("unique_identifier_msgs/msg/UUID", {"uuid": bytes(15)}, "16 elements, not 15"),
        ("geometry_msgs/msg/Pose", {"position": 1, "orientation": 2}, "not a message"),
    ],
)
def test_what_a_type_cannot_carry_is_not_encoded(name, message, words):
    with pytest.raises(CdrError, match=words):
        codec_of(name).encode(message)


def test_bounded_texts_and_sequences_keep_their_bounds():
    name = "rmw_dds_common/msg/NodeEntitiesInfo"
    message = default_message(name) | {"node_name": "n" * 257}
    with pytest.raises(CdrError, match="256"):
        codec_of(name).encode(message)
    descriptor = default_message("rcl_interfaces/msg/ParameterDescriptor")
    two = [{"from_value": 0.0, "to_value": 1.0, "step": 0.0}] * 2
    with pytest.raises(CdrError, match="takes 1 elements, not 2"):
        codec_of("rcl_interfaces/msg/ParameterDescriptor").encode(
            descriptor | {"floating_point_range": two}
        )


# -- templates ------------------------------------------------------------------------------------


def test_a_templates_numbers_are_those_of_the_message():
    given = {"header": {"frame_id": "odd"}, "name": ["a", "bcd"], "position": [0, 0]}
    template = Template(JOINTS, completed(JOINTS, given))
    template.slot("header.stamp")(3, 4)
    template.slot("position")(0.5, -0.5)
    message = codec_of(JOINTS).decode(bytes(template.data))
    assert message["header"]["stamp"] == {"sec": 3, "nanosec": 4}
    assert message["position"] == [0.5, -0.5]
    assert message["name"] == ["a", "bcd"]
    assert message["effort"] == []


def test_a_template_reaches_into_arrays_of_messages():
    name = "tf2_msgs/msg/TFMessage"
    one = default_message("geometry_msgs/msg/TransformStamped") | {"child_frame_id": "tool0"}
    template = Template(name, {"transforms": [one, one]})
    template.slot("transforms.1.transform")(1, 2, 3, 0, 0, 0, 1)
    first, second = codec_of(name).decode(bytes(template.data))["transforms"]
    assert first == one
    assert second["transform"]["translation"] == {"x": 1.0, "y": 2.0, "z": 3.0}


def test_numbers_are_read_from_messages_that_are_otherwise_the_same():
    message = default_message(POSE) | {
        "header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "x"}
    }
    template = Template(POSE, message)
    read = template.reader("pose.orientation", "header.stamp.sec")
    template.slot("header.stamp.sec")(9)
    template.slot("pose.orientation")(1, 2, 3, 4)
    assert read(bytes(template.data)) == (9, 1.0, 2.0, 3.0, 4.0)
    template.slot("header.stamp.nanosec")(10)
    assert read(bytes(template.data)) is None
    longer = codec_of(POSE).encode(message | {"header": message["header"] | {"frame_id": "xyz12"}})
    assert read(longer) is None
    assert read(longer[:20]) is None


@pytest.mark.parametrize("path", ["nothing", "header.frame_id", "header", ""])
def test_a_template_has_slots_of_numbers_only(path):
    with pytest.raises(KeyError, match="number"):
        Template(POSE, default_message(POSE)).slot(path)


def test_a_slot_has_no_length_of_an_array_between_its_numbers():
    name = "trajectory_msgs/msg/JointTrajectory"
    point = {"positions": [0.5], "velocities": [0.5]}
    template = Template(name, completed(name, {"points": [point]}))
    with pytest.raises(KeyError, match="more than numbers"):
        template.slot("points.0")


def test_a_default_may_have_what_begins_a_comment_elsewhere():
    (field,) = parse_message("p/msg/A", 'string a "it # 1" # more').fields
    assert field.default == '"it # 1"'


# -- messages in user input -----------------------------------------------------------------------


def test_missing_fields_take_their_defaults():
    pose = completed("geometry_msgs/msg/Pose", {"position": {"x": 1}})
    assert pose["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    assert pose["position"] == {"x": 1.0, "y": 0.0, "z": 0.0}


def test_forms_that_json_gives_are_taken():
    joy = completed("sensor_msgs/msg/Joy", {"axes": [1, None], "buttons": [1]})
    assert joy["axes"][0] == 1.0
    assert math.isnan(joy["axes"][1])
    stamp = completed("std_msgs/msg/Header", {"stamp": {"secs": 3, "nsecs": 4}})["stamp"]
    assert stamp == {"sec": 3, "nanosec": 4}
    uuid = "unique_identifier_msgs/msg/UUID"
    assert completed(uuid, {"uuid": "AAECAwQFBgcICQoLDA0ODw=="})["uuid"] == bytes(range(16))
    assert completed(uuid, {"uuid": list(range(16))})["uuid"] == bytes(range(16))


@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("geometry_msgs/msg/Pose", {"positio": {}}, "positio: .*no such field; it has position"),
        ("geometry_msgs/msg/Pose", {"position": {"x": True}}, "position.x: takes a number"),
        ("geometry_msgs/msg/Pose", {"position": 3}, "position: takes an object"),
        ("geometry_msgs/msg/Pose", [], "takes an object"),
        ("std_msgs/msg/Int32", {"data": 1.5}, "data: takes a whole number"),
        ("std_msgs/msg/Int32", {"data": 1 << 40}, "data: takes a whole number"),
        ("std_msgs/msg/Bool", {"data": 1}, "data: takes true or false"),
        ("std_msgs/msg/String", {"data": 1}, "data: takes a text"),
        ("std_msgs/msg/String", {"data": "\udcff"}, "data: takes Unicode without lone surrogates"),
        ("std_msgs/msg/Float64", {"data": 10**400}, "data: the number is too large"),
        ("sensor_msgs/msg/Joy", {"axes": 1}, "axes: takes a list"),
        ("sensor_msgs/msg/Joy", {"axes": [0] * 100_001}, "axes: takes 100000 elements at most"),
        ("unique_identifier_msgs/msg/UUID", {"uuid": [1, 2]}, "uuid: takes 16 elements, not 2"),
        ("unique_identifier_msgs/msg/UUID", {"uuid": "%%"}, "uuid: .*not base64"),
        ("unique_identifier_msgs/msg/UUID", {"uuid": [300] * 16}, "uuid: takes a whole number"),
    ],
)
def test_what_does_not_fit_is_named(name, given, words):
    from cardan.protocols.ros2.messages import MessageError

    with pytest.raises(MessageError, match=words):
        completed(name, given)
