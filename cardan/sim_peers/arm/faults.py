"""Faults of the simulated arm, its controller and the network."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.link import LINK_FAULTS

FAULTS: tuple[FaultSwitch, ...] = (
    *LINK_FAULTS,
    FaultSwitch.share("garbage", "share of states with a datagram of junk before it", 0.1),
    FaultSwitch("silence", "silent for this long every 5 s, s", 0.3),
    FaultSwitch("restart", "the controller restarts at this time, once: a new session, s", 5.0),
    FaultSwitch.at("estop", "emergency stop"),
    FaultSwitch(
        "offset-deg", "every joint rests this far from where it is commanded, deg", 1.0, -30.0, 30.0
    ),
    FaultSwitch("jam", "this joint (1: the first) does not move any more from 2 s on", 2.0, 1, 16),
    FaultSwitch.share("slow", "the drives reach only this share of the speed", 0.2),
    FaultSwitch("noise-deg", "standard deviation of the measured joints, deg", 0.01, 0.0, 10.0),
)

SILENCE_EVERY_S = 5.0
JAM_AT_S = 2.0
RESTART_SILENCE_S = 1.0
"""A real controller takes minutes; to the other side only the silence counts."""
