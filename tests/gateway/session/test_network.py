"""A session in a separate process, moved over the network by ROS 2 interfaces."""

import itertools
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

zenoh = pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')

from cardan.bus.node import BusNode  # noqa: E402
from cardan.bus.options import BusOptions  # noqa: E402
from cardan.bus.zenoh_network import BusNetwork  # noqa: E402
from cardan.gateway.arm.vocab import State  # noqa: E402
from cardan.protocols.ros2.actions import GoalStatus  # noqa: E402
from cardan.protocols.ros2.cdr import codec_of  # noqa: E402
from cardan.protocols.ros2.messages import completed  # noqa: E402
from cardan.protocols.ros2.zenoh import LATCHED_QOS, Attachment  # noqa: E402
from cardan.robots import load_arm  # noqa: E402
from tests.ros2_packages import write_packages  # noqa: E402
from tests.serving import ARM_SESSION, session_on_the_network  # noqa: E402
from tests.sweep.world import stamp_s  # noqa: E402
from tests.waiting import WITHIN_S, done_again, until, until_streamed  # noqa: E402

pytestmark = pytest.mark.matrix

ARM = "/left/arm"
SESSION = f'{ARM_SESSION}other_names = ["servo", "crtk", "fzi", "cmd_vel"]\n'
TIMEOUT_S = WITHIN_S
POSE = "geometry_msgs/msg/Pose"
TWIST = "geometry_msgs/msg/Twist"
RESULT = "cardan_msgs/msg/CommandResult"
MOVE = "cardan_msgs/action/MovePose"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
FOLLOW_NAME = "/left/joint_trajectory_controller/follow_joint_trajectory"


