"""Runs a program with the simulated device in place of the real one."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType

from cardan.common.files import create_file
from cardan.common.signals import ENDING_SIGNALS, on_ending
from cardan.errors import ConfigurationError
from cardan_omni.peer.library import (
    LIBRARY_NAMES,
    LIBRARY_VARIABLE,
    SETTINGS_VARIABLE,
    library_path,
)
from cardan_omni.peer.settings import OmniSettings

GRACE_S = 5.0
"""Time for a program to end after a request."""


@contextlib.contextmanager
def environment(settings: OmniSettings) -> Iterator[Mapping[str, str]]:
    """Environment of a program, valid within the block, in which it finds the simulated device when
    it loads libHD. Raises DeviceNotFoundError if the library was not compiled."""
    library = library_path()
    with tempfile.TemporaryDirectory(prefix="cardan-omni-") as name:
        folder = Path(name)
        file = folder / "settings"
        file.write_text(settings.text, encoding="utf-8")
        for known in LIBRARY_NAMES:
            (folder / known).symlink_to(library)
        paths = [name, os.environ.get("LD_LIBRARY_PATH", "")]
        yield {
            **os.environ,
            SETTINGS_VARIABLE: str(file),
            LIBRARY_VARIABLE: str(library),
            "LD_LIBRARY_PATH": os.pathsep.join(filter(None, paths)),
        }


def prepare_log(settings: OmniSettings) -> None:
    """Empty the log, so that it has only rows of this run.

    Raises ConfigurationError when it cannot be written.
    """
    if settings.log:
        try:
            create_file(settings.log).close()
        except OSError as error:
            raise ConfigurationError(
                "log", f"{settings.log!r} cannot be written: {error.strerror}"
            ) from None


def missing_log(settings: OmniSettings) -> str:
    """Return why a program that has run left no rows in the log; empty when it did."""
    if not settings.log or not (path := Path(settings.log)).is_file():
        return ""
    with path.open("rb") as file:
        if not file.readline():
            return f"{path} is empty: the program has not initialized the simulated device"
        if not file.readline():
            return f"{path} has no rows: the program has not started the device's scheduler"
    return ""


def run_program(words: Sequence[str], settings: OmniSettings, seconds: float | None = None) -> int:
    """Run a program with the simulated device; return its exit code. Signals are forwarded to it;
    when this process is killed, it gets SIGTERM, and SIGKILL 5 s later. After `seconds` it gets
    SIGTERM, which counts as 0. A program ended by a signal returns 128 plus the signal's number, as
    in a shell. Main thread only. Raises ConfigurationError when it cannot be run or its log cannot
    be written, DeviceNotFoundError without the library.
    """
    with environment(settings) as variables:
        prepare_log(settings)
        folder = str(Path(variables[SETTINGS_VARIABLE]).parent)
        with _guard(folder) as guarded, _Runner(seconds) as runner:
            return runner.run(words, variables, guarded)


_GUARD = """
read -r pid || pid=
[ "$pid" = 0 ] && exit 0
if [ -n "$pid" ]; then
    read -r over && exit 0
    kill -TERM "$pid"
    for _ in 1 2 3 4 5; do
        sleep 1
        kill -0 "$pid" 2>/dev/null || pid=
        [ -n "$pid" ] || break
    done
    [ -n "$pid" ] && kill -KILL "$pid"
fi
rm -rf -- "$1"
"""
"""Script for sh, which reads the program's process id, then a line at the regular end. The end of
its input without that line means that this process has died."""


@contextlib.contextmanager
def _guard(folder: str) -> Iterator[Callable[[int], None]]:
    """Start a process that ends the program and removes the folder if this process is killed.
    Yields a function that must be called with the program's process id."""
    reading, writing = os.pipe()
    try:
        guard = os.posix_spawn(
            "/bin/sh",
            ["sh", "-c", _GUARD, "cardan-omni-guard", folder],
            {"PATH": os.environ.get("PATH", os.defpath)},
            file_actions=(
                (os.POSIX_SPAWN_DUP2, reading, 0),
                (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0),
                (os.POSIX_SPAWN_OPEN, 2, os.devnull, os.O_WRONLY, 0),
            ),
            # A signal to this process's group, such as Ctrl-C, is not for it.
            setpgroup=0,
        )
    finally:
        os.close(reading)
    reported: list[int] = []

    def say(word: str) -> None:
        with contextlib.suppress(BrokenPipeError):  # Another process has ended the guard.
            os.write(writing, f"{word}\n".encode())

    def tell(pid: int) -> None:
        reported.append(pid)
        say(str(pid))

    try:
        yield tell
    finally:
        say("over" if reported else "0")
        os.close(writing)
        os.waitpid(guard, 0)


class _Runner:
    def __init__(self, seconds: float | None) -> None:
        self._seconds = seconds
        self._pid = 0
        self._end_requested = False
        self._leaving = contextlib.ExitStack()

    def __enter__(self) -> _Runner:
        self._leaving.enter_context(on_ending(self._pass_on))
        if self._seconds is not None:
            timer = signal.getitimer(signal.ITIMER_REAL)
            self._leaving.callback(signal.signal, signal.SIGALRM, signal.getsignal(signal.SIGALRM))
            self._leaving.callback(signal.setitimer, signal.ITIMER_REAL, *timer)
            signal.signal(signal.SIGALRM, self._end)
        return self

    def __exit__(self, *_exception: object) -> None:
        self._leaving.close()

    def run(
        self, words: Sequence[str], variables: Mapping[str, str], started: Callable[[int], None]
    ) -> int:
        # No signal may come between the program's start and knowing its number.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
        try:
            self._pid = os.posix_spawnp(
                words[0],
                list(words),
                variables,
                setsigmask=mask,
                # Python ignores these two, and a started program inherits ignored signals.
                setsigdef=(signal.SIGPIPE, signal.SIGXFSZ),
            )
            started(self._pid)
        except OSError as error:
            raise ConfigurationError("", f"{words[0]!r} cannot be run: {error.strerror}") from None
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if self._seconds is not None:
            # 0 would set no alarm at all.
            signal.setitimer(signal.ITIMER_REAL, max(self._seconds, 1e-3), GRACE_S)
        _, status = os.waitpid(self._pid, 0)
        self._pid = 0
        code = os.waitstatus_to_exitcode(status)
        if code < 0:
            return 0 if self._end_requested else 128 - code
        return code

    def _pass_on(self, number: int) -> None:
        if number in (signal.SIGINT, signal.SIGQUIT) and _in_foreground():
            return  # The terminal has sent the signal to the program, too.
        self._kill(number)

    def _end(self, _number: int, _frame: FrameType | None) -> None:
        self._kill(signal.SIGKILL if self._end_requested else signal.SIGTERM)
        self._end_requested = True

    def _kill(self, number: int) -> None:
        if self._pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, number)


def _in_foreground() -> bool:
    """Return True if a terminal's Ctrl-C reaches this process and the programs that it has
    started."""
    try:
        terminal = os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY)
    except OSError:
        return False
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return False
    finally:
        os.close(terminal)
