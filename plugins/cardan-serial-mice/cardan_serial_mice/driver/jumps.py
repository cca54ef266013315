"""Plausibility check for motion without checksums: no wrong bit is to become a deflection.

A packet farther out than a hand moves the cap in one period is held until the next packet, which
confirms it if it is near. Towards rest every packet counts at once.
"""

from __future__ import annotations

from typing import NamedTuple

from cardan_serial_mice.protocol import Counts

JUMP = 0.55
"""A fast hand takes some 0.1 s from rest to the stop: half the full scale in a period of 50 ms."""

REST: Counts = (0, 0, 0, 0, 0, 0)


class Verdict(NamedTuple):
    """The verdict on a packet."""

    counts: Counts | None
    """The deflection that counts now; None: none that is new."""
    garbled: bool
    """The packet, or the one held before it, was found to be wrong."""


class JumpGuard:
    """Plausibility check of the motion packets of a device, in their order.

    The newest packet counts, or the one before while the newest waits: never an older one.
    `step` is how far the cap gets from one packet to the next, counts of each axis.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Begin anew: the cap is at rest, or nothing is known of it."""
        self._last = REST
        """Counts of the packet that counts."""
        self._before_fall: Counts | None = None
        """The packet before `_last`, where `_last` is much less: that may be a bit error."""
        self._waiting: Counts | None = None
        """The newest packet, when the next has to confirm it."""
        self._missed = False
        """There was an unusable packet since `_last`."""

    def miss(self) -> None:
        """A packet could not be read: the cap may be a step further."""
        self._missed = True

    def refuse(self) -> Counts | None:
        """Drop an impossible packet; returns what counts for this period; None: nothing new."""
        held = None if self._missed or self._waiting is not None else self._held()
        self._missed = True
        return held

    def judge(self, counts: Counts) -> Verdict:
        """Take a packet of six axes."""
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
        """`_last` once more, but never a rest, which only the device can report."""
        return self._last if any(self._last) else None

    def _take(self, counts: Counts, waiting: Counts | None, garbled: bool) -> Verdict:
        last = self._last
        self._before_fall = None if _within(last, counts, self._step) else last
        self._last, self._waiting, self._missed = counts, waiting, False
        return Verdict(counts, garbled)


def _within(counts: Counts, reference: Counts, reach: float) -> bool:
    """Whether each axis is at most `reach` outside of what lies between 0 and `reference`."""
    for count, limit in zip(counts, reference, strict=True):
        if limit < 0:
            if not limit - reach <= count <= reach:
                return False
        elif not -reach <= count <= limit + reach:
            return False
    return True
