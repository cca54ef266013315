"""ROS 2 over DDS on the wire, against the vectors of the protocol reference."""

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed, default_message
from cardan.protocols.ros2.type_hash import type_hash
from cardan_dds.wire import (
    BARE_NODE,
    CYCLONE,
    DISCOVERY_TYPE,
    FAST_DDS,
    HUMBLE_GID_BYTES,
    REPLY,
    REQUEST,
    TOPIC,
    Announcement,
    DdsGraph,
    DdsName,
    Endpoint,
    NodeInfo,
    ServicePacket,
    dds_topic,
    dds_type_of,
    exact,
    parsed_user_data,
    ros_name,
    service_id,
    user_data,
    vendor,
)

STRING, TRIGGER = "std_msgs/msg/String", "std_srvs/srv/Trigger"
CYCLONE_GUID = b"\x01\x10" + bytes(range(14))
FAST_GUID = b"\x01\x0f" + bytes(range(14))


@pytest.mark.parametrize(
    ("prefix", "name", "type_name", "topic", "dds_type"),
    [
        (
            TOPIC,
            "/state/pose",
            "geometry_msgs/msg/PoseStamped",
            "rt/state/pose",
            "geometry_msgs::msg::dds_::PoseStamped_",
        ),
        (REQUEST, "/gcmp", TRIGGER, "rq/gcmpRequest", "std_srvs::srv::dds_::Trigger_Request_"),
        (REPLY, "/gcmp", TRIGGER, "rr/gcmpReply", "std_srvs::srv::dds_::Trigger_Response_"),
        (
            REQUEST,
            "/move/_action/send_goal",
            "pkg/action/A_SendGoal",
            "rq/move/_action/send_goalRequest",
            "pkg::action::dds_::A_SendGoal_Request_",
        ),
    ],
)
def test_names_on_dds_and_back(prefix, name, type_name, topic, dds_type):
    assert dds_topic(prefix, name) == topic
    assert dds_type_of(prefix, type_name) == dds_type
    assert ros_name(topic, dds_type) == DdsName(prefix, name, type_name)


@pytest.mark.parametrize(
    "topic", ["ros_discovery_info", "DCPSTopic", "rt", "rt/", "rq/gcmp", "xx/a", ""]
)
def test_other_topics_are_nothing_to_ros(topic):
    assert ros_name(topic, "std_msgs::msg::dds_::String_") is None


def test_a_topic_of_a_foreign_type_has_no_type_of_ros():
    assert ros_name("rt/a", "Image") == DdsName(TOPIC, "/a", "")


def test_user_data_of_endpoints():
    data = user_data({"clientid": "1.10.a", "typehash": "RIHS01_ab"})
    assert data == b"clientid=1.10.a;typehash=RIHS01_ab;"
    assert parsed_user_data(data) == {"clientid": "1.10.a", "typehash": "RIHS01_ab"}
    assert user_data({"typehash": ""}) == b""
    assert parsed_user_data(b"\xff;=;a") == {"": ""}


def test_the_id_of_a_service_has_no_zero_padding():
    guid = bytes.fromhex("0110a0b0c0d0e0f001020304000001c1")
    assert service_id(guid, 258) == "1.10.a0.b0.c0.d0.e0.f0.1.2.3.4.0.0.1.2"


def test_vendors_by_their_first_two_bytes():
    assert vendor(CYCLONE_GUID) == CYCLONE
    assert vendor(FAST_GUID) == FAST_DDS
    assert vendor(b"\x01\x01") == "RTI Connext"
    assert vendor(b"\x01\x12") == "RustDDS"
    assert vendor(b"\x07\x07") == vendor(b"") == ""


REQUEST_PACKET = bytes.fromhex("00010000 88776655 44332211 07000000 00000000 00".replace(" ", ""))
REPLY_PACKET = bytes.fromhex(
    "00010000 88776655 44332211 07000000 00000000 01 000000 03000000 6f6b00".replace(" ", "")
)


@pytest.mark.parametrize(
    ("vector", "type_name", "message"),
    [
        (REQUEST_PACKET, f"{TRIGGER}_Request", {}),
        (REPLY_PACKET, f"{TRIGGER}_Response", {"success": True, "message": "ok"}),
    ],
)
def test_requests_and_replies(vector, type_name, message):
    cdr = codec_of(type_name).encode(completed(type_name, message))
    padded = vector + bytes(-len(vector) % 4)
    packet = ServicePacket(0x1122334455667788, 7, cdr)
    assert packet.encode() == padded
    found = ServicePacket.decode(padded)
    assert found[:2] == packet[:2]
    assert exact(type_name, found.cdr) == cdr


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", bytes(20), b"\0\1\0\0" + bytes(15)])
def test_what_has_no_header_is_no_request(data):
    assert ServicePacket.decode(data) is None


