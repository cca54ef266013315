"""Core of the driver of serial devices: reports in the form of a HID device that reports each 33 to
60 ms while deflected, and notices of the connection."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.drivers.spacemouse.core import SpaceMouseCore
from cardan.types import DeviceLink
from cardan_serial_mice.driver.notices import Doubt, Lapse, Notice


class SerialMouseCore(SpaceMouseCore):
    """State of one serial device; see :mod:`cardan.drivers.spacemouse.core` for the rules."""

    def on_notice(self, notice: Notice, now_s: float) -> None:
        """Handle a notice about the device's connection, at `now_s`."""
        if isinstance(notice, Lapse):
            self.on_lost(notice.reason, now_s)
        elif not isinstance(notice, Doubt):
            self.on_opened(now_s, notice.model, None, notice.period_s)
        elif self._open:
            self._counts["doubts"] += 1
            self._resumed_reason = notice.reason
            self._invalidate_input(DeviceLink.STALE, notice.reason, now_s)

    @property
    def _counters(self) -> Mapping[str, str]:
        return {**super()._counters, "doubts": "queries of the buttons without an answer"}
