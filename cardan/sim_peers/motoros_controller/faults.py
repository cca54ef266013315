"""Faults the robot inside the simulated controller can be told to have.

Those of its network and servers, and the common events of a cell, are in `server_faults`.
"""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch

ROBOT_FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch("remote-off", "remote control is taken away at this time, s", 5.0),
    FaultSwitch("job-stop", "the job INIT_ROS is stopped at this time, s", 5.0),
    FaultSwitch("energy-saving", "the drives go into energy saving at this time, s", 5.0),
    FaultSwitch(
        "increment-error", "the first increments after this time are refused (5012), s", 5.0
    ),
    FaultSwitch(
        "old-firmware",
        "a queue survives a change of mode and plays on, pulses above a speed limit are lost, "
        "CHECK_MOTION_READY gives no reason, feedback has no speeds (1: yes)",
        1.0,
        0.0,
        1.0,
    ),
)
