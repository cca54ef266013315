"""``cardan`` commands as subprocesses, each of which prints READY once it serves."""

from __future__ import annotations

import contextlib
import itertools
import os
import selectors
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

from cardan.common.text_sanitizer import printable
from cardan.errors import DriverError

READY_WITHIN_S = 20.0
"""Longest time until the command serves; importing takes a second on a slow machine."""

END_WITHIN_S = 5.0
"""Longest time for its orderly shutdown; then it is killed."""

_AT_ONCE = 65536
"""Bytes per read: as many as a pipe holds."""

_LAST_WORDS = 2000
"""Characters of its standard error that are kept."""


class CardanSubprocess:
    """Subprocess ``cardan WORDS`` from its start to its end. It ends with this process, too, even
    after a kill; Ctrl-C in the terminal does not reach it."""

    def __init__(
        self,
        *words: str,
        folder: Path | None = None,
        ready_within_s: float = READY_WITHIN_S,
        end_within_s: float = END_WITHIN_S,
        at: Sequence[str] = (),
    ) -> None:
        """Start it in `folder` (None: here), which is removed if this process is killed. It is
        killed if it does not end within `end_within_s` of the request. `at`: words before the
        command that execute it, such as nsenter's. Raises DriverError if it does not serve in time;
        its output is on standard error then."""
        self._ready_within_s, self._end_within_s = ready_within_s, end_within_s
        self.code = 0
        """Exit code, once it has ended."""
        self.before: list[str] = []
        """Lines that it printed before READY."""
        self.lines: tuple[str, ...] = ()
        """Lines that it printed after READY, once it has ended."""
        self.complaints = ""
        """Last output on standard error, once it has ended."""
        named = itertools.takewhile(lambda word: not word.startswith("-"), words)
        self._name = shlex.join(itertools.islice(named, 3))
        self._log: IO[str] = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self._unread = b""
        """Output after the last complete line. Lines must not wait in a file's own buffer, which a
        selector does not see."""
        self._process = subprocess.Popen(
            [
                *at,
                sys.executable,
                "-m",
                "cardan.gateway.session.parent_death",
                str(folder or ""),
                *words,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            bufsize=0,
            cwd=folder,
            start_new_session=True,
        )
        try:
            self.endpoint = self._endpoint()
        except BaseException:
            self.end()
            raise

    def _endpoint(self) -> str:
        stdout = self._process.stdout
        assert stdout is not None
        give_up_s = time.monotonic() + self._ready_within_s
        with selectors.DefaultSelector() as selector:
            selector.register(stdout, selectors.EVENT_READ)
            while selector.select(max(0.0, give_up_s - time.monotonic())):
                said = os.read(stdout.fileno(), _AT_ONCE)
                if not said:
                    self.end()
                    sys.stderr.write(self.complaints)
                    raise DriverError(f"`cardan {self._name}` ended before it served")
                *lines, self._unread = (self._unread + said).split(b"\n")
                for index, line in enumerate(lines):
                    words = line.decode(errors="replace").rstrip()
                    if words.startswith("READY "):
                        self._unread = b"\n".join((*lines[index + 1 :], self._unread))
                        return words.removeprefix("READY ").strip()
                    self.before.append(words)
        raise DriverError(
            f"`cardan {self._name}` did not serve within {self._ready_within_s:.0f} s"
        )

    def end(self) -> None:
        """Request its end, and wait; it is killed if it does not end. Twice is fine."""
        process, log = self._process, self._log
        if log.closed:
            return
        process.terminate()
        try:
            process.wait(self._end_within_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        assert process.stdin is not None
        assert process.stdout is not None
        self.code = process.returncode
        with process.stdin, process.stdout, log:
            said = self._unread + process.stdout.read()
            self.lines = tuple(said.decode(errors="replace").splitlines())
            log.seek(0)
            self.complaints = printable(log.read()[-_LAST_WORDS:], "\n")


@contextlib.contextmanager
def cardan_subprocess(
    *words: str, folder: Path | None = None, ready_within_s: float = READY_WITHIN_S
) -> Iterator[str]:
    """Run ``cardan WORDS`` as a :class:`CardanSubprocess`; yield its endpoint, then end it."""
    command = CardanSubprocess(*words, folder=folder, ready_within_s=ready_within_s)
    try:
        yield command.endpoint
    finally:
        command.end()
