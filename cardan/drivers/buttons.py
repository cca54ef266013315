"""State of a device's buttons, with all edges, for one consumer."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from cardan.types import ButtonEvent

MAX_EVENTS = 4096
"""Most button edges queued; beyond it the oldest are dropped and counted."""


class ButtonEdges:
    """Button edges, computed from the set of buttons that are down.

    A button that was down when the device was lost must not act when the device is back: after
    `release_all` it counts as up until the device has reported it up.
    """

    def __init__(self) -> None:
        self.held: frozenset[str] = frozenset()
        self.lost_edges = 0
        self.masked: frozenset[str] = frozenset()
        """Buttons that count as released until they are reported released."""
        self.queued: deque[ButtonEvent] = deque(maxlen=MAX_EVENTS)
        """Edges since the last call of `events`."""

    def set(self, labels: Sequence[str], now_s: float) -> None:
        """Set the pressed buttons to `labels` at `now_s`. Queues the edges, releases first."""
        if self.masked:
            self.masked &= frozenset(labels)
            labels = [label for label in labels if label not in self.masked]
        self._show(labels, now_s)

    def mask(self, labels: Sequence[str]) -> None:
        """Count these as released until they are reported released: the time of their press is
        unknown."""
        self.masked |= frozenset(labels)

    def release_all(self, now_s: float) -> None:
        """Count every button as released, because their state is unknown now."""
        self.masked |= self.held
        self._show((), now_s)

    def events(self) -> list[ButtonEvent]:
        """Return and clear the edges since the last call, oldest first."""
        events = list(self.queued)
        self.queued.clear()
        return events

    def _show(self, labels: Sequence[str], now_s: float) -> None:
        held = frozenset(labels)
        if held == self.held:
            return
        edges = [ButtonEvent(now_s, label, False) for label in sorted(self.held - held)]
        edges += [
            ButtonEvent(now_s, label, True)
            for label in dict.fromkeys(labels)
            if label not in self.held
        ]
        self.lost_edges += max(0, len(self.queued) + len(edges) - MAX_EVENTS)
        self.queued.extend(edges)
        self.held = held
