"""A node of a real rclpy watches and commands an arm: `cardan face dds`, as everybody starts it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import NamedTuple

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install cardan[dds]")

from cardan.protocols.ros2.type_hash import type_hash
from cardan.robots import load_arm
from tests.dds_rig import OPTIONS
from tests.serving import ARM_SESSION, free_endpoint, served
from tests.sweep.rclpy_judge import DISTRIBUTIONS, RclpyNode, python_of
from tests.sweep.world import await_rest
from tests.waiting import until

pytestmark = [pytest.mark.matrix, pytest.mark.timeout(120)]

ARM, FACE = "/left/arm", "/cardan_dds_face"
POSES, JOINTS, VELOCITY = f"{ARM}/state/pose", "/left/joint_states", "/left/cmd_vel"
DESCRIPTION, DIAGNOSTICS = "/left/robot_description", "/diagnostics"
RESULTS = f"{ARM}/result_text"
STRING, EMPTY, TWIST = "std_msgs/msg/String", "std_msgs/msg/Empty", "geometry_msgs/msg/Twist"
TRIGGER = "std_srvs/srv/Trigger"
GET, SET = "rcl_interfaces/srv/GetParameters", "rcl_interfaces/srv/SetParameters"
HEARD = {
    POSES: "geometry_msgs/msg/PoseStamped",
    JOINTS: "sensor_msgs/msg/JointState",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    RESULTS: STRING,
}
REST_WITHIN_S = 1.0
NONE_WITHIN_S = 2.0


class Lab(NamedTuple):
    """A session, and the face between it and a domain of DDS."""

    domain: int
    endpoint: str


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    python_of(DISTRIBUTIONS[0])
    endpoint, domain = free_endpoint(), OPTIONS.number
    file = tmp_path_factory.mktemp("session") / "session.toml"
    file.write_text(f'{ARM_SESSION.format(endpoint=endpoint)}other_names = ["cmd_vel"]\n')
    run = [sys.executable, "-m", "cardan", "run", str(file), "--seconds", "300"]
    with subprocess.Popen(run, stdout=subprocess.DEVNULL) as session:
        try:
            with served("face", "dds", "--router", endpoint, "--dds-domain", str(domain)):
                yield Lab(domain, endpoint)
        finally:
            session.terminate()


class Operator(RclpyNode):
    """It knows what it has heard last."""

    def z(self):
        return self.newest(POSES)["pose"]["position"]["z"]

    def results(self):
        samples = self.found("sample", topic=RESULTS)
        found = [json.loads(each["message"]["data"]) for each in samples]
        return [(each["command"], each["outcome"]) for each in found]

    def status(self):
        """What `/diagnostics` says of the arm."""
        rows = {
            each["name"].rpartition(" ")[2]: each for each in self.newest(DIAGNOSTICS)["status"]
        }
        return {each["key"]: each["value"] for each in rows["arm"]["values"]}

    def graph(self):
        known = len(self.found("graph"))
        self.do("graph")
        return self.wait("graph", known + 1)

    def advertise(self, topic, kind):
        self.do("advertise", topic=topic, kind=kind)
        self.wait("matched", topic=topic)

    def tell(self, verb, kind=EMPTY, **message):
        """Publish a command, once."""
        topic = f"{ARM}/command/{verb}"
        self.advertise(topic, kind)
        self.do("publish", topic=topic, message=message)

    def tell_and_wait(self, verb):
        self.tell(verb)
        until(lambda: (verb, "done") in self.results(), verb)

    def stream(self, speed):
        """Move the arm, until somebody ends it."""
        until(lambda: not self.status()["authority"], "that nobody has the arm")
        self.advertise(VELOCITY, TWIST)
        begun = self.z()
        self.do("publish", topic=VELOCITY, message={"linear": {"z": speed}}, period_s=0.02)
        until(lambda: (self.z() - begun) / speed > 0.2, "the motion")


@pytest.fixture(params=DISTRIBUTIONS)
def operator(request, lab, tmp_path):
    with Operator(request.param, lab.domain, tmp_path) as found:
        for topic, kind in HEARD.items():
            found.do("subscribe", topic=topic, kind=kind)
        for topic in (POSES, JOINTS, DIAGNOSTICS):
            found.wait("sample", topic=topic)
        yield found


def test_it_reads_the_state(operator):
    assert operator.found("ready")[0]["middleware"] == "rmw_fastrtps_cpp"
    pose = operator.newest(POSES)
    assert pose["header"]["frame_id"] == "base_link"
    assert pose["pose"]["position"]["z"] == pytest.approx(0.43, abs=0.1)
    joints = operator.newest(JOINTS)
    assert joints["name"] == list(load_arm("ur5").joint_names)
    assert len(joints["position"]) == 6
    assert operator.status()["phase"] in ("disarmed", "holding")


def test_the_arm_is_on_its_graph_by_the_types_that_it_knows(operator):
    wanted = {
        topic: dict.fromkeys((FACE[1:], "judge"), type_hash(kind)) for topic, kind in HEARD.items()
    }

    def of_what_it_hears():
        hashes = operator.graph()["hashes"]
        return {topic: hashes[topic] for topic in HEARD}

    # Of which node an endpoint is comes after the endpoint.
    until(lambda: of_what_it_hears() == wanted, "the graph")
    graph = operator.graph()
    assert {FACE, "/judge"} <= {*graph["nodes"]}
    assert {topic: graph["topics"][topic] for topic in HEARD} == {
        topic: [kind] for topic, kind in HEARD.items()
    }


@pytest.mark.real("jazzy")
def test_its_stream_moves_the_arm_while_it_is_there(operator, lab):
    operator.stream(-0.05)
    operator.kill()
    killed_s = time.monotonic()
    await_rest(lab.endpoint)
    assert time.monotonic() - killed_s < REST_WITHIN_S


def test_it_stops_the_arm_by_a_topic(operator, lab):
    operator.stream(0.05)
    operator.tell_and_wait("stop")
    # The stream that goes on does not begin again by itself.
    await_rest(lab.endpoint)


def test_it_takes_and_gives_up_the_authority_and_acknowledges_by_topics(operator):
    until(lambda: not operator.status()["authority"], "that nobody has the arm")
    operator.tell_and_wait("acquire")
    until(lambda: "judge" in operator.status()["authority"], "the authority")
    operator.tell_and_wait("release")
    until(lambda: not operator.status()["authority"], "that it is given up")
    operator.tell_and_wait("acknowledge")


def test_its_motion_arrives(operator):
    until(lambda: not operator.status()["authority"], "that nobody has the arm")
    pose = operator.newest(POSES)["pose"]
    aim = pose["position"]["z"] - 0.02
    operator.tell(
        "movl", "geometry_msgs/msg/Pose", **pose | {"position": {**pose["position"], "z": aim}}
    )
    until(lambda: ("movl", "done") in operator.results(), "the arrival")
    assert operator.results() == [("movl", "accepted"), ("movl", "done")]
    until(lambda: operator.z() == pytest.approx(aim, abs=0.001), "the pose")


def test_what_is_latched_comes_once_each_time(operator):
    for count in (1, 2, 3):
        operator.do("subscribe", topic=DESCRIPTION, kind=STRING, latched=True)
        sample = operator.wait("sample", count, topic=DESCRIPTION)
        assert "<robot" in sample["message"]["data"]
        time.sleep(0.5)
        assert len(operator.found("sample", topic=DESCRIPTION)) == count
        operator.do("unsubscribe", topic=DESCRIPTION)


def test_services_and_parameters_and_actions_are_not_there_for_it(operator):
    """Fast DDS gets no answer of Cyclone DDS: it must not see them as ready."""
    services = operator.graph()["services"]
    assert [each for each in services if not each.startswith("/judge/")] == []
    for service, kind in ((f"{ARM}/stop", TRIGGER), (f"{ARM}/get_parameters", GET)):
        operator.do("call", service=service, kind=kind, request={}, wait_s=NONE_WITHIN_S)
        operator.wait("no service", service=service)
