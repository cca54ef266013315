"""A goal followed at once by its cancellation, and a client that leaves right after its goal, with
a session in a separate process: over Zenoh, DDS and rosbridge."""

from __future__ import annotations

import json
import os
import queue
import time

import pytest

pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
pytest.importorskip("cbor2", reason='cbor2 is not installed: "cardan[network]"')

from websockets.sync.client import connect

from cardan.bus.network import Failure
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.protocols.ros2.actions import CANCEL_TYPE, GoalStatus
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from tests.serving import served, session_on_the_network
from tests.waiting import until

pytestmark = pytest.mark.matrix

ARM = "/left/arm"
TIMEOUT_S = 30.0
GOALS = {
    "movl": ("cardan_msgs/action/MovePose", lambda pose: {"x": pose}),
    "movv": (
        "cardan_msgs/action/MoveTwist",
        lambda _pose: {"xdot": {"linear": {"x": 0.0, "y": 0.0, "z": -0.05}}},
    ),
}
WATCHED_S = 1.0
"""Time for which an arm with a canceled goal must stay in place."""


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory):
    """Options of a session's network."""
    with session_on_the_network(tmp_path_factory.mktemp("session")) as endpoint:
        yield endpoint


def ask(network, name, kind, **request):
    """Call a service of the arm without waiting; return the queue that gets the response."""
    answers = queue.Queue()
    whole = completed(f"{kind}_Request", request)
    data = codec_of(f"{kind}_Request").encode(whole)
    network.call(f"{ARM}/{name}", kind, data, answers.put, TIMEOUT_S)
    return answers


def answer(answers, kind):
    reply = answers.get(timeout=TIMEOUT_S)
    assert not isinstance(reply, Failure), reply
    return codec_of(f"{kind}_Response").decode(reply)


@pytest.fixture(scope="module")
def watcher(endpoint):
    """A node that watches the arm."""
    with BusNetwork(BusOptions(router=endpoint, listen=()), "watcher") as network:
        assert network.wait_for_service(f"{ARM}/set_parameters_atomically", TIMEOUT_S)
        until(lambda: where(network))
        yield network


def where(network):
    kind = "cardan_msgs/srv/Stat"
    reply = ask(network, "stat", kind).get(timeout=TIMEOUT_S)
    found = None if isinstance(reply, Failure) else codec_of(f"{kind}_Response").decode(reply)
    return found and found["success"] and found["pose"]["pose"]


def goal_of(verb, watcher):
    """Type of a goal that would move the arm down, and the goal."""
    type_name, goal = GOALS[verb]
    pose = where(watcher)
    pose["position"]["z"] -= 0.1
    return type_name, goal(pose)


def assert_stays(watcher, z):
    """Check that the arm is at its old place and stays there."""
    end_s = time.monotonic() + WATCHED_S
    while time.monotonic() < end_s:
        assert where(watcher)["position"]["z"] == pytest.approx(z, abs=2e-3)
        time.sleep(0.05)


def canceled_at_once(network, watcher, verb):
    """Send a goal and its cancellation by separate calls, without waiting in between."""
    z = where(watcher)["position"]["z"]
    type_name, goal = goal_of(verb, watcher)
    base = f"action/{verb}/_action"
    goal_id = {"uuid": os.urandom(16)}
    sent = ask(network, f"{base}/send_goal", f"{type_name}_SendGoal", goal_id=goal_id, goal=goal)
    ended = ask(network, f"{base}/cancel_goal", CANCEL_TYPE, goal_info={"goal_id": goal_id})
    assert answer(sent, f"{type_name}_SendGoal")["accepted"]
    code = answer(ended, CANCEL_TYPE)["return_code"]
    reported = ask(network, f"{base}/get_result", f"{type_name}_GetResult", goal_id=goal_id)
    assert answer(reported, f"{type_name}_GetResult")["status"] == GoalStatus.CANCELED
    assert_stays(watcher, z)
    return code


@pytest.mark.parametrize("verb", GOALS)
def test_by_zenoh(endpoint, watcher, verb):
    with BusNetwork(BusOptions(router=endpoint, listen=()), "user") as user:
        assert user.wait_for_service(f"{ARM}/action/{verb}/_action/get_result", TIMEOUT_S)
        for _ in range(3):
            # A single connection keeps the order: the goal arrives before its cancellation.
            assert canceled_at_once(user, watcher, verb) == 0


def test_by_dds(endpoint, watcher):
    pytest.importorskip("cyclonedds", reason='cyclonedds is not installed: "cardan[dds]"')
    from tests.dds_network import OPTIONS, network

    number = str(OPTIONS.dds_domain)
    with (
        served(
            "net", "server", "dds", "--router", endpoint, "--dds-domain", number, "--services", "*"
        ),
        network("user") as user,
    ):
        assert user.wait_for_service(f"{ARM}/set_parameters_atomically", TIMEOUT_S)
        for verb in GOALS:
            assert user.wait_for_service(f"{ARM}/action/{verb}/_action/get_result", TIMEOUT_S)
            for _ in range(3):
                # Two services of DDS have no common order: either code may come.
                assert canceled_at_once(user, watcher, verb) in (0, 2)


@pytest.fixture(scope="module")
def rosbridge(endpoint, watcher):
    with served("net", "server", "rosbridge", "--router", endpoint, "--port", "0") as url:
        yield url


def send(client, verb, watcher):
    type_name, goal = goal_of(verb, watcher)
    given = {"action": f"{ARM}/action/{verb}", "action_type": type_name, "args": goal}
    client.send(json.dumps({"op": "send_action_goal", "id": "g", **given}))


def meet(client):
    """Wait until the server has discovered the arm's actions."""

    def known():
        client.send(json.dumps({"op": "call_service", "service": "/rosapi/action_servers"}))
        return f"{ARM}/action/movv" in str(client.recv(timeout=TIMEOUT_S))

    until(known)


@pytest.mark.parametrize("verb", GOALS)
def test_by_rosbridge(rosbridge, watcher, verb):
    with connect(rosbridge) as client:
        meet(client)
        for _ in range(3):
            z = where(watcher)["position"]["z"]
            send(client, verb, watcher)
            cancel = {"op": "cancel_action_goal", "id": "g", "action": f"{ARM}/action/{verb}"}
            client.send(json.dumps(cancel))
            reported = json.loads(client.recv(timeout=TIMEOUT_S))
            assert (reported["op"], reported["status"]) == ("action_result", GoalStatus.CANCELED)
            assert_stays(watcher, z)


@pytest.mark.parametrize("verb", GOALS)
def test_a_client_of_rosbridge_that_closes_right_after_its_goal(rosbridge, watcher, verb):
    for _ in range(3):
        z = where(watcher)["position"]["z"]
        with connect(rosbridge) as client:
            meet(client)
            send(client, verb, watcher)
        # Its node leaves the network too, and afterwards none of its goals continues.
        until(lambda: not any("rosbridge_client" in node for node in watcher.nodes()))
        assert where(watcher)["position"]["z"] == pytest.approx(z, abs=5e-3)
        assert_stays(watcher, where(watcher)["position"]["z"])
