"""Third-party programs watch and command an arm: real rclpy through `cardan net server dds`,
started in the usual way, and others. docs/ros2.md lists the abilities of each."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install cardan[dds]")

from cardan.protocols.ros2.type_hash import type_hash
from cardan.robots import load_arm
from tests.dds_network import OPTIONS
from tests.serving import free_tcp_port, served, session_on_the_network
from tests.sweep.operators import (
    ARM,
    HEARD,
    JOINTS,
    POSES,
    STRING,
    Lab,
    operator as made,
)
from tests.sweep.world import await_rest, rests, stamp_s, statuses
from tests.waiting import until

pytestmark = pytest.mark.matrix

RCLPY = ("jazzy", "kilted")
WITH_SERVICES = ("zenoh-ros2-sdk", "roslibpy", "dora-rs")
EVERY = (*RCLPY, *WITH_SERVICES)
DESCRIPTION, POSE = "/left/robot_description", "geometry_msgs/msg/Pose"
TRIGGER = "std_srvs/srv/Trigger"
GET, SET = "rcl_interfaces/srv/GetParameters", "rcl_interfaces/srv/SetParameters"
MOVE, ACTION = "cardan_msgs/srv/MovePose", "cardan_msgs/action/MovePose"
STATUS_HZ = 50
REST_WITHIN_S = 1.0
NONE_WITHIN_S = 2.0
SERVER = "/cardan_dds_server"
NAMELESS = "_CREATED_BY_BARE_DDS_APP_"
"""Node name that rmw_fastrtps of Kilted reports for each endpoint of Cyclone DDS."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    domain, names = OPTIONS.number, 'other_names = ["cmd_vel"]\n'
    with (
        session_on_the_network(tmp_path_factory.mktemp("session"), more=names) as endpoint,
        served("net", "server", "dds", "--router", endpoint, "--dds-domain", str(domain)),
    ):
        yield Lab(endpoint, domain)


@pytest.fixture(scope="module")
def rosbridge(lab):
    """Port of the rosbridge server."""
    pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")
    port = free_tcp_port()
    with served("net", "server", "rosbridge", "--router", lab.endpoint, "--port", str(port)):
        yield port


@pytest.fixture
def judge(request):
    return request.param


@pytest.fixture
def operator(judge, lab, tmp_path, request):
    if judge == "roslibpy":
        lab = lab._replace(port=request.getfixturevalue("rosbridge"))
    with made(judge, lab, tmp_path) as found:
        found.watch()
        yield found


def by(*judges):
    """Parametrize a test with these programs."""
    return pytest.mark.parametrize("judge", judges, indirect=True)


@by(*EVERY)
def test_it_reads_the_state(operator):
    pose = operator.newest(POSES)
    assert pose["header"]["frame_id"] == "base_link"
    assert pose["pose"]["position"]["z"] == pytest.approx(0.43, abs=0.1)
    joints = operator.newest(JOINTS)
    assert joints["name"] == list(load_arm("ur5").joint_names)
    assert len(joints["position"]) == 6
    assert operator.status()["phase"] in ("disarmed", "holding")


@by(*RCLPY)
def test_the_arm_is_on_its_graph_by_the_types_that_it_knows(operator, judge):
    assert operator.found("ready")[0]["middleware"] == "rmw_fastrtps_cpp"
    server = {"jazzy": SERVER[1:], "kilted": NAMELESS}[judge]
    wanted = {
        topic: dict.fromkeys((server, "judge"), type_hash(kind)) for topic, kind in HEARD.items()
    }

    def of_what_it_hears():
        hashes = operator.graph()["hashes"]
        return {topic: hashes[topic] for topic in HEARD}

    # The node of an endpoint is announced after the endpoint.
    until(lambda: of_what_it_hears() == wanted, "the graph")
    graph = operator.graph()
    assert {SERVER, "/judge"} <= {*graph["nodes"]}
    assert {topic: graph["topics"][topic] for topic in HEARD} == {
        topic: [kind] for topic, kind in HEARD.items()
    }


@pytest.mark.real("jazzy")
@by(*EVERY)
def test_its_stream_moves_the_arm_while_it_is_there(operator, lab):
    with statuses(lab.endpoint) as await_status:
        operator.stream(-0.05)
        killed_s = time.time()
        operator.kill()
        reported = []

        def rested(status):
            reported.extend([rests(status)] * (stamp_s(status) > killed_s))
            return any(reported)

        await_status(rested, "the rest")
    # Time to rest, by the number of status messages since.
    assert reported.index(True) < REST_WITHIN_S * STATUS_HZ


