"""Program at the server's socket: its requests and settings, and its send queue."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from cardan.protocols.spnav.codes import MASK_V1
from cardan_spnav_server.protocol import (
    INT_MAX,
    INT_MIN,
    MASK_V0,
    ClientReader,
    StringAssembler,
    encode_button,
    encode_motion,
)

QUIET_S = 0.05
"""Time after its last request in which a new client gets no events: libspnav discards pending
records before a request, and takes the next record for the answer."""

NEW_FOR_S = 2.0
"""Time for which a client counts as new, independent of its requests."""

UNREAD_EDGES = 256
"""Unread button and device events after which a client is disconnected."""

UNREAD_REPLIES = 4096
"""Unread reply records after which a client is disconnected; a long string has 2731."""


class _Motion:
    """A waiting motion, which is merged with the next ones until the client reads it."""

    __slots__ = ("counts", "period_ms")

    def __init__(self, counts: Sequence[int], period_ms: int) -> None:
        self.counts = counts
        self.period_ms = period_ms


class SpnavClient:
    """Settings of a client and its queue.

    Motion is kept as the newest since the last other event; other events are all kept, in order.
    Replies overtake events.
    """

    def __init__(self, now_s: float) -> None:
        self.reader = ClientReader()
        self.sensitivity = 1.0
        self.mask: int = MASK_V0
        self.name = ""
        self.strings = StringAssembler()
        self._pressed: set[int] = set()
        """Buttons that the client will see as pressed after it has read all events."""
        self._connected_s = now_s
        self._quiet_until_s = now_s + QUIET_S
        self._replies: deque[bytes] = deque()
        self._events: deque[_Motion | bytes] = deque()
        self._edges = 0
        self._sending = b""
        self.failure = ""
        """Reason to disconnect the client; empty: none."""

    def shake_hands(self, version: int) -> None:
        """Use protocol `version` for the client from now on."""
        if version:
            self.mask = MASK_V1

    def on_request(self, now_s: float) -> None:
        """Record the time of a request."""
        if now_s < self._quiet_until_s:
            end_s = self._connected_s + NEW_FOR_S
            self._quiet_until_s = min(now_s + QUIET_S, end_s)

    def reply(self, record: bytes) -> None:
        """Queue a reply."""
        if len(self._replies) >= UNREAD_REPLIES:
            self.failure = f"it left {UNREAD_REPLIES} replies unread"
            return
        self._replies.append(record)

    def motion(self, counts: Sequence[int], period_ms: int) -> None:
        """Queue a motion of `counts`, before this client's sensitivity."""
        if self._events and isinstance(self._events[-1], _Motion):
            last = self._events[-1]
            last.counts = counts
            last.period_ms += period_ms
        else:
            self._events.append(_Motion(counts, period_ms))

    def button(self, number: int, pressed: bool) -> None:
        """Queue a press or release of a button."""
        (self._pressed.add if pressed else self._pressed.discard)(number)
        self.event(encode_button(number, pressed))

    def hold(self, numbers: set[int]) -> None:
        """Queue the edges after which exactly these buttons are pressed, releases first."""
        for number in sorted(self._pressed - numbers):
            self.button(number, False)
        for number in sorted(numbers - self._pressed):
            self.button(number, True)

    def event(self, record: bytes) -> None:
        """Queue an event that must not be lost."""
        if self._edges >= UNREAD_EDGES:
            self.failure = f"it left {UNREAD_EDGES} events unread"
            return
        self._events.append(record)
        self._edges += 1

    def outgoing(self, now_s: float) -> bytes:
        """Return the next bytes to send, a record or the rest of one; empty: nothing yet."""
        if not self._sending:
            if self._replies:
                self._sending = self._replies.popleft()
            elif self._events and now_s >= self._quiet_until_s:
                item = self._events.popleft()
                if isinstance(item, _Motion):
                    self._sending = self._encoded(item)
                else:
                    self._edges -= 1
                    self._sending = item
        return self._sending

    def sent(self, size: int) -> None:
        """Record that `size` bytes of `outgoing` were sent."""
        self._sending = self._sending[size:]

    @property
    def due_s(self) -> float:
        """Time at which delayed events are due; inf: there are none."""
        if self._sending or not self._events:
            return math.inf
        return self._quiet_until_s

    def _encoded(self, motion: _Motion) -> bytes:
        counts, sensitivity = motion.counts, self.sensitivity
        if sensitivity != 1.0:
            counts = [int(min(INT_MAX, max(INT_MIN, count * sensitivity))) for count in counts]
        return encode_motion(counts, motion.period_ms)
