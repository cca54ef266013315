"""Commands of Cardan that run beside a server, each in a separate process that ends with it: none
can delay a page's motion."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from cardan.common.text_sanitizer import printable

CARDAN: Final = (sys.executable, "-m", "cardan.gateway.session.parent_death", "")
"""Words before a command: it ends with this process, even after a kill."""

ENDS_WITHIN_S: Final = 10.0
"""Longest time for a command's orderly shutdown: a recorder writes messages that have arrived."""

MOST_LINE: Final = 64 * 1024
"""Bytes of a line that is read."""


class AsyncSubprocess:
    """A command from its start to its end."""

    def __init__(self, command: Sequence[str], heard: Callable[[str], None]) -> None:
        """`heard` gets each line of its output and error output."""
        self._command, self._heard = command, heard
        self._process: asyncio.subprocess.Process | None = None
        self._reading: asyncio.Task[None] | None = None

    async def start(self, environment: Mapping[str, str] | None = None) -> None:
        """Start it; `environment` is added to that of this process. Raises OSError."""
        self._process = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            start_new_session=True,
            limit=MOST_LINE,
            env={**os.environ, **(environment or {})},
        )
        self._reading = asyncio.create_task(self._read(self._process))

    @property
    def code(self) -> int | None:
        """Its exit code; None: it has not ended, or was not started."""
        return None if self._process is None else self._process.returncode

    @staticmethod
    def _line(data: bytes) -> str:
        return printable(data.decode(errors="replace").strip())

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        while True:
            try:
                data = await process.stdout.readline()
            except ValueError:  # A longer line: the part that was read is gone.
                continue
            if not data:
                break
            if line := self._line(data):
                self._heard(line)
        await process.wait()

    async def ended(self) -> None:
        """Wait until it has ended and all of its output was passed on."""
        if self._reading is not None:
            await asyncio.shield(self._reading)

    def ask_to_end(self) -> None:
        """Request its end. Does not wait; idempotent."""
        if self._process is not None and self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.terminate()

    async def end(self) -> None:
        """Request its end, and wait; it is killed if it does not end. Twice is fine."""
        process, reading = self._process, self._reading
        if process is None or reading is None:
            return
        self.ask_to_end()
        _, late = await asyncio.wait([reading], timeout=ENDS_WITHIN_S)
        if late:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await reading
