"""Faults the robot inside the simulated controller can be told to have.

Those of its network and servers, and the common events of a cell, are in `server_faults`.
"""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch

ROBOT_FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch.at("remote-off", "remote control is taken away"),
    FaultSwitch.at("job-stop", "the job INIT_ROS is stopped"),
    FaultSwitch.at("energy-saving", "the drives go into energy saving"),
    FaultSwitch(
        "increment-error", "the first increments after this time are refused (5012), s", 5.0
    ),
    FaultSwitch.flag(
        "old-firmware",
        "a queue survives a change of mode and plays on, pulses above a speed limit are lost, "
        "CHECK_MOTION_READY gives no reason, feedback has no speeds",
    ),
)
