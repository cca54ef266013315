"""Names, key expressions, attachments and tokens in the format of rmw_zenoh."""

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.ros2.graph import Graph
from cardan.protocols.ros2.names import RosNameError, checked_name, dds_type, type_of_dds
from cardan.protocols.ros2.type_hash import UNSUPPORTED, type_hash
from cardan.protocols.ros2.zenoh import (
    DEFAULT_QOS,
    LATCHED_QOS,
    PUBLISHER,
    SERVICE,
    SUBSCRIPTION,
    Attachment,
    Entity,
    Qos,
    data_key,
)

POSE = "geometry_msgs/msg/PoseStamped"


@pytest.mark.parametrize(
    ("given", "full"),
    [
        ("/state/pose", "/state/pose"),
        ("pose", "/pose"),
        ("~/pose", "/arm/teleop/pose"),
        ("~/action/movl/_action/send_goal", "/arm/teleop/action/movl/_action/send_goal"),
        ("_hidden", "/_hidden"),
    ],
)
def test_names_become_absolute(given, full):
    assert checked_name(given, "/arm/teleop") == full


@pytest.mark.parametrize(
    "name", ["", "/", "a//b", "a/", "1a", "a__b", "ä", "a b", "a-b", "*", "a\n"]
)
def test_names_that_ros_refuses_are_refused(name):
    with pytest.raises(RosNameError, match="words of letters"):
        checked_name(name)


def test_types_have_a_form_of_their_own_on_the_wire():
    assert dds_type(POSE) == "geometry_msgs::msg::dds_::PoseStamped_"
    assert dds_type("std_srvs/srv/Trigger") == "std_srvs::srv::dds_::Trigger_"
    assert type_of_dds("geometry_msgs::msg::dds_::PoseStamped_") == POSE
    for text in ("", "a::b", "geometry_msgs::msg::PoseStamped", "a::msg::dds_::B", "a::b::c::d::e"):
        assert type_of_dds(text) == ""


def test_keys_have_domain_name_type_and_hash():
    mark = type_hash(POSE)
    assert data_key(0, "/state/pose", POSE) == (
        f"0/state/pose/geometry_msgs::msg::dds_::PoseStamped_/{mark}"
    )
    assert data_key(7, "/gcmp", "std_srvs/srv/Trigger") == (
        "7/gcmp/std_srvs::srv::dds_::Trigger_/"
        "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
    )
    assert data_key(0, "/a", POSE, hashed=False).endswith(f"/{UNSUPPORTED}")


def test_attachments_have_33_bytes():
    attachment = Attachment(5, 1_700_000_000_000_000_001, bytes(range(16)))
    data = attachment.encode()
    assert len(data) == 33
    assert data[:8] == (5).to_bytes(8, "little")
    assert data[16] == 16
    assert Attachment.decode(data) == attachment


@given(st.binary(max_size=64))
def test_other_attachments_are_none(data):
    decoded = Attachment.decode(data)
    assert decoded is None or (len(data) == 33 and data[16] == 16)


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (DEFAULT_QOS, "::,10:,:,:,,"),
        (LATCHED_QOS, ":1:,1:,:,:,,"),
        (Qos(reliable=False, depth=5), "2::,5:,:,:,,"),
        (Qos(keep_all=True), "::2,10:,:,:,,"),
    ],
)
def test_the_depth_is_always_written(qos, text):
    assert qos.text() == text
    assert Qos.parse(text) == qos


def test_an_empty_depth_is_rmw_zenohs_own():
    assert Qos.parse("::,:,:,:,,").depth == 42
    assert Qos.parse("").depth == 42
    assert Qos.parse("garbage:x:y,z").depth == 42
    assert Qos.parse(f"::2,{'9' * 5000}:,:,:,,").depth == 42  # more digits than int() accepts


def entity(kind=PUBLISHER, name="/state/pose", namespace="/", type_name=POSE):
    return Entity("abc1", "0", "3", kind, namespace, "arm", name, type_name, type_hash(type_name))


def test_tokens_say_who_has_what():
    token = entity().token(0)
    assert token == (
        "@ros2_lv/0/abc1/0/3/MP/%/%/arm/%state%pose/geometry_msgs::msg::dds_::PoseStamped_/"
        f"{type_hash(POSE)}/::,10:,:,:,,"
    )
    assert Entity.parse(token) == entity()
    node = Entity("abc1", "0", "0", "NN", "/left", "arm")
    assert node.token(3) == "@ros2_lv/3/abc1/0/0/NN/%/%left/arm"
    assert Entity.parse(node.token(3)) == node
    assert node.full_node == "/left/arm"


@given(st.text(max_size=80))
def test_what_is_no_token_is_none(text):
    assert Entity.parse(text) is None
    assert Entity.parse(f"@ros2_lv/{text}") is None or text.count("/") >= 7


def test_the_graph_follows_the_tokens():
    graph = Graph()
    service = entity(SERVICE, "/gcmp", type_name="std_srvs/srv/Trigger")
    for each in (entity(), entity(SUBSCRIPTION), service):
        assert graph.add(each.token(0)) is not None
        assert graph.add(each.token(0)) is None
    assert graph.add("nonsense") is None
    assert graph.strange == 1
    assert graph.topics() == {"/state/pose": POSE}
    assert graph.services() == {"/gcmp": "std_srvs/srv/Trigger"}
    assert graph.nodes() == ["/arm"]
    assert [e.kind for e in graph.publishers("/state/pose")] == [PUBLISHER]
    assert [e.kind for e in graph.subscribers("/state/pose")] == [SUBSCRIPTION]
    found = graph.entities(PUBLISHER, SUBSCRIPTION, SERVICE)
    assert [each.full_node for each in found] == ["/arm"] * 3
    assert graph.remove(entity().token(0)) == entity()
    assert graph.remove(entity().token(0)) is None
    assert graph.publishers("/state/pose") == []
    graph.clear()
    assert graph.entities() == []
