"""Clock of a page or of another computer, by the clock here: the age of the messages that it
sends.

Its clock has nothing in common with ours. A client that asks it for the time knows that it was read
between request and reply: the quickest recent round trip is the best measure. Times: monotonic, s.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

MOST_ROUNDS = 60
"""Round trips that are remembered: of half a minute, in which clocks drift by less than 2 ms, where
the other is asked twice a second."""

LONGEST_S = 1.0
"""Slower round trips tell nothing that is of use."""

SLACK_S = 0.01
"""Two round trips that disagree by more than they may and this: a clock was set, or stood still
while its computer slept."""


class _Round(NamedTuple):
    took_s: float
    offset_s: float
    """Offset of our clock against the other's, as if both ways took the same time."""


class RemoteClock:
    """The clock of a page, or of another computer."""

    def __init__(self, most: int = MOST_ROUNDS) -> None:
        """`most`: round trips that are remembered."""
        self._rounds: deque[_Round] = deque(maxlen=most)
        self._best: _Round | None = None
        self._took: deque[float] = deque(maxlen=most)
        self.quickest_s = math.inf
        """Likewise, also across resets of the other clock: our clock alone measures it."""
        self.resets = 0
        """How often its clock was found to be another."""

    @property
    def known(self) -> bool:
        """Whether a round trip has told."""
        return self._best is not None

    @property
    def round_s(self) -> float | None:
        """The quickest round trip of late; None before the first."""
        return None if self._best is None else self._best.took_s

    @property
    def median_s(self) -> float | None:
        """Median of the round trips of late."""
        took = sorted(each.took_s for each in self._rounds)
        return took[len(took) // 2] if took else None

    def heard(self, asked_s: float, there_s: float, now_s: float) -> None:
        """The other, asked at `asked_s`, said `there_s`; its answer came at `now_s`."""
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
        """Its time by our clock; None while that is not known."""
        return None if self._best is None else there_s + self._best.offset_s
