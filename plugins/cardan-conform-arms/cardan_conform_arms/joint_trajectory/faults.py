"""Defects of action servers, for the simulated one."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch

FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch.flag("lacks-joint", "joint states lack the first joint"),
    FaultSwitch.flag("rejects", "rejects every goal"),
    FaultSwitch.flag("mute", "answers nothing"),
    FaultSwitch.flag("no-result", "accepts goals, and never gives a result"),
    FaultSwitch("late", "results come VALUE s late", 1.8, 0.0, 1.9),
    FaultSwitch("code", "goals that succeed have the error_code VALUE", -5.0, -5.0, 0.0),
    FaultSwitch("drifts", "the arm drifts by VALUE rad/s", 1e-3, 0.0, 1.0),
    FaultSwitch.flag("status-back", "the status of a goal that has ended is EXECUTING again"),
    FaultSwitch.flag("no-status", "publishes no status"),
    FaultSwitch.flag("strange-feedback", "feedback has an id that no goal has"),
    FaultSwitch("slow", "takes VALUE s longer for goals that move the arm", 1.8, 0.0, 1.9),
    FaultSwitch("short", "ends after the share VALUE of the way", 0.5, 0.0, 1.0),
    FaultSwitch.flag("early", "says of every goal at once that it has succeeded"),
    FaultSwitch.flag("unknown", "ignores the names of joints"),
    FaultSwitch.flag("too-few", "accepts goals for a part of the joints"),
    FaultSwitch.flag("unequal", "accepts points that lack a position"),
    FaultSwitch.flag("same-time", "accepts times that do not increase"),
    FaultSwitch.flag("nan", "takes positions that are not numbers for the arm's own"),
    FaultSwitch.flag("no-cancel", "rejects cancellations"),
    FaultSwitch.flag("aborts", "goals that are canceled end as ABORTED"),
    FaultSwitch.flag("coasts", "goals that are canceled move the arm on"),
    FaultSwitch.flag("forgets", "forgets a cancellation that arrives before its goal"),
    FaultSwitch.flag("both", "a goal that another one replaces is reported as succeeded"),
    FaultSwitch.flag("whole-turn", "continuous joints make the whole turns of a plan"),
)
