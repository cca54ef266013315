"""Asks a haptic device to let force out when the hand takes hold, and again while it refuses."""

from __future__ import annotations

from cardan.drivers.haptic import HapticDevice
from cardan.errors import CommandError, DriverError
from cardan.haptics import OperatingState
from cardan.types import NEVER_S

ENABLE_PERIOD_S = 0.05
"""How often a device that was not ready at the clutch-in is asked to let force out."""


class ForceEnabling:
    """From one clutch-in to its clutch-out."""

    def __init__(self, device: HapticDevice) -> None:
        self._device = device
        self.refusal = ""
        """Why the device lets no force out, in words."""
        self._again = False
        """Whether it is to be asked again: what stands in the way may pass."""
        self._tried_s = NEVER_S
        self._faults = 0
        """How many the device had told of when it was asked."""

    def engage(self, now_s: float) -> None:
        """The operator took hold: let force out, after a latched fault too."""
        self.refusal, self._again = "", False
        told = self._device.haptics()
        if told.state not in (OperatingState.DISABLED, OperatingState.FAULT):
            return
        self._faults, self._tried_s = told.faults, now_s
        try:
            self._device.enable()
        except CommandError as error:
            self.refusal, self._again = f"no force: {error}", True
        except DriverError as error:
            self.refusal = f"no force: {error}"

    def retry(self, now_s: float) -> None:
        """What refused the clutch-in may have passed. A fault of after it needs another one."""
        if self._again and now_s - self._tried_s >= ENABLE_PERIOD_S:
            if self._device.haptics().faults == self._faults:
                self.engage(now_s)
            else:
                self._again = False

    def release(self) -> None:
        """The operator let go."""
        self._again = False
