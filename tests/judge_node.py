"""Third-party ROS 2 node in its own process: reads commands, one per line, and reports in lines of
JSON."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

SEGMENT = re.compile(r"/dev/shm/fastrtps_[0-9a-f]{16}\b")
WAIT_S = 120.0
"""Longest wait for prompt messages; participants announce themselves every few seconds."""


class JudgeNode:
    """Node for a with statement. The process ends with its standard input."""

    def __init__(self, command: Sequence[str | Path], env: Mapping[str, str] | None = None) -> None:
        self._command, self._env = command, env
        self.events: list[dict[str, Any]] = []
        """All reported events in their order."""
        self._changed = threading.Condition()
        self._ended = self._killed = False

    def __enter__(self) -> JudgeNode:
        self._process = subprocess.Popen(
            self._command, env=self._env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        return self

    def __exit__(self, *_: object) -> None:
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        stdin.close()
        try:
            code = self._process.wait(WAIT_S)
            assert code == (-signal.SIGKILL if self._killed else 0)
        finally:
            self._process.kill()
            self._process.wait()
            self._reader.join()
            stdout.close()

    def kill(self) -> None:
        """Kill it like a crash, and remove its shared memory."""
        maps = Path(f"/proc/{self._process.pid}/maps").read_text()
        self._process.kill()
        self._process.wait()
        self._killed = True
        for segment in set(SEGMENT.findall(maps)):
            for name in (segment, f"{segment}_el"):
                Path(name).unlink(missing_ok=True)

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._changed:
                self.events.append(json.loads(line))
                self._changed.notify_all()
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def say(self, line: str) -> None:
        """Send it a command."""
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def found(self, event: str, **fields: object) -> list[dict[str, Any]]:
        """Return all events of a kind with these fields, so far."""
        with self._changed:
            return [
                each
                for each in self.events
                if each["event"] == event and all(each[key] == fields[key] for key in fields)
            ]

    def wait(self, event: str, count: int = 1, **fields: object) -> dict[str, Any]:
        """Return the newest event of a kind with these fields, after at least `count` of them."""
        end_s = time.monotonic() + WAIT_S
        while True:
            with self._changed:
                known = len(self.events)
            found = self.found(event, **fields)
            if len(found) >= count:
                return found[-1]
            with self._changed:
                left_s = end_s - time.monotonic()
                assert left_s > 0, f"no {event} with {fields}; last: {self.events[-5:]}"
                assert not self._ended, f"it has ended; last: {self.events[-5:]}"
                if len(self.events) == known:
                    self._changed.wait(left_s)
