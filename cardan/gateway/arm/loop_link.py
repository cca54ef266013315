"""Link between threads and the loop of an arm: its ticks, work for it to do, and its end."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from cardan.common.forks import IN_CHILD, give_up_in_children
from cardan.errors import DriverError, MotionLoopError

NOT_OPEN = "the arm is not open"
"""Reason for refusing requests to it."""

POLL_S = 0.05
"""Longest time between two checks of whether the loop still runs."""


class LoopLink:
    """Link between the loop that drives an arm and the threads that wait for its effects.

    The loop calls `begin`, `run_due` once a cycle, and `end`; all else is for other threads.
    """

    def __init__(self) -> None:
        self._ticked = threading.Condition()
        self._listeners = 0
        self._errands: deque[tuple[Callable[[], None], list[Exception | None]]] = deque()
        self._why_not = NOT_OPEN

    # -- for the loop ----------------------------------------------------------------------------

    def begin(self) -> None:
        """Mark the loop as running."""
        self._errands.clear()
        self._why_not = ""
        give_up_in_children(self)

    def run_due(self) -> None:
        """Run the functions queued by other threads and wake waiting threads; cheap if none."""
        while self._errands:
            errand, answer = self._errands.popleft()
            try:
                errand()
            except Exception as error:
                answer.append(error)
            else:
                answer.append(None)
        if self._listeners:
            with self._ticked:
                self._ticked.notify_all()

    def end(self, why: str) -> None:
        """Mark the loop as ended, for this reason."""
        self._why_not = why
        while self._errands:
            self._errands.popleft()[1].append(DriverError("the loop has ended"))
        with self._ticked:
            self._ticked.notify_all()

    def after_fork(self) -> None:
        """Mark the loop as absent in a forked child; the parent's goes on."""
        if not self._why_not:
            self._why_not = f"the arm is not open in this process: {IN_CHILD}"
        self._ticked, self._listeners = threading.Condition(), 0
        self._errands.clear()

    # -- for other threads -----------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Whether the loop drives the arm."""
        return not self._why_not

    def require(self) -> None:
        """Raise MotionLoopError unless the loop runs."""
        if self._why_not:
            raise MotionLoopError(self._why_not)

    def wait(self, timeout_s: float = POLL_S) -> None:
        """Wait until the next tick, or until the time is over."""
        self.wait_for(None, timeout_s)

    def wait_for(self, done: Callable[[], bool] | None, timeout_s: float) -> None:
        """Wait until `done` is true after a tick, or until the time is over."""
        with self._ticked:
            self._listeners += 1
            try:
                if done is None:
                    self._ticked.wait(timeout_s)
                else:
                    self._ticked.wait_for(done, timeout_s)
            finally:
                self._listeners -= 1

    def do(self, errand: Callable[[], None]) -> None:
        """Have the loop's thread call `errand`; raises its errors, or MotionLoopError."""
        answer: list[Exception | None] = []
        self._errands.append((errand, answer))
        while not answer:
            self.require()
            self.wait()
        if answer[0] is not None:
            raise answer[0]
