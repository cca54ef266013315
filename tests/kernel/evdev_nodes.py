"""Event nodes of the kernel, read with nothing but the structures of linux/input.h."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

EVENT = struct.Struct("llHHi")
EV_SYN, EV_KEY, EV_ABS = 0, 1, 3


def nodes_called(name: str) -> list[str]:
    """Event nodes of the input devices with this name, oldest first."""
    return [
        f"/dev/input/{folder.parent.name}"
        for folder in sorted(Path("/sys/class/input").glob("event*/device"))
        if (folder / "name").read_text().strip() == name
    ]


@contextmanager
def events_of(node: str) -> Iterator[EventReader]:
    """Read the events of a node from now on."""
    fd = os.open(node, os.O_RDONLY | os.O_NONBLOCK)
    try:
        yield EventReader(fd)
    finally:
        os.close(fd)


class EventReader:
    """Collects events as (type, code, value)."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self.events: list[tuple[int, int, int]] = []

    def gather(self) -> list[tuple[int, int, int]]:
        """All events so far, without synchronization events."""
        while True:
            try:
                data = os.read(self._fd, 64 * EVENT.size)
            except BlockingIOError:
                return self.events
            for _, _, kind, code, value in EVENT.iter_unpack(data):
                if kind != EV_SYN:
                    self.events.append((kind, code, value))