class User:
    """A node that uses the session."""

    def __init__(self, endpoint):
        options = BusOptions(router=endpoint, listen=())
        self.network = BusNetwork(options, "watcher")
        self.node = BusNode(options, "user")
        self._publishers, self._subscriptions, self._results = {}, {}, []
        self._goals = itertools.count(1)

    def open(self):
        self.network.open()
        self.node.open()
        last = "set_parameters_atomically"
        assert self.network.wait_for_service(f"{ARM}/{last}", TIMEOUT_S)
        assert self.network.wait_for_service(f"{FOLLOW_NAME}/_action/get_result", TIMEOUT_S)
        for topic, name in (("result", RESULT), ("state/status", "cardan_msgs/msg/ArmStatus")):
            self.subscribe(f"{ARM}/{topic}", name)
        until(lambda: self.heard(f"{ARM}/state/status"), "the status")

    def close(self):
        self.node.close()
        self.network.close()

    # -- topics ----------------------------------------------------------------------------------

    def subscribe(self, topic, type_name, depth=200, qos=None):
        more = () if qos is None else (qos,)
        retained = self.node.subscription(topic, type_name, depth, *more)
        self._subscriptions[topic] = retained, type_name
        return retained

    def heard(self, topic):
        """All messages since the last call."""
        retained, type_name = self._subscriptions[topic]
        return [codec_of(type_name).decode(each.data) for each in iter(retained.poll, None)]

    def publish(self, topic, type_name, given=None, data=None):
        """Publish once the session has subscribed; return the sequence number."""
        key = topic, type_name
        if key not in self._publishers:
            name = topic if topic.startswith("/left") else f"{ARM}{topic}"
            self._publishers[key] = self.node.publisher(name, type_name)
        if data is None:
            data = codec_of(type_name).encode(completed(type_name, given or {}))
        publisher = self._publishers[key]
        publisher.put(data, time.time_ns())
        return publisher._sequence

    def outcome(self, command, number, *outcomes):
        """The first of these outcomes of a command, and its reason."""

        def find():
            self._results += self.heard(f"{ARM}/result")
            for each in self._results:
                named = (each["command"], each["sequence"]) == (command, number)
                if named and each["outcome"] in outcomes:
                    return each
            return None

        found = until(find, f"{' or '.join(outcomes)} of {command}")
        return found["outcome"], found["reason"]

    # -- services --------------------------------------------------------------------------------

    def call(self, service, type_name, timeout_s=TIMEOUT_S, data=None, **given):
        name = service if service.startswith("/left") else f"{ARM}/{service}"
        client = self.node.client(name, type_name)
        if data is None:
            data = codec_of(f"{type_name}_Request").encode(completed(f"{type_name}_Request", given))
        reply = client.call(data, timeout_s)
        client.close()
        return None if reply is None else codec_of(f"{type_name}_Response").decode(reply)

    def where(self):
        return self.call("stat", "cardan_msgs/srv/Stat")["pose"]["pose"]

    def moved(self, z):
        pose = self.where()
        pose["position"]["z"] += z
        return pose

    def until_at(self, pose):
        """Wait until the arm's measured pose is there: the command is there earlier."""
        z = pose["position"]["z"]
        until(lambda: abs(self.where()["position"]["z"] - z) < 1e-3, "the arrival")

    def settled(self):
        """Pose of the arm once it is measured at rest."""
        last = {}

        def still():
            now = self.where()
            before, last["pose"] = last.get("pose"), now
            return before == now and now

        return until(still, "the rest")

    def state(self):
        return self.call("stat", "cardan_msgs/srv/Stat")["state"]

    def set(self, name, value):
        value = (
            {"type": 4, "string_value": value}
            if isinstance(value, str)
            else {"type": 3, "double_value": value}
        )
        parameters = [{"name": name, "value": value}]
        answer = self.call(
            "set_parameters", "rcl_interfaces/srv/SetParameters", parameters=parameters
        )
        return answer["results"][0]

    # -- actions ---------------------------------------------------------------------------------

    def send(self, action, type_name, goal):
        goal_id = os.urandom(16)
        answer = self.call(
            f"{action}/_action/send_goal", f"{type_name}_SendGoal",
            goal_id={"uuid": goal_id}, goal=goal,
        )  # fmt: skip
        assert answer["accepted"]
        return goal_id

    def result(self, action, type_name, goal_id):
        answer = self.call(
            f"{action}/_action/get_result", f"{type_name}_GetResult", goal_id={"uuid": goal_id}
        )
        return GoalStatus(answer["status"]), answer["result"]

    def wait_for_authority(self):
        """Wait until no other source has the arm: a source that left keeps it until its lease
        ends."""
        self.wait_for_status("the end of the lease", authority=("", "ros2 /user"))

    def rest(self):
        """Stop the motion, and wait until the arm is at rest."""
        assert self.call("stop", "std_srvs/srv/Trigger")["success"]
        self.wait_for_status("the rest", phase=("disarmed", "holding"))

    def wait_for_status(self, what, **values):
        """Wait until a new status of the arm has one of the values of a field."""
        ((field, allowed),) = values.items()
        topic = f"{ARM}/state/status"
        self.heard(topic)
        until(lambda: any(each[field] in allowed for each in self.heard(topic)), what)


@pytest.fixture(scope="module")
def user(tmp_path_factory):
    with session_on_the_network(tmp_path_factory.mktemp("network"), SESSION) as endpoint:
        found = User(endpoint)
        try:
            found.open()
            yield found
        finally:
            found.close()


@pytest.fixture(autouse=True)
def quick_and_at_rest(user):
    """Each test begins at rest, with parameters for fast motion."""
    user.rest()
    user.wait_for_authority()
    assert user.set("preset_streaming_cmd", "none")["successful"]
    for name, value in (
        ("trajectory_reference_speed", 0.2),
        ("trajectory_reference_acceleration", 1.0),
        ("frame", "base"),
    ):
        reported = user.set(name, value)
        assert reported["successful"], reported["reason"]
    user.heard(f"{ARM}/result")
    user._results.clear()  # The publishers of each type number their messages from 1.
    yield
    user.rest()


