"""Locks that a loop can look at, so that it makes way for who waits."""

from __future__ import annotations

import threading


class PlanningLock:
    """A reentrant lock that knows whether it is taken."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self.taken = 0

    def __enter__(self) -> None:
        self._lock.acquire()
        self.taken += 1

    def __exit__(self, *_: object) -> None:
        self.taken -= 1
        self._lock.release()


class PoliteLock:
    """A reentrant lock that knows whether somebody waits for it, so that a loop which never
    sleeps can let them have it."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._waiting: set[int] = set()

    @property
    def awaited(self) -> bool:
        """True while another thread waits, or is about to take the lock."""
        return bool(self._waiting)

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            me = threading.get_ident()
            self._waiting.add(me)
            self._lock.acquire()
            self._waiting.discard(me)

    def __exit__(self, *_: object) -> None:
        self._lock.release()
