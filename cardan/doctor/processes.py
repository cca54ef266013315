"""Open files and sockets of processes, read from /proc."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from cardan.common.files import text_or_empty

_PARENT = re.compile(r"^PPid:\s*(\d+)$", re.MULTILINE)
_MOST_ANCESTORS = 8
_WORDS_SHOWN = 80


class Holder(NamedTuple):
    """Process that has a file or socket open."""

    pid: int
    command: str
    """Its command line, shortened."""
    is_ours: bool
    """True if it belongs to a command of Cardan."""

    def __str__(self) -> str:
        return f"{self.command} (pid {self.pid})"


def holders(targets: Iterable[str], root: Path = Path("/")) -> dict[str, Holder]:
    """Return the processes that have each of these files or sockets ("/dev/hidraw0",
    "socket:[4711]") open. A user sees their own processes, the superuser all."""
    wanted = set(targets)
    found: dict[str, Holder] = {}
    for process in processes(root):
        if not wanted - found.keys():
            break
        if process.name == str(os.getpid()):
            continue
        try:
            opened = list((process / "fd").iterdir())
        except OSError:
            continue
        for each in opened:
            with contextlib.suppress(OSError):
                target = os.readlink(each)
                if target in wanted:
                    found.setdefault(target, _holder(process))
    return found


def processes(root: Path) -> Iterator[Path]:
    """Yield the folders of all processes."""
    with contextlib.suppress(OSError):
        yield from (each for each in (root / "proc").iterdir() if each.name.isdecimal())


def named(name: str, root: Path = Path("/")) -> list[int]:
    """Return the processes of the program `name`."""
    return sorted(
        int(each.name) for each in processes(root) if text_or_empty(each / "comm") == name
    )


def _holder(process: Path) -> Holder:
    words = _words(process)
    command = " ".join(words) or text_or_empty(process / "comm") or "a program"
    if len(command) > _WORDS_SHOWN:
        command = command[: _WORDS_SHOWN - 3] + "..."
    return Holder(int(process.name), command, _is_ours(process))


def _is_ours(process: Path) -> bool:
    """Return True if a process or one of its ancestors is the command of Cardan."""
    for _ in range(_MOST_ANCESTORS):
        words = _words(process)
        if any(os.path.basename(word) == "cardan" for word in words[:3]):
            return True
        parent = _PARENT.search(text_or_empty(process / "status"))
        if parent is None or parent[1] in ("0", "1"):
            return False
        process = process.parent / parent[1]
    return False


def _words(process: Path) -> list[str]:
    return [word for word in text_or_empty(process / "cmdline").split("\0") if word]
