"""Detects pauses of this computer: a virtual machine without a processor, a laptop's closed lid."""

from __future__ import annotations

import os
import threading
import time

LOOKED_EVERY_S = 0.005


class Pauses:
    """Measure in a ``with`` block how late this computer is, on each of its processors.

    A thread per processor sleeps for 5 ms at a time. Other programs on that processor were woken as
    late as the thread, unless they have real-time scheduling.
    """

    def __init__(self) -> None:
        self.longest_s = 0.0
        """Longest delay of a processor."""
        self._ended = threading.Event()
        self._threads = [
            threading.Thread(target=self._look, args=(processors,), daemon=True, name="pauses")
            for processors in _processors()
        ]

    def __enter__(self) -> Pauses:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_exception: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()

    def _look(self, processors: set[int]) -> None:
        """Measure until the block ends, on these processors alone, or on all if none is given."""
        if processors:
            os.sched_setaffinity(0, processors)  # of this thread
        woken_s = time.monotonic()
        while not self._ended.is_set():
            time.sleep(LOOKED_EVERY_S)
            now_s = time.monotonic()
            self.longest_s = max(self.longest_s, now_s - woken_s - LOOKED_EVERY_S)
            woken_s = now_s


def _processors() -> list[set[int]]:
    """Return the processors of this process one by one, if the system can tell them apart."""
    try:
        return [{processor} for processor in os.sched_getaffinity(0)]
    except AttributeError:  # only Linux can
        return [set()]
