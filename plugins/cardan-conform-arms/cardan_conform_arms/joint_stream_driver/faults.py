"""Defects of clients of the joint stream, for the simulated driver."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch

FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch.flag("mute", "sends nothing"),
    FaultSwitch.flag("presumes", "does not greet, but commands session 1"),
    FaultSwitch("truncated", "every VALUE-th datagram is cut short", 20.0, 1.0),
    FaultSwitch("joints", "its holds name VALUE joints", 7.0, 1.0, 16.0),
    FaultSwitch("step-2", "counts its commands by VALUE", 2.0, 2.0),
    FaultSwitch.flag("old-session", "keeps the session that it began with"),
    FaultSwitch("lazy", "answers only every VALUE-th state", 3.0, 2.0),
    FaultSwitch("twice", "answers every VALUE-th state twice", 10.0, 1.0),
    FaultSwitch("late", "answers VALUE ms late", 20.0, 0.0, 1000.0),
    FaultSwitch("clock", "its clock is VALUE times as fast, as one in milliseconds", 1000.0),
    FaultSwitch.flag("stale", "continues with its old target in a new session"),
    FaultSwitch("begins-fast", "first commands have VALUE rad/s", 0.5),
    FaultSwitch("beyond", "every 50th command is VALUE rad or rad/s further", 20.0),
    FaultSwitch("jump", "every 50th command jumps by VALUE rad", 0.2),
    FaultSwitch("degrees", "speeds beside positions are VALUE times as high", 57.3, 0.0, 1e3),
    FaultSwitch("obstinate", "while the arm is stopped, keeps a target VALUE rad away", 0.05),
    FaultSwitch.flag("gives-up", "ends at the first datagram that is no state"),
    FaultSwitch.flag("answers-old", "answers states that are old or come twice"),
    FaultSwitch.flag("answers-earlier", "answers states of earlier sessions"),
    FaultSwitch("chatters", "sends every VALUE ms while the arm is silent", 20.0, 1.0),
    FaultSwitch.flag("greets-once", "does not greet an arm that has fallen silent"),
    FaultSwitch.flag("one-session", "does not answer another session than the first"),
    FaultSwitch.flag("loses-heart", "does not answer any more after a silence"),
    FaultSwitch.flag("leaves-moving", "ends without a last command, in motion"),
)
