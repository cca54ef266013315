"""Move an arm by verbs and a stream of a program, through a session in a separate process."""

from __future__ import annotations

import sys
import time

from cardan.gateway.session.remote import session_arm

STREAM_PERIOD_S = 0.02
"""The arm brakes if the stream is silent for 0.1 s (parameter streamTimeout)."""


def main(path: str) -> None:
    """Move down and back, then stream a twist for half a second."""
    with session_arm(path) as arm:
        arm.set_parameters({"trajectoryRefSpeed": 0.1, "trajectoryRefAccel": 0.5})
        x, y, z, *turn = arm.stat().pose
        arm.movj([x, y, z - 0.1, *turn])
        print("movj arrived:", arm.wait(timeout_s=20.0))

        line = arm.movl([x, y, z, *turn])
        print("movl arrived:", arm.wait(), "in", round(line.duration_s, 1), "s as planned")

        arm.set_parameter("streamingCommand", "twst")
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s:
            refused = arm.twist([0.0, 0.0, -0.05, 0.0, 0.0, 0.0])
            if refused:
                print("twist:", refused)
                break
            time.sleep(STREAM_PERIOD_S)
        arm.stop()
        print("streamed", round(1e3 * (z - arm.stat().pose[2])), "mm down")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "examples/verbs-ur5-simulated.toml")
