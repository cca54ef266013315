"""ROS 2's spacenav_node as a process: `python -m bench.spacenav_node SOCKET ROUTER`.

It polls spacenavd's socket every millisecond, like the node's timer, and publishes the node's four
topics for each event, in the node's order (spacenav/src/spacenav.cpp of ros-drivers). The node is
C++ and repeats /spacenav/joy with every poll after the first event. To keep Python's cost out of
the measurement, three messages are encoded beforehand, and joy is repeated every 8 ms.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import sys
import time
from typing import Final

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.protocols.ros2.cdr import codec_of

EVENT: Final = struct.Struct("=8i")
"""An event of spacenavd's protocol, version 0: its type and seven words."""
MOTION, PRESS, RELEASE = 0, 1, 2
POLL_S, REPEAT_S = 0.001, 0.008
FULL_SCALE: Final = 512.0
JOY: Final = "sensor_msgs/msg/Joy"
VECTOR, TWIST = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Twist"
ZERO: Final = {"x": 0.0, "y": 0.0, "z": 0.0}


def main(path: str, router: str) -> None:
    """Publish the events of the daemon at `path` on the bus of `router`, until the daemon ends."""
    daemon = socket.socket(socket.AF_UNIX)
    daemon.connect(path)
    daemon.setblocking(False)
    with BusNode(BusOptions(router=router, mode="client"), "spacenav") as node:
        codec = codec_of(JOY)
        vector = codec_of(VECTOR).encode(ZERO)
        before = [
            (node.publisher("/spacenav/offset", VECTOR), vector),
            (node.publisher("/spacenav/rot_offset", VECTOR), vector),
            (
                node.publisher("/spacenav/twist", TWIST),
                codec_of(TWIST).encode({"linear": ZERO, "angular": ZERO}),
            ),
        ]
        joy = node.publisher("/spacenav/joy", JOY)
        axes, buttons = [0.0] * 6, [0, 0]
        poll_s = time.monotonic()
        repeat_s = math.inf
        while True:
            poll_s = max(poll_s + POLL_S, time.monotonic())
            time.sleep(max(0.0, poll_s - time.monotonic()))
            event = b""
            with contextlib.suppress(BlockingIOError):
                if not (event := daemon.recv(EVENT.size)):
                    return
            now_ns = time.time_ns()
            if event:
                kind, x, y, z, rx, ry, rz, _ = EVENT.unpack(event)
                if kind == MOTION:
                    axes = [each / FULL_SCALE for each in (z, -x, y, rz, -rx, ry)]
                    for publisher, data in before:
                        publisher.put(data, now_ns)
                else:
                    buttons[x] = int(kind == PRESS)
            elif poll_s < repeat_s:
                continue
            stamp = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
            message = {"header": {"stamp": stamp, "frame_id": ""}, "axes": axes, "buttons": buttons}
            joy.put(codec.encode(message), now_ns)
            repeat_s = poll_s + REPEAT_S


if __name__ == "__main__":
    main(*sys.argv[1:])
