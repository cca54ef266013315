"""A session on DDS through the server, each in a separate process, judged by a third-party
program."""

import json
import os
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
pytest.importorskip("cyclonedds", reason='cyclonedds is not installed: "cardan[dds]"')

from cardan.protocols.ros2.actions import GoalStatus
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan_dds.network import DdsNetwork
from tests.dds_network import SESSION_OPTIONS, TIMEOUT_S
from tests.ros2_packages import write_packages
from tests.serving import served, session_on_the_network
from tests.waiting import done_again, until

pytestmark = pytest.mark.matrix

ARM = "/left/arm"
DORA = Path(__file__).with_name("dora_dds.py")
MOVE, POSE = "cardan_msgs/action/MovePose", "geometry_msgs/msg/Pose"


@pytest.fixture(scope="module")
def domain(tmp_path_factory):
    """Run a session and the server for it; return the DDS domain."""
    number = str(SESSION_OPTIONS.dds_domain)
    with session_on_the_network(tmp_path_factory.mktemp("session")) as endpoint:
        server = ("net", "server", "dds", "--router", endpoint, "--dds-domain", number)
        with served(*server, "--services", "*") as ready:
            assert ready == f"dds/{number}"
            yield number


@contextmanager
def met():
    """Participant that has discovered the session's services."""
    with DdsNetwork(SESSION_OPTIONS, "user") as user:
        assert user.wait_for_service(f"{ARM}/set_parameters_atomically", TIMEOUT_S)
        assert user.wait_for_service(f"{ARM}/action/movl/_action/get_result", TIMEOUT_S)
        yield user


@pytest.fixture
def user(domain):
    with met() as user:
        yield user


def called(user, name, kind, **request):
    replies, there = [], threading.Event()
    user.call(
        f"{ARM}/{name}",
        kind,
        codec_of(f"{kind}_Request").encode(completed(f"{kind}_Request", request)),
        lambda reply: (replies.append(reply), there.set()),
        TIMEOUT_S,
    )
    assert there.wait(TIMEOUT_S)
    return codec_of(f"{kind}_Response").decode(replies[0])


def test_services_and_parameters(user):
    assert called(user, "stop", "std_srvs/srv/Trigger") == {"success": True, "message": ""}
    kinds = called(
        user, "get_parameter_types", "rcl_interfaces/srv/GetParameterTypes", names=["gain", "frame"]
    )
    assert kinds["types"] == bytes([3, 4])


def test_an_action_tells_where_the_arm_is_and_ends(user):
    feedback = []
    kind = f"{MOVE}_FeedbackMessage"
    handle = user.subscribe(
        f"{ARM}/action/movl/_action/feedback",
        kind,
        lambda cdr, _ns: feedback.append(codec_of(kind).decode(cdr)),
    )
    goals = []

    def moved():
        pose = called(user, "stat", "cardan_msgs/srv/Stat")["pose"]["pose"]
        pose["position"]["z"] -= 0.02
        goal = {"uuid": os.urandom(16)}
        sent = called(
            user,
            "action/movl/_action/send_goal",
            f"{MOVE}_SendGoal",
            goal_id=goal,
            goal={"x": pose},
        )
        assert sent["accepted"]
        goals.append(goal)
        return called(user, "action/movl/_action/get_result", f"{MOVE}_GetResult", goal_id=goal)

    ended = done_again(moved, lambda reported: reported["result"]["message"])
    assert ended["status"] == GoalStatus.SUCCEEDED, ended
    assert ended["result"]["success"]
    until(lambda: goals[-1] in [each["goal_id"] for each in feedback], "where it is")
    assert all(each["goal_id"] in goals for each in feedback)
    handle.close()


def test_the_description_is_there_for_who_comes_late(user):
    heard = []
    until(lambda: "/left/robot_description" in user.topics())
    handle = user.subscribe("/left/robot_description", None, lambda cdr, _ns: heard.append(cdr))
    assert b"<robot" in until(lambda: heard)[0]
    handle.close()


def test_a_node_of_dora_rs_watches_and_commands_the_arm(domain, tmp_path):
    """Only the server is on the domain: if RustDDS meets two participants at once, it may forget
    the writers of one (findings/rustdds_forgets_writers_when_another_participant_joins.sh)."""
    pytest.importorskip("dora", reason="dora-rs is not installed: pip install dora-rs pyarrow")
    write_packages(tmp_path)
    with met():
        pass  # The participant has left before the node starts.
    reported = json.loads(
        subprocess.run(
            [sys.executable, str(DORA), ARM],
            env={**os.environ, "AMENT_PREFIX_PATH": str(tmp_path), "ROS_DOMAIN_ID": domain},
            stdout=subprocess.PIPE, check=True, timeout=100.0,
        ).stdout
    )  # fmt: skip
    assert reported["pose"]["header"]["frame_id"] == "base_link"
    assert reported["accepted"]["outcome"] == "accepted"
    assert reported["arrived"] is not None
