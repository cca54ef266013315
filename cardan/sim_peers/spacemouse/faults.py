"""Faults of a simulated 3Dconnexion device, and the line that alters its reports."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cardan.errors import ScriptError
from cardan.protocols.connexion.devices import Family, Model
from cardan.sim_peers import base
from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.delay_line import DelayLine

FAULTS = (
    FaultSwitch("unplug", "the device vanishes at VALUE s, whatever it is doing", 3.0),
    FaultSwitch("replug", "the device that vanished is back at VALUE s", 4.0, after="unplug"),
    FaultSwitch("silence", "nothing more comes after the first deflection past VALUE s", 3.0),
    FaultSwitch("seized", "opens, but never sends: another program holds the device"),
    FaultSwitch(
        "refuse", "cannot be opened for the first VALUE s (inf: never)", math.inf, 0.0, math.inf
    ),
    FaultSwitch("short-report", "every VALUE-th motion report is cut short", 10.0, 1.0),
    FaultSwitch("unknown-id", "an unknown report before every VALUE-th motion report", 10.0, 1.0),
    FaultSwitch("padded-report", "every report is zero-filled to VALUE bytes", 64.0, 1.0, 4096.0),
    FaultSwitch("lost-half", "every VALUE-th rotation half of a pair is lost", 10.0, 1.0),
    FaultSwitch("duplicate-half", "every VALUE-th rotation half of a pair comes twice", 10.0, 1.0),
    FaultSwitch("late-half", "every VALUE-th rotation half trails the next translation", 10.0, 1.0),
    FaultSwitch(
        "burst", "for VALUE s in every 2·VALUE s nothing, then all of it at once", 0.5, 0.001
    ),
    FaultSwitch("newest-lost", "a full queue loses the newest (Linux hidraw), not the oldest"),
    FaultSwitch("wrong-family", "motion reports of the other family than the model's"),
    FaultSwitch(
        "drift", "every axis rests VALUE counts off zero: never any silence", 5.0, -350.0, 350.0
    ),
    FaultSwitch(
        "overrange",
        "full deflection gives VALUE counts, not the declared range",
        420.0,
        1.0,
        32767.0,
    ),
    FaultSwitch("stuck-button", "the button of report-3 bit VALUE, once down, stays down", 0.0),
    FaultSwitch("low-battery", "the battery reports VALUE percent", 5.0, 0.0, 100.0),
)

_HALF_FAULTS = ("lost-half", "duplicate-half", "late-half")
_UNKNOWN_ID = 0x2A
_LATE_S = 0.012
"""A late half comes between the next translation (8 ms on) and the next rotation (16 ms on)."""


def check_faults(faults: Mapping[str, float], model: Model) -> None:
    """Raise ScriptError for an unknown fault, or one that `model` cannot have."""
    base.check_faults(faults, FAULTS)
    for name in faults:
        if name in _HALF_FAULTS and _sent_family(faults, model) is not Family.SPLIT:
            raise ScriptError(
                f"fault {name}: {model.name} sends whole reports, not pairs of halves"
            )
    if "stuck-button" in faults and faults["stuck-button"] not in model.buttons:
        raise ScriptError(
            f"fault stuck-button: {model.name} has no button of bit {faults['stuck-button']:g}; "
            f"it has: {', '.join(map(str, sorted(model.buttons))) or 'none'}"
        )
    if "low-battery" in faults and not model.battery:
        raise ScriptError(f"fault low-battery: {model.name} has no battery")


def _sent_family(faults: Mapping[str, float], model: Model) -> Family:
    if not faults.get("wrong-family"):
        return model.family
    return Family.ONE if model.family is Family.SPLIT else Family.SPLIT


class FaultyLine(DelayLine):
    """Line between the device and the host: carries, loses, corrupts or delays reports.

    `family`: that of the device's motion reports.
    """

    def __init__(self, faults: Mapping[str, float], model: Model, seed: int) -> None:
        check_faults(faults, model)
        self.family = _sent_family(faults, model)
        super().__init__(faults, seed)
        self._padding = int(faults.get("padded-report", 0))
        self._motions = 0
        self._halves = 0

    def carry_motion(self, report: bytes, sent_s: float) -> None:
        """Carry a motion report (id 1 or 2) sent at `sent_s`."""
        self._motions += 1
        if self._strikes("unknown-id", self._motions):
            self.carry(bytes([_UNKNOWN_ID]) + self._random.randbytes(6), sent_s)
        is_half = report[0] == 2
        self._halves += is_half
        if is_half and self._strikes("lost-half", self._halves):
            return
        if self._strikes("short-report", self._motions):
            report = report[: self._random.randint(1, 6)]
        late = is_half and self._strikes("late-half", self._halves)
        self.carry(report, sent_s + _LATE_S if late else sent_s)
        if is_half and self._strikes("duplicate-half", self._halves):
            self.carry(report, sent_s)

    def carry(self, report: bytes, sent_s: float) -> None:
        """Carry any report sent at `sent_s`."""
        super().carry(report.ljust(self._padding, b"\0"), sent_s)
