"""The daemon's processes: a session, or a server, from its start to its end.

Callbacks in separate threads report their output and their end.
"""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Final

from cardan.common.logs import FORMAT_VARIABLE, LEVEL_VARIABLE, LogFormat, level_of
from cardan.common.resource_errors import shortage
from cardan.gateway.arm.requests import is_answer
from cardan.gateway.daemon.client import SOCKET_VARIABLE
from cardan.gateway.daemon.restart_policy import Ended
from cardan.gateway.daemon.systemd_watchdog import HUNG_S, STARTS_WITHIN_S
from cardan.gateway.servers.stats import TELLS_VARIABLE, figures_of
from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.session import (
    EXIT_CANNOT_OPEN,
    EXIT_CONFIGURATION,
    EXIT_OK,
)
from cardan.gateway.session.snapshot import DeviceSnapshot, Snapshot
from cardan.gateway.session.supervisor import KILL_AFTER_S, SessionProcess

SERVER_LEAVES_WITHIN_S: Final = 8.0
"""Time after which a server that was requested to end is killed: it closes its clients'
connections."""

LINE_BYTES: Final = 4096
"""Longest line of output that is kept whole."""

LINES_AT_ONCE: Final = 1000
LINES_A_SECOND: Final = 200
"""Most lines taken from a process, at once and per second; further ones are only counted. A flood
of lines from one process would keep the daemon from the others."""

_log = logging.getLogger(__name__)

Say = Callable[[str], None]
"""Called with each line that a process has written; lines of its log begin with their priority."""

Over = Callable[[Ended, str], None]
"""Called with outcome and reason once a process has ended."""


class Process(ABC):
    """A running process. Its callbacks `say` and `over` are called in separate threads."""

    @property
    @abstractmethod
    def pid(self) -> int:
        """Process id."""

    @abstractmethod
    def stop(self) -> None:
        """Request its orderly shutdown. Does not wait; idempotent."""

    @abstractmethod
    def join(self, timeout_s: float) -> None:
        """Wait until it has ended and everything was reported."""


