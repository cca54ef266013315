"""Faults of the simulated controller's network and servers, and events of a cell at a time."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.tcp_servers import RESET, SILENT

SERVER_FAULTS: tuple[FaultSwitch, ...] = (
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
