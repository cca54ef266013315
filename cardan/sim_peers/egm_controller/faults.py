"""Faults of the simulated controller and its network."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.link import LINK_FAULTS

FAULTS: tuple[FaultSwitch, ...] = (
    *LINK_FAULTS,
    FaultSwitch.share("garbage", "share of cycles with a datagram that is not EGM before it", 0.1),
    FaultSwitch("pause", "silent for this long every 5 s, s", 0.3),
    FaultSwitch("restart", "the controller restarts at this time, once: seqno 0, new port, s", 5.0),
    FaultSwitch("port-change", "the local port changes every so many s", 3.0),
    FaultSwitch.at("estop", "emergency stop"),
    FaultSwitch.at("motors-off", "motors go off"),
    FaultSwitch(
        "clock-step",
        "the wall clock in the datagrams steps by this much after 2 s, s",
        3600.0,
        -1e9,
    ),
    FaultSwitch.flag("rapid-undefined", "RAPID's execution state is sent as UNDEFINED"),
)

PAUSE_EVERY_S = 5.0
CLOCK_STEP_AT_S = 2.0
RESTART_SILENCE_S = 2.0
"""A real controller takes minutes; to a PC only the silence counts."""
