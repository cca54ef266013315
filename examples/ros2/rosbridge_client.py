"""Jog an arm through rosbridge: roslibpy (pip install roslibpy), and `cardan net server
rosbridge`."""

from __future__ import annotations

import argparse
import threading
import time
from typing import Any

import roslibpy

STREAM_PERIOD_S = 0.02
"""The arm brakes if the stream is silent for 0.1 s (parameter stream_timeout)."""


def main() -> None:
    """Select the stream of twists, move the TCP back and forth, and stop."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="with ?t=TOKEN, if it has one")
    parser.add_argument("--arm", default="/cartesian_control_server_ros2", help="its node")
    parser.add_argument("--seconds", type=float, default=4.0)
    options = parser.parse_args()

    ros = roslibpy.Ros(options.url)
    ros.run(timeout=10)
    try:
        jog(ros, options.arm, options.seconds)
    finally:
        ros.terminate()


def jog(ros: roslibpy.Ros, arm: str, seconds: float) -> None:
    """Move the TCP back and forth along y."""
    places: list[dict[str, float]] = []
    seen = threading.Event()

    def show(message: dict[str, Any]) -> None:
        places.append(message["pose"]["position"])
        seen.set()

    def tell(result: dict[str, Any]) -> None:
        words = result["reason"] or "fine"
        print(f"result: {result['command']} of {result['source']} {result['outcome']}: {words}")

    roslibpy.Topic(ros, f"{arm}/state/pose", "geometry_msgs/PoseStamped").subscribe(show)
    roslibpy.Topic(ros, f"{arm}/result", "cardan_msgs/CommandResult").subscribe(tell)
    if not seen.wait(10.0):
        raise SystemExit(f"{arm} shows no pose: is its session on the network of the server?")

    chosen = roslibpy.Service(ros, f"{arm}/set_parameters", "rcl_interfaces/SetParameters").call(
        roslibpy.ServiceRequest(
            {
                "parameters": [
                    {
                        "name": "preset_streaming_cmd",
                        "value": {"type": 4, "string_value": "twist"},
                    }
                ]
            }
        ),
        timeout=10,
    )
    assert chosen is not None
    (answer,) = chosen["results"]
    if not answer["successful"]:
        raise SystemExit(f"no stream of twists: {answer['reason']}")

    command = roslibpy.Topic(ros, f"{arm}/command/twist", "geometry_msgs/Twist")
    command.advertise()
    began_s = time.monotonic()
    while (now_s := time.monotonic() - began_s) < seconds:
        speed_m_s = 0.05 if now_s < seconds / 2 else -0.05
        twist = {"linear": {"x": 0.0, "y": speed_m_s, "z": 0.0}}
        command.publish(roslibpy.Message(twist))
        time.sleep(STREAM_PERIOD_S)
    stopped = roslibpy.Service(ros, f"{arm}/stop", "std_srvs/Trigger").call(
        roslibpy.ServiceRequest(), timeout=10
    )
    assert stopped is not None
    # Release the authority, so that other clients need not wait for the end of its lease.
    roslibpy.Service(ros, f"{arm}/release", "std_srvs/Trigger").call(
        roslibpy.ServiceRequest(), timeout=10
    )
    way_m = max(each["y"] for each in places) - min(each["y"] for each in places)
    print(f"the TCP moved by {1e3 * way_m:.0f} mm and is stopped: {stopped['success']}")


if __name__ == "__main__":
    main()