def test_the_arm_is_on_the_graph(user):
    topics, services = user.network.topics(), user.network.services()
    assert topics[f"{ARM}/state/pose"].type == "geometry_msgs/msg/PoseStamped"
    assert topics["/left/joint_states"].publishers == (ARM,)
    assert topics["/left/robot_description"].latched
    assert topics["/tf"].type == "tf2_msgs/msg/TFMessage"
    assert services[f"{ARM}/inv"].type == "rl_cartesian_control_msgs/srv/Inv"
    assert services[f"{FOLLOW_NAME}/_action/send_goal"].type == f"{FOLLOW}_SendGoal"
    description = user.subscribe("/left/robot_description", "std_msgs/msg/String", 1, LATCHED_QOS)
    urdf = until(description.poll, "the description")
    assert "<robot" in codec_of("std_msgs/msg/String").decode(urdf.data)["data"]


@pytest.mark.real
def test_a_topic_moves_the_arm_and_its_result_tells(user):
    def reported():
        user.rest()
        target = user.moved(-0.04)
        number = user.publish("/command/movl", POSE, target)
        begun = user.outcome("movl", number, "accepted", "refused")
        ended = user.outcome("movl", number, "done", "aborted", "refused")
        return begun, ended, target

    begun, ended, target = done_again(reported)
    assert begun == ("accepted", "")
    assert ended == ("done", "")
    user.until_at(target)


@pytest.mark.parametrize("topic", ["servo_node/delta_twist_cmds", "servo_cv", "cmd_vel"])
def test_a_stream_under_another_programs_name_moves_the_arm_and_ends(user, topic):
    pose = user.subscribe("/left/measured_cp", "geometry_msgs/msg/PoseStamped", 1)
    status = user.subscribe("/left/servo_node/status", "moveit_msgs/msg/ServoStatus", 1)
    operating = user.subscribe("/left/operating_state", "crtk_msgs/msg/OperatingState", 1)
    before = user.where()["position"]["z"]
    message = {"header": {"frame_id": "base_link"}, "twist": {"linear": {"z": 0.1}}}

    def moved():
        user.publish(f"/left/{topic}", "geometry_msgs/msg/TwistStamped", message)
        sample = pose.poll()
        if sample is None:
            return False
        reported = codec_of("geometry_msgs/msg/PoseStamped").decode(sample.data)
        return reported["pose"]["position"]["z"] > before + 0.005

    until(moved, "the motion")
    reported = codec_of("moveit_msgs/msg/ServoStatus").decode(until(status.poll, "the status").data)
    assert reported["code"] >= 0
    state = codec_of("crtk_msgs/msg/OperatingState")
    assert state.decode(until(operating.poll, "the state").data)["state"] == "ENABLED"
    user.settled()
    for each in (pose, status, operating):
        each.close()


def test_a_service_moves_the_arm_and_wait_says_when_it_arrived(user):
    target = user.moved(0.04)
    assert user.call("movl", "cardan_msgs/srv/MovePose", x=target)["success"]
    assert user.call("wait", "cardan_msgs/srv/Wait", timeout=20.0)["success"]
    user.until_at(target)


@pytest.mark.real
def test_an_action_moves_the_arm_with_feedback_and_can_be_canceled(user):
    action = f"{ARM}/action/movl"
    feedback = user.subscribe(f"{action}/_action/feedback", f"{MOVE}_FeedbackMessage")
    sent = []

    def moved():
        user.rest()
        sent.append(user.send(action, MOVE, {"x": user.moved(-0.04)}))
        return user.result(action, MOVE, sent[-1])

    assert done_again(moved) == (GoalStatus.SUCCEEDED, {"success": True, "message": ""})
    reported = [bytes(each["goal_id"]["uuid"]) for each in user.heard(f"{action}/_action/feedback")]
    assert sent[-1] in reported
    assert {*reported} <= {*sent}
    feedback.close()

    def canceled():
        user.rest()
        # The motion takes 20 s, so that it is active when it is canceled, even on a slow computer.
        assert user.set("trajectory_reference_speed", 0.01)["successful"]
        goal_id = user.send(action, MOVE, {"x": user.moved(0.2)})
        with ThreadPoolExecutor(1) as waiting:
            result = waiting.submit(user.result, action, MOVE, goal_id)
            until(lambda: user.state() == int(State.MOVL) or result.done(), "the motion")
            info = {"goal_id": {"uuid": goal_id}}
            answer = user.call(
                f"{action}/_action/cancel_goal", "action_msgs/srv/CancelGoal", goal_info=info
            )
            return answer, *result.result()

    answer, status, result = done_again(canceled)
    assert len(answer["goals_canceling"]) == 1, (answer, status, result)
    assert status is GoalStatus.CANCELED
    goal_id = user.send(action, MOVE, {"x": {"position": {"x": 9}}})
    status, reported = user.result(action, MOVE, goal_id)
    assert status is GoalStatus.ABORTED
    assert "movl" in reported["message"]


