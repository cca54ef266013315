"""Detector of pauses of this process: it was stopped, or its computer slept.

Messages that clients sent meanwhile wait in the system's buffers, and none may move an arm when the
process goes on: their sender may be gone.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

STOOD_STILL_S = 1.0
"""A process that did nothing for so long stood still: one with no more than its share of a busy
computer waits for a tenth of it."""

BEAT_S = 0.1
"""How often it is looked, besides at each frame that comes."""

BUSY_SHARE = 0.5
"""A thread that worked for this share of the time was busy and did not stand still."""

_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Goes on while the computer sleeps, where there is such a clock."""


class StandStill:
    """Reports pauses of the process. All but `standing` is for one thread."""

    def __init__(self, tell: Callable[[float], None]) -> None:
        """`tell` is called with the time, in s, that it stood still for."""
        self._tell = tell
        self._looked: tuple[float, float] | None = None
        """When it was looked last, and how long the process had worked then."""
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Look again and again, in the running loop. A timer of a loop is due before anything that
        arrived is handed on."""
        self._timer = asyncio.get_running_loop().call_later(BEAT_S, self.start)
        self.look()

    def stop(self) -> None:
        """Look no more."""
        if self._timer is not None:
            self._timer.cancel()

    def look(self) -> None:
        """Look how long ago it was looked last."""
        self.observe(time.clock_gettime(_CLOCK), time.process_time())

    def observe(self, now_s: float, worked_s: float) -> None:
        """The same, at `now_s`, when the process had worked for `worked_s`."""
        passed_s = self._stood_s(now_s, worked_s)
        self._looked = now_s, worked_s
        if passed_s > 0.0:
            self._tell(passed_s)

    @property
    def standing(self) -> bool:
        """Whether it stood still, and it was not looked since. From any thread."""
        return self._stood_s(time.clock_gettime(_CLOCK), time.process_time()) > 0.0

    def _stood_s(self, now_s: float, worked_s: float) -> float:
        """For how long it stood still since it was looked last; 0: it did not."""
        if self._looked is None:
            return 0.0
        passed_s = now_s - self._looked[0]
        busy = worked_s - self._looked[1] >= BUSY_SHARE * passed_s
        return passed_s if passed_s > STOOD_STILL_S and not busy else 0.0
