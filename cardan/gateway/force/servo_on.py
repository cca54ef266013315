"""Enables the force of a haptic device at the clutch-in, and retries while the device refuses."""

from __future__ import annotations

from cardan.common.haptics import OperatingState
from cardan.drivers.haptic import HapticDevice
from cardan.errors import CommandError, DriverError
from cardan.types import NEVER_S

ENABLE_PERIOD_S = 0.05
"""How often enabling is retried with a device that was not ready at the clutch-in."""


class ForceEnabling:
    """Enables force from one clutch-in to its clutch-out."""

    def __init__(self, device: HapticDevice) -> None:
        self._device = device
        self.refusal = ""
        """Reason why the device renders no force."""
        self._again = False
        """True to retry: the cause of the refusal may pass."""
        self._tried_s = NEVER_S
        self._faults = 0
        """Number of faults that the device had reported at the last attempt."""

    def engage(self, now_s: float) -> None:
        """Enable the force at the clutch-in, after a latched fault too."""
        self.refusal, self._again = "", False
        haptic = self._device.haptics()
        if haptic.state not in (OperatingState.DISABLED, OperatingState.FAULT):
            return
        self._faults, self._tried_s = haptic.faults, now_s
        try:
            self._device.enable()
        except CommandError as error:
            self.refusal, self._again = f"no force: {error}", True
        except DriverError as error:
            self.refusal = f"no force: {error}"

    def retry(self, now_s: float) -> None:
        """Retry if the cause may have passed. A fault since then needs a new clutch-in."""
        if self._again and now_s - self._tried_s >= ENABLE_PERIOD_S:
            if self._device.haptics().faults == self._faults:
                self.engage(now_s)
            else:
                self._again = False

    def release(self) -> None:
        """End enabling at the clutch-out."""
        self._again = False
