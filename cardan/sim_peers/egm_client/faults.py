"""Defects of clients of EGM, some of them seen in public ones."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch

FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch.flag("mute", "answers nothing"),
    FaultSwitch("lazy", "answers only every VALUE-th datagram", 3.0, 2.0),
    FaultSwitch("twice", "answers every VALUE-th datagram twice", 10.0, 1.0),
    FaultSwitch("late", "answers VALUE ms late", 20.0, 0.0, 1000.0),
    FaultSwitch("step-2", "counts its messages by VALUE, as older Python libraries", 2.0, 2.0),
    FaultSwitch("mtype", "sends messages of type VALUE", 0.0, 0.0, 9.0),
    FaultSwitch("truncated", "every VALUE-th message is cut short", 20.0, 1.0),
    FaultSwitch("empty", "every VALUE-th message has no reference", 20.0, 1.0),
    FaultSwitch("quaternion", "quaternions have the length VALUE", 1.1, 0.0, 10.0),
    FaultSwitch.flag("stale", "continues with its old target in a new session"),
    FaultSwitch("jump", "the reference jumps by VALUE mm in every 100th message", 20.0),
    FaultSwitch(
        "obstinate",
        "while commands do not act, keeps a reference VALUE mm away, as abb_libegm",
        5.0,
    ),
    FaultSwitch.flag("gives-up", "ends at the first datagram that is not EGM"),
    FaultSwitch.flag("answers-old", "answers old and duplicate datagrams"),
    FaultSwitch("chatters", "sends every VALUE ms while the controller is silent", 50.0, 1.0),
    FaultSwitch.flag("one-port", "never answers another port than the first"),
    FaultSwitch("leaves-moving", "its last message has a speed of VALUE mm/s", 10.0),
)
