"""Standard output and standard error that never block the program.

Written text is passed to a thread, and only that thread waits for a stopped terminal or an unread
pipe. Installed by the ``cardan`` command; a program that uses the package keeps its own streams.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import Any, TextIO

MAX_WAITING_BYTES = 1 << 18
"""Most bytes that wait for a reader: more than a screen, and than a pipe holds."""

READ_WITHIN_S = 0.2
"""Duration of a write above which there is no reader. Most terminals and files take
microseconds."""

AT_ONCE_BYTES = 128
"""Size of one write to a terminal: it takes all of it before the write returns, and a slow
terminal, such as a serial line of 9600 baud, must not look like a stopped one."""

LAST_WORDS_S = 0.5
"""Longest wait for a reader at the end of a program that serves, or that was requested to end."""


class BackgroundOutput(io.BufferedIOBase):
    """A byte stream to a file descriptor, written by a thread of its own.

    Once too many bytes wait, `write` waits, too; after `keep_up` it drops data instead. An error in
    the thread is raised by the next `write`, or never if `quiet`.
    """

    def __init__(self, fd: int, name: str, *, quiet: bool = False) -> None:
        super().__init__()
        self.name = name
        self._fd = fd
        self._quiet = quiet
        self._at_once_bytes = AT_ONCE_BYTES if self.isatty() else MAX_WAITING_BYTES
        self._keeping_up = self._ended = False
        self._pieces: deque[bytes] = deque()
        self._waiting_bytes = 0
        """Bytes of the piece that is being written, and of those after it."""
        self._began_s: float | None = None
        """Start of the present write."""
        self._error: OSError | None = None
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def fileno(self) -> int:
        """The file descriptor."""
        return self._fd

    def isatty(self) -> bool:
        """Return whether it is a terminal."""
        return os.isatty(self._fd)

    def writable(self) -> bool:
        """Return True."""
        return True

    @property
    def error(self) -> OSError | None:
        """Error that prevents writing; None while it works."""
        return self._error

    def keep_up(self) -> None:
        """Drop data without room from now on, instead of waiting."""
        with self._changed:
            self._keeping_up = True
            self._changed.notify_all()

    def is_read(self) -> bool:
        """True if the last data was taken within READ_WITHIN_S."""
        began_s = self._began_s
        return began_s is None or time.monotonic() - began_s < READ_WITHIN_S

    def is_behind(self) -> bool:
        """True if some data still waits."""
        return self._waiting_bytes > 0

    def write(self, data: Any) -> int:
        """Pass `data` to the thread; all of it counts as written."""
        piece = bytes(data)
        with self._changed:
            while not (self._error or self._ended or self._fits(piece) or self._keeping_up):
                self._changed.wait()
            if self._error is not None and not (self._quiet or self._ended):
                raise OSError(self._error.errno, self._error.strerror)
            if self._error is None and not self._ended and self._fits(piece):
                if self._has_thread():
                    self._pieces.append(piece)
                    self._waiting_bytes += len(piece)
                    self._changed.notify_all()
                else:
                    with contextlib.suppress(OSError):
                        self._write_piece(piece)
                    self._began_s = None
        return len(piece)

    def finish(self) -> None:
        """Wait until all is written; a stream that keeps up waits for LAST_WORDS_S at most. Later
        writes are dropped."""
        with self._changed:
            end_s = time.monotonic() + LAST_WORDS_S
            while self._waiting_bytes and self._error is None:
                left_s = end_s - time.monotonic() if self._keeping_up else None
                if left_s is not None and left_s <= 0.0:
                    break
                self._changed.wait(left_s)
        self.end()

    def end(self) -> None:
        """Drop all data written from now on."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _has_thread(self) -> bool:
        """Return whether a thread writes, started at the first call. If the system gives none, a
        `quiet` stream works without, and another one raises RuntimeError."""
        if self._thread is None:
            thread = threading.Thread(
                target=self._write_all, name=f"cardan-{self.name}", daemon=True
            )
            try:
                thread.start()
            except RuntimeError:
                if not self._quiet:
                    raise
                return False
            self._thread = thread
        return True

    def _fits(self, piece: bytes) -> bool:
        return not self._waiting_bytes or self._waiting_bytes + len(piece) <= MAX_WAITING_BYTES

    def _write_all(self) -> None:
        while True:
            with self._changed:
                while not self._pieces:
                    self._changed.wait()
                piece = self._pieces.popleft()
            error = None
            try:
                self._write_piece(piece)
            except OSError as raised:
                error = raised
            with self._changed:
                self._began_s, self._error = None, error
                self._waiting_bytes -= len(piece)
                if error is not None:
                    self._pieces.clear()
                    self._waiting_bytes = 0
                self._changed.notify_all()
                if error is not None:
                    return

    def _write_piece(self, piece: bytes) -> None:
        rest = memoryview(piece)
        while rest:
            self._began_s = time.monotonic()
            try:
                rest = rest[os.write(self._fd, rest[: self._at_once_bytes]) :]
            except BlockingIOError:  # Another program has made it so.
                poll = select.poll()
                poll.register(self._fd, select.POLLOUT)
                poll.poll()


