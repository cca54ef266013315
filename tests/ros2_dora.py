"""Node of dora-rs in its own process: `python -m tests.ros2_dora CONFIG ARM`.

Prints what it saw of the arm's topics, services, parameters and actions as one line of JSON.
Source: dora-rs 1.1, Ros2Context over Zenoh; AMENT_PREFIX_PATH leads to the interfaces.
"""

import json
import sys
import time
import warnings

warnings.filterwarnings("ignore", message="dora-rs ROS2 Bridge")

import dora  # noqa: E402
import pyarrow as pa  # noqa: E402

TIMEOUT_S = 120.0


class Reports(dict):
    """Results, each also printed to stderr at once, which shows the missing ones."""

    def __setitem__(self, name, value):
        super().__setitem__(name, value)
        print(f"{name}: {value}", file=sys.stderr, flush=True)


def main(config, arm):
    transport = dora.Ros2Transport.zenoh("rep2016", config)
    context = dora.Ros2Context(transport=transport, domain_id=0)
    node = context.new_node("dora", "/", dora.Ros2NodeOptions(rosout=False))
    qos = dora.Ros2QosPolicies(reliable=True, keep_last=10)
    # dora finds only servers with its own history depth; ROS 2's parameters have 1000.
    parameters = dora.Ros2QosPolicies(reliable=True, keep_last=1000)

    def topic(name, kind):
        return node.create_topic(f"{arm}/{name}", kind, qos)

    def call(name, kind, request, depth=qos):
        client = node.create_service_client(f"{arm}/{name}", kind, depth)
        return client.call(pa.array([request]), TIMEOUT_S).to_pylist()[0]

    def heard(subscription, wanted=lambda _message: True):
        end_s = time.monotonic() + TIMEOUT_S
        while time.monotonic() < end_s:
            found = subscription.next()
            if found is not None and wanted(message := found.to_pylist()[0]):
                return message
        return None

    reported = Reports()
    poses = node.create_subscription(topic("state/pose", "geometry_msgs/PoseStamped"), qos)
    results = node.create_subscription(topic("result", "cardan_msgs/CommandResult"), qos)
    commands = node.create_publisher(topic("command/movl", "geometry_msgs/Pose"), qos)
    reported["stop"] = call("stop", "std_srvs/Trigger", {})
    reported["pose"] = heard(poses)
    pose = call("stat", "cardan_msgs/Stat", {})["pose"]["pose"]
    pose["position"]["z"] -= 0.02
    commands.publish(pa.array([pose]))
    reported["accepted"] = heard(results, lambda each: each["command"] == "movl")
    reported["wait"] = call("wait", "cardan_msgs/Wait", {"timeout": TIMEOUT_S})
    reported["types"] = call(
        "get_parameter_types", "rcl_interfaces/GetParameterTypes", {"names": ["gain", "frame"]},
        parameters,
    )["types"]  # fmt: skip
    action = node.create_action_client(f"{arm}/action/movl", "cardan_msgs/MovePose", qos)
    pose["position"]["z"] += 0.02
    goal = action.send_goal(pa.array([{"x": pose}]), TIMEOUT_S)
    reported["feedback"] = action.take_feedback(goal, TIMEOUT_S).to_pylist()[0]
    status, result = action.take_result(goal, TIMEOUT_S)
    reported["result"] = [status, result.to_pylist()[0]]
    print(json.dumps(reported), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
