"""Defects of clients of MotoROS, some of them seen in public ones, for the driver that is
simulated."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch

FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch.flag("absent", "never connects"),
    FaultSwitch.flag("no-motion", "connects to the state port only"),
    FaultSwitch("truncated", "every VALUE-th message lacks its last four bytes", 20.0, 1.0),
    FaultSwitch("pieces", "every VALUE-th message is sent in two pieces", 10.0, 1.0),
    FaultSwitch("pipelines", "after every VALUE-th request another without waiting", 10.0, 1.0),
    FaultSwitch.flag("other-order", "writes in the other byte order than the controller"),
    FaultSwitch.flag("topics", "sends its requests as topics"),
    FaultSwitch.flag("talks-to-states", "sends a PING to the state port"),
    FaultSwitch("unknown-command", "probes with the command VALUE", 200_199.0, 0.0),
    FaultSwitch.flag("no-stop", "sends no STOP_MOTION on a new connection"),
    FaultSwitch.flag("no-start", "sends points and speeds without a start of motion"),
    FaultSwitch.flag("takes-no-for-yes", "takes a refused start for one that worked"),
    FaultSwitch("fields", "points and speeds have the valid_fields VALUE", 3.0, 0.0, 15.0),
    FaultSwitch("nan", "every VALUE-th point or speed is not a number", 50.0, 1.0),
    FaultSwitch("starts-off", "first points are VALUE rad off", 0.05),
    FaultSwitch("starts-moving", "first points and speeds have VALUE rad/s", 0.1),
    FaultSwitch.flag("hasty", "begins a trajectory while the arm still moves"),
    FaultSwitch("sequence", "every VALUE-th point or speed has the sequence before", 20.0, 1.0),
    FaultSwitch("time-stands", "every VALUE-th point has the time before", 20.0, 1.0),
    FaultSwitch("leap", "every 50th point or speed leaps by VALUE rad or rad/s", 20.0),
    FaultSwitch("out-of-range", "every 50th point is VALUE rad out of its way and back", 7.0),
    FaultSwitch.flag("skips-busy", "takes BUSY for SUCCESS, and goes on with the next point"),
    FaultSwitch.flag("skips-first", "takes a refused first point for one that was taken"),
    FaultSwitch("starves", "every 25th point is sent VALUE ms late", 40.0, 0.0, 1000.0),
    FaultSwitch.flag("no-info", "starts the velocity mode without asking for it"),
    FaultSwitch("watchdog", "asks for a watchdog of VALUE ms", 5000.0),
    FaultSwitch("dozes", "is silent for VALUE ms every 0.5 s in velocity mode", 150.0),
    FaultSwitch.flag("blind", "looks at neither status nor refusals, and moves on"),
    FaultSwitch.flag("restarts", "starts motion again by itself when it ended"),
    FaultSwitch.flag("resets", "resets alarms and errors by itself, as soon as there are any"),
    FaultSwitch.flag("deaf", "does not notice that states cease"),
    FaultSwitch("patient", "waits VALUE s for a reply", 10.0, 0.1, 10.0),
    FaultSwitch("impatient", "asks again after VALUE ms without a reply", 100.0, 1.0),
    FaultSwitch.flag("credulous", "takes any reply for the answer"),
    FaultSwitch.flag("gives-up", "does not connect again"),
    FaultSwitch.flag("one-read", "takes what one read brings for one message"),
    FaultSwitch.flag("leaves-moving", "ends by closing its sockets, in motion"),
    FaultSwitch.flag("leaves-mode-on", "ends without leaving the mode"),
    FaultSwitch.flag("stays", "ends without closing its connections"),
)
