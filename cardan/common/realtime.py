"""Real-time scheduling of a control loop: precedence on the processor and in the interpreter."""

from __future__ import annotations

import contextlib
import os
import sys

FIFO_PRIORITY = 10
"""Priority above everything ordinary; below the kernel's own interrupt threads, which run at 50."""

NICE = -10
"""Nice value if real-time scheduling is not allowed."""

SCHEDULING_VARIABLE = "CARDAN_SCHEDULING"
"""The environment variable for a process that must not have precedence, such as a demo beside
sessions: "ordinary"."""


def ask_for_real_time() -> str:
    """Use the best scheduling this user is allowed; return its name. Linux allows it to root, and
    to users with rtprio in ``/etc/security/limits.d``. Threads started later have it too."""
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
"""Time after which a computing thread releases the interpreter. Python's own 5 ms are longer than
EGM's period: a verb planned beside the loop would cost it control instants."""


def share_interpreter_promptly() -> None:
    """Let every thread of this process yield to the loop's thread within SWITCH_INTERVAL_S."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
