"""Send queue of one client of a server: control first, the newest sample of a topic wins.

Nothing here sends: `SendQueue.take` returns due frames. Time is monotonic, in seconds.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

MAX_CONTROL_FRAMES = 10_000
"""Most frames that are no publications and wait for a client to read."""

LATCHED_DEPTH = 100
"""Messages of a latched topic that wait for a client: each of its publishers has its own last one,
and all of them count."""

Frame = str | bytes
"""A WebSocket message: text or binary."""


class Pace(Protocol):
    """How a topic's messages reach a client."""

    @property
    def throttle_s(self) -> float:
        """Shortest time between two messages; 0: any."""

    @property
    def queue_length(self) -> int:
        """How many wait while the client is not ready; 0: the newest alone."""


PaceT = TypeVar("PaceT", bound=Pace)
SampleT = TypeVar("SampleT")


class TopicQueue(Generic[PaceT, SampleT]):
    """A topic on its way to a client."""

    def __init__(self, topic: str, delivery: PaceT) -> None:
        self.topic = topic
        """Name that the client uses."""
        self.delivery = delivery
        self.next_s = float("-inf")
        """When the next message may go out."""
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
        """There were too many control frames: the client does not read."""
        self.superseded = 0
        """Publications that newer ones took the place of."""
        self._max_control_bytes = max_control_bytes
        self._control: deque[Frame] = deque()
        self._control_bytes = 0
        self._ready: deque[TopicQueue[PaceT, SampleT]] = deque()
        """Streams with something that waits, in the order of their turns."""

    @property
    def has_control(self) -> bool:
        """Whether frames that are no publications wait."""
        return bool(self._control)

    def add_control(self, frame: Frame) -> None:
        """A frame that is no publication."""
        self._control.append(frame)
        self._control_bytes += len(frame)
        if self._control_bytes > self._max_control_bytes or len(self._control) > MAX_CONTROL_FRAMES:
            self.overflowed = True

    def offer(
        self, stream: TopicQueue[PaceT, SampleT], sample: SampleT, now_s: float, free: bool
    ) -> bool:
        """A publication: true where it is to be sent at once. `free`: the way to the client is."""
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
        """When `take` has something; None: not before something new comes."""
        if self._control:
            return float("-inf")
        return min((stream.next_s for stream in self._ready), default=None)

    def forget(self, stream: TopicQueue[PaceT, SampleT]) -> None:
        """The client does not want the stream any more."""
        if stream.waiting:
            stream.waiting.clear()
            self._ready.remove(stream)
