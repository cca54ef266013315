"""Scheduling of a control loop: precedence on the processor and in the interpreter, and processors
that do not sleep."""

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


LATENCY_FILE = "/dev/cpu_dma_latency"
"""File of Linux' power management: the latency written into it, as a native 32-bit integer of µs,
is the longest time in which a processor may wake, for as long as the file is open."""

_awake: list[int] = []
"""Descriptor of the open file, if there is one."""


def keep_processors_awake(*, awake: bool) -> None:
    """Keep the processors from sleeping, or let them, until changed or until this process ends.

    A processor that sleeps wakes tens of µs after a message has arrived. Linux allows this to
    users who may write LATENCY_FILE. It costs power, as idle processors poll. A process with
    ordinary scheduling by SCHEDULING_VARIABLE does not ask for it.
    """
    if awake and not _awake and os.environ.get(SCHEDULING_VARIABLE) != "ordinary":
        with contextlib.suppress(OSError):
            _awake.append(os.open(LATENCY_FILE, os.O_WRONLY | os.O_CLOEXEC))
            os.write(_awake[0], bytes(4))
    elif not awake and _awake:
        os.close(_awake.pop())


SWITCH_INTERVAL_S = 1e-4
"""Time after which a computing thread releases the interpreter. Python's own 5 ms are longer than
EGM's period: a verb planned beside the loop would cost it control instants."""


def share_interpreter_promptly() -> None:
    """Let every thread of this process yield to the loop's thread within SWITCH_INTERVAL_S."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
