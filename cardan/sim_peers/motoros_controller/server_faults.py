"""Faults of the simulated controller's network and servers, and events of a cell at a time."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch

SERVER_FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch("drop-reply", "share of replies that are never sent (0..1)", 0.05, 0.0, 1.0),
    FaultSwitch("late", "every reply is sent this much later, ms", 100.0, 0.0, 60_000.0),
    FaultSwitch(
        "stale-reply",
        "share of replies in whose place the one before is sent again (0..1)",
        0.05,
        0.0,
        1.0,
    ),
    FaultSwitch(
        "silent", "from this time on nothing is sent or read, the sockets stay open, s", 5.0
    ),
    FaultSwitch("cut", "the motion connection is closed at this time, s", 5.0),
    FaultSwitch("reset", "every connection is reset at this time, s", 5.0),
    FaultSwitch(
        "strict-recv",
        "one recv is one message, as in MotoROS: a split message is refused and lost (1: yes)",
        1.0,
        0.0,
        1.0,
    ),
    FaultSwitch(
        "state-pause", "the state port is silent for this long every 5 s, s", 0.3, 0.0, 5.0
    ),
    FaultSwitch("garbage", "share of state cycles with junk before them (0..1)", 0.05, 0.0, 1.0),
    FaultSwitch("split", "every message is written in two pieces (1: yes)", 1.0, 0.0, 1.0),
    FaultSwitch(
        "merge", "the messages of a state cycle are written as one piece (1: yes)", 1.0, 0.0, 1.0
    ),
    FaultSwitch("estop", "emergency stop at this time, s", 5.0),
    FaultSwitch("alarm", "alarm 4107 at this time, s", 5.0),
    FaultSwitch("teach", "the key switch is turned to teach at this time, s", 5.0),
    FaultSwitch("hold", "hold at this time, s", 5.0),
    FaultSwitch("servo-off", "servo power goes off at this time, s", 5.0),
    FaultSwitch("pfl", "collaborative stop at this time, s", 5.0),
    FaultSwitch(
        "fsu",
        "the functional safety unit allows this share of the full speed, from the start (0..1)",
        0.25,
        0.0,
        1.0,
    ),
)

STATE_PAUSE_EVERY_S = 5.0
FAULT_ALARM = 4107
