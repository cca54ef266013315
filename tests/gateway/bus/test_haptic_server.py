"""A haptic device under the names of YARP's wrapper, without a network, in virtual time."""

import math

import pytest

from cardan.common.haptics import FeedbackLimits
from cardan.drivers.ihaptic import IHapticDevice
from cardan.errors import DriverError
from cardan.gateway.bus.haptic_server import ALL, LOOK_PERIOD_S, PAPER, PRESENT, HapticServer
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import known_types
from cardan.protocols.ros2.messages import completed
from cardan.types import IDENTITY, ZERO3, Pose, Quaternion, Vector3
from tests.gateway.bus.fakes import FakeNode, FakeRequest, FakeUser
from tests.gateway.force.fakes import FakeHaptic

VECTOR, JOINTS = "geometry_msgs/msg/Vector3", "sensor_msgs/msg/JointState"
TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"
YARP = "yarp_control_msgs/srv/"
QUARTER = Quaternion(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""A quarter of a turn about z, from x to y."""


class Taken:
    """Records the feedback that it is given."""

    why_no_torques = ""

    def __init__(self):
        self.given, self.stops, self.why_not = [], 0, ""

    def give(self, publisher, sequence, asked, now_s):
        if self.why_not:
            return self.why_not
        self.given.append((publisher, sequence, asked))
        return ""

    def stop(self):
        self.stops += 1
        return self.why_not


class Bench:
    def __init__(self, device=None, served=True, mode="cartesian"):
        self.node, self.feedback = FakeNode(), Taken()
        self.device = device or FakeHaptic()
        self.haptic = IHapticDevice(self.device, mode)
        feedback = self.feedback if served else None
        self.server = HapticServer(self.node, self.device, self.haptic, feedback, period_s=0.02)
        self.now_s = 1.0

    def run(self, seconds=2 * LOOK_PERIOD_S):
        for _ in range(round(seconds / 0.004) + 1):
            self.now_s += 0.004
            self.server.poll(self.now_s)
            self.server.publish(self.now_s, round(self.now_s * 1e9))

    def reported(self, topic):
        return self.node.publishers[f"~/{topic}"].messages

    def publisher(self, type_name, topic="feedback", user="user"):
        return FakeUser(self.node, "MP", f"~/{topic}", type_name, user=user)

    def call(self, name, type_name, **given):
        client = FakeUser(self.node, "SC", f"~/{name}", type_name)
        asked = client.ask(completed(f"{type_name}_Request", given))
        self.run()
        return codec_of(f"{type_name}_Response").decode(asked.answer)


class TorqueHaptic(FakeHaptic):
    feedback_limits = FeedbackLimits(3.0, 0.35)


def test_the_tables_have_the_names_of_the_wrapper_and_of_the_paper():
    assert [each.name for each in PRESENT.services] == [
        "stop_feedback", "get_max_feedback", "get_transform", "set_transform",
    ]  # fmt: skip
    assert [each.name for each in PAPER.services] == [
        "stop_feedback", "set_force_mode", "state/force_mode", "state/max_force_feedback",
        "state/transform", "set_transformation",
    ]  # fmt: skip
    assert {"state/force_feedback", "state/transform"} < set(PAPER.state)
    for names in ALL:
        assert {each.type_name for each in names.services} <= set(known_types())


def test_the_state_is_published_in_the_frame_of_the_transformation():
    bench = Bench()
    bench.device.pose = Pose(Vector3(0.02, 0.01, 0.0), IDENTITY)
    bench.device.haptic_state = bench.device.haptic_state._replace(force=Vector3(0.5, 0.0, 0.0))
    bench.device.buttons = frozenset({"button_2"})
    bench.haptic.set_transformation(Pose(Vector3(10.0, 20.0, 30.0), QUARTER))
    bench.run(0.2)
    pose = bench.reported("state/pose")[-1]
    assert pose["position"] == pytest.approx({"x": 9.99, "y": 20.02, "z": 30.0})
    assert pose["orientation"] == pytest.approx({"x": 0, "y": 0, "z": QUARTER.z, "w": QUARTER.w})
    assert bench.reported("state/buttons")[-1]["data"] == [0, 1]
    # A force is only rotated, not shifted.
    force = bench.reported("state/force_feedback")[-1]["force"]
    assert force == pytest.approx({"x": 0.0, "y": 0.5, "z": 0.0})
    transform = bench.reported("state/transform")[-1]
    assert transform["translation"] == {"x": 10.0, "y": 20.0, "z": 30.0}
    assert bench.reported("state/force_mode")[-1]["data"] is True
    assert len(bench.reported("state/pose")) == pytest.approx(10, abs=1)
    bench.device.buttons = frozenset()
    bench.run(0.1)
    assert bench.reported("state/buttons")[-1]["data"] == [0, 0]


def test_a_device_without_a_pose_publishes_none(monkeypatch):
    bench = Bench()

    def nowhere():
        raise DriverError("it is in the inkwell")

    monkeypatch.setattr(bench.device, "measured_pose", nowhere)
    bench.run(0.1)
    assert bench.reported("state/pose") == []
    assert bench.reported("state/buttons")


def test_feedback_is_taken_in_both_types():
    bench = Bench()
    bench.publisher(VECTOR).publish({"x": 0.1, "y": 0.2, "z": 0.3})
    bench.run()
    paper = bench.publisher(JOINTS, user="paper")
    paper.publish(completed(JOINTS, {"effort": [0.4, 0.5, 0.6]}))
    bench.run()
    (first, _, one), (second, _, two) = bench.feedback.given
    assert (one, two) == ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
    assert first != second
    accepted = [each for each in bench.reported("result") if each["outcome"] == "accepted"]
    assert [each["command"] for each in accepted] == ["feedback", "feedback"]
    assert bench.server.refused == 0


@pytest.mark.parametrize(
    ("type_name", "message", "words"),
    [
        (JOINTS, {"effort": [0.1, 0.2]}, "three numbers of effort, not 2"),
        (JOINTS, {"position": [0.1, 0.2, 0.3]}, "three numbers of effort, not 0"),
        ("geometry_msgs/msg/Wrench", {}, f"takes {VECTOR} or {JOINTS}, not geometry_msgs"),
    ],
)
def test_bad_feedback_is_refused_with_a_reason_once(type_name, message, words):
    bench = Bench()
    user = bench.publisher(type_name)
    for _ in range(3):
        user.publish(completed(type_name, message))
    bench.run()
    assert bench.feedback.given == []
    assert bench.server.refused == 3
    (result,) = bench.reported("result")
    assert words in result["reason"]
    assert (result["outcome"], result["success"]) == ("refused", False)
    assert "3 messages or requests refused" in bench.server.part().message


def test_what_the_session_refuses_is_reported_and_taking_again_too():
    bench = Bench()
    user = bench.publisher(VECTOR)
    for why in ("not now", "not now", "", ""):
        bench.feedback.why_not = why
        user.publish({"x": 0.0, "y": 0.0, "z": 0.0})
        bench.run()
    assert [each["outcome"] for each in bench.reported("result")] == ["refused", "accepted"]


def test_while_another_has_the_name_nothing_is_taken_but_a_stop():
    bench = Bench()
    bench.server.inhibited = why = "another node has the name /stylus"
    bench.publisher(VECTOR).publish({"x": 0.1, "y": 0.0, "z": 0.0})
    bench.run()
    assert bench.feedback.given == []
    assert bench.reported("result")[-1]["reason"] == f"feedback: {why}"
    before = bench.haptic.get_transformation()
    transform = {"translation": {"x": 1.0, "y": 0.0, "z": 0.0}, "rotation": {"w": 1.0}}
    bench.call("set_transform", f"{YARP}SetTransformation", transform=transform)
    assert bench.haptic.get_transformation() == before
    assert not bench.call("set_force_mode", SET_BOOL, data=False)["success"]
    kind = "rcl_interfaces/srv/SetParameters"
    mode = {"name": "mode_feedback", "value": {"type": 4, "string_value": "joint"}}
    (result,) = bench.call("set_parameters", kind, parameters=[mode])["results"]
    assert why in result["reason"]
    assert bench.call("state/force_mode", TRIGGER)["message"] == "cartesian"
    assert bench.call("stop_feedback", TRIGGER)["success"]
    assert bench.feedback.stops == 1
    bench.server.inhibited = ""
    bench.publisher(VECTOR).publish({"x": 0.1, "y": 0.0, "z": 0.0})
    bench.run()
    assert len(bench.feedback.given) == 1


def test_bytes_that_are_no_message_are_refused():
    bench = Bench()
    user = bench.publisher(VECTOR)
    user.publish({"x": 0.0, "y": 0.0, "z": 0.0})
    queue = bench.node.queues["~/feedback"].waiting
    queue[0] = queue[0]._replace(data=b"\0\1\0\0junk")
    bench.run()
    assert bench.feedback.given == []
    assert bench.server.refused == 1


def test_what_is_far_too_long_is_not_even_read():
    bench = Bench()
    bench.publisher(JOINTS).publish(completed(JOINTS, {"effort": [0.0] * 100_000}))
    bench.run()
    assert (
        "bytes are too many for sensor_msgs/msg/JointState" in bench.reported("result")[0]["reason"]
    )
    client = FakeUser(bench.node, "SC", "~/set_parameters", "rcl_interfaces/srv/SetParameters")
    given = completed("rcl_interfaces/msg/Parameter", {"name": "mode_feedback"})
    asked = client.ask({"parameters": [given] * 1000})
    bench.run()
    answer = codec_of("rcl_interfaces/srv/SetParameters_Response").decode(asked.answer)
    (result,) = answer["results"]
    assert "bytes are too many for rcl_interfaces/srv/SetParameters_Request" in result["reason"]
    assert (bench.feedback.given, bench.server.refused) == ([], 2)


def test_a_publisher_that_is_no_ros_node_is_taken_too():
    bench = Bench()
    user = bench.publisher(VECTOR)
    for _ in range(2):
        user.publish({"x": 0.1, "y": 0.0, "z": 0.0}, attached=False)
    bench.run()
    assert [sequence for _, sequence, _ in bench.feedback.given] == [1, 2]


@pytest.mark.parametrize("name", ["get_max_feedback", "state/max_force_feedback"])
def test_the_largest_feedback_is_reported(name):
    bench = Bench(TorqueHaptic())
    answer = bench.call(name, f"{YARP}GetMaxFeedback")
    assert answer == {
        "max_feedback": {"x": 3.0, "y": 3.0, "z": 3.0},
        "response": "NOT_SPECIFIED",
        "success": True,
    }
    bench.haptic.set_joint_torque_mode()
    torque = bench.call(name, f"{YARP}GetMaxFeedback")["max_feedback"]
    assert torque == {"x": 0.35, "y": 0.35, "z": 0.35}  # N·m


@pytest.mark.parametrize(
    ("setter", "getter"),
    [("set_transform", "get_transform"), ("set_transformation", "state/transform")],
)
def test_the_transformation_is_set_and_got(setter, getter):
    bench = Bench()
    wanted = {
        "translation": {"x": 1.0, "y": 2.0, "z": 3.0},
        "rotation": {"x": 0.0, "y": 0.0, "z": QUARTER.z, "w": QUARTER.w},
    }
    answer = bench.call(setter, f"{YARP}SetTransformation", transform=wanted)
    assert answer["success"]
    reported = bench.call(getter, f"{YARP}GetTransformation")
    assert reported["success"]
    assert reported["transform"]["translation"] == wanted["translation"]
    assert reported["transform"]["rotation"] == pytest.approx(wanted["rotation"])


def test_a_transformation_that_is_none_is_refused_and_changes_nothing():
    bench = Bench()
    flat = {"rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}}
    for given in (flat, {"translation": {"x": math.nan, "y": 0.0, "z": 0.0}}):
        answer = bench.call("set_transform", f"{YARP}SetTransformation", transform=given)
        assert not answer["success"]
        assert "the transformation" in answer["response"]
    assert bench.haptic.get_transformation() == Pose(ZERO3, IDENTITY)
    assert bench.server.refused == 2


def test_the_transformation_comes_as_a_topic_of_older_clients_too():
    bench = Bench()
    transform = "geometry_msgs/msg/Transform"
    bench.publisher(transform, "set_transformation").publish(
        completed(transform, {"translation": {"x": 1.0}})
    )
    bench.run()
    assert bench.haptic.get_transformation().position == (1.0, 0.0, 0.0)


def test_the_mode_is_set_by_service_and_by_parameter_and_ends_the_feedback():
    bench = Bench(TorqueHaptic())
    assert bench.call("state/force_mode", TRIGGER)["message"] == "cartesian"
    assert bench.call("set_force_mode", SET_BOOL, data=False)["success"]
    assert bench.feedback.stops == 1
    assert bench.call("state/force_mode", TRIGGER)["message"] == "joint"
    assert set_parameter(bench, "cartesian") == {"successful": True, "reason": ""}
    assert bench.haptic.is_cartesian_force_mode_enabled()
    got = bench.call("get_parameters", "rcl_interfaces/srv/GetParameters", names=["mode_feedback"])
    assert got["values"][0]["string_value"] == "cartesian"
    events = bench.node.publishers["/parameter_events"].messages
    values = [
        each["value"]["string_value"]
        for event in events
        for each in (*event["new_parameters"], *event["changed_parameters"])
        if each["name"] == "mode_feedback"
    ]
    assert values == ["cartesian", "joint", "cartesian"]


def set_parameter(bench, value, name="mode_feedback"):
    parameters = [{"name": name, "value": {"type": 4, "string_value": value}}]
    asked = "rcl_interfaces/srv/SetParameters"
    return bench.call("set_parameters", asked, parameters=parameters)["results"][0]


def test_modes_that_are_none_or_that_nobody_has_are_refused():
    bench = Bench()
    answer = bench.call("set_force_mode", SET_BOOL, data=False)
    assert not answer["success"]
    assert "FakeHaptic takes forces, no joint torques" in answer["message"]
    assert "torque" in set_parameter(bench, "joint")["reason"]
    assert "cartesian" in set_parameter(bench, "polar")["reason"]
    assert "there is no parameter" in set_parameter(bench, "joint", "mode")["reason"]
    bench.feedback.why_no_torques = "a session renders forces"
    assert (
        bench.call("set_force_mode", SET_BOOL, data=False)["message"] == "a session renders forces"
    )
    assert bench.haptic.is_cartesian_force_mode_enabled()


def test_feedback_is_stopped():
    bench = Bench()
    assert bench.call("stop_feedback", TRIGGER)["success"]
    assert bench.feedback.stops == 1
    bench.feedback.why_not = "it is not the network's"
    assert bench.call("stop_feedback", TRIGGER) == {
        "success": False,
        "message": "it is not the network's",
    }


def test_a_flood_of_requests_is_answered_one_at_a_time_and_none_is_starved():
    bench = Bench()
    flood = FakeUser(bench.node, "SC", "~/get_transform", f"{YARP}GetTransformation")
    for _ in range(100):
        flood.ask(completed(f"{YARP}GetTransformation_Request", {}))
    assert bench.call("stop_feedback", TRIGGER)["success"]
    assert len(bench.node.requests["~/get_transform"].waiting) > 90


def test_no_request_to_any_service_waits_for_ever():
    bench = Bench()
    asked = {name: FakeRequest(b"\0\1\0\0" + b"\xff" * 3, None) for name in bench.node.requests}
    for name, request in asked.items():
        bench.node.requests[name].waiting.append(request)
    bench.run(2 * len(asked) * LOOK_PERIOD_S)
    assert [name for name, request in asked.items() if not isinstance(request.answer, bytes)] == []
    assert bench.server.refused == len(asked) > 10
    stopped = codec_of(f"{TRIGGER}_Response").decode(asked["~/stop_feedback"].answer)
    assert not stopped["success"]
    assert "too many" in stopped["message"]


def test_a_device_that_is_only_shown_takes_nothing():
    bench = Bench(served=False)
    bench.run(0.1)
    assert bench.reported("state/pose")
    assert bench.node.queues == bench.node.requests == {}
    assert "~/result" not in bench.node.publishers
