"""What the commands share: exit codes, the types of their options, and tables."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_CANNOT_OPEN = 3
EXIT_INCOMPLETE = 4

ConfigFile = Annotated[Path, typer.Argument(metavar="FILE", help="Configuration file (TOML).")]
Seconds = Annotated[
    float | None, typer.Option(min=0.0, help="End after this time; default: on Ctrl-C.")
]


def print_table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print rows of cells under their columns' names."""
    table = Table(*columns, box=None)
    for cells in rows:
        table.add_row(*map(Text, cells))  # What stands in brackets is no markup.
    Console().print(table)
