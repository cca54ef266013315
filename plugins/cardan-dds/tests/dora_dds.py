"""A node of dora-rs over DDS, with RustDDS: `python dora_dds.py ARM`, in a separate process.

Prints what it saw of the arm's topics as one line of JSON. Services are left out: over DDS dora-rs
reads what is in them from the wrong byte. Source: dora-rs 1.1, Ros2Context; AMENT_PREFIX_PATH leads
to the interfaces, ROS_DOMAIN_ID is the domain.
"""

import json
import os
import sys
import time
import warnings

warnings.filterwarnings("ignore", message="dora-rs ROS2 Bridge")

import dora  # noqa: E402
import pyarrow as pa  # noqa: E402

TIMEOUT_S = 30.0
PERIOD_S = 0.02
"""Polling period: dora-rs does not wait. Commands without a pause flood the server and starve it on
a busy computer."""


def main(arm):
    context = dora.Ros2Context(
        transport=dora.Ros2Transport.dds(), domain_id=int(os.environ["ROS_DOMAIN_ID"])
    )
    node = context.new_node("dora", "/", dora.Ros2NodeOptions(rosout=False))
    qos = dora.Ros2QosPolicies(reliable=True, keep_last=10)

    def topic(name, kind):
        return node.create_topic(f"{arm}/{name}", kind, qos)

    def heard(subscription, wanted=lambda _message: True, meanwhile=lambda: None):
        end_s = time.monotonic() + TIMEOUT_S
        while time.monotonic() < end_s:
            meanwhile()
            found = subscription.next()
            if found is not None and wanted(message := found.to_pylist()[0]):
                return message
            if found is None:
                time.sleep(PERIOD_S)
        return None

    reported = {}
    poses = node.create_subscription(topic("state/pose", "geometry_msgs/PoseStamped"), qos)
    results = node.create_subscription(topic("result", "cardan_msgs/CommandResult"), qos)
    commands = node.create_publisher(topic("command/movl", "geometry_msgs/Pose"), qos)
    reported["pose"] = heard(poses)
    pose = reported["pose"]["pose"]
    pose["position"]["z"] -= 0.02
    # dora-rs does not report matched peers: query until its own subscription is listed, too. While
    # the arm moves, further commands are refused.
    reported["accepted"] = heard(
        results,
        lambda each: (each["command"], each["outcome"]) == ("movl", "accepted"),
        lambda: commands.publish(pa.array([pose])),
    )
    reported["arrived"] = heard(
        poses, lambda each: abs(each["pose"]["position"]["z"] - pose["position"]["z"]) < 0.002
    )
    print(json.dumps(reported), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
