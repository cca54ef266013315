"""Move an arm that a session on any computer offers on the network.

Start the session first: ``cardan run examples/ros2/session.toml``.
"""

from __future__ import annotations

import argparse
import time

import cardan
from cardan.bus.options import BusOptions


def main() -> None:
    """Move 50 mm down and back, then stream a twist for half a second."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "address",
        nargs="?",
        default="/cartesian_control_server_ros2",
        help="the arm's node, an endpoint to meet it by, or both (tcp/192.168.1.10:7447/NODE)",
    )
    parser.add_argument("--zenoh-config", default="", help="of Zenoh, instead: TLS, for instance")
    options = parser.parse_args()

    bus = BusOptions(zenoh_config=options.zenoh_config) if options.zenoh_config else None
    with cardan.network_arm(options.address, bus) as arm:
        arm.set_parameters({"trajectoryRefSpeed": 0.1, "trajectoryRefAccel": 0.5})
        x, y, z, *turn = arm.stat().pose
        for height in (z - 0.05, z):
            line = arm.movl([x, y, height, *turn])
            print("movl arrived:", arm.wait(timeout_s=20.0), "in", round(line.duration_s, 1), "s")

        arm.set_parameter("streamingCommand", "twst")
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s:
            if refused := arm.twist([0.0, 0.05, 0.0, 0.0, 0.0, 0.0]):
                print("twist:", refused)
                break
            time.sleep(0.02)
        arm.stop()
        print(f"streamed {1e3 * (arm.stat().pose[1] - y):.0f} mm")


if __name__ == "__main__":
    main()
