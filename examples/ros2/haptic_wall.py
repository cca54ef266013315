"""Virtual wall: read a haptic device's pose from the bus and publish the force.

python examples/ros2/haptic_wall.py [SECONDS [ROUTER]]

A ROS 2 node would subscribe to /omni/state/pose and publish on /omni/feedback.
"""

import sys
import time

from cardan.bus.node import BusNode
from cardan.bus.options import ROUTER, BusOptions
from cardan.protocols.ros2.cdr import codec_of

WALL_M = 0.0
"""Position of the wall along x, which is forward."""

STIFFNESS_N_M = 60.0
"""Limited because the force is computed over a network at 200 Hz; a session evaluates its fixtures
at 1000 Hz."""

POSE, VECTOR = "geometry_msgs/msg/Pose", "geometry_msgs/msg/Vector3"

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
router = sys.argv[2] if len(sys.argv) > 2 else ROUTER
poses, forces = codec_of(POSE), codec_of(VECTOR)
strongest = 0.0
with BusNode(BusOptions(router=router), "haptic_wall") as node:
    stylus = node.waiting_subscription("/omni/state/pose", POSE, 1)
    feedback = node.publisher("/omni/feedback", VECTOR)
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        received = stylus.wait(0.5)
        pose = None if received is None else poses.decode(received.data)
        if not isinstance(pose, dict):
            print("no pose from /omni/state/pose")
            continue
        depth_m = max(0.0, pose["position"]["x"] - WALL_M)
        force_n = -STIFFNESS_N_M * depth_m
        strongest = max(strongest, -force_n)
        feedback.put(forces.encode({"x": force_n, "y": 0.0, "z": 0.0}), time.time_ns())
print(f"strongest force {strongest:.2f} N")
