"""Faults of a simulated JR3, its board and the bus."""

from __future__ import annotations

import math

from cardan.sim_peers.base import FaultSwitch

FAULTS = (
    FaultSwitch("no-sensor", "nothing is plugged into the board: it never gets ready"),
    FaultSwitch("sensor-unplug", "the sensor is unplugged from its board at VALUE s", 5.0),
    FaultSwitch("power-cycle", "power fails at VALUE s and comes back 0.5 s later", 5.0),
    FaultSwitch("silence", "the board hangs at VALUE s: nothing more comes from it", 5.0),
    FaultSwitch("stopped", "another program on the bus sends STOP at VALUE s", 5.0),
    FaultSwitch("lost", "share of the board's frames that are lost (0..1)", 0.05, 0.0, 1.0),
    FaultSwitch("lost-moments", "every VALUE-th MOMENTS is lost", 10.0, 1.0),
    FaultSwitch("wrong-counter", "every VALUE-th MOMENTS has another counter", 10.0, 1.0),
    FaultSwitch("duplicate", "every VALUE-th pair comes twice", 10.0, 1.0),
    FaultSwitch("short-frame", "every VALUE-th FORCES is cut short", 10.0, 1.0),
    FaultSwitch("unknown-frame", "a frame of junk before every VALUE-th FORCES", 10.0, 1.0),
    FaultSwitch("lost-ack", "every VALUE-th acknowledgment is lost", 3.0, 1.0),
    FaultSwitch("late-ack", "every acknowledgment comes VALUE ms late", 300.0),
    FaultSwitch("error-ack", "acknowledgments carry the state VALUE", 2.0, 0.0, 255.0),
    FaultSwitch("counter", "the counter starts at VALUE", 65000.0, 0.0, 65535.0),
    FaultSwitch("drift", "zero wanders by VALUE N/s on every force", 0.5, -math.inf, math.inf),
)

TIMED_FAULTS = ("sensor-unplug", "power-cycle", "silence", "stopped")
"""Faults whose times count from the board's first command to acquire."""

POWER_OFF_S = 0.5
