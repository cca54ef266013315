"""A program with ROS 2's default middleware watches and commands an arm through `cardan net server
dds`."""

from __future__ import annotations

import pytest

from cardan.protocols.ros2.cdr import codec_of
from cardan.robots import load_arm
from tests.fastdds import FastNode
from tests.sweep.plan import NODE, RESULT
from tests.waiting import until, until_streamed

pytestmark = pytest.mark.matrix

POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Twist"
JOINTS, EMPTY = "sensor_msgs/msg/JointState", "std_msgs/msg/Empty"
TRIGGER, STATUS = "std_srvs/srv/Trigger", "cardan_msgs/msg/ArmStatus"
COMMAND_RESULT = "cardan_msgs/msg/CommandResult"


class Program(FastNode):
    """A node that keeps the newest messages that it received."""

    def newest(self, topic, type_name):
        """Newest message, or None."""
        found = self.found("sample", topic=topic)
        return codec_of(type_name).decode(bytes.fromhex(found[-1]["cdr"])) if found else None

    def z(self):
        return self.newest(f"{NODE}/state/pose", POSE)["pose"]["position"]["z"]

    def results(self):
        found = self.found("sample", topic=RESULT)
        return [codec_of(COMMAND_RESULT).decode(bytes.fromhex(each["cdr"])) for each in found]

    def stream(self, topic, z_m_s):
        """Move the arm by a stream that runs until the node ends."""
        begun = self.z()
        self.publish(topic, TWIST, {"linear": {"z": z_m_s}}, count=100_000, period_ms=20)
        until_streamed(
            lambda: (self.z() - begun) / z_m_s > 0.2,
            lambda: [each["outcome"] for each in self.results() if each["command"] == "twist"],
            lambda: self.publish(topic, TWIST, {}),
            "the motion",
        )

    def phase(self):
        return self.newest(f"{NODE}/state/status", STATUS)["phase"]


@pytest.fixture
def program(domain):
    with Program(domain) as found:
        for topic, type_name in (
            (f"{NODE}/state/pose", POSE),
            (f"{NODE}/state/status", STATUS),
            ("/left/joint_states", JOINTS),
            (RESULT, COMMAND_RESULT),
        ):
            found.subscribe(topic, type_name)
        for topic in (f"{NODE}/state/pose", f"{NODE}/state/status", "/left/joint_states"):
            found.wait("sample", topic=topic)
        yield found


def test_it_reads_the_state(program):
    pose = program.newest(f"{NODE}/state/pose", POSE)
    assert pose["header"]["frame_id"] == "base_link"
    assert pose["pose"]["position"]["z"] == pytest.approx(0.43, abs=0.1)
    joints = program.newest("/left/joint_states", JOINTS)
    assert joints["name"] == list(load_arm("ur5").joint_names)
    assert len(joints["position"]) == 6


@pytest.mark.real
def test_its_twist_moves_the_arm_while_it_is_there(program, session):
    topic = f"{NODE}/command/twist"
    program.advertise(topic, TWIST)
    program.wait("matched", topic=f"rt{topic}", kind="writer")
    session.choose("none")  # The first command of the stream selects its kind.
    program.stream(topic, -0.05)
    program.kill()
    # The last command is fresh for 0.1 s; then the arm brakes, even while DDS considers the writer
    # alive.
    session.rest()


def test_it_stops_the_arm_by_a_topic_as_services_do_not_reach_it(program, session):
    stop = f"{NODE}/command/stop"
    program.advertise(stop, EMPTY)
    program.advertise("/left/cmd_vel", TWIST)
    program.wait("matched", topic=f"rt{stop}", kind="writer")
    program.do("client", f"{NODE}/stop", TRIGGER)
    program.wait("matched", topic=f"rq{NODE}/stopRequest", kind="writer")
    session.choose("none")
    program.stream("/left/cmd_vel", 0.05)
    program.request(f"{NODE}/stop", TRIGGER, {})
    assert program.wait("requested", written=1)["servers"] == 1
    higher = program.z()
    until(lambda: program.z() > higher + 0.005, "motion, because no request arrived")
    program.publish(stop, EMPTY, {})

    def stopped():
        reported = program.results()
        return [each for each in reported if (each["command"], each["outcome"]) == ("stop", "done")]

    until(stopped, "the stop")
    # The running stream must not move the arm again by itself.
    until(lambda: program.phase() in ("holding", "disarmed"), "the rest")
    assert program.found("reply") == []
