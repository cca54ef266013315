"""Processor usage of a process."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

WINDOW_S: Final = 1.0
"""Shortest time over which the use is measured: the kernel counts in hundredths of a second."""

_UTIME, _STIME = 11, 12
"""Fields of /proc/PID/stat after the command's name."""


def processor_time_s(pid: int) -> float | None:
    """Return the time on processors so far, by Linux's proc(5); None if not available."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace")
    except OSError:
        return None
    numbers = text.rpartition(")")[2].split()
    return (int(numbers[_UTIME]) + int(numbers[_STIME])) / os.sysconf("SC_CLK_TCK")


class ProcessorUse:
    """Share of one processor that a process used recently."""

    def __init__(self) -> None:
        self._pid = 0
        self._before: tuple[float, float] | None = None
        self._share: float | None = None

    def share(self, pid: int, now_s: float) -> float | None:
        """Return the present share, 1.0 for a whole processor; None before the first figure."""
        if pid != self._pid:
            self._pid, self._before, self._share = pid, None, None
        if self._before is not None and now_s - self._before[0] < WINDOW_S:
            return self._share
        used_s = processor_time_s(pid)
        if used_s is None:
            return None
        if self._before is not None:
            self._share = (used_s - self._before[1]) / (now_s - self._before[0])
        self._before = now_s, used_s
        return self._share
