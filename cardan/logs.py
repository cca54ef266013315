"""Logging to standard error, by commands and by a session's process."""

from __future__ import annotations

import logging
import sys

from cardan.printable import PrintableFormatter

FORMAT = "%(asctime)s %(name)s: %(message)s"


class _StderrHandler(logging.Handler):
    """Logs to what sys.stderr is at the time: a live view puts itself in its place."""

    def __init__(self) -> None:
        super().__init__()
        self.setFormatter(PrintableFormatter(FORMAT))

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line. An error is no concern of who logs."""
        try:
            sys.stderr.write(self.format(record) + "\n")
            sys.stderr.flush()
        except Exception:
            self.handleError(record)


def log_to_stderr(level: int) -> None:
    """Log what is of `level` or above. A program that has set logging up keeps its way."""
    logging.basicConfig(level=level, handlers=[_StderrHandler()])