class RunningSession(Process):
    """A running session, watched in a separate thread."""

    def __init__(
        self,
        config: SessionConfig,
        say: Say,
        over: Over,
        answered: Callable[[bytes], None],
        has_device: bool = True,
        router_promised: Callable[[tuple[str, int]], bool] = lambda _address: False,
    ) -> None:
        """Start it. `answered` gets its replies and the states of motions; `has_device`: whether it
        begins with its operator device; `router_promised` returns True for the address of a router
        that the daemon runs, from any thread. Raises OSError."""
        self.snapshot = Snapshot(device=DeviceSnapshot(held=has_device))
        """The newest snapshot."""
        self.due_s = time.monotonic() + STARTS_WITHIN_S
        """Local monotonic time by which the next snapshot is due."""
        self._over, self._answered = over, answered
        self._lines = Lines(say)
        self._process = SessionProcess(
            config,
            say=self._lines.take,
            has_device=has_device,
            log_format=LogFormat.PRIORITY,
            router_promised=router_promised,
        )
        self._thread = threading.Thread(target=self._follow, name="cardan-follow", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def send(self, packet: bytes) -> None:
        """Send a request. Raises OSError if it takes none."""
        self._process.send(packet)

    def stop(self) -> None:
        self._process.stop()

    def join(self, timeout_s: float) -> None:
        self._thread.join(timeout_s)

    def _follow(self) -> None:
        how, reason = Ended.DIED, "its supervision failed"
        try:
            outcome = self._process.follow(self._take)
            how = _HOW.get(outcome.exit_code, Ended.DIED)
            reason = outcome.last.error or outcome.last.ending or outcome.last.arm.message
        except Exception as error:
            reason = shortage(error) or repr(error)
        finally:
            self._lines.end()
            self._over(how, reason)

    def _take(self, packet: bytes) -> Snapshot | None:
        if is_answer(packet):
            self._answered(packet)
            return None
        self.snapshot = Snapshot.from_bytes(packet)
        self.due_s = time.monotonic() + HUNG_S
        return self.snapshot


_HOW = {
    EXIT_OK: Ended.AS_ASKED,
    EXIT_CONFIGURATION: Ended.MISCONFIGURED,
    EXIT_CANNOT_OPEN: Ended.UNABLE,
}


class RunningServer(Process):
    """A running server: ``cardan net server`` with the given words, which ends with this
    process."""

    def __init__(self, words: Sequence[str], say: Say, over: Over, socket: str) -> None:
        """Start it; `socket`: that of the daemon. Raises OSError."""
        self.endpoint = ""
        """Endpoint, once it serves."""
        self.figures: dict[str, int] = {}
        """Newest statistics that it printed."""
        self._said, self._over = say, over
        self._stopping = False
        self._last = ""
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "cardan.gateway.session.parent_death",
                "",
                "net",
                "server",
                *words,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={
                **os.environ,
                TELLS_VARIABLE: "1",
                SOCKET_VARIABLE: socket,
                FORMAT_VARIABLE: LogFormat.PRIORITY.value,
                LEVEL_VARIABLE: logging.getLevelName(_log.getEffectiveLevel()).lower(),
            },
        )
        self._thread = threading.Thread(target=self._follow, name="cardan-server", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def stop(self) -> None:
        if not self._stopping:
            self._stopping = True
            with contextlib.suppress(OSError):
                self._process.terminate()
            killer = threading.Timer(SERVER_LEAVES_WITHIN_S, self._kill)
            killer.daemon = True
            killer.start()

    def _kill(self) -> None:
        if self._process.poll() is None:
            self._process.kill()

    def join(self, timeout_s: float) -> None:
        self._thread.join(timeout_s)

    def _follow(self) -> None:
        process = self._process
        assert process.stdout is not None
        assert process.stdin is not None
        lines = Lines(self._take)
        while data := process.stdout.read1(LINE_BYTES):  # type: ignore[attr-defined]
            lines.take(data)
        lines.end()
        code = process.wait()
        process.stdout.close()
        process.stdin.close()
        how = Ended.AS_ASKED if code == 0 else _HOW.get(code, Ended.DIED)
        self._over(how, "" if code == 0 else self._last or f"it ended with status {code}")

    def _take(self, line: str) -> None:
        if (figures := figures_of(line)) is not None:
            self.figures = figures
            return
        if line.startswith("READY "):
            self.endpoint = line.removeprefix("READY ")
        self._last = level_of(line)[1]
        self._said(line)


class Lines:
    """Splits the output of a process into lines, limited in rate."""

    def __init__(self, say: Say, clock: Callable[[], float] = time.monotonic) -> None:
        self._say, self._left, self._clock = say, b"", clock
        self._room, self._seen_s = float(LINES_AT_ONCE), clock()
        self._dropped = 0

    def take(self, data: bytes) -> None:
        """Take output of the process."""
        *lines, left = (self._left + data).split(b"\n")
        while len(left) > LINE_BYTES:
            lines.append(left[:LINE_BYTES])
            left = left[LINE_BYTES:]
        self._left = left
        now_s = self._clock()
        self._room += LINES_A_SECOND * (now_s - self._seen_s)
        self._room, self._seen_s = min(self._room, LINES_AT_ONCE), now_s
        for line in lines:
            if line.strip():
                self._take(line.decode(errors="backslashreplace").rstrip())

    def end(self) -> None:
        """Take the last line without its end."""
        self.take(b"\n")
        self._tell_dropped()

    def _take(self, line: str) -> None:
        if self._room < 1.0:
            self._dropped += 1
            return
        self._room -= 1.0
        self._tell_dropped()
        self._say(line)

    def _tell_dropped(self) -> None:
        if self._dropped:
            self._say(f"<4>{self._dropped} lines were left out: they came too fast")
            self._dropped = 0


ENDS_WITHIN_S: Final = max(KILL_AFTER_S, SERVER_LEAVES_WITHIN_S) + 2.0
"""Longest time for any of them to end after the request."""
