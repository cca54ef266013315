"""Library in this process as a transport, for `cardan.conform.live`."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator

from cardan.conform.transports import LARGEST_READ, TargetWire, Wires
from cardan_omni.conform.calls import HdCalls
from cardan_omni.driver.library import load

REPORT_EVERY = 20
"""Number of ticks after which the reader is woken: a thread that wakes takes time from the
scheduler's thread."""


class _Program(TargetWire):
    def __init__(self, path: str) -> None:
        self._reading, self._writing = os.pipe()
        for each in (self._reading, self._writing):
            os.set_blocking(each, False)
        self._ticks = 0
        self._answers: list[bytes] = []
        self._calls = HdCalls(load(path), time.monotonic, self._ticked)
        self._answers.append(self._calls.began)

    def fileno(self) -> int:
        return self._reading

    def _ticked(self) -> None:
        self._ticks += 1
        if self._ticks % REPORT_EVERY == 0:
            self._wake()

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            os.write(self._writing, b"x")

    def read(self) -> Iterator[tuple[bytes, str]]:
        with contextlib.suppress(OSError):
            os.read(self._reading, LARGEST_READ)
        answers, self._answers = self._answers, []
        for each in (*answers, *self._calls.ticks()):
            yield each, ""

    def write(self, data: bytes) -> None:
        self._answers += self._calls.ticks()
        self._answers.append(self._calls.do(data))
        self._wake()

    def close(self) -> None:
        self._calls.end()
        os.close(self._reading)
        os.close(self._writing)


class Library(Wires):
    """Library at `path`, which stays loaded until the process ends."""

    def __init__(self, path: str) -> None:
        self._path = path

    def open(self, channel: str) -> TargetWire:
        return _Program(self._path)
