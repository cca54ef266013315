"""Logging to standard error, by commands and by a session's process: for people, for programs, or
for systemd's journal."""

from __future__ import annotations

import contextlib
import enum
import json
import logging
import os
import re
import socket
import struct
import sys
from collections.abc import Callable
from datetime import datetime, timezone
from types import TracebackType
from typing import Any

from cardan.common.text_sanitizer import printable

FORMAT = "%(asctime)s %(name)s: %(message)s"

JOURNAL_SOCKET = "/run/systemd/journal/socket"
"""Socket at which the journal takes entries with fields: systemd.journal-fields(7)."""

JOURNAL_VARIABLE = "JOURNAL_STREAM"
"""Variable by which systemd names the file that it reads into the journal: device and inode of
standard error."""

_PRIORITIES = (
    (logging.CRITICAL, 2),
    (logging.ERROR, 3),
    (logging.WARNING, 4),
    (logging.INFO, 6),
)
"""Severities of syslog by lowest level; lower levels are for debugging, 7."""

_FIELDS = "cardan_fields"


class LogFormat(str, enum.Enum):
    """Format of a line of the log."""

    TEXT = "text"
    """For people."""
    JSON = "json"
    """A JSON object per line."""
    PRIORITY = "priority"
    """Lines that begin with their priority, for systemd and the daemon: ``<4>text``."""
    JOURNAL = "journal"
    """Entries of systemd's journal with fields; without the journal, lines with priority."""


FORMAT_VARIABLE = "CARDAN_LOG_FORMAT"
LEVEL_VARIABLE = "CARDAN_LOG_LEVEL"
"""Environment variables by which the daemon sets the log format and level of its servers."""


def fields(**values: str) -> dict[str, Any]:
    """Return the `extra` of a call of a logger: fields by which programs find the entry, such as
    `name` of a session and `event`. Names are lower case; empty values are left out."""
    return {_FIELDS: {name: value for name, value in values.items() if value}}


def found_format() -> LogFormat:
    """Return the format for the present reader of standard error: the journal, a user, or a
    program."""
    if _reads_journal():
        return LogFormat.JOURNAL
    return LogFormat.TEXT if sys.stderr.isatty() else LogFormat.JSON


def _reads_journal() -> bool:
    try:
        found = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get(JOURNAL_VARIABLE) == f"{found.st_dev}:{found.st_ino}"


def _fields_of(record: logging.LogRecord) -> dict[str, str]:
    return getattr(record, _FIELDS, {})


class PrintableFormatter(logging.Formatter):
    """Formatter for a terminal: one line per entry, several for tracebacks."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        """Return the line, with line breaks escaped."""
        return printable(super().formatMessage(record))

    def formatException(  # noqa: N802
        self,
        ei: tuple[type[BaseException], BaseException, TracebackType | None]
        | tuple[None, None, None],
    ) -> str:
        """Return the traceback."""
        return printable(super().formatException(ei), "\n")


def make_logs_printable() -> None:
    """Print warnings that no handler takes to the terminal, made printable."""
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(PrintableFormatter())


class JsonFormatter(logging.Formatter):
    """Formatter of entries as JSON objects: time (UTC), level, logger, message, fields, and a
    traceback."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, with line breaks escaped."""
        time = datetime.fromtimestamp(record.created, timezone.utc)
        table = {
            "time": f"{time:%Y-%m-%dT%H:%M:%S}.{time.microsecond // 1000:03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            **_fields_of(record),
            "message": record.getMessage(),
        }
        if record.exc_info:
            table["traceback"] = self.formatException(record.exc_info)
        return json.dumps(table, separators=(",", ":"))


class _PriorityFormatter(PrintableFormatter):
    """Formatter of lines that the journal reads from standard error; a traceback is one line."""

    def __init__(self) -> None:
        super().__init__("%(name)s: %(message)s")

    def format(self, record: logging.LogRecord) -> str:
        return f"<{_priority(record)}>{printable(super().format(record))}"


class _StderrHandler(logging.Handler):
    """Logs to the current sys.stderr: a live view replaces it."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line. Errors do not reach the caller that logs."""
        try:
            sys.stderr.write(self.format(record) + "\n")
            sys.stderr.flush()
        except Exception:
            self.handleError(record)


class _JournalHandler(_StderrHandler):
    """Logs to the journal's own socket; a busy journal does not block."""

    def __init__(self) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._plain = PrintableFormatter("%(message)s")

    def emit(self, record: logging.LogRecord) -> None:
        """Send an entry, or write it as a line if it cannot be sent."""
        try:
            entry = {
                "MESSAGE": self._plain.format(record),
                "PRIORITY": str(_priority(record)),
                "SYSLOG_IDENTIFIER": "cardan",
                "CARDAN_LOGGER": record.name,
                **{f"CARDAN_{key.upper()}": value for key, value in _fields_of(record).items()},
            }
            data = b"".join(_entry_field(name, value) for name, value in entry.items())
            self._socket.sendto(data, socket.MSG_DONTWAIT, JOURNAL_SOCKET)
        except Exception:
            super().emit(record)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.close()
        super().close()


def _entry_field(name: str, value: str) -> bytes:
    data = value.encode("utf-8", "backslashreplace")
    if b"\n" not in data:
        return b"%s=%s\n" % (name.encode(), data)
    return b"%s\n%s%s\n" % (name.encode(), struct.pack("<Q", len(data)), data)


def _priority(record: logging.LogRecord) -> int:
    return next((number for level, number in _PRIORITIES if record.levelno >= level), 7)


_PRIORITY_LINE = re.compile(r"<([0-7])>")


def level_of(line: str) -> tuple[int, str]:
    """Return the level at the beginning of a line, and its text; INFO for a line without a
    level."""
    found = _PRIORITY_LINE.match(line)
    if found is None:
        return logging.INFO, line
    number = int(found.group(1))
    level = next((level for level, most in _PRIORITIES if number <= most), logging.DEBUG)
    return level, line[found.end() :]


_FORMATTERS: dict[LogFormat, Callable[[], logging.Formatter]] = {
    LogFormat.TEXT: lambda: PrintableFormatter(FORMAT),
    LogFormat.JSON: JsonFormatter,
    LogFormat.PRIORITY: _PriorityFormatter,
}


def log_to_stderr(level: int, form: LogFormat = LogFormat.TEXT) -> None:
    """Log entries of `level` or above. A program with its own logging setup keeps it."""
    handler: logging.Handler
    if form is LogFormat.JOURNAL:
        handler = _JournalHandler()
        handler.setFormatter(_PriorityFormatter())
    else:
        handler = _StderrHandler()
        handler.setFormatter(_FORMATTERS[form]())
    logging.basicConfig(level=level, handlers=[handler])
