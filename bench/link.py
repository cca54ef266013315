"""One direction of a network link: loss, delay, reordering, duplicates. No I/O."""

from __future__ import annotations

import heapq
import random
from collections import Counter, deque
from dataclasses import dataclass
from typing import NamedTuple


class Conditions(NamedTuple):
    """Effects of a link on Ethernet frames, one way."""

    delay_s: float = 0.0
    jitter_s: float = 0.0
    """Half of the range of delays; each frame draws its own."""
    loss: float = 0.0
    """Probability that a frame is lost."""
    stall_s: float = 0.0
    """Duration of a stall: nothing arrives, then everything at once, ..."""
    stall_every_s: float = 0.0
    """... and the period of stalls; 0: no stalls."""
    rate_bps: float = 0.0
    """Rate limit; 0: unlimited."""
    queue_bytes: int = 65536
    """Capacity of the queue before a rate-limited link; excess frames are lost."""
    twice: float = 0.0
    """Probability that a frame is duplicated."""
    in_order: bool = True
    """A late frame delays those behind it; else they overtake it."""
    cut: bool = False
    """Everything is lost, including frames in transit."""


LOGGED = 4096
"""Number of frames in a way's log: those of the last seconds."""


@dataclass
class Carried:
    """A frame's send and arrival times."""

    sent_s: float
    bytes: int
    came_s: float | None = None
    """None: lost, or in transit."""


class Way:
    """A link in one direction. Times are those of any monotonic clock, s."""

    def __init__(self, conditions: Conditions, chosen: random.Random) -> None:
        self.conditions = conditions
        """May be replaced at any time; frames in transit keep their time of arrival."""
        self.counts: Counter[str] = Counter()
        """Number of frames "sent"; of these "lost", and "overflowed" in the queue."""
        self._chosen = chosen
        self._free_s = self._latest_s = 0.0
        self._coming: list[tuple[float, int, bytes, Carried]] = []
        self._log: deque[Carried] = deque(maxlen=LOGGED)

    def send(self, frame: bytes, now_s: float) -> None:
        """Accept a frame for transmission."""
        conditions, chosen = self.conditions, self._chosen
        self.counts["sent"] += 1
        carried = Carried(now_s, len(frame))
        self._log.append(carried)
        sent_s = now_s
        if conditions.rate_bps:
            waits_s = max(0.0, self._free_s - now_s)
            if waits_s * conditions.rate_bps / 8 + len(frame) > conditions.queue_bytes:
                self.counts["overflowed"] += 1
                return
            sent_s = self._free_s = now_s + waits_s + 8 * len(frame) / conditions.rate_bps
        if conditions.cut or chosen.random() < conditions.loss:
            self.counts["lost"] += 1
            return
        for copy in range(1 + (chosen.random() < conditions.twice)):
            jitter_s = chosen.uniform(-conditions.jitter_s, conditions.jitter_s)
            comes_s = sent_s + max(0.0, conditions.delay_s + jitter_s)
            if conditions.stall_every_s:
                stalled_s = comes_s % conditions.stall_every_s
                comes_s += max(0.0, conditions.stall_s - stalled_s)
            if conditions.in_order:
                comes_s = max(comes_s, self._latest_s)
            self._latest_s = max(comes_s, self._latest_s)
            number = 2 * self.counts["sent"] + copy
            heapq.heappush(self._coming, (comes_s, number, frame, carried))

    @property
    def next_s(self) -> float:
        """Time of the next arrival; inf if no frame is in transit."""
        return self._coming[0][0] if self._coming else float("inf")

    def arrived(self, now_s: float) -> list[bytes]:
        """Return the frames that have arrived since the last call, in order."""
        frames = []
        while self.next_s <= now_s:
            *_, frame, carried = heapq.heappop(self._coming)
            if self.conditions.cut:
                self.counts["lost"] += 1
                continue
            frames.append(frame)
            if carried.came_s is None:
                carried.came_s = now_s
        return frames

    def carried(self, since_s: float, until_s: float) -> list[Carried]:
        """Return the frames sent in an interval, from the last LOGGED ones."""
        return [each for each in self._log if since_s <= each.sent_s <= until_s]
