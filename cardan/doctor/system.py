"""Checks of the kernel and of the computer's clock for a control loop."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from typing import Final

from cardan.common.realtime import FIFO_PRIORITY
from cardan.doctor.base import Check, Finding, Subject, caution, good
from cardan.drivers.haptic import HapticDevice

GROUP = "system"

LIMITS_FILE: Final = "/etc/security/limits.d/50-cardan.conf"

HAPTIC_PRIORITY: Final = 99
"""Limit that a user needs for haptic devices, whose force loop runs above the session's."""

CAP_SYS_NICE: Final = 23
CAP_IPC_LOCK: Final = 14
"""Capabilities that lift the limits (linux/capability.h)."""

MOST_LOAD: Final = 1.0
"""Runnable processes per processor beyond which some of them wait."""

SLOW_GOVERNORS: Final = frozenset({"powersave", "conservative"})
GOOD_CLOCKS: Final = frozenset(
    {
        "tsc",
        "kvm-clock",
        "hyperv_clocksource_tsc_page",
        "xen",
        "arch_sys_counter",
        "riscv_clocksource",
    }
)
"""Clocks that are read without a system call, or nearly."""

UNLIMITED: Final = -1


def has_capability(status: str, number: int) -> bool:
    """Read from /proc/PID/status whether a process has a capability."""
    found = re.search(r"^CapEff:\s*([0-9a-f]+)$", status, re.MULTILINE)
    return found is not None and bool(int(found[1], 16) >> number & 1)


def check_scheduling(limit: int, capable: bool, haptic: bool) -> Finding:
    """Check that sessions may use real-time scheduling. `limit`: RLIMIT_RTPRIO."""
    need = HAPTIC_PRIORITY if haptic else FIFO_PRIORITY
    if capable or limit == UNLIMITED or limit >= need:
        allowed = "without a limit" if capable or limit == UNLIMITED else f"up to priority {limit}"
        return good("real-time", f"real-time scheduling is allowed, {allowed}")
    return caution(
        "real-time",
        f"real-time scheduling is allowed up to priority {limit}, and {need} is needed"
        if limit
        else "real-time scheduling is not allowed",
        "the robot's cycles are answered late while other programs work",
        f'echo "$USER - rtprio {need}" | sudo tee {LIMITS_FILE}, then log in again',
    )


def check_memory_lock(limit: int, capable: bool, haptic: bool) -> Finding:
    """Check that libraries may lock memory. `limit`: RLIMIT_MEMLOCK, bytes."""
    enough = 64 << 20
    if capable or limit == UNLIMITED or limit >= enough or not haptic:
        amount = "unlimited" if capable or limit == UNLIMITED else f"{limit / 2**20:.0f} MiB"
        return good("memory-lock", f"memory that may be locked: {amount}")
    return caution(
        "memory-lock",
        f"memory that may be locked: {limit / 2**20:.0f} MiB",
        "Cardan locks none, but a haptic device's library may want to, and pauses when its memory "
        "is swapped out",
        f'echo "$USER - memlock unlimited" | sudo tee -a {LIMITS_FILE}, then log in again',
    )


def check_governors(governors: Mapping[str, str]) -> Finding:
    """Check that processors keep their clock rate. `governors`: by processor, or empty."""
    kinds = sorted(set(governors.values()))
    if not kinds:
        return good("governor", "the system does not change the processors' frequency")
    if slow := [kind for kind in kinds if kind in SLOW_GOVERNORS]:
        return caution(
            "governor",
            f"the processors' frequency is governed by {' and '.join(slow)}",
            "a loop that sleeps most of each cycle is run at the lowest frequency, and its "
            "latency grows",
            "sudo cpupower frequency-set -g performance",
        )
    return good("governor", f"the processors' frequency is governed by {' and '.join(kinds)}")


def check_clock(name: str, available: str) -> Finding:
    """Check that reading the clock is quick. `available`: the names of all, separated by spaces."""
    if not name or name in GOOD_CLOCKS:
        return good("clock", f"clock source {name or 'unknown'}")
    better = next((each for each in available.split() if each in GOOD_CLOCKS), "")
    path = "/sys/devices/system/clocksource/clocksource0/current_clocksource"
    return caution(
        "clock",
        f"clock source {name}" + (f", where there is {better}" if better else ""),
        "each reading of the clock is a system call of some microseconds",
        f"echo {better} | sudo tee {path}"
        if better
        else "`sudo dmesg | grep -i tsc` says why the kernel does not trust the processor's clock",
    )


def check_load(load: float, processors: int) -> Finding:
    """Check that the computer is not overloaded. `load`: the mean of the last minute."""
    what = f"load {load:.1f} on {processors} processor{'s' * (processors != 1)}"
    if load <= MOST_LOAD * processors:
        return good("load", what)
    return caution(
        "load",
        what,
        "cycles are late where the session has no real-time scheduling",
        "top -o %CPU, and end programs that need not run",
    )


def _is_haptic(subject: Subject) -> bool:
    return any(isinstance(each.driver, HapticDevice) for each in subject.used())


def _limit(name: str) -> int:
    """Return a limit of this process; UNLIMITED if the system has none."""
    try:
        import resource
    except ImportError:  # Not on Windows.
        return UNLIMITED
    if (number := getattr(resource, name, None)) is None:
        return UNLIMITED
    soft, _hard = resource.getrlimit(number)
    return UNLIMITED if soft == resource.RLIM_INFINITY else soft


class Scheduling(Check):
    """Permission to use real-time scheduling."""

    group, tells = GROUP, ("real-time",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        capable = has_capability(subject.read("proc/self/status"), CAP_SYS_NICE)
        return [check_scheduling(_limit("RLIMIT_RTPRIO"), capable, _is_haptic(subject))]


class MemoryLock(Check):
    """Memory that the user may lock against swapping."""

    group, tells = GROUP, ("memory-lock",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        capable = has_capability(subject.read("proc/self/status"), CAP_IPC_LOCK)
        return [check_memory_lock(_limit("RLIMIT_MEMLOCK"), capable, _is_haptic(subject))]


class Governor(Check):
    """Frequency governor of the processors."""

    group, tells = GROUP, ("governor",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        folder = subject.root / "sys/devices/system/cpu"
        paths = sorted(folder.glob("cpu[0-9]*/cpufreq/scaling_governor"))
        found = {path.parts[-3]: subject.read_path(path) for path in paths}
        return [check_governors({name: each for name, each in found.items() if each})]


class Clock(Check):
    """Clock source of the kernel."""

    group, tells = GROUP, ("clock",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        folder = "sys/devices/system/clocksource/clocksource0"
        names = (subject.read(f"{folder}/{each}_clocksource") for each in ("current", "available"))
        return [check_clock(*names)]


class Load(Check):
    """Load of the computer."""

    group, tells = GROUP, ("load",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        words = subject.read("proc/loadavg").split()
        if not words:
            return []
        return [check_load(float(words[0]), os.cpu_count() or 1)]
