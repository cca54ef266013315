"""Resources that processes use (from /proc), and those left behind after their end."""

from __future__ import annotations

import contextlib
import os
import stat
import time
from pathlib import Path
from typing import NamedTuple

_TICKS_S = os.sysconf("SC_CLK_TCK")


class Use(NamedTuple):
    """Resources that a process uses now."""

    rss_mb: float
    fds: int
    threads: int
    cpu_s: float
    """Processor time since its start."""


def use_of(pid: int) -> Use | None:
    """Return a process's present use; None if it has ended."""
    try:
        status = dict(
            line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines()
        )
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return Use(
            int(status["VmRSS"].split()[0]) / 1024.0,
            len(os.listdir(f"/proc/{pid}/fd")),
            int(status["Threads"]),
            (int(fields[11]) + int(fields[12])) / _TICKS_S,
        )
    except (OSError, KeyError, ValueError):
        return None


def is_marked(pid: int, mark: str) -> bool:
    """Return True if the environment of a process has ``MARK=TOKEN``."""
    with contextlib.suppress(OSError):
        return mark.encode() in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    return False


def marked_processes(mark: str) -> dict[int, str]:
    """List the processes whose environment has ``MARK=TOKEN``, except this one: id and command."""
    found = {}
    for each in os.listdir("/proc"):
        if not each.isdigit() or int(each) == os.getpid():
            continue
        with contextlib.suppress(OSError):
            if is_marked(int(each), mark):
                words = Path(f"/proc/{each}/cmdline").read_bytes().replace(b"\0", b" ")
                if words:
                    found[int(each)] = words.decode(errors="replace").strip()
    return found


def shared_memory(pid: int) -> set[str]:
    """List the files of shared memory that a process has mapped."""
    with contextlib.suppress(OSError):
        text = Path(f"/proc/{pid}/maps").read_text()
        return {
            line.split(maxsplit=5)[5]
            for line in text.splitlines()
            if line.count("/dev/shm/") and not line.endswith("(deleted)")
        }
    return set()


def left_behind(folder: Path, mark: str, mapped: set[str], within_s: float) -> list[str]:
    """List what is left at the end of a soak: processes, sockets, shared memory, temporary files.
    Processes that are just ending get some time."""
    give_up_s = time.monotonic() + within_s
    while marked_processes(mark) and time.monotonic() < give_up_s:
        time.sleep(0.1)
    found = [f"process {pid}: {words:.200}" for pid, words in marked_processes(mark).items()]
    for path in sorted(folder.rglob("*")):
        with contextlib.suppress(OSError):
            if stat.S_ISSOCK(path.lstat().st_mode):
                found.append(f"socket {path.relative_to(folder)}")
    found += [
        f"file {path.relative_to(folder)}"
        for name in ("tmp", "run")
        for path in sorted((folder / name).rglob("*"))
        if not stat.S_ISSOCK(path.lstat().st_mode)
    ]
    found += [f"shared memory {path}" for path in sorted(mapped) if os.path.exists(path)]
    return found
