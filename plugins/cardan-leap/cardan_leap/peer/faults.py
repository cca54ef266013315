"""Faults of the simulated tracking service and its tracker."""

from __future__ import annotations

import math

from cardan.sim_peers.base import FaultSwitch

FAULTS = (
    FaultSwitch("unplug", "the tracker is unplugged at VALUE s", 3.0),
    FaultSwitch("replug", "the tracker that was unplugged is back at VALUE s", 4.0, after="unplug"),
    FaultSwitch("pause", "the tracker stops sending frames at VALUE s", 3.0),
    FaultSwitch("no-device", "no tracker is plugged in"),
    FaultSwitch("stall", "no frames for VALUE s, every 5 s", 0.3, 0.0, 5.0),
    FaultSwitch(
        "burst", "for VALUE s in every 2·VALUE s nothing, then all of it at once", 0.5, 0.001
    ),
    FaultSwitch("drop", "this share of the frames is left out (0..1)", 0.1, 0.0, 1.0),
    FaultSwitch("restart", "the service restarts at VALUE s: gone for 1 s, new ids", 5.0),
    FaultSwitch("refuse", "no connections for the first VALUE s (inf: never)", 1.0, 0.0, math.inf),
    FaultSwitch("mute", "connections are accepted, but nothing is ever sent"),
    FaultSwitch("highest-version", "versions above VALUE are closed with code 1001", 4.0, 1.0, 6.0),
    FaultSwitch("lost-focus", "another program takes the focus at VALUE s", 3.0),
    FaultSwitch("malformed", "every VALUE-th frame is cut short", 10.0, 1.0),
    FaultSwitch("unknown", "a message of unknown kind before every VALUE-th frame", 10.0, 1.0),
    FaultSwitch("no-palm", "every VALUE-th frame has hands without a palm", 10.0, 1.0),
    FaultSwitch("absurd", "every VALUE-th frame has its hands 5 m away", 10.0, 1.0),
    FaultSwitch("repeat", "every VALUE-th frame comes twice", 10.0, 1.0),
    FaultSwitch("count-anew", "frame ids begin at 1 again at VALUE s", 3.0),
    FaultSwitch("new-ids", "every hand gets a new id every VALUE s", 2.0, 0.01),
    FaultSwitch("confidence", "every hand is seen with this confidence (0..1)", 0.1, 0.0, 1.0),
)

STALL_EVERY_S = 5.0
RESTART_S = 1.0
ABSURD_MM = 5000.0
