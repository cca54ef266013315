"""ROS 2 type hashes: published values, and comparison with rosbags."""

import pytest

from cardan.protocols.ros2.definitions import TEXT
from cardan.protocols.ros2.interfaces import (
    InterfaceError,
    action_type,
    known_types,
    service_type,
)
from cardan.protocols.ros2.names import dds_type
from cardan.protocols.ros2.type_description import describe_type
from cardan.protocols.ros2.type_hash import type_hash

KNOWN = (
    (
        "sensor_msgs/msg/CompressedImage",
        "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a",
    ),
    ("std_msgs/msg/Header", "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01"),
    ("std_msgs/msg/String", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
    ("std_msgs/msg/Bool", "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9"),
    ("std_msgs/msg/Int32", "b6578ded3c58c626cfe8d1a6fb6e04f706f97e9f03d2727c9ff4e74b1cef0deb"),
    ("std_msgs/msg/Empty", "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312"),
    (
        "std_msgs/msg/Int32MultiArray",
        "84a7346323525d1b4dfca899df3820f245e54009dac5a6b69217d14fdefd1701",
    ),
    (
        "std_msgs/msg/Float64MultiArray",
        "1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f",
    ),
    ("geometry_msgs/msg/Pose", "d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa"),
    (
        "geometry_msgs/msg/PoseStamped",
        "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    ),
    ("geometry_msgs/msg/Twist", "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"),
    (
        "geometry_msgs/msg/TwistStamped",
        "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    ),
    (
        "geometry_msgs/msg/Wrench",
        "018e8519d57c16adbe97c9fe1460ef21fec7e31bc541de3d653a35895677ce52",
    ),
    (
        "geometry_msgs/msg/WrenchStamped",
        "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    ),
    (
        "geometry_msgs/msg/Transform",
        "beb83fbe698636351461f6f35d1abb20010c43d55374d81bd041f1ba2581fddc",
    ),
    (
        "geometry_msgs/msg/TransformStamped",
        "0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206",
    ),
    (
        "sensor_msgs/msg/JointState",
        "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    ),
    ("sensor_msgs/msg/Joy", "0d356c79cad3401e35ffeb75a96a96e08be3ef896b8b83841d73e890989372c5"),
    (
        "rcl_interfaces/msg/ParameterEvent",
        "043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204",
    ),
    ("rcl_interfaces/msg/Log", "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac"),
    (
        "rmw_dds_common/msg/ParticipantEntitiesInfo",
        "91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e",
    ),
    ("std_srvs/srv/Trigger", "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"),
    (
        "std_srvs/srv/Trigger_Request",
        "d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199",
    ),
    (
        "std_srvs/srv/Trigger_Response",
        "2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf",
    ),
    (
        "std_srvs/srv/Trigger_Event",
        "ec4a1d26b0575e61906890342aba9523a2360e9845857c5590fa6e23bc39e1c2",
    ),
    ("std_srvs/srv/SetBool", "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"),
    (
        "rcl_interfaces/srv/GetParameters",
        "bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
    ),
    (
        "rcl_interfaces/srv/SetParameters",
        "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    ),
    (
        "rcl_interfaces/srv/SetParametersAtomically",
        "0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
    ),
    (
        "rcl_interfaces/srv/ListParameters",
        "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
    ),
    (
        "rcl_interfaces/srv/DescribeParameters",
        "845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
    ),
    (
        "rcl_interfaces/srv/GetParameterTypes",
        "da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca",
    ),
)
"""Hashes that ROS 2 distributions from Iron on contain."""

FOLLOW = "control_msgs/action/FollowJointTrajectory"
CONTROL = (
    (f"{FOLLOW}_SendGoal", "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f"),
    (
        f"{FOLLOW}_SendGoal_Request",
        "179c93691f1f6d1d115881ff88c3917b7cc6eac2ba4bf56766cc7c4389e19ef1",
    ),
    (
        f"{FOLLOW}_SendGoal_Response",
        "e6a48ba740ae254500129a877f0b071be8663a115da1a539b74599cc97921fbf",
    ),
    (f"{FOLLOW}_Goal", "8a9060704b269608f5a340934cc26e66869dd14bdac29e2e7fd9ec8b9882d205"),
    (f"{FOLLOW}_GetResult", "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b"),
    (f"{FOLLOW}_Result", "8002e99ed2c14c6faa522f2a93c26d744c5982f254f9e98ff9c6f19789bdb220"),
    (f"{FOLLOW}_Feedback", "3fd0aaecf71725121ae1ff7f01098a5e0da581e672be18a6b2c286cb43d96b49"),
    (
        f"{FOLLOW}_FeedbackMessage",
        "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    ),
)
"""Hashes of control_msgs up to 6.2 (Iron, Jazzy), from a build of
`follow_joint_trajectory__struct.h` by rosidl_generator_c. Newer versions have the same hashes of
goal and result."""

KILTED = "95618cc7"
"""Start of the hash of the feedback in control_msgs 6.3 to 6.8 (Kilted and later), from a client's
key; no published source of the whole hash was found."""

OWN = "cardan_msgs/"
DIFFERS = {"rmw_dds_common/msg/Gid", "service_msgs/msg/ServiceEventInfo"}
"""rosbags has older definitions of these: 24 bytes, and uint8 in place of char."""


@pytest.mark.parametrize(("name", "expected"), KNOWN + CONTROL)
def test_hashes_are_those_of_ros_2(name, expected):
    assert type_hash(name) == f"RIHS01_{expected}"


def test_the_feedback_of_kilted_has_indices_and_the_same_name():
    kilted = f"{FOLLOW}SinceKilted"
    assert type_hash(f"{kilted}_FeedbackMessage").startswith(f"RIHS01_{KILTED}")
    assert dds_type(f"{kilted}_FeedbackMessage") == dds_type(f"{FOLLOW}_FeedbackMessage")
    for part in ("SendGoal", "GetResult", "Goal", "Result"):
        assert type_hash(f"{kilted}_{part}") == type_hash(f"{FOLLOW}_{part}")
    assert kilted not in known_types()


def messages():
    return [name for name in known_types() if "/msg/" in name]


STORES = ("ROS2_HUMBLE", "ROS2_IRON", "ROS2_JAZZY", "ROS2_KILTED", "ROS2_LYRICAL")
"""rosbags' definitions by distribution."""

UNJUDGED = {
    "cardan_msgs",
    "control_msgs",
    "crtk_msgs",
    "moveit_msgs",
    "rosapi",
    "yarp_control_msgs",
}
"""Packages that rosbags lacks for all distributions. Only the hashes in `CONTROL` have an
independent source."""
SINCE_IRON = {"service_msgs", "type_description_interfaces"}


def judge(store="ROS2_JAZZY"):
    rosbags = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed: pip install")
    return rosbags.get_typestore(rosbags.Stores[store])


@pytest.mark.parametrize("distribution", STORES)
def test_rosbags_computes_the_same_of_every_distribution(distribution):
    store = judge(distribution)
    lacked = set()
    for name in messages():
        if name not in store.fielddefs:
            lacked.add(name.split("/")[0])
        elif not _contains(name, DIFFERS):
            assert type_hash(name) == store.hash_rihs01(name), name
    assert lacked == UNJUDGED | (SINCE_IRON if distribution == "ROS2_HUMBLE" else set())


def test_rosbags_computes_the_same_of_those_that_it_lacks():
    from rosbags.typesys import get_types_from_msg

    from cardan.protocols.ros2.interfaces import message_type

    store = judge()
    missing = [name for name in messages() if name not in store.fielddefs]
    found = {}
    for name in missing:
        found |= get_types_from_msg(message_type(name).text, name)
    store.register(found)
    for name in missing:
        assert type_hash(name) == store.hash_rihs01(name), name


def _contains(name, others):
    from cardan.protocols.ros2.interfaces import referenced

    return name in others or not others.isdisjoint(referenced(name))


@pytest.mark.parametrize("name", [name for name in known_types() if "/srv/" in name])
def test_every_service_has_one_hash_for_itself_and_one_for_each_part(name):
    service = service_type(name)
    marks = {type_hash(each) for each in (name, service.request, service.response, f"{name}_Event")}
    assert len(marks) == 4


@pytest.mark.parametrize("name", [name for name in known_types() if "/action/" in name])
def test_every_action_has_hashes_for_what_is_on_the_wire(name):
    action = action_type(name)
    wire = (action.send_goal.name, action.get_result.name, action.feedback)
    assert len({type_hash(each) for each in wire}) == 3


@pytest.mark.parametrize("name", ["", "Pose", "geometry_msgs/Nope", "a/b/c/d", "std_msgs/msg/é"])
def test_what_is_no_type_is_named(name):
    with pytest.raises(InterfaceError, match="type"):
        type_hash(name)
    with pytest.raises(InterfaceError, match="type"):
        action_type(name.replace("geometry_msgs/", "control_msgs/action/"))


# -- ~/get_type_description ------------------------------------------------------------------------


def asked(name, mark="", sources=True):
    return {"type_name": name, "type_hash": mark, "include_type_sources": sources}


def test_a_description_has_the_types_within_and_its_file():
    name = "geometry_msgs/msg/PoseStamped"
    answer = describe_type(asked(name, type_hash(name)))
    assert answer["successful"]
    described = answer["type_description"]
    assert described["type_description"]["type_name"] == name
    within = [each["type_name"] for each in described["referenced_type_descriptions"]]
    assert within == sorted(within)
    assert "builtin_interfaces/msg/Time" in within
    assert [each["type_name"] for each in answer["type_sources"]] == [name, *within]


def test_a_description_is_of_the_revision_whose_hash_is_asked_for():
    for part in ("Feedback", "FeedbackMessage"):
        name, later = f"{FOLLOW}_{part}", f"{FOLLOW}SinceKilted_{part}"
        for mark, kilted in (("", False), (type_hash(name), False), (type_hash(later), True)):
            answer = describe_type(asked(name, mark))
            assert answer["successful"]
            described = answer["type_description"]
            whole = [described["type_description"], *described["referenced_type_descriptions"]]
            (feedback,) = (each for each in whole if each["type_name"] == f"{FOLLOW}_Feedback")
            assert ("index" in [each["name"] for each in feedback["fields"]]) is kilted
            assert "SinceKilted" not in str(answer)


def test_a_description_says_what_it_does_not_know():
    name = "geometry_msgs/msg/Pose"
    assert "RIHS01_d501954e" in describe_type(asked(name, "RIHS01_0"))["failure_reason"]
    assert "Nope" in describe_type(asked("geometry_msgs/msg/Nope"))["failure_reason"]
    assert describe_type(asked(name, sources=False))["type_sources"] == []


def test_every_type_is_defined_once():
    names = [line for line in TEXT.splitlines() if line.startswith("@")]
    assert sorted(names) == sorted(set(names))
