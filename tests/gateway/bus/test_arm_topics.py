"""Topics that a session publishes about its arm."""

import math

import pytest

from cardan.gateway.arm.vocab import State, Stream
from cardan.gateway.bus.arm_topics import (
    ERROR,
    LOG_WARN,
    OK,
    ArmNames,
    ArmTopics,
    DiagnosticStatus,
)
from cardan.protocols.ros2.cdr import Codec
from cardan.spatial import compose
from cardan.types import Pose, Quaternion, Vector3, Wrench
from tests.gateway.arm.arms import World
from tests.gateway.bus.bench import FakeNode

NOW_NS = 5_000_000_007
TOOL = Pose(Vector3(0.0, 0.0, 0.1), Quaternion(1.0, 0.0, 0.0, 0.0))
FLAGS = {"state": int(State.MOVL), "stream": int(Stream.POSE), "ready": True, "moving": True}


class PublishedArm:
    """An arm's topics on a fake node."""

    def __init__(self, **more):
        self.node, self.world = FakeNode(), World()
        self.names = ArmNames(self.world.model.joint_names)
        self.topics = ArmTopics(self.node, self.names, period_s=0.02, **more)

    def publish(self, state=None, pose="measured", now_s=None):
        world = self.world
        state = state or world.state()
        pose = world.verbs.commanded.pose if pose == "measured" else pose
        now_s = state.stamp_s + 0.001 if now_s is None else now_s
        self.topics.publish(state, pose, world.verbs.controller.status(), FLAGS, now_s, NOW_NS)

    def heard(self, topic):
        return self.node.publishers[topic].messages


@pytest.fixture
def shown():
    shown = PublishedArm(robot_description="<robot/>", tool=TOOL)
    shown.world.verbs.movj(shown.world.moved(0.0, 0.0, -0.05))
    shown.world.tick(50)
    return shown


def numbers(pose):
    p, q = pose["position"], pose["orientation"]
    return [p["x"], p["y"], p["z"], q["w"], q["x"], q["y"], q["z"]]


def test_one_instant_has_one_stamp_the_robots(shown):
    shown.publish()
    stamps = {
        name: message[-1]["header"]["stamp"]
        for name in ("/joint_states", "/arm/state/pose", "/arm/state/target", "/arm/state/twist",
                     "/arm/state/status")
        if (message := shown.heard(name))
    }  # fmt: skip
    assert len(stamps) == 5
    for stamp in stamps.values():
        assert stamp["sec"] * 10**9 + stamp["nanosec"] == pytest.approx(NOW_NS - 1_000_000, abs=9)


def test_joint_states_have_what_the_robot_reports(shown):
    world = shown.world
    shown.publish()
    state = world.state()._replace(torques=(1.0,) * 6)
    shown.publish(state)
    shown.publish(state._replace(velocities=()))
    first, second, third = shown.heard("/joint_states")
    assert tuple(first["name"]) == world.model.joint_names
    assert first["position"] == list(world.q)
    assert first["velocity"] == list(world.v)
    assert first["effort"] == []
    assert second["effort"] == [1.0] * 6
    assert third["velocity"] == []
    shown.publish(state._replace(joints=(1.0, 2.0)))
    assert len(shown.heard("/joint_states")) == 3


def test_poses_and_transforms_fit_together(shown):
    shown.publish()
    pose = shown.world.verbs.commanded.pose
    message = shown.heard("/arm/state/pose")[-1]
    assert message["header"]["frame_id"] == "base_link"
    assert numbers(message["pose"]) == pytest.approx([*pose.position, *pose.orientation])
    (moving,) = shown.heard("/tf")[-1]["transforms"]
    assert (moving["header"]["frame_id"], moving["child_frame_id"]) == ("base_link", "tool0")
    t, r = moving["transform"]["translation"], moving["transform"]["rotation"]
    flange = Pose(Vector3(t["x"], t["y"], t["z"]), Quaternion(r["w"], r["x"], r["y"], r["z"]))
    again = compose(flange, TOOL)
    assert [*again.position] == pytest.approx([*pose.position])
    (fixed,) = shown.heard("/tf_static")[0]["transforms"]
    assert (fixed["header"]["frame_id"], fixed["child_frame_id"]) == ("tool0", "tcp")
    assert fixed["transform"]["translation"]["z"] == 0.1


def test_what_comes_late_gets_what_does_not_change(shown):
    for name in ("/tf_static", "/robot_description"):
        assert shown.node.publishers[name].qos.transient_local
        assert len(shown.heard(name)) == 1
    assert shown.heard("/robot_description")[0]["data"] == "<robot/>"


def test_what_is_around_the_arm_is_asked_to_who_comes_late():
    shown = PublishedArm(scene='{"obstacles":[]}')
    topic = "/arm/scene"
    assert shown.node.publishers[topic].qos.transient_local
    assert [each["data"] for each in shown.heard(topic)] == ['{"obstacles":[]}']


@pytest.mark.parametrize(
    ("transforms", "moving", "fixed"), [("all", 1, 1), ("tool", 0, 1), ("none", 0, 0)]
)
def test_transforms_of_others_are_left_to_them(transforms, moving, fixed):
    shown = PublishedArm(transforms=transforms)
    shown.world.verbs.movj(shown.world.moved(0.0, 0.0, -0.05))
    shown.world.tick(5)
    shown.publish()
    there = shown.node.publishers
    assert ("/tf" in there, "/tf_static" in there) == (bool(moving), bool(fixed))
    assert "/robot_description" not in there