class DroppingOutput(io.BufferedIOBase):
    """A byte stream to a non-blocking pipe: data that does not fit is dropped."""

    def __init__(self, fd: int) -> None:
        super().__init__()
        self.name = fd
        self._fd = fd

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """The file descriptor."""
        return self._fd

    def write(self, data: Any) -> int:
        """Write `data`, or drop it."""
        with contextlib.suppress(OSError):
            os.write(self._fd, data)
        return len(data)


def dropping_text(fd: int) -> TextIO:
    """Return a stream of lines to a non-blocking pipe."""
    return io.TextIOWrapper(
        DroppingOutput(fd), encoding="utf-8", errors="backslashreplace", line_buffering=True
    )


_installed: dict[str, BackgroundOutput] = {}
"""Streams by their names in sys."""


@contextlib.contextmanager
def in_background() -> Iterator[None]:
    """Write sys.stdout and sys.stderr in the background in a ``with`` block. A stream that is no
    file, such as a test's, stays. Closed file descriptors 0 to 2 are opened on /dev/null: a socket
    with one of these numbers would get the output of libraries."""
    for fd in (0, 1, 2):
        try:
            os.fstat(fd)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # The lowest free number: this one.
    before = sys.stdout, sys.stderr
    for name, stream in zip(("stdout", "stderr"), before, strict=True):
        if not isinstance(stream, io.TextIOWrapper):
            continue
        quiet = name == "stderr"  # No stream is left that could report the error.
        try:
            stream.flush()
            output = BackgroundOutput(stream.fileno(), f"<{name}>", quiet=quiet)
        except (OSError, ValueError):
            continue
        wrapped = io.TextIOWrapper(
            output,
            encoding=stream.encoding,
            errors="backslashreplace",
            line_buffering=quiet or stream.isatty(),
        )
        setattr(sys, name, wrapped)
        _installed[name] = output
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        for output in _installed.values():
            output.end()
        _installed.clear()


def keep_up() -> None:
    """Never wait for a reader again: for a program that serves, or that was requested to end."""
    for output in _installed.values():
        output.keep_up()


def is_read() -> bool:
    """Return whether a reader, or a file, takes the data written to standard output."""
    output = _installed.get("stdout")
    return output is None or output.is_read()


def is_behind() -> bool:
    """Return whether standard output has not taken all written data yet."""
    output = _installed.get("stdout")
    return output is not None and output.is_behind()


def finish(name: str) -> OSError | None:
    """Flush ``stdout`` or ``stderr``, as far as there is a reader. Return the error."""
    if name not in _installed:
        return None
    output = _installed[name]
    with contextlib.suppress(OSError):
        getattr(sys, name).flush()
    output.finish()
    return output.error


def failed(error: OSError) -> bool:
    """Return whether `error` is that of standard output."""
    output = _installed.get("stdout")
    return output is not None and output.error is not None and output.error.errno == error.errno


def why_unwritten(error: OSError) -> str:
    """Return the error of standard output for its user; empty if only the reader of a pipe has
    closed it, like ``head``."""
    if error.errno in (errno.EPIPE, errno.ECONNRESET):
        return ""
    return f"standard output cannot be written: {error.strerror}"
