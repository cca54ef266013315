"""Faults of a simulated remote, and the radio link that alters its reports."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cardan.errors import ScriptError
from cardan.sim_peers import base
from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.delay_line import DelayLine

FAULTS = (
    FaultSwitch("bad-checksum", "the first accelerometer calibration block has a wrong checksum"),
    FaultSwitch("no-calibration", "every calibration reads FF, as in clones"),
    FaultSwitch("busy", "every VALUE-th read of memory is refused with error 4", 3.0, 1.0),
    FaultSwitch("lost-ack", "every VALUE-th acknowledgment is never sent", 3.0, 1.0),
    FaultSwitch("slow-memory", "memory answers VALUE s late, as a cold remote's", 0.5),
    FaultSwitch(
        "silence", "from VALUE s on the remote neither sends nor obeys; link stays up", 3.0
    ),
    FaultSwitch("out-of-range", "out of range at VALUE s: silence, then the link is given up", 3.0),
    FaultSwitch("in-range", "back in range at VALUE s", 8.0, after="out-of-range"),
    FaultSwitch("power-off", "the remote is switched off at VALUE s", 3.0),
    FaultSwitch(
        "power-on",
        "the remote that was off is switched on again at VALUE s",
        4.0,
        after="power-off",
    ),
    FaultSwitch("close-control", "the remote closes the control channel at VALUE s", 3.0),
    FaultSwitch("close-interrupt", "the remote closes the interrupt channel at VALUE s", 3.0),
    FaultSwitch("battery-low", "the battery falls below the flag's threshold at VALUE s", 3.0),
    FaultSwitch("hot-plug", "the Nunchuk comes or goes in the first long read past VALUE s", 0.0),
    FaultSwitch("stale-mode", "every status report ends the data reports until a mode is set"),
    FaultSwitch(
        "stolen-mode", "every VALUE s another program sets data mode 0x30, not continuous", 2.0, 0.1
    ),
    FaultSwitch("woken-by-1-2", "the first output report ends the link; -TR remotes only"),
    FaultSwitch("refuse", "cannot be connected to for the first VALUE s", math.inf, 0.0, math.inf),
    FaultSwitch("short-report", "every VALUE-th data report is cut short", 10.0, 1.0),
    FaultSwitch("unknown-id", "an unknown report before every VALUE-th data report", 10.0, 1.0),
    FaultSwitch(
        "burst", "for VALUE s in every 2·VALUE s nothing, then all of it at once", 0.5, 0.001
    ),
)

_UNKNOWN_ID = 0x2A

SLOT_PAIR_S = 2 * 625e-6
"""The remote sends in every other Bluetooth time slot of 625 µs, one report in each. Source:
Bluetooth Core Specification, baseband."""
WAITING_REPORTS = 32
"""Reports that the remote queues for later slots; more are lost."""


def check_faults(faults: Mapping[str, float], *, tr: bool) -> None:
    """Raise ScriptError for an unknown or unsuitable fault."""
    base.check_faults(faults, FAULTS)
    if "woken-by-1-2" in faults and not tr:
        raise ScriptError("fault woken-by-1-2: only a -TR remote has it")


class FaultyLink(DelayLine):
    """Radio link between remote and host: carries, corrupts or delays reports.

    Reports arrive when they are sent, so a few may come at once; but no more of them than there are
    slots, however many a host asks for.
    """

    def __init__(self, faults: Mapping[str, float], seed: int) -> None:
        super().__init__(faults, seed)
        self._data_reports = 0
        self._free_s = 0.0
        self.lost = 0
        """Number of reports that found `WAITING_REPORTS` others in the queue."""

    def carry(self, report: bytes, sent_s: float) -> None:
        """Carry any report sent at `sent_s`, if a slot is free."""
        slot_s = max(sent_s, self._free_s)
        if slot_s - sent_s > WAITING_REPORTS * SLOT_PAIR_S:
            self.lost += 1
            return
        self._free_s = slot_s + SLOT_PAIR_S
        super().carry(report, sent_s)

    def carry_data(self, report: bytes, sent_s: float) -> None:
        """Carry a data report sent at `sent_s`."""
        self._data_reports += 1
        if self._strikes("unknown-id", self._data_reports):
            self.carry(bytes((_UNKNOWN_ID,)) + self._random.randbytes(6), sent_s)
        if self._strikes("short-report", self._data_reports):
            report = report[: self._random.randint(1, len(report) - 1)]
        self.carry(report, sent_s)
