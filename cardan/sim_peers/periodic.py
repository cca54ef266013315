"""Core of a simulated device that reports periodically, in motion or not."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Generic, NamedTuple

from cardan.sim_peers.backends.base import M
from cardan.sim_peers.base import FaultSwitch, TimedActions, check_faults

PERIODIC_FAULTS = (
    FaultSwitch("unplug", "the device vanishes at VALUE s", 3.0),
    FaultSwitch("replug", "the device that vanished is back at VALUE s", 4.0, after="unplug"),
    FaultSwitch("silence", "nothing more is sent from VALUE s on", 3.0),
    FaultSwitch("refuse", "the device cannot be opened for the first VALUE s", 2.0),
)


class PeriodicDevice(ABC, Generic[M]):
    """Sends a report, of type M, every `period_s`; times are s from the script's start.

    It has the `PERIODIC_FAULTS`. `switches`: these and the device's own; raises ScriptError for any
    other fault.
    """

    def __init__(
        self,
        period_s: float,
        faults: Mapping[str, float],
        switches: Sequence[FaultSwitch] = PERIODIC_FAULTS,
    ) -> None:
        check_faults(faults, switches)
        self.plugged = True
        """True if programs can find the device."""
        self.silent = False
        """True if the device sends nothing although it is plugged in."""
        self.next_due_s = 0.0
        """Time of the next report."""
        self._period_s = period_s
        self._timed = TimedActions(
            faults, {"unplug": self.unplug, "replug": self.replug, "silence": self.fall_silent}
        )

    @abstractmethod
    def report(self) -> M:
        """Return the device's report now."""

    def unplug(self) -> None:
        """Remove the device."""
        self.plugged = False

    def replug(self) -> None:
        """Bring the device back."""
        self.plugged = True

    def fall_silent(self) -> None:
        """Stop sending."""
        self.silent = True

    def reports(self, now_s: float) -> list[M]:
        """Return the reports from the last call until `now_s`."""
        reports = []
        while self.next_due_s <= now_s:
            for _, action in self._timed.due(self.next_due_s):
                action()
            if self.plugged and not self.silent:
                reports.append(self.report())
            self.next_due_s += self._period_s
        return reports

    def skip_to(self, now_s: float) -> None:
        """Skip the reports before `now_s`: the machine was too busy to simulate them."""
        missed = math.ceil((now_s - self.next_due_s) / self._period_s)
        self.next_due_s += max(0, missed) * self._period_s


class HeldModel(NamedTuple):
    """Data of a device that a motion script needs."""

    name: str
    buttons: Mapping[int, str]


class HeldPeriodicDevice(PeriodicDevice[M]):
    """Device with six deflections and buttons, on a program's page or node."""

    model: HeldModel

    def __init__(
        self, period_s: float, faults: Mapping[str, float], switches: Sequence[FaultSwitch]
    ) -> None:
        super().__init__(period_s, faults, switches)
        self.axes: tuple[float, ...] = (0.0,) * 6
        """Deflections, -1..1, robot frame."""
        self.held: tuple[str, ...] = ()
        self.led: bool | None = None
        self.rumble = 0.0
        """Newest commanded strength of vibration, 0..1."""

    def set_axes(self, axes: Sequence[float]) -> None:
        """Deflect the device."""
        self.axes = tuple(axes)

    def press(self, label: str) -> None:
        """Press a button."""
        self.held = (*self.held, label)

    def release(self, label: str) -> None:
        """Release a button."""
        self.held = tuple(each for each in self.held if each != label)

    def silence(self) -> None:
        """Stop sending: the sender of its reports hangs."""
        self.silent = True

    def resume(self) -> None:
        """Send reports again."""
        self.silent = False
