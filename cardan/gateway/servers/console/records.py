"""Recording and viewing of records on the server's machine, for pages. Each record is made and read
by a separate process, so that it cannot delay a page's motion. Pages name no paths: the server
names its files, and shows those of one folder."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import shutil
import sys
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from cardan.common.files import records_folder
from cardan.errors import ConfigurationError
from cardan.gateway.servers.console.subprocesses import CARDAN, AsyncSubprocess
from cardan.gateway.servers.stats import TELLS_VARIABLE, figures_of

RECORDER: Final = (*CARDAN, "net", "server", "recorder")

SHOWING: Final = (sys.executable, "-m", "cardan.recording.player")

BEGINS_WITHIN_S: Final = 15.0
"""Longest time for a recorder to begin: joining the bus takes seconds on a busy computer."""

LEAST_FREE: Final = 1_000_000_000
"""Bytes that a record leaves free on its disk, for the gateway."""

MOST_LISTED: Final = 200
"""Most records in a list, the newest."""

MOST_SHOWN: Final = 8
"""Most records shown at a time: each takes a process."""

MOST_LINE: Final = 9 * 2**20
"""Longest line of a shown record, with its head."""

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}\.mcap")

_FULL: Final = f"less than {LEAST_FREE / 1e9:g} GB is free on the disk of the records"

_LAST_LINES: Final = 5


class RecordsError(Exception):
    """Reason why a request was not carried out."""


class Records:
    """The records of a folder, and the present recording."""

    def __init__(
        self, folder: Path, bus_words: Sequence[str], recorder: Sequence[str] = RECORDER
    ) -> None:
        """`bus_words`: options of the bus for the recorder."""
        self.folder = folder
        self.shown = 0
        """Count of records shown to pages now."""
        self._command = [*recorder, f"--folder={folder}", *bus_words]
        self._recorder: AsyncSubprocess | None = None
        self._following: asyncio.Task[None] | None = None
        self._began = asyncio.Event()
        """Set once the recording has begun or failed."""
        self._said: deque[str] = deque(maxlen=_LAST_LINES)
        self._path: Path | None = None
        self._since_s = 0.0
        self._figures: dict[str, int] = {}
        self._ended = ""
        """Last message of the newest recorder."""

    def table(self) -> dict[str, Any]:
        """Return the table for pages: the records, newest first, and the progress of the present
        one."""
        recording = None
        if self._path is not None:
            recording = {
                "name": self._path.name,
                "seconds": round(time.monotonic() - self._since_s, 1),
                "bytes": self._figures.get("bytes", 0),
                "messages": self._figures.get("messages", 0),
                "dropped": self._figures.get("dropped", 0) + self._figures.get("lost", 0),
            }
        return {"recording": recording, "ended": self._ended, "records": self._listed()}

    def _listed(self) -> list[dict[str, Any]]:
        found = []
        with contextlib.suppress(OSError):
            for entry in os.scandir(self.folder):
                with contextlib.suppress(OSError):
                    if _NAME.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                        about = entry.stat(follow_symlinks=False)
                        found.append((about.st_mtime, entry.name, about.st_size))
        found.sort(reverse=True)
        return [
            {"name": name, "bytes": size, "changed_s": round(changed_s, 1)}
            for changed_s, name, size in found[:MOST_LISTED]
        ]

    def path(self, name: object) -> Path:
        """Return the file of a record. Raises RecordsError if there is none of this name."""
        if isinstance(name, str) and _NAME.fullmatch(name):
            path = self.folder / name
            if path.is_file() and not path.is_symlink():
                return path
        raise RecordsError(f"there is no record {str(name)[:110]!r}")

    async def record(self) -> None:
        """Begin a record; return once it is being made. Raises RecordsError."""
        if self._recorder is not None:
            raise RecordsError("a record is being made already; end it first")
        if self._is_full():
            raise RecordsError(_FULL)
        self._ended, self._figures, self._said = "", {}, deque(maxlen=_LAST_LINES)
        self._recorder = recorder = AsyncSubprocess(self._command, self._heard)
        self._began = asyncio.Event()
        try:
            await recorder.start({TELLS_VARIABLE: "1"})
        except OSError as error:
            self._recorder = None
            raise RecordsError(f"the recorder cannot be started: {error}") from None
        self._following = asyncio.create_task(self._follow(recorder))
        try:
            await asyncio.wait_for(self._began.wait(), BEGINS_WITHIN_S)
        except asyncio.TimeoutError:
            await self.close()
            raise RecordsError("the recorder does not start") from None
        if self._recorder is None:
            raise RecordsError(self._ended or "the recorder has ended at once")

    def _heard(self, line: str) -> None:
        if (figures := figures_of(line)) is not None:
            self._figures = figures
            if self._recorder is not None and _FULL not in self._said and self._is_full():
                self._said.append(_FULL)
                self._recorder.ask_to_end()
        elif line.startswith("READY "):
            self._path, self._since_s = Path(line.removeprefix("READY ")), time.monotonic()
            self._said.clear()
            self._began.set()
        else:
            self._said.append(line.removeprefix("cardan: "))

    def _is_full(self) -> bool:
        there = next((each for each in (self.folder, *self.folder.parents) if each.is_dir()), None)
        try:
            return there is not None and shutil.disk_usage(there).free < LEAST_FREE
        except OSError:
            return False

    async def _follow(self, recorder: AsyncSubprocess) -> None:
        await recorder.ended()
        self._ended = "; ".join(self._said)
        self._recorder = self._path = None
        self._began.set()

    async def finish(self) -> None:
        """End the record; return once its file is complete. Raises RecordsError."""
        if self._recorder is None:
            raise RecordsError("no record is being made")
        await self.close()

    async def close(self) -> None:
        """End the present recording."""
        recorder, following = self._recorder, self._following
        if recorder is not None and following is not None:
            await recorder.end()
            await following


class OpenRecord:
    """A record that one page views, from `open` to `close`."""

    def __init__(
        self,
        records: Records,
        name: object,
        send: Callable[[Mapping[str, Any] | str], None],
        calm: Callable[[], Awaitable[None]],
        command: Sequence[str] = SHOWING,
    ) -> None:
        """`send`: to the page, a table or the inside of a JSON object; `calm`: waits until the page
        has read that. Raises RecordsError."""
        self._path = records.path(name)
        if records.shown >= MOST_SHOWN:
            raise RecordsError(f"{MOST_SHOWN} records are shown to pages already")
        records.shown += 1
        self._records, self._send, self._calm, self._command = records, send, calm, command
        self._process: asyncio.subprocess.Process | None = None
        self._waiting: list[str] = []
        self._task = asyncio.create_task(self._run())

    def order(self, table: Mapping[str, Any]) -> None:
        """Change the shown topics, time or speed."""
        keys = ("topics", "at_s", "rate", "playing")
        line = json.dumps({key: table[key] for key in keys if key in table}) + "\n"
        process = self._process
        if process is None or process.stdin is None:
            self._waiting = [*self._waiting[-8:], line]
        elif not process.stdin.is_closing() and _room(process.stdin):
            process.stdin.write(line.encode())

    async def _run(self) -> None:
        try:
            self._process = process = await asyncio.create_subprocess_exec(
                *self._command,
                str(self._path),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
                limit=MOST_LINE,
            )
            assert process.stdin is not None
            assert process.stdout is not None
            for line in self._waiting:
                process.stdin.write(line.encode())
            about = json.loads(await process.stdout.readline() or b'{"error": "it cannot be read"}')
            if "error" in about:
                self._send({"over": about["error"]})
                return
            self._send({"about": about})
            while line := (await process.stdout.readline()).decode().strip():
                await self._calm()
                self._send(line[1:-1])
            self._send({"over": "the program that reads it has ended"})
        except (OSError, ValueError) as error:
            self._send({"over": f"it cannot be shown: {error}"})

    async def close(self) -> None:
        """Stop showing it."""
        self._task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._task
        process = self._process
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        self._records.shown -= 1


MOST_ORDERS: Final = 64 * 1024
"""Bytes of orders that wait for the program that reads a record."""


def _room(stream: asyncio.StreamWriter) -> bool:
    return stream.transport.get_write_buffer_size() < MOST_ORDERS


def records_of(folder: str, bus_words: Sequence[str]) -> Records | None:
    """Return the records of `folder`, or of the user's; None: this user has no folder for them."""
    try:
        return Records(records_folder(folder), bus_words)
    except ConfigurationError:
        return None
