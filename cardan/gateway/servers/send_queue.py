"""Send queue of one client of a server: control first, the newest sample of a topic wins.

No I/O: `SendQueue.take` returns due frames. Time is monotonic, in seconds.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

MAX_CONTROL_FRAMES = 10_000
"""Most waiting frames of a client that are no publications."""

LATCHED_DEPTH = 100
"""Most waiting messages of a latched topic for a client: each publisher has its own last one, and
all of them count."""

Frame = str | bytes
"""A WebSocket message: text or binary."""


class Pace(Protocol):
    """Pace of a topic's messages for a client."""

    @property
    def throttle_s(self) -> float:
        """Shortest time between two messages; 0: no limit."""

    @property
    def queue_length(self) -> int:
        """Most messages that wait while the client is not ready; 0: only the newest."""


PaceT = TypeVar("PaceT", bound=Pace)
SampleT = TypeVar("SampleT")


class TopicQueue(Generic[PaceT, SampleT]):
    """Queue of a topic for a client."""

    def __init__(self, topic: str, delivery: PaceT) -> None:
        self.topic = topic
        """Name that the client uses."""
        self.delivery = delivery
        self.next_s = float("-inf")
        """Earliest time of the next message."""
        self.waiting: deque[SampleT] = deque()


@dataclass(slots=True)
class Due(Generic[PaceT, SampleT]):
    """A publication that is to be sent now."""

    stream: TopicQueue[PaceT, SampleT]
    sample: SampleT


class SendQueue(Generic[PaceT, SampleT]):
    """Send queue of one client. Newer publications replace older ones, which bounds them; control
    frames are never dropped: `overflowed` if there are too many."""

    def __init__(self, max_control_bytes: int) -> None:
        self.overflowed = False
        """True if there were too many control frames: the client does not read."""
        self.superseded = 0
        """Count of publications replaced by newer ones."""
        self._max_control_bytes = max_control_bytes
        self._control: deque[Frame] = deque()
        self._control_bytes = 0
        self._ready: deque[TopicQueue[PaceT, SampleT]] = deque()
        """Streams with waiting messages, in the order of their turns."""

    @property
    def has_control(self) -> bool:
        """True if frames that are no publications wait."""
        return bool(self._control)

    def add_control(self, frame: Frame) -> None:
        """Add a frame that is no publication."""
        self._control.append(frame)
        self._control_bytes += len(frame)
        if self._control_bytes > self._max_control_bytes or len(self._control) > MAX_CONTROL_FRAMES:
            self.overflowed = True

    def offer(
        self, stream: TopicQueue[PaceT, SampleT], sample: SampleT, now_s: float, free: bool
    ) -> bool:
        """Offer a publication; return whether it is to be sent at once. `free`: the connection to
        the client is."""
        throttle_s, queue_length = stream.delivery.throttle_s, stream.delivery.queue_length
        due = now_s >= stream.next_s
        if due and free and not stream.waiting and not self._control:
            stream.next_s = now_s + throttle_s
            return True
        if not due and not queue_length and not stream.waiting:
            return False  # It asked for one message per interval.
        if not stream.waiting:
            self._ready.append(stream)
        elif len(stream.waiting) >= max(1, queue_length):
            stream.waiting.popleft()
            self.superseded += 1
        stream.waiting.append(sample)
        return False

    def take(self, now_s: float) -> Frame | Due[PaceT, SampleT] | None:
        """Return the next control frame or publication to send; None if nothing is due."""
        if self._control:
            frame = self._control.popleft()
            self._control_bytes -= len(frame)
            return frame
        for _ in range(len(self._ready)):
            stream = self._ready.popleft()
            if stream.next_s > now_s:
                self._ready.append(stream)
                continue
            sample = stream.waiting.popleft()
            if stream.waiting:
                self._ready.append(stream)
            stream.next_s = now_s + stream.delivery.throttle_s
            return Due(stream, sample)
        return None

    def due_s(self) -> float | None:
        """Earliest time at which `take` has a frame; None: not before a new one arrives."""
        if self._control:
            return float("-inf")
        return min((stream.next_s for stream in self._ready), default=None)

    def forget(self, stream: TopicQueue[PaceT, SampleT]) -> None:
        """Remove a stream that the client unsubscribed."""
        if stream.waiting:
            stream.waiting.clear()
            self._ready.remove(stream)
