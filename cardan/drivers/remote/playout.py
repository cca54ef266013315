"""Playout buffer: motion with the spacing of the device's states, despite network jitter.

As for speech over packet networks (Ramjee, Kurose, Towsley, Schulzrinne: Adaptive playout
mechanisms for packetized audio applications in wide-area networks, INFOCOM 1994): each state is
shown at its sender's stamp plus one delay, which follows the transit times of late. Differences of
transit times are enough for that, so an unknown offset of the sender's clock does not matter.
Nothing here has a clock: times of the sender are its own, all others the caller's, monotonic, s.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort
from collections import deque
from typing import NamedTuple

from cardan.types import NEUTRAL, NEVER_S, Axes, Pose

KEPT_S = 4.0
"""Transit times of so long decide: clocks that drift by 1e-4 do so by 0.4 ms in it."""

MOST_KEPT = 2000
"""Transit times at most: of 4 s at twice the rate at which states are sent."""

IN_TIME = 0.99
"""Share of the states for which the delay is long enough, where its bound allows that."""

GROWS, SHRINKS = 0.1, 0.01
"""Change of the delay per time while there is motion: it stretches and shortens the motion by as
much."""


class MotionSample(NamedTuple):
    """Motion of the device in one state."""

    sent_s: float
    """Time of sending, by the sender's clock."""
    made_s: float
    """Time of the state, by the local clock, as known on arrival."""
    stamp_s: float
    """Stamp of the device's report, by the local clock."""
    axes: Axes
    pose: Pose | None = None


class Playout:
    """Playout buffer of received states. States come in the order of `sent_s`."""

    def __init__(self, most_s: float, max_age_s: float) -> None:
        """`most_s`: no state waits longer, 0: each is shown on arrival. A shown state older than
        `max_age_s` gives way to a waiting one."""
        self._most_s, self._max_age_s = most_s, max_age_s
        self.shown: MotionSample | None = None
        self._waiting: deque[tuple[float, MotionSample]] = deque(maxlen=MOST_KEPT)
        """Waiting states with their due times, in order."""
        self._transits: deque[tuple[float, float]] = deque()
        """Arrival of each state, and its transit time except for the offset of the clocks."""
        self._sorted: list[float] = []
        """The transit times alone."""
        self._lag_s = math.nan
        """Delay from `sent_s` to showing it; not known before the first state."""
        self._sent_s = NEVER_S

    def forget(self) -> None:
        """Discard transit times and waiting states: the sender's clock has changed."""
        self._waiting.clear()
        self._transits.clear()
        self._sorted.clear()
        self._lag_s = math.nan

    def clear(self) -> None:
        """Discard all received states."""
        self._waiting.clear()
        self.shown = None

    # -- what arrives --------------------------------------------------------------------------

    def heard(self, sent_s: float, now_s: float) -> None:
        """Record the arrival of a state, whether it is taken or not."""
        transits = self._transits
        while transits and (transits[0][0] < now_s - KEPT_S or len(transits) >= MOST_KEPT):
            del self._sorted[bisect_left(self._sorted, transits.popleft()[1])]
        transits.append((now_s, now_s - sent_s))
        insort(self._sorted, now_s - sent_s)

    def take(self, motion: MotionSample, now_s: float, *, at_once: bool) -> None:
        """Take a state that was `heard`. `at_once`: show it now, and drop waiting ones.

        Rest is at once: a released control does not move on.
        """
        at_rest = not any(motion.axes)
        if at_rest and motion.pose is None:
            at_once = True
        elif at_rest:
            self._waiting = deque(
                [(due_s, each._replace(axes=NEUTRAL)) for due_s, each in self._waiting], MOST_KEPT
            )
            if self.shown is not None:
                self.shown = self.shown._replace(axes=NEUTRAL)
        self._adapt(motion.sent_s, free=at_once)
        if at_once:
            self._waiting.clear()
            self.shown = motion
            return
        due_s = min(motion.sent_s + self._lag_s, now_s + self._most_s)
        if self._waiting:
            due_s = max(due_s, self._waiting[-1][0])
        self._waiting.append((due_s, motion))
        self.advance(now_s)

    def _adapt(self, sent_s: float, *, free: bool) -> None:
        """The delay follows the transit times, slowly unless nothing is in motion (`free`)."""
        # States that no delay within the bound would have helped, as after a stall, do not count.
        helped = bisect_right(self._sorted, self._sorted[0] + self._most_s)
        wanted_s = _quantile(self._sorted, IN_TIME, helped)
        passed_s = max(0.0, sent_s - self._sent_s)
        self._sent_s = sent_s
        if free or math.isnan(self._lag_s):
            self._lag_s = wanted_s
        else:
            change_s = wanted_s - self._lag_s
            self._lag_s += max(-SHRINKS * passed_s, min(GROWS * passed_s, change_s))

    # -- what is shown -------------------------------------------------------------------------

    def advance(self, now_s: float) -> bool:
        """Show what is due: whether that is another state than before."""
        changed = False
        while self._waiting and (self._waiting[0][0] <= now_s or self._is_old(now_s)):
            self.shown = self._waiting.popleft()[1]
            changed = True
        return changed

    def _is_old(self, now_s: float) -> bool:
        return self.shown is None or now_s - self.shown.made_s > self._max_age_s

    @property
    def due_s(self) -> float:
        """Time at which the next one is shown; inf: none waits."""
        return self._waiting[0][0] if self._waiting else math.inf

    # -- figures -------------------------------------------------------------------------------

    @property
    def transit_s(self) -> float:
        """Median transit time, but for the offset of the clocks; nan: none is known."""
        return _quantile(self._sorted, 0.5) if self._sorted else math.nan

    @property
    def jitter_s(self) -> float:
        """99th percentile of the transit times above the quickest; nan: none is known."""
        return _quantile(self._sorted, 0.99) - self._sorted[0] if self._sorted else math.nan

    @property
    def added_s(self) -> float:
        """Wait of a state with the median transit time; nan: not known."""
        return min(max(0.0, self._lag_s - self.transit_s), self._most_s)


def _quantile(ordered: list[float], share: float, count: int = 0) -> float:
    """Quantile of the first `count` of them, 0: of all; the smallest that `share` do not exceed."""
    return ordered[math.ceil(share * (count or len(ordered))) - 1]
