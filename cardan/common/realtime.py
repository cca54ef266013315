"""Real-time scheduling of a control loop: the processor before others, the interpreter at once."""

from __future__ import annotations

import contextlib
import os
import sys

FIFO_PRIORITY = 10
"""Above everything ordinary; below the kernel's own interrupt threads, which run at 50."""

NICE = -10
"""The next best thing, where real-time scheduling is not allowed."""

SCHEDULING_VARIABLE = "CARDAN_SCHEDULING"
"""The environment variable by which a process that must not run before others, as a demo beside
sessions, is told so: "ordinary"."""


def ask_for_real_time() -> str:
    """Use the best scheduling this user is allowed; returns its name.

    Linux lets root have it, and users whom ``/etc/security/limits.d`` gives rtprio. Threads
    started later have it too.
    """
    if os.environ.get(SCHEDULING_VARIABLE) == "ordinary":
        return "ordinary"
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
            return "real time"
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
        return "raised priority"
    return "ordinary"


SWITCH_INTERVAL_S = 1e-4
"""After so long a thread that computes lets another have the interpreter. Python's own 5 ms are
more than EGM's period: a verb that is planned beside the loop would cost it control instants."""


def share_interpreter_promptly() -> None:
    """Have every thread of this process let the loop's thread go on within SWITCH_INTERVAL_S."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
