"""Hold-to-run of a page, which allows its operator to move an arm or device. Only frames with a
held control keep a hold: it ends with the first other frame, and when none arrives. After an end
without a release, the control must be released before it counts again. Times are monotonic, s."""

from __future__ import annotations

import enum
import math
from collections import Counter
from typing import Final

from cardan.protocols.handheld.frames import OperatorFrame

FRESH_S: Final = 0.15
"""Longest age of a frame since the page made it: nine of sixty a second."""

AHEAD_S: Final = 0.1
"""Largest time that a frame may be in the future: beyond, its clock is unknown."""

LONGEST_S: Final = 10.0
"""Default limit for jogging an arm without a sign of the person: a page may live while its browser
hangs, and never learn that the control was released. Devices need none: their sensors fall silent
with the browser."""

_HALF: Final = 2**31
_WHOLE: Final = 2**32


class Grip(enum.Enum):
    """State of the hold-to-run button or dead-man."""

    FREE = "free"
    HELD = "held"
    LOST = "lost"
    """The control must be released first."""


class HoldVerdict(enum.Enum):
    """Treatment of a frame."""

    DROPPED = "dropped"
    REST = "rest"
    """The frame counts, and nothing is held."""
    BEGINS = "begins"
    """The hold begins with the frame."""
    GOES_ON = "goes on"


class Hold:
    """The hold of one control."""

    def __init__(self, longest_s: float = math.inf) -> None:
        """`longest_s`: longest time without renewal."""
        self.longest_s = longest_s
        self.grip = Grip.LOST
        self.why = "let go of the control once"
        """Reason why it is LOST, or for the end of the newest hold."""
        self.counts: Counter[str] = Counter()
        """Counts. "late": frames after a newer one; "old": delayed frames; "unknown": frames of a
        page whose clock is not known yet; "lost": holds that ended without a release."""
        self._sequence: int | None = None
        self._until_s = self._renewed_s = float("-inf")

    @property
    def until_s(self) -> float | None:
        """Time at which the hold ends without a frame or renewal; None: nothing is held."""
        if self.grip is not Grip.HELD:
            return None
        return min(self._until_s, self._renewed_s + self.longest_s)

    def left_s(self, now_s: float) -> float | None:
        """Return the time left without renewal; None: nothing is held, or no limit."""
        if self.grip is not Grip.HELD or math.isinf(self.longest_s):
            return None
        return max(0.0, self._renewed_s + self.longest_s - now_s)

    def renew(self, now_s: float) -> None:
        """Renew the hold: the pointer has moved, the key has repeated itself, or the browser has
        proved that it runs."""
        self._renewed_s = now_s

    def take(self, frame: OperatorFrame, made_s: float | None, now_s: float) -> HoldVerdict:
        """Take a frame that the page made at `made_s`; None if unknown."""
        if (
            self._sequence is not None
            and not 0 < (frame.sequence - self._sequence) % _WHOLE < _HALF
        ):
            self.counts["late"] += 1
            return HoldVerdict.DROPPED
        self._sequence = frame.sequence
        self.look(now_s)
        if not frame.hold:
            # A release counts at any delay.
            self.grip, self.why = Grip.FREE, ""
            return HoldVerdict.REST
        if made_s is None or made_s - now_s > AHEAD_S:
            self.counts["unknown"] += 1
            return HoldVerdict.DROPPED
        if now_s - made_s > FRESH_S:
            self.counts["old"] += 1
            return HoldVerdict.DROPPED
        if not frame.visible or not frame.tracking:
            self.lose("the page is hidden" if not frame.visible else "the tracking was lost")
            return HoldVerdict.REST
        if self.grip is Grip.LOST:
            return HoldVerdict.REST
        began = self.grip is Grip.FREE
        if began:
            self._renewed_s = now_s
        self.grip, self._until_s = Grip.HELD, made_s + FRESH_S
        return HoldVerdict.BEGINS if began else HoldVerdict.GOES_ON

    def look(self, now_s: float) -> bool:
        """Check for silence; return whether it ended a hold."""
        until_s = self.until_s
        if until_s is None or now_s < until_s:
            return False
        if now_s >= self._until_s:
            self.lose(f"no frame for {1e3 * FRESH_S:.0f} ms")
        else:
            self.lose(
                f"held for {self.longest_s:g} s without a sign of the operator: release and "
                "press again"
            )
        return True

    def lose(self, why: str) -> None:
        """Ignore the hold until it is released."""
        self.counts["lost"] += self.grip is Grip.HELD
        self.grip, self.why = Grip.LOST, why
