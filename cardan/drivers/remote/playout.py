"""Playout buffer: restores the timing of the device's states despite network jitter.

As for speech over packet networks (Ramjee, Kurose, Towsley, Schulzrinne: Adaptive playout
mechanisms for packetized audio applications in wide-area networks, INFOCOM 1994): each state is
shown at its sender's stamp plus one delay, which follows recent transit times. Differences of
transit times suffice, so an unknown offset of the sender's clock does not matter. The buffer has no
clock: the sender's times are by its own, all others by the caller's, monotonic, s.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort
from collections import deque
from typing import NamedTuple

from cardan.types import NEUTRAL, NEVER_S, Axes, Pose

RETENTION_S = 4.0
"""Window of the transit times that count: clocks that drift by 1e-4 do so by 0.4 ms in it."""

CAPACITY = 2000
"""Most transit times kept: of 4 s at twice the rate at which states are sent."""

IN_TIME = 0.99
"""Share of the states for which the delay suffices, if its bound allows that."""

GROWS, SHRINKS = 0.1, 0.01
"""Change of the delay per time during motion, which stretches and shortens the motion by as
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
        """Set `most_s`, the longest wait of a state (0: each is shown on arrival). A shown state
        older than `max_age_s` is replaced by a waiting one."""
        self._most_s, self._max_age_s = most_s, max_age_s
        self.shown: MotionSample | None = None
        self._waiting: deque[tuple[float, MotionSample]] = deque(maxlen=CAPACITY)
        """Waiting states with their due times, in order."""
        self._transits: deque[tuple[float, float]] = deque()
        """Arrival of each state, and its transit time up to the offset of the clocks."""
        self._sorted: list[float] = []
        """Transit times alone."""
        self._lag_s = math.nan
        """Delay from `sent_s` to showing; unknown before the first state."""
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

    # -- reception -------------------------------------------------------------------------------

    def heard(self, sent_s: float, now_s: float) -> None:
        """Record the arrival of a state, whether it is used or not."""
        transits = self._transits
        while transits and (transits[0][0] < now_s - RETENTION_S or len(transits) >= CAPACITY):
            del self._sorted[bisect_left(self._sorted, transits.popleft()[1])]
        transits.append((now_s, now_s - sent_s))
        insort(self._sorted, now_s - sent_s)

    def take(self, motion: MotionSample, now_s: float, *, at_once: bool) -> None:
        """Add a state that was `heard`.

        `at_once`: show it now, and drop waiting ones. Rest is shown at once: a released control
        stops.
        """
        at_rest = not any(motion.axes)
        if at_rest and motion.pose is None:
            at_once = True
        elif at_rest:
            self._waiting = deque(
                [(due_s, each._replace(axes=NEUTRAL)) for due_s, each in self._waiting], CAPACITY
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
        """Adapt the delay to the transit times, slowly unless nothing is in motion (`free`)."""
        # States too late for any delay within the bound, as after a stall, do not count.
        helped = bisect_right(self._sorted, self._sorted[0] + self._most_s)
        wanted_s = _quantile(self._sorted, IN_TIME, helped)
        passed_s = max(0.0, sent_s - self._sent_s)
        self._sent_s = sent_s
        if free or math.isnan(self._lag_s):
            self._lag_s = wanted_s
        else:
            change_s = wanted_s - self._lag_s
            self._lag_s += max(-SHRINKS * passed_s, min(GROWS * passed_s, change_s))

    # -- playout ---------------------------------------------------------------------------------

    def advance(self, now_s: float) -> bool:
        """Show what is due; return True if the shown state has changed."""
        changed = False
        while self._waiting and (self._waiting[0][0] <= now_s or self._is_old(now_s)):
            self.shown = self._waiting.popleft()[1]
            changed = True
        return changed

    def _is_old(self, now_s: float) -> bool:
        return self.shown is None or now_s - self.shown.made_s > self._max_age_s

    @property
    def due_s(self) -> float:
        """Time at which the next state is shown, s; inf: none waits."""
        return self._waiting[0][0] if self._waiting else math.inf

    # -- figures -------------------------------------------------------------------------------

    @property
    def transit_s(self) -> float:
        """Median transit time up to the offset of the clocks, s; nan: unknown."""
        return _quantile(self._sorted, 0.5) if self._sorted else math.nan

    @property
    def jitter_s(self) -> float:
        """99th percentile of the transit times above the quickest, s; nan: unknown."""
        return _quantile(self._sorted, 0.99) - self._sorted[0] if self._sorted else math.nan

    @property
    def added_s(self) -> float:
        """Wait of a state with the median transit time, s; nan: unknown."""
        return min(max(0.0, self._lag_s - self.transit_s), self._most_s)


def _quantile(ordered: list[float], share: float, count: int = 0) -> float:
    """Quantile of the first `count` of them (0: of all): the smallest not exceeded by `share`."""
    return ordered[math.ceil(share * (count or len(ordered))) - 1]
