"""State of the device's calibration, without any I/O and in the caller's time.

The tick asks the library, and starts a calibration when the library reports that it is possible.
The position may jump then: force is allowed only after the answer has been "calibrated" for
`SETTLE_S`, and forbidden as soon as it is anything else.
"""

from __future__ import annotations

from cardan.common.haptics import Calibration
from cardan_omni.protocol import CalibrationStyle

SETTLE_S = 0.1
UPDATE_AGAIN_S = 0.5
"""Time after which an update without effect is requested again."""

SLOW_S = 15.0
"""Time without success after which the reason lists further possible causes."""

_MANUAL = {
    CalibrationStyle.INKWELL: "put the stylus into the inkwell",
    CalibrationStyle.AUTO: "move the stylus about",
    CalibrationStyle.ENCODER_RESET: (
        "put the stylus into the reset position of the device's manual and hold it there"
    ),
}
_TOOL = "; if that does not help, calibrate with the vendor's diagnostic tool"
_SLOW = {
    CalibrationStyle.INKWELL: f"; press it in until its light changes{_TOOL}",
    CalibrationStyle.AUTO: _TOOL,
    CalibrationStyle.ENCODER_RESET: _TOOL,
}


def style_of(styles: int) -> CalibrationStyle:
    """Return the one of the device's `styles` (bits) to calibrate with: the inkwell if it has
    one."""
    for style in (CalibrationStyle.INKWELL, CalibrationStyle.AUTO, CalibrationStyle.ENCODER_RESET):
        if styles & style:
            return style
    return CalibrationStyle.INKWELL


class CalibrationWatch:
    """State machine that follows the answers of the library's calibration check. Times are
    monotonic, s."""

    def __init__(self, styles: int = CalibrationStyle.INKWELL) -> None:
        self.state = Calibration.UNKNOWN
        self.changes = 0
        """Number of times that the device lost a valid calibration."""
        self.updates = 0
        """Number of calibrations started."""
        self._style = style_of(styles)
        self._good_since_s: float | None = None
        self._bad_since_s: float | None = None
        self._updated_s = float("-inf")

    @property
    def style(self) -> CalibrationStyle:
        """Style to calibrate with."""
        return self._style

    def on_opened(self, styles: int) -> None:
        """Discard all state when the device was opened (again)."""
        self._style = style_of(styles)
        self.state = Calibration.UNKNOWN
        self._good_since_s = self._bad_since_s = None
        self._updated_s = float("-inf")

    def on_answer(self, answer: Calibration, now_s: float) -> bool:
        """Process the check's `answer`; return True if the library must calibrate now, with
        `style`."""
        self.state = answer
        if answer is Calibration.OK:
            self._bad_since_s = None
            if self._good_since_s is None:
                self._good_since_s = now_s
            return False
        if self._good_since_s is not None:
            self.changes += 1
            self._good_since_s = None
        if self._bad_since_s is None:
            self._bad_since_s = now_s
        if answer is not Calibration.NEEDS_UPDATE or now_s - self._updated_s < UPDATE_AGAIN_S:
            return False
        self._updated_s = now_s
        self.updates += 1
        return True

    def usable(self, now_s: float) -> bool:
        """True if the position is valid and force is allowed."""
        return self._good_since_s is not None and now_s - self._good_since_s >= SETTLE_S

    def reason(self, now_s: float) -> str:
        """Return why the device is not usable; empty if it is."""
        if self.usable(now_s):
            return ""
        if self.state is Calibration.OK:
            return "calibrated: waiting for the position to settle"
        slow = self._bad_since_s is not None and now_s - self._bad_since_s >= SLOW_S
        if self.state is Calibration.NEEDS_MANUAL_INPUT:
            how = _MANUAL[self._style] + ", to calibrate the device"
            return how + (_SLOW[self._style] if slow else "")
        if self.state is Calibration.NEEDS_UPDATE:
            return "the device is being calibrated: hold the stylus still" + (
                _SLOW[self._style] if slow else ""
            )
        return "the device does not say whether it is calibrated"
