"""Plausibility check for motion without checksums: a bit error must not become a deflection.

A packet beyond a hand's travel in one period is held until the next packet, which confirms it if it
is near. Packets towards rest count at once.
"""

from __future__ import annotations

from typing import NamedTuple

from cardan_serial_mice.protocol import Counts

JUMP = 0.55
"""A fast hand takes some 0.1 s from rest to the stop: half the full scale in a period of 50 ms."""

REST: Counts = (0, 0, 0, 0, 0, 0)


class Verdict(NamedTuple):
    """Result of the check of a packet."""

    counts: Counts | None
    """Deflection that counts now; None: no new one."""
    garbled: bool
    """The packet, or the held one before it, was found to be wrong."""


class JumpGuard:
    """Plausibility check of the motion packets of a device, in their order.

    The newest packet counts, or the one before while the newest waits: never an older one. `step`:
    largest travel of the cap from one packet to the next, counts of each axis.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Reset: the cap is at rest, or in an unknown position."""
        self._last = REST
        """Counts of the packet that counts."""
        self._before_fall: Counts | None = None
        """Packet before `_last`, if `_last` is much smaller: that may be a bit error."""
        self._waiting: Counts | None = None
        """Newest packet, if the next has to confirm it."""
        self._missed = False
        """True if an unusable packet followed `_last`."""

    def miss(self) -> None:
        """Record an unreadable packet: the cap may be a step further."""
        self._missed = True

    def refuse(self) -> Counts | None:
        """Drop an impossible packet; return the deflection of this period; None: nothing new."""
        held = None if self._missed or self._waiting is not None else self._held()
        self._missed = True
        return held

    def judge(self, counts: Counts) -> Verdict:
        """Check a packet of six axes."""
        waiting = self._waiting
        if not any(counts):
            self.reset()
            return Verdict(counts, waiting is not None)
        step, last, fallen = self._step, self._last, self._before_fall
        reach = step if waiting is None and not self._missed else 2.0 * step
        if _within(counts, last, reach) or (
            fallen is not None and _within(counts, fallen, 2.0 * step)
        ):
            garbled = waiting is not None and not _within(waiting, counts, step)
            return self._take(counts, None, garbled)
        if waiting is None:
            self._waiting = counts
            return Verdict(None if self._missed else self._held(), False)
        if _within(counts, waiting, step):
            return self._take(counts, None, False)
        if _within(waiting, counts, step):
            return self._take(waiting, counts, False)
        self._waiting = counts
        return Verdict(None, True)

    def _held(self) -> Counts | None:
        """Return `_last` again, but never a rest, which only the device can report."""
        return self._last if any(self._last) else None

    def _take(self, counts: Counts, waiting: Counts | None, garbled: bool) -> Verdict:
        last = self._last
        self._before_fall = None if _within(last, counts, self._step) else last
        self._last, self._waiting, self._missed = counts, waiting, False
        return Verdict(counts, garbled)


def _within(counts: Counts, reference: Counts, reach: float) -> bool:
    """Return True if each axis is at most `reach` outside of the range from 0 to `reference`."""
    for count, limit in zip(counts, reference, strict=True):
        if limit < 0:
            if not limit - reach <= count <= reach:
                return False
        elif not -reach <= count <= limit + reach:
            return False
    return True