def test_a_goal_of_the_released_type_is_answered(user):
    """Uses the type hash of ROS 2 clients, which is not computed here."""
    node = user.network.node
    mark = "RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f"
    key = (
        f"{node.options.domain}{FOLLOW_NAME}/_action/send_goal/"
        f"control_msgs::action::dds_::FollowJointTrajectory_SendGoal_/{mark}"
    )
    name = f"{FOLLOW}_SendGoal_Request"
    goal = completed(name, {"goal_id": {"uuid": list(range(16))}})
    attachment = Attachment(1, time.time_ns(), bytes(range(16))).encode()
    answer = node.get(key, codec_of(name).encode(goal), attachment, 5.0)
    assert answer is not None
    assert codec_of(f"{FOLLOW}_SendGoal_Response").decode(answer)["accepted"]


def test_a_plan_of_moveit_is_carried_out(user):
    joints = user.subscribe("/left/joint_states", "sensor_msgs/msg/JointState", 1)
    state = codec_of("sensor_msgs/msg/JointState").decode(until(joints.poll, "the joints").data)
    begin = state["position"]
    goal = begin[0] + 0.15
    points = [
        {
            "positions": [begin[0] + share * 0.15, *begin[1:]],
            "velocities": [0.0] * 6 if share in (0.0, 1.0) else [0.2] + [0.0] * 5,
            "time_from_start": {"sec": int(2 * share // 1), "nanosec": int(2 * share % 1 * 1e9)},
        }
        for share in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    tolerance = [{"name": name, "position": 0.05} for name in state["name"]]
    given = {
        "trajectory": {"joint_names": state["name"], "points": points},
        "path_tolerance": tolerance,
        "goal_tolerance": tolerance,
        "goal_time_tolerance": {"sec": 1},
    }
    goal_id = user.send(FOLLOW_NAME, FOLLOW, given)
    status, reported = user.result(FOLLOW_NAME, FOLLOW, goal_id)
    assert (status, reported["error_code"], reported["error_string"]) == (
        GoalStatus.SUCCEEDED,
        0,
        "",
    )

    def arrived():
        found = joints.poll()
        if found is None:
            return False
        now = codec_of("sensor_msgs/msg/JointState").decode(found.data)["position"][0]
        return abs(now - goal) < 2e-3

    until(arrived, "the goal")
    joints.close()


def test_joint_states_with_speeds_are_a_stream_of_them(user):
    """Messages as from JointStateTopicSystem of ros2_control, with names in any order."""
    joint_state = "sensor_msgs/msg/JointState"
    names = [*load_arm("ur5").joint_names[1:], load_arm("ur5").joint_names[0]]
    message = {"name": names, "velocity": [0.0, 0.0, 0.0, 0.0, 0.0, 0.2]}
    user.subscribe("/left/joint_states", joint_state, 1)

    def pan():
        """Position of the first joint."""
        found = until(lambda: user.heard("/left/joint_states"), "a joint state")[-1]
        return found["position"][found["name"].index(names[-1])]

    begun = pan()

    def turned():
        user.publish("/command/joints", joint_state, message)
        return pan() > begun + 0.1

    until(turned, "the turn")
    last = {}

    def rests():  # The stream has ended.
        before, last["at"] = last.get("at"), pan()
        return before == last["at"]

    until(rests, "the rest")
    number = user.publish("/command/joints", joint_state, message | {"name": names[1:]})
    assert "6 numbers of velocity for 5 names" in user.outcome("joints", number, "refused")[1]


def test_a_node_of_dora_rs_watches_and_commands_the_arm(user, tmp_path):
    pytest.importorskip("dora", reason="dora-rs is not installed: pip install dora-rs pyarrow")
    write_packages(tmp_path)
    config = tmp_path / "zenoh.json5"
    config.write_text(
        f'{{mode: "peer", connect: {{endpoints: ["{user.node.options.router}"]}}, '
        "listen: {endpoints: []}, scouting: {multicast: {enabled: false}}}"
    )
    reported = json.loads(
        subprocess.run(
            [sys.executable, "-m", "tests.ros2_dora", str(config), ARM],
            env={**os.environ, "AMENT_PREFIX_PATH": str(tmp_path)},
            stdout=subprocess.PIPE, check=True, timeout=100.0,
        ).stdout
    )  # fmt: skip
    assert reported["stop"] == {"success": True, "message": ""}
    assert reported["pose"]["header"]["frame_id"] == "base_link"
    assert reported["accepted"]["outcome"] == "accepted"
    assert reported["wait"]["success"]
    assert reported["types"] == [3, 4]
    assert reported["feedback"]["pose"]["header"]["frame_id"] == "base_link"
    assert reported["result"][1] == {"success": True, "message": ""}


# -- a publisher that is killed -------------------------------------------------------------------


STATUS = f"{ARM}/state/status"
STATUS_HZ = 50
RESTS = "disarmed", "holding"


def streamed_and_killed(user):
    """Let another node stream twists, kill it while the arm moves, and return the time of the
    kill."""
    assert user.set("preset_streaming_cmd", "twist")["successful"]
    script = f"""
import select, sys, time
from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
down, zero = (
    codec_of("{TWIST}").encode(completed("{TWIST}", {{"linear": {{"z": z}}}})) for z in (-0.03, 0.0)
)
with BusNode(BusOptions(router="{user.node.options.router}", listen=()), "streamer") as node:
    publisher = node.publisher("{ARM}/command/twist", "{TWIST}")
    while True:
        asked, _, _ = select.select([sys.stdin.buffer.raw], (), (), 0.02)
        publisher.put(zero if asked and sys.stdin.buffer.raw.read(1) else down, time.time_ns())
"""
    user.heard(f"{ARM}/result")
    outcomes = []

    def of_twists():
        reported = user.heard(f"{ARM}/result")
        outcomes.extend(each["outcome"] for each in reported if each["command"] == "twist")
        return outcomes

    with subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE) as streamer:
        try:
            until_streamed(
                lambda: any(s["moving"] for s in user.heard(STATUS)),
                of_twists,
                lambda: os.write(streamer.stdin.fileno(), b"0"),
                "the motion",
            )
        finally:
            streamer.kill()
    return time.time()


@pytest.mark.real
def test_a_publisher_that_dies_in_midst_of_a_stream_brakes_the_arm(user):
    killed_s = streamed_and_killed(user)
    phases = []

    def rested():
        phases.extend(each["phase"] for each in user.heard(STATUS) if stamp_s(each) > killed_s)
        return any(each in RESTS for each in phases)

    until(rested, "the rest")
    # 0.1 s of silence and a short ramp, measured by the number of status messages.
    assert [each in RESTS for each in phases].index(True) < 1.0 * STATUS_HZ


def test_the_stream_of_one_that_died_is_its_own_while_it_may_be_fresh(user):
    """In the test matrix only: it fails on a computer so slow that commands are never fresh."""
    streamed_and_killed(user)
    until(lambda: any(s["phase"] in RESTS for s in user.heard(STATUS)), "the rest")
    where = user.settled()["position"]["z"]
    sent = set()

    def refused():
        """True if the arm reports the refusal."""
        sent.add(user.publish("/command/twist", TWIST, {"linear": {"z": -0.03}}))
        reported = [each for each in user.heard(f"{ARM}/result") if each["sequence"] in sent]
        return any("has authority over the arm" in each["reason"] for each in reported)

    until(refused, "the refusal")
    assert user.where()["position"]["z"] == pytest.approx(where, abs=1e-4)
