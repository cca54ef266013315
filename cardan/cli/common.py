"""What the commands share: exit codes, the types of their options, and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cardan.errors import OptionError
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
