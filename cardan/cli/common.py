"""What the commands share: exit codes, the types of their options, logs, and tables."""

from __future__ import annotations

import enum
import logging
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cardan import output
from cardan.errors import ConfigurationError, OptionError
from cardan.logs import log_to_stderr
from cardan.plugins import Loaded
from cardan.printable import printable

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_CANNOT_OPEN = 3
EXIT_INCOMPLETE = 4


def check_seconds(seconds: float | None) -> float | None:
    """A duration from the command line, s. Raises OptionError unless it is 0 or more, and ends."""
    if seconds is not None and not 0.0 <= seconds < math.inf:
        raise OptionError("--seconds", seconds, "a finite number of seconds, 0 or more")
    return seconds


ConfigFile = Annotated[Path, typer.Argument(metavar="FILE", help="Configuration file (TOML).")]
Seconds = Annotated[
    float | None,
    typer.Option(callback=check_seconds, help="End after this time; default: on Ctrl-C."),
]


class LogLevel(str, enum.Enum):
    """Least level of what is logged on standard error."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Log all there is: --log-level debug.")
]
Level = Annotated[
    LogLevel | None,
    typer.Option(
        "--log-level",
        help="What is logged on standard error; default: info of simulated peers, else warning.",
    ),
]


def begin_serving(
    verbose: bool, level: LogLevel | None, default: LogLevel = LogLevel.WARNING
) -> None:
    """Begin a command that runs until it is told to end: its log goes to standard error, and
    nobody who does not read its output holds it up.

    Raises ConfigurationError for `verbose` with another level than debug.
    """
    if verbose and level not in (None, LogLevel.DEBUG):
        raise ConfigurationError("--verbose, --log-level", "give one of them")
    level = LogLevel.DEBUG if verbose else level or default
    log_to_stderr(getattr(logging, level.name))
    output.keep_up()


def print_unusable(found: Loaded[Any]) -> None:
    """Print a line for each plug-in that cannot be loaded or is not used."""
    for name, why in found.refused.items():
        print(f"{printable(name)}  {printable(why)}")
    for note in found.notes:
        print(printable(note))


def print_table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print rows of cells under their columns' names."""
    table = Table(*columns, box=None)
    for cells in rows:
        # What stands in brackets is no markup.
        table.add_row(*(Text(printable(cell)) for cell in cells))
    Console().print(table)
