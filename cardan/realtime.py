"""Asks the system to run this process before others, as a control loop should be."""

from __future__ import annotations

import contextlib
import os

FIFO_PRIORITY = 10
"""Above everything ordinary; below the kernel's own interrupt threads, which run at 50."""

NICE = -10
"""The next best thing, where real-time scheduling is not allowed."""


def ask_for_real_time() -> str:
    """Use the best scheduling this user is allowed; returns its name.

    Linux lets root have it, and users whom ``/etc/security/limits.d`` gives rtprio. Threads
    started later have it too.
    """
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
            return "real time"
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
        return "raised priority"
    return "ordinary"
