"""Faults of the simulated Motoman: robot, network, servers, and events of a cell."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.tcp_servers import RESET, SILENT

FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch.at("remote-off", "remote control is switched off"),
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
    FaultSwitch.share("drop-reply", "share of replies that are never sent"),
    FaultSwitch("late", "every reply is sent this much later, ms", 100.0, 0.0, 60_000.0),
    FaultSwitch.share(
        "stale-reply", "share of replies in whose place the one before is sent again"
    ),
    SILENT,
    FaultSwitch.at("cut", "the motion connection is closed"),
    RESET,
    FaultSwitch.flag(
        "strict-recv",
        "one recv is one message, as in MotoROS: a split message is refused and lost",
    ),
    FaultSwitch(
        "state-pause", "the state port is silent for this long every 5 s, s", 0.3, 0.0, 5.0
    ),
    FaultSwitch.share("garbage", "share of state cycles with junk before them"),
    FaultSwitch.flag("split", "every message is written in two pieces"),
    FaultSwitch.flag("merge", "the messages of a state cycle are written as one piece"),
    FaultSwitch.at("estop", "emergency stop"),
    FaultSwitch.at("alarm", "alarm 4107"),
    FaultSwitch.at("teach", "the key switch is turned to teach"),
    FaultSwitch.at("hold", "hold"),
    FaultSwitch.at("servo-off", "servo power goes off"),
    FaultSwitch.at("pfl", "collaborative stop"),
    FaultSwitch.share(
        "fsu",
        "the functional safety unit allows this share of the full speed, from the start",
        0.25,
    ),
)

STATE_PAUSE_EVERY_S = 5.0
FAULT_ALARM = 4107