def test_padding_is_taken_from_messages_whose_length_is_not_known_by_their_type():
    for type_name in (STRING, "std_msgs/msg/Bool", "std_msgs/msg/Int8MultiArray"):
        cdr = codec_of(type_name).encode(default_message(type_name))
        for zeros in range(4):
            assert exact(type_name, cdr + bytes(zeros)) == cdr
        assert exact(type_name, cdr + bytes(4)) == cdr + bytes(4)
        assert exact(type_name, cdr + b"\1") == cdr + b"\1"
    pose = codec_of("geometry_msgs/msg/Pose").encode(default_message("geometry_msgs/msg/Pose"))
    assert exact("geometry_msgs/msg/Pose", pose) == pose
    assert exact(STRING, b"\0\1\0\0\xff") == b"\0\1\0\0\xff"
    assert exact("std_msgs/msg/Bool", b"\0\1\0\3\1\0\0\0") == b"\0\1\0\0\1"


ANNOUNCED = Announcement(
    CYCLONE_GUID,
    (
        NodeInfo("/teleop/gateway", (bytes(16),), (bytes([1]) * 16, bytes([2]) * 16)),
        NodeInfo("/server"),
    ),
)


def test_an_announcement_is_the_message_of_rmw_dds_common():
    def gid(guid):
        return {"data": guid}

    property_of = {
        "gid": gid(CYCLONE_GUID),
        "node_entities_info_seq": [
            {
                "node_namespace": "/teleop",
                "node_name": "gateway",
                "reader_gid_seq": [gid(bytes(16))],
                "writer_gid_seq": [gid(bytes([1]) * 16), gid(bytes([2]) * 16)],
            },
            {
                "node_namespace": "/",
                "node_name": "server",
                "reader_gid_seq": [],
                "writer_gid_seq": [],
            },
        ],
    }
    assert ANNOUNCED.encode() == codec_of(DISCOVERY_TYPE).encode(property_of)
    assert type_hash(DISCOVERY_TYPE) == (
        "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"
    )


def test_announcements_are_read_again_with_ids_of_both_lengths():
    assert Announcement.decode(ANNOUNCED.encode()) == ANNOUNCED
    humble = ANNOUNCED.encode(HUMBLE_GID_BYTES)
    assert humble[4:28] == CYCLONE_GUID + bytes(8)
    assert Announcement.decode(humble, HUMBLE_GID_BYTES) == ANNOUNCED
    assert Announcement.decode(humble) is None
    assert Announcement.decode(ANNOUNCED.encode(), HUMBLE_GID_BYTES) is None


@given(st.binary(max_size=200), st.sampled_from([16, 24]))
def test_an_announcement_that_is_none_raises_nothing(data, length):
    Announcement.decode(data, length)
    Announcement.decode(ANNOUNCED.encode()[: len(data)] + data, length)


def endpoint(number, topic="rt/a", writes=True, participant=CYCLONE_GUID, **more):
    guid = participant[:12] + number.to_bytes(4, "big")
    kind = "std_msgs::msg::dds_::String_"
    return Endpoint(guid, participant, writes, topic, kind, number, **more)


def test_the_graph_has_who_is_there():
    graph = DdsGraph()
    writer, reader = endpoint(1), endpoint(2, writes=False)
    for each in (writer, reader, writer, endpoint(3, topic="DCPSParticipant")):
        graph.add(each)
    assert graph.names(TOPIC) == ["/a"]
    assert graph.having(TOPIC, "/a", writes=True) == [writer]
    assert graph.having(TOPIC, "/a", writes=False) == [reader]
    assert graph.by_handle(1) == writer
    assert graph.node_of(writer) == BARE_NODE
    graph.announce(Announcement(CYCLONE_GUID, (NodeInfo("/talker", (), (writer.guid,)),)))
    assert graph.node_of(writer) == "/talker"
    assert graph.nodes() == ["/talker"]
    assert graph.remove(writer.guid) == writer
    assert graph.remove(writer.guid) is None
    assert graph.by_handle(1) is None
    graph.forget(CYCLONE_GUID)
    assert graph.nodes() == []
    graph.remove(reader.guid)
    assert graph.names(TOPIC) == []


def test_endpoints_of_one_server_belong_together():
    reader = endpoint(1, writes=False, user=b"serviceid=1.2;typehash=x;")
    assert reader.belongs(endpoint(2, user=b"serviceid=1.2;"), "serviceid")
    assert not reader.belongs(endpoint(2, user=b"serviceid=1.3;"), "serviceid")
    assert reader.belongs(endpoint(2), "serviceid")
    assert not reader.belongs(endpoint(2, participant=FAST_GUID), "serviceid")
