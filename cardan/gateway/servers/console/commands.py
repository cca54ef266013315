"""Commands of a page for the daemon and the doctor: those of the command line, each in a separate
process, so that none can delay the page's motion. An arm's Stop is not among them: the page calls
the verb `stop` like every client of rosbridge (`bus/arm_server.py`)."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

from cardan.common.text_sanitizer import printable

COMMAND: Final = (sys.executable, "-m", "cardan")

COMMAND_WORDS: Final[Mapping[str, tuple[str, ...]]] = {
    "list": ("daemon", "ps", "--json"),
    "start": ("daemon", "start"),
    "stop": ("daemon", "stop"),
    "restart": ("daemon", "restart"),
    "doctor": ("doctor", "--json"),
}
"""Requests, and the words of their commands."""

NAMED: Final = frozenset({"start", "stop", "restart"})
"""Requests about one session or server."""

WITHIN_S: Final = 60.0
"""Longest time of a command: the doctor listens to controllers and reads every file."""

FOUND_FAILURES: Final = 4
"""Exit code of the doctor when it has found faults: its output is valid."""

MOST_WORDS: Final = 1000
"""Most characters of an error output that are passed on."""

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")


class OrderError(Exception):
    """Reason why an order was not carried out."""


def words_of(do: object, name: object) -> list[str]:
    """Return the words of the command. Raises OrderError."""
    words = COMMAND_WORDS.get(do) if isinstance(do, str) else None
    if words is None:
        raise OrderError(f"do is {str(do)[:60]!r}; allowed: {', '.join(COMMAND_WORDS)}")
    if do not in NAMED:
        return list(words)
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise OrderError(f"{do} needs the name of a session or a server")
    return [*words, name]


async def carry_out(words: Sequence[str], command: Sequence[str] = COMMAND) -> Any:
    """Run a command and return its output: JSON, or its text. Raises OrderError."""
    process = await asyncio.create_subprocess_exec(
        *command,
        *words,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        said, complaints = await asyncio.wait_for(process.communicate(), WITHIN_S)
    except asyncio.TimeoutError:
        raise OrderError(f"{words[0]} does not come to an end") from None
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    text = said.decode(errors="replace").strip()
    answered = process.returncode == 0 or (
        words[0] == "doctor" and process.returncode == FOUND_FAILURES
    )
    if not answered:
        why = complaints.decode(errors="replace").strip() or text
        last = printable(why.removeprefix("cardan: "))[-MOST_WORDS:]
        raise OrderError(last or f"{words[0]} ended with status {process.returncode}")
    try:
        return json.loads(text)
    except ValueError:
        return printable(text)
