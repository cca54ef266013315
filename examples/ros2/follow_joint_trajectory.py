"""Make an arm follow a joint trajectory, like MoveIt, but through rosbridge: roslibpy (pip install
roslibpy), and `cardan net server rosbridge`."""

from __future__ import annotations

import argparse
import threading
from typing import Any

import roslibpy


def main() -> None:
    """Move the last joint by 0.3 rad within 3 s, and back."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090")
    parser.add_argument("--action", default="/joint_trajectory_controller/follow_joint_trajectory")
    options = parser.parse_args()

    ros = roslibpy.Ros(options.url)
    ros.run(timeout=10)
    try:
        state = newest(ros, "/joint_states", "sensor_msgs/JointState")
        names, here = state["name"], state["position"]
        there = [*here[:-1], here[-1] + 0.3]
        follow(ros, options.action, names, [(0.0, here), (3.0, there), (6.0, here)])
    finally:
        ros.terminate()


def newest(ros: roslibpy.Ros, topic: str, kind: str) -> dict[str, Any]:
    """Return the next message of a topic."""
    found: list[dict[str, Any]] = []
    there = threading.Event()

    def take(message: dict[str, Any]) -> None:
        found.append(message)
        there.set()

    heard = roslibpy.Topic(ros, topic, kind)
    heard.subscribe(take)
    if not there.wait(10.0):
        raise SystemExit(f"nothing on {topic}: is a session on the network of the server?")
    heard.unsubscribe()
    return found[0]


def follow(
    ros: roslibpy.Ros, action: str, names: list[str], way: list[tuple[float, list[float]]]
) -> None:
    """Send the trajectory and wait for its end. `way`: times (s) and joint positions (rad)."""
    points = [
        {
            "positions": positions,
            "velocities": [0.0] * len(names),
            "time_from_start": {"sec": int(time_s), "nanosec": int(1e9 * (time_s % 1.0))},
        }
        for time_s, positions in way
    ]
    goal = roslibpy.Goal({"trajectory": {"joint_names": names, "points": points}})
    farthest, ended = [0.0], threading.Event()

    def feel(feedback: dict[str, Any]) -> None:
        errors = feedback["error"]["positions"]
        farthest[0] = max(farthest[0], *map(abs, errors))

    def end(result: dict[str, Any]) -> None:
        values = result["values"]
        print(f"error code {values['error_code']} {values['error_string']}".rstrip())
        ended.set()

    def fail(words: Any) -> None:
        print(f"failed: {words}")
        ended.set()

    client = roslibpy.ActionClient(ros, action, "control_msgs/FollowJointTrajectory")
    client.send_goal(goal, end, feel, fail)
    if not ended.wait(way[-1][0] + 10.0):
        raise SystemExit("it did not finish")
    print(f"at most {farthest[0]:.4f} rad from the plan")


if __name__ == "__main__":
    main()
