"""Queue from any threads to one waiting thread, with reliable time-outs. The standard library's
``SimpleQueue.get`` with a time-out may wait for ever in CPython 3.10 to 3.12: it can miss its
time-out. ``queue.Queue`` takes a lock for each `put`, so that a loop's thread would wait for one
that is not running."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

T = TypeVar("T")


class Wake(Protocol):
    """Methods of a lock that an inbox needs."""

    def acquire(self, blocking: bool = True, timeout: float = -1.0) -> bool: ...
    def release(self) -> None: ...


class InboxEmptyError(Exception):
    """Error: no item arrived in time."""


class Inbox(Generic[T]):
    """Items in order of arrival. Any thread may put, one thread gets."""

    def __init__(
        self,
        most: int | None = None,
        *,
        wake: Wake | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`most`: largest number of items, beyond which the oldest are dropped; None: unlimited.
        `wake` and `clock` are for tests."""
        self._items: deque[T] = deque(maxlen=most)
        # Held, except between a put and the get that it wakes.
        self._wake: Wake = threading.Lock() if wake is None else wake
        self._wake.acquire()
        self._clock = clock

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T) -> None:
        """Add an item. Never blocks."""
        self._items.append(item)
        with contextlib.suppress(RuntimeError):  # The wake-up is already under way.
            self._wake.release()

    def get(self, timeout_s: float | None = None) -> T:
        """Return the oldest item, or the next one. `timeout_s`: longest wait, 0 or less: none;
        None: unlimited. Raises InboxEmptyError if none arrives in time."""
        end_s = None if timeout_s is None else self._clock() + timeout_s
        while True:
            try:
                return self._items.popleft()
            except IndexError:
                pass
            if end_s is None:
                self._wake.acquire()
                continue
            left_s = end_s - self._clock()
            if left_s <= 0.0:
                raise InboxEmptyError
            # A lock takes no time that is negative, and none above TIMEOUT_MAX.
            self._wake.acquire(timeout=min(left_s, threading.TIMEOUT_MAX))