@by(*EVERY)
def test_it_stops_the_arm_by_a_topic(operator, lab):
    operator.stream(0.05)
    operator.tell_and_wait("stop")
    # The running stream must not move the arm again by itself.
    await_rest(lab.endpoint)
    operator.kill()


@by(*EVERY)
def test_it_takes_and_gives_up_the_authority_and_acknowledges_by_topics(operator):
    operator.wait_for_authority()
    operator.tell_and_wait("acquire")
    until(lambda: operator.status()["authority"], "the authority")
    operator.tell_and_wait("release")
    until(lambda: not operator.status()["authority"], "that it is given up")
    operator.tell_and_wait("acknowledge")


@by(*EVERY)
def test_its_motion_arrives(operator):
    operator.wait_for_authority()
    pose = operator.newest(POSES)["pose"]
    pose["position"]["z"] -= 0.02
    operator.tell("movl", POSE, **pose)
    until(lambda: ("movl", "done") in operator.results(), "the arrival")
    assert operator.results() == [("movl", "accepted"), ("movl", "done")]
    until(lambda: operator.z() == pytest.approx(pose["position"]["z"], abs=0.001), "the pose")


# zenoh-ros2-sdk 0.1.8 looks for publishers of latched topics by a name in which only the first
# slash is replaced by `%`; on the wire all are. It never finds such a publisher in a namespace.
@by(*RCLPY, "roslibpy", "dora-rs")
def test_what_is_latched_comes_once_each_time(operator):
    for count in (1, 2, 3):
        operator.do("subscribe", topic=DESCRIPTION, kind=STRING, latched=True)
        sample = operator.wait("sample", count, topic=DESCRIPTION)
        assert "<robot" in sample["message"]["data"]
        time.sleep(0.5)
        assert len(operator.found("sample", topic=DESCRIPTION)) == count
        operator.do("unsubscribe", topic=DESCRIPTION)


@by(*RCLPY)
def test_services_and_parameters_and_actions_are_not_there_for_it(operator):
    """Fast DDS gets no reply from servers of Cyclone DDS, and must not see them as ready."""
    services = operator.graph()["services"]
    assert [each for each in services if not each.startswith("/judge/")] == []
    assert operator.called(f"{ARM}/stop", TRIGGER, NONE_WITHIN_S) is None
    assert operator.called(f"{ARM}/get_parameters", GET, NONE_WITHIN_S) is None


# zenoh-ros2-sdk 0.1.8 does not support services with an empty request.
@by("roslibpy", "dora-rs")
def test_it_stops_the_arm_by_a_service(operator):
    assert operator.called(f"{ARM}/stop", TRIGGER)["success"]


@by("roslibpy", "dora-rs")
def test_its_action_tells_where_the_arm_is_and_ends(operator):
    operator.wait_for_authority()
    pose = operator.newest(POSES)["pose"]
    pose["position"]["z"] -= 0.02
    operator.do("act", action=f"{ARM}/action/movl", kind=ACTION, goal={"x": pose})
    operator.wait("feedback")
    operator.wait("result")
    until(lambda: operator.z() == pytest.approx(pose["position"]["z"], abs=0.001), "the pose")


# zenoh-ros2-sdk 0.1.8 looks for the types of parameter services in `rcl_interfaces/srv`.
@by("roslibpy", "dora-rs")
def test_it_sets_and_reads_parameters(operator):
    operator.wait_for_authority()
    gain = {"name": "gain", "value": {"type": 3, "double_value": 1.5}}
    answer = operator.called(f"{ARM}/set_parameters", SET, parameters=[gain])
    assert [each["successful"] for each in answer["results"]] == [True]
    answer = operator.called(f"{ARM}/get_parameters", GET, names=["gain"])
    assert [each["double_value"] for each in answer["values"]] == [1.5]


@by(*WITH_SERVICES)
def test_its_service_moves_the_arm(operator):
    operator.wait_for_authority()
    pose = operator.newest(POSES)["pose"]
    pose["position"]["z"] += 0.02
    assert operator.called(f"{ARM}/movl", MOVE, x=pose)["success"]
    until(lambda: operator.z() == pytest.approx(pose["position"]["z"], abs=0.001), "the pose")
