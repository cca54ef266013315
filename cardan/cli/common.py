"""Shared parts of the commands: exit codes, the types of their options, logs, and tables."""

from __future__ import annotations

import enum
import json
import logging
import math
import os
import posixpath
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from cardan.common import output
from cardan.common.logs import FORMAT_VARIABLE, LEVEL_VARIABLE, LogFormat, log_to_stderr
from cardan.common.plugins import Loaded
from cardan.common.text_sanitizer import printable
from cardan.common.troubles import coded
from cardan.errors import ConfigurationError, OptionError

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_CANNOT_OPEN = 3
EXIT_INCOMPLETE = 4

EPILOG = (
    "Exit codes: 0 success; 1 internal error, or nothing can be printed; 2 wrong configuration or "
    "usage; 3 a device or robot cannot be opened; 4 it ran, but with problems, which it names."
)


def closing(example: str) -> str:
    """Return the end of a command's help, with the example of its use."""
    return f"Example: {example.strip()}\n\n{EPILOG}"


def check_seconds(seconds: float | None) -> float | None:
    """Return a duration from the command line, s. Raises OptionError unless finite and at least
    0."""
    if seconds is not None and not 0.0 <= seconds < math.inf:
        raise OptionError("--seconds", seconds, "a finite number of seconds, 0 or more")
    return seconds


AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead, for programs.")]
ConfigFile = Annotated[Path, typer.Argument(metavar="FILE", help="Configuration file (TOML).")]
Seconds = Annotated[
    float | None,
    typer.Option(callback=check_seconds, help="End after this time; default: on Ctrl-C."),
]


class LogLevel(str, enum.Enum):
    """Lowest level that is logged on standard error."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Log everything: --log-level debug.")
]
Level = Annotated[
    LogLevel | None,
    typer.Option(
        "--log-level",
        help="Lowest level on standard error; default: info for simulated peers, else warning.",
    ),
]


def begin_serving(
    verbose: bool,
    level: LogLevel | None,
    default: LogLevel = LogLevel.WARNING,
    form: LogFormat | None = None,
) -> None:
    """Begin a command that runs until it is stopped: log to standard error, and never block on a
    reader of its output.

    Defaults: the level and form of the daemon that runs it, else `default` and text.

    Raises ConfigurationError for `verbose` with another level than debug.
    """
    if verbose and level not in (None, LogLevel.DEBUG):
        raise ConfigurationError("--verbose, --log-level", "give one of them")
    given = os.environ.get(LEVEL_VARIABLE, "")
    default = LogLevel(given) if given in {each.value for each in LogLevel} else default
    level = LogLevel.DEBUG if verbose else level or default
    given = os.environ.get(FORMAT_VARIABLE, "")
    form = form or (LogFormat(given) if given in {each.value for each in LogFormat} else None)
    log_to_stderr(getattr(logging, level.name), form or LogFormat.TEXT)
    output.keep_up()


def print_problem(words: str, keep: str = "") -> None:
    """Print a problem on standard error, with its code if it has one; `keep`: characters that are
    printed as they are."""
    print(f"cardan: {coded(printable(words, keep))}", file=sys.stderr)


def print_json(value: Any) -> None:
    """Print a value as one line of JSON; non-finite numbers become null."""
    print(json.dumps(_plain(value)), flush=True)


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, enum.Enum):
        return value.name.lower() if isinstance(value, int) else value.value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def print_unusable(found: Loaded[Any]) -> None:
    """Print a line for each plug-in that cannot be loaded or is not used."""
    for name, why in found.refused.items():
        print(f"{printable(name)}  {printable(why)}")
    for note in found.notes:
        print(printable(note))


def print_table(
    columns: Sequence[str], rows: Iterable[Iterable[str]], as_json: bool = False
) -> None:
    """Print rows of cells under the columns' names; or as JSON, a list of objects."""
    if as_json:
        keys = [each.replace(" ", "_") for each in columns]
        print_json([dict(zip(keys, cells, strict=True)) for cells in rows])
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(*columns, box=None)
    for cells in rows:
        # Brackets in a cell are not markup.
        table.add_row(*(Text(printable(cell), overflow="fold") for cell in cells))
    Console().print(table)


def page_path(page: str) -> str:
    """Return the path of a documentation page from the repository's root. `page` is relative to
    docs/. A URL or an empty text is returned unchanged."""
    return posixpath.normpath(f"docs/{page}") if page and "://" not in page else page
