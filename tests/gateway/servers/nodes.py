"""Nodes on a network within the test: an action server, and a node with parameters."""

from __future__ import annotations

import threading

from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from tests.gateway.servers.memory_network import TEST_NODE

MOVE = "control_msgs/action/FollowJointTrajectory"


class Mover:
    """An action server on the network."""

    def __init__(self, network, accepts=True, feedback=f"{MOVE}_FeedbackMessage"):
        self.network, self.accepts, self.feedback = network, accepts, feedback
        self.goals, self.canceled = [], []
        self.asked_result = threading.Event()
        network.offer("/move/_action/send_goal", f"{MOVE}_SendGoal", self.take)
        network.serve("/move/_action/get_result", f"{MOVE}_GetResult", self.result, TEST_NODE)
        network.offer("/move/_action/cancel_goal", "action_msgs/srv/CancelGoal", self.cancel)
        network.known["/move/_action/feedback"] = feedback

    def take(self, request):
        self.goals.append(request)
        return {"accepted": self.accepts}

    def result(self, request, answered):
        self.answered = answered
        self.asked_result.set()

    def cancel(self, request):
        self.canceled.append(request["goal_info"]["goal_id"]["uuid"])
        return {}

    def feed_back(self, uuid, **further):
        feedback = {"joint_names": ["a"], **further}
        goal = {"uuid": uuid}
        self.network.publish(
            "/move/_action/feedback", self.feedback, goal_id=goal, feedback=feedback
        )

    def end(self, status, **result):
        kind = f"{MOVE}_GetResult_Response"
        data = codec_of(kind).encode(completed(kind, {"status": status, "result": result}))
        self.answered(data)


class Parameters:
    """A node's parameters on the network."""

    def __init__(self, network, **values):
        self.values = {
            name: completed("rcl_interfaces/msg/ParameterValue", value)
            for name, value in values.items()
        }
        for name, kind, answer in (
            ("get_parameters", "GetParameters", self.get),
            ("set_parameters", "SetParameters", self.set),
            ("list_parameters", "ListParameters", self.list),
        ):
            network.offer(f"{TEST_NODE}/{name}", f"rcl_interfaces/srv/{kind}", answer)

    def get(self, request):
        return {"values": [self.values.get(name, {}) for name in request["names"]]}

    def set(self, request):
        (parameter,) = request["parameters"]
        if parameter["name"] == "fixed":
            return {"results": [{"successful": False, "reason": "it is fixed"}]}
        self.values[parameter["name"]] = parameter["value"]
        return {"results": [{"successful": True}]}

    def list(self, request):
        return {"result": {"names": list(self.values)}}
