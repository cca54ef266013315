"""Logging to standard error, by commands and by a session's process."""

from __future__ import annotations

import logging
import sys
from typing import TYPE_CHECKING, Any

from cardan.printable import PrintableFormatter

FORMAT = "%(asctime)s %(name)s: %(message)s"


if TYPE_CHECKING:
    _StreamHandler = logging.StreamHandler[Any]
else:
    _StreamHandler = logging.StreamHandler  # Not to be subscripted before Python 3.11.


class _StderrHandler(_StreamHandler):
    """Logs to what sys.stderr is at the time: a live view puts itself in its place."""

    def __init__(self) -> None:
        logging.Handler.__init__(self)
        self.setFormatter(PrintableFormatter(FORMAT))

    @property
    def stream(self) -> Any:
        return sys.stderr


def log_to_stderr(level: int) -> None:
    """Log what is of `level` or above. A program that has set logging up keeps its way."""
    logging.basicConfig(level=level, handlers=[_StderrHandler()])
