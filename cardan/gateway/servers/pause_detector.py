"""Detector of pauses of this process: it was stopped, or its computer slept.

Messages that clients sent meanwhile wait in the system's buffers, and must not move an arm when the
process resumes: their sender may be gone.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

STOOD_STILL_S = 1.0
"""Least duration of a pause: a process with its normal share of a busy computer waits for a tenth
of it."""

BEAT_S = 0.1
"""Period of checks, in addition to those at each frame."""

BUSY_SHARE = 0.5
"""Share of working time at which a thread was busy and not paused."""

_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Clock that continues while the computer sleeps, if there is one."""


class StandStill:
    """Reports pauses of the process. All but `standing` is for one thread."""

    def __init__(self, tell: Callable[[float], None]) -> None:
        """`tell` is called with the length of a pause, s."""
        self._tell = tell
        self._looked: tuple[float, float] | None = None
        """Time of the last check, and the working time of the process then."""
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Check periodically in the running loop. A loop's timer is due before any received data is
        handled."""
        self._timer = asyncio.get_running_loop().call_later(BEAT_S, self.start)
        self.look()

    def stop(self) -> None:
        """Stop checking."""
        if self._timer is not None:
            self._timer.cancel()

    def look(self) -> None:
        """Check the time since the last check."""
        self.observe(time.clock_gettime(_CLOCK), time.process_time())

    def observe(self, now_s: float, worked_s: float) -> None:
        """Check at `now_s`, when the process had worked for `worked_s`."""
        passed_s = self._stood_s(now_s, worked_s)
        self._looked = now_s, worked_s
        if passed_s > 0.0:
            self._tell(passed_s)

    @property
    def standing(self) -> bool:
        """True if the process was paused since the last check. From any thread."""
        return self._stood_s(time.clock_gettime(_CLOCK), time.process_time()) > 0.0

    def _stood_s(self, now_s: float, worked_s: float) -> float:
        """Return the length of the pause since the last check; 0: none."""
        if self._looked is None:
            return 0.0
        passed_s = now_s - self._looked[0]
        busy = worked_s - self._looked[1] >= BUSY_SHARE * passed_s
        return passed_s if passed_s > STOOD_STILL_S and not busy else 0.0