def test_the_target_twist_and_wrench(shown):
    shown.publish()
    status = shown.world.verbs.controller.status()
    target = shown.heard("/arm/state/target")[-1]
    assert numbers(target["pose"])[:3] == pytest.approx([*status.pose.position])
    linear = shown.heard("/arm/state/twist")[-1]["twist"]["linear"]
    assert linear["z"] == status.twist.linear.z != 0.0
    assert shown.heard("/arm/state/wrench") == []
    wrench = Wrench(Vector3(1.0, 2.0, 3.0), Vector3(4.0, 5.0, 6.0))
    shown.publish(shown.world.state()._replace(wrench=wrench))
    reported = shown.heard("/arm/state/wrench")[-1]["wrench"]
    assert reported == {
        "force": {"x": 1.0, "y": 2.0, "z": 3.0},
        "torque": {"x": 4.0, "y": 5.0, "z": 6},
    }


def test_the_status_says_what_it_is_doing_and_who_moves_it(shown):
    shown.publish()
    reported = shown.heard("/arm/state/status")[-1]
    assert reported["state"] == int(State.MOVL)
    assert reported["stream"] == int(Stream.POSE)
    assert reported["phase"] == "moving"
    assert reported["authority"] == shown.world.verbs.controller.authority.owner
    assert reported["ready"]


def test_of_a_status_whose_texts_stay_only_the_numbers_are_written_anew(shown, monkeypatch):
    encoded = []
    encode = Codec.encode

    def counted(codec, message):
        encoded.append(codec.name)
        return encode(codec, message)

    monkeypatch.setattr(Codec, "encode", counted)
    controller = shown.world.verbs.controller
    status, reported = controller.status(), shown.heard("/arm/state/status")
    monkeypatch.setattr(controller, "status", lambda: status)
    for trips in range(10):
        status = status._replace(trips=trips, lead_used=0.1 * trips)
        shown.publish()
    assert encoded.count("cardan_msgs/msg/ArmStatus") < 4
    assert [each["trips"] for each in reported] == list(range(10))
    assert [each["lead_used"] for each in reported] == [0.1 * trips for trips in range(10)]
    assert {each["state"] for each in reported} == {int(State.MOVL)}


def test_a_status_whose_texts_change_has_the_new_ones_at_once(shown, monkeypatch):
    controller = shown.world.verbs.controller
    status, reported = controller.status(), shown.heard("/arm/state/status")
    monkeypatch.setattr(controller, "status", lambda: status)
    words = ["", "", "", "held", "held", "held", "", "a much longer reason", ""]
    for trips, message in enumerate(words):
        status = status._replace(trips=trips, message=message)
        shown.publish()
    assert [each["message"] for each in reported] == words
    assert [each["trips"] for each in reported] == list(range(len(words)))


def test_without_a_pose_there_is_none(shown):
    shown.publish(pose=None)
    assert shown.heard("/arm/state/pose") == shown.heard("/tf") == []
    assert len(shown.heard("/joint_states")) == 1


def test_it_is_due_once_a_period_and_never_catches_up(shown):
    topics = shown.topics
    assert topics.due(-1e9)
    shown.publish(now_s=100.0)
    assert not topics.due(100.019)
    assert topics.due(100.02)
    shown.publish(now_s=200.0)
    assert topics.due(200.0 + 0.02)
    assert not topics.due(200.0 + 0.019)


def test_diagnostics_come_once_a_second(shown):
    parts = [
        DiagnosticStatus("robot", OK, "link live", values={"rate": 250}),
        DiagnosticStatus("device", ERROR, "lost"),
    ]
    for now_s in (0.0, 0.5, 0.99, 1.0):
        shown.topics.put_diagnostics(parts, now_s, NOW_NS)
    first, second = shown.heard("/diagnostics")
    assert first["status"] == second["status"]
    assert [row["name"] for row in first["status"]] == ["/arm: robot", "/arm: device"]
    assert [row["level"] for row in first["status"]] == [OK, ERROR]
    assert first["status"][0]["values"] == [{"key": "rate", "value": "250"}]


def test_the_diagnostics_have_what_the_status_says(shown):
    shown.publish()
    shown.topics.put_diagnostics([], 1.0, NOW_NS)
    (array,), (status,) = shown.heard("/diagnostics"), shown.heard("/arm/state/status")
    (row,) = array["status"]
    assert row["name"] == "/arm: arm"
    said = {each["key"]: each["value"] for each in row["values"]}
    assert (said["state"], said["stream"]) == ("movl", "pose")
    for name in ("phase", "authority", "ready", "moving", "lead_used", "trips"):
        assert said[name] == str(status[name])
    assert said["limits"] == ", ".join(status["limits"])
    assert said.keys() | {"message", "header"} == status.keys()


def test_the_log_is_rosouts(shown):
    shown.topics.log(LOG_WARN, "the robot is gone", NOW_NS)
    (line,) = shown.heard("/rosout")
    assert (line["level"], line["name"], line["msg"]) == (30, "arm", "the robot is gone")
    assert line["stamp"] == {"sec": 5, "nanosec": 7}


def test_numbers_that_are_none_are_published_as_they_are(shown):
    shown.publish(shown.world.state()._replace(velocities=(math.nan,) * 6))
    assert all(map(math.isnan, shown.heard("/joint_states")[-1]["velocity"]))


def test_further_topics_have_the_very_same_messages():
    same = {"state/pose": ["measured_cp", "current_pose"], "joint_states": ["measured_js"]}
    shown = PublishedArm(same=same)
    shown.publish()
    for own, others in (
        ("/arm/state/pose", same["state/pose"]),
        ("/joint_states", ["measured_js"]),
    ):
        assert len(shown.heard(own)) == 1
        for other in others:
            assert shown.heard(f"/{other}") == shown.heard(own)
