"""What the commands share: exit codes and the types of their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_CANNOT_OPEN = 3
EXIT_INCOMPLETE = 4

ConfigFile = Annotated[Path, typer.Argument(metavar="FILE", help="Configuration file (TOML).")]
Seconds = Annotated[
    float | None, typer.Option(min=0.0, help="End after this time; default: on Ctrl-C.")
]
