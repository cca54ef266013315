"""Estimate of the clock of a page or of another computer, for the age of its messages. Its clock is
unrelated to the local one. The time in a reply was read between request and reply: the quickest
recent round trip is the best measure. Times: monotonic, s."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

MOST_ROUNDS = 60
"""Number of remembered round trips: half a minute at two a second, in which clocks drift by less
than 2 ms."""

LONGEST_S = 1.0
"""Longest round trip that is used."""

SLACK_S = 0.01
"""Disagreement of two round trips, beyond their uncertainty, at which a clock counts as set or as
stopped by sleep."""


class _Round(NamedTuple):
    took_s: float
    offset_s: float
    """Offset of the local clock from the other, for equal delays both ways."""


class RemoteClock:
    """Estimate of the clock of a page, or of another computer."""

    def __init__(self, most: int = MOST_ROUNDS) -> None:
        """`most`: number of remembered round trips."""
        self._rounds: deque[_Round] = deque(maxlen=most)
        self._best: _Round | None = None
        self._took: deque[float] = deque(maxlen=most)
        self.quickest_s = math.inf
        """Quickest round trip, also across resets of the other clock: the local clock alone
        measures it."""
        self.resets = 0
        """Count of detected changes of the other clock."""

    @property
    def known(self) -> bool:
        """True after the first round trip."""
        return self._best is not None

    @property
    def round_s(self) -> float | None:
        """Quickest recent round trip; None before the first."""
        return None if self._best is None else self._best.took_s

    @property
    def median_s(self) -> float | None:
        """Median of the recent round trips."""
        took = sorted(each.took_s for each in self._rounds)
        return took[len(took) // 2] if took else None

    def heard(self, asked_s: float, there_s: float, now_s: float) -> None:
        """Take the other's time `there_s`, requested at `asked_s` and received at `now_s`."""
        took_s = now_s - asked_s
        if not 0.0 <= took_s <= LONGEST_S:
            return
        self._took.append(took_s)
        self.quickest_s = min(self._took)
        found = _Round(took_s, 0.5 * (asked_s + now_s) - there_s)
        best = self._best
        if best is not None:
            most_s = 0.5 * (best.took_s + took_s) + SLACK_S
            if abs(found.offset_s - best.offset_s) > most_s:
                self._rounds.clear()
                self.resets += 1
        self._rounds.append(found)
        self._best = min(self._rounds)

    def here_s(self, there_s: float) -> float | None:
        """Convert its time to the local clock; None while that is unknown."""
        return None if self._best is None else there_s + self._best.offset_s
